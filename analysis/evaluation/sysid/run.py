"""Tune logs of machines that no engine simulated with their owners' models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from analysis.evaluation.sysid.outcomes import MachineTrial, SysidOutcome, outcomes_of, trials
from analysis.evaluation.sysid.targets import MACHINES
from analysis.processes import Piece, parallel_map
from tunenet_logs.terminal import Progress

NOISES = (1.0, 0.5, 2.0)  # times the noise that the logs usually have


@dataclass(frozen=True)
class SysidOrder:
    """Settings of the experiment.

    Attributes:
        seeds: each with its own logs.
        logs: for each seed, machine and section; see `trials`.
        sections: of `choices.SYSID_SECTIONS`.
        jobs: processes; None for all cores.
    """

    seeds: Sequence[int]
    logs: int
    sections: Sequence[str]
    jobs: int | None = None


def sysid_sections(
    order: SysidOrder, progress: Progress
) -> Iterator[tuple[str, list[SysidOutcome]]]:
    """Yield all results section by section."""
    for section in order.sections:
        wanted = trials([section], order.seeds, order.logs, NOISES)
        pieces = [Piece(trial, name=_name(trial)) for trial in wanted]
        found = parallel_map(outcomes_of, pieces, order.jobs, progress, (section, "log"))
        yield section, [one for some in found for one in some]


def _name(trial: MachineTrial) -> str:
    return f"{MACHINES[trial.machine].name} {trial.seed}"
