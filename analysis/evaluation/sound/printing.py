"""Print the results of `tunenet-eval sound`, and list the files it can write."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from analysis.evaluation.choices import SOUND_SECTIONS, chosen_sections
from analysis.evaluation.writing import write_json_to, write_text_to

if TYPE_CHECKING:
    from analysis.evaluation.printing import Writers
    from tunenet_logs.terminal import Progress


def print_sound(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run bounces by ear, alone and beside pictures; see `Experiment`."""
    from analysis.evaluation.sound.records import sound_csv, sound_json
    from analysis.evaluation.sound.run import SoundOrder, SoundOutcome, sound_sections
    from analysis.evaluation.sound.tables import sound_table

    wanted = chosen_sections(arguments, SOUND_SECTIONS)
    order = SoundOrder(seeds, arguments.targets, wanted, arguments.jobs)
    found: list[tuple[str, SoundOutcome]] = []

    def blocks() -> Iterator[str]:
        for section, outcomes in sound_sections(order, progress):
            if section != "phyphox" or "alone" not in wanted:
                found.extend((section, one) for one in outcomes)
            yield sound_table(section, outcomes, order)

    return blocks(), {
        "json": lambda to: write_json_to(to, sound_json(found, order)),
        "csv": lambda to: write_text_to(to, sound_csv(found)),
    }
