"""Print the results of `tunenet-eval sysid`, and list the files it can write."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from analysis.evaluation.choices import SYSID_SECTIONS, chosen_sections
from analysis.evaluation.writing import write_json_to, write_text_to

if TYPE_CHECKING:
    from analysis.evaluation.printing import Writers
    from tunenet_logs.terminal import Progress


def print_sysid(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Tune users' models from logs of machines that no engine simulated; see `Experiment`."""
    from analysis.evaluation.sysid.outcomes import SysidOutcome
    from analysis.evaluation.sysid.records import sysid_csv, sysid_json
    from analysis.evaluation.sysid.run import SysidOrder, sysid_sections
    from analysis.evaluation.sysid.tables import sysid_table

    wanted = chosen_sections(arguments, SYSID_SECTIONS)
    order = SysidOrder(seeds, arguments.targets, wanted, arguments.jobs)
    all_of_them: list[SysidOutcome] = []

    def blocks() -> Iterator[str]:
        for section, outcomes in sysid_sections(order, progress):
            all_of_them.extend(outcomes)
            yield sysid_table(section, outcomes, order)

    return blocks(), {
        "json": lambda to: write_json_to(to, sysid_json(all_of_them, order)),
        "csv": lambda to: write_text_to(to, sysid_csv(all_of_them)),
    }
