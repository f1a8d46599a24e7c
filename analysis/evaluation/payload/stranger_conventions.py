"""Measure how often a log reveals its driver's torque convention.

A torque is the joint's or the load's, with the arm's weight in it or without. Strangers' logs
without a tare, light and full ones in turn, are given as each of the four drivers would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np

from analysis.evaluation.payload.stranger_arm import (
    FULL,
    LIGHT,
    StrangerRun,
    described_arm,
    stranger_log,
)
from analysis.evaluation.payload.strangers import (
    PORTION,
    StrangerAnswer,
    stranger_answer,
    stranger_numbers,
)
from analysis.payload.torque_model import CONVENTIONS, Convention
from analysis.processes import Piece, parallel_map
from recorders.simulators.arm.description import JACO_TOOL_LINK, JACO_URDF
from tunenet_logs.episode import Episode
from tunenet_logs.terminal import Progress

# Of a log; who trusts `ok` is misled by the third alone.
OUTCOMES = ("right and ok", "right and suspect", "wrong and ok", "wrong and suspect", "rejected")

_TROUBLES = (LIGHT, FULL)


@dataclass(frozen=True)
class ConventionRow:
    """Logs of drivers with one convention.

    Attributes:
        convention: what they mean; None for all drivers together.
        logs: how many.
        outcomes: how many of them, by the words of `OUTCOMES`.
    """

    convention: Convention | None
    logs: int
    outcomes: Mapping[str, int]


@dataclass(frozen=True)
class _Asked:
    """One log.

    Attributes:
        number: that it is drawn from.
        at: its place among all, which says the troubles and the convention.
    """

    number: int
    at: int

    @property
    def convention(self) -> Convention:
        return CONVENTIONS[self.at // len(_TROUBLES) % len(CONVENTIONS)]


def convention_rows(
    seeds: Sequence[int], count: int, jobs: int | None, progress: Progress
) -> list[ConventionRow]:
    """Tune `count` logs in equal shares of the seeds: a row each convention, and one of all."""
    asked = [_Asked(number, at) for at, number in enumerate(stranger_numbers(seeds, count))]
    parts = [tuple(asked[at : at + PORTION]) for at in range(0, len(asked), PORTION)]
    pieces = [Piece(part, len(part), "") for part in parts]
    done = parallel_map(_outcomes, pieces, jobs, progress, ("conventions", "log"))
    told = [what for part in done for what in part]
    rows = []
    for meant in (*CONVENTIONS, None):
        pairs = zip(asked, told, strict=True)
        own = [what for one, what in pairs if meant in (None, one.convention)]
        counts = {what: own.count(what) for what in OUTCOMES}
        rows.append(ConventionRow(meant, len(own), counts))
    return rows


def _outcomes(asked: tuple[_Asked, ...]) -> list[str]:
    found = []
    for one in asked:
        troubles = _TROUBLES[one.at % len(_TROUBLES)]
        log = stranger_log(JACO_URDF, JACO_TOOL_LINK, one.number, troubles)
        meant = as_meant(described_arm(JACO_URDF), log.held, one.convention)
        found.append(outcome(one.convention, stranger_answer(meant, ())))
    return found


def outcome(meant: Convention, answer: StrangerAnswer | None) -> str:
    """Classify an answer as one of `OUTCOMES`."""
    if answer is None:
        return "rejected"
    known = "right" if answer.convention == meant else "wrong"
    return f"{known} and {'ok' if answer.is_ok else 'suspect'}"


def as_meant(model: Any, run: StrangerRun, convention: Convention) -> Episode:
    """Convert a run to another driver's convention, given Pinocchio's model of the empty arm."""
    position = run.episode.signals["/joint_states.position"]
    effort = run.episode.signals["/joint_states.effort"]
    values = np.array(effort.values)
    if not convention.has_gravity:
        library, data = import_module("pinocchio"), model.createData()
        weight = library.computeGeneralizedGravity
        values -= np.array([weight(model, data, row).copy() for row in position.values])
    turned = replace(effort, values=convention.sign * values)
    return replace(run.episode, signals={position.name: position, effort.name: turned})
