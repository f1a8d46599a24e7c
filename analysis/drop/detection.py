"""A drop that was found in an episode, and the estimation problem that it poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from analysis.drop import observations as views
from analysis.drop.film import FilmedDrop
from analysis.drop.free_fall import Drop
from analysis.estimators.base import Problem
from analysis.estimators.observation import Observation
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from recorders.simulators.drop import DropRig, DropSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError, UsageError

_HIGHEST_M = 100.0

DISAGREEMENT = "let go without spin, over a hard and level surface, and compare"
"""What to do where a cross-check of a drop disagrees."""


@dataclass(frozen=True, eq=False)
class DropDetection:
    """A drop in an episode, as one preset looks at it.

    Attributes:
        physical: whether the preset simulates the ball itself, or the paper's engine.
        topic: where the ball's position, or its pictures, came from.
        drop: with heights along `up`.
        start_ns: where the drop's clock is 0: the first sample of the log's signal.
        sideways_m: horizontal positions in the drop's window [m], shape (T, any).
        target: o_T.
        warnings: what a user should know, in words.
        film: the track and where heights are in the picture; None for a drop that was measured.
        unread: what could not be read of its pictures, in words; "" if nothing.
        taken_ns: when a picture was taken, by its stamp, of those that are stamped later.
        known_m: ball diameter and drop height as the log says; None where it does not.
    """

    physical: bool
    topic: str
    drop: Drop
    start_ns: int
    sideways_m: Array
    target: Observation
    warnings: tuple[str, ...]
    film: FilmedDrop | None = None
    unread: str = ""
    taken_ns: Mapping[int, int] = field(default_factory=dict)
    known_m: tuple[float | None, float | None] = (None, None)

    @property
    def window(self) -> Mapping[str, float]:
        """Its first sample, first impact and last sample [s]."""
        seconds = self.drop.seconds
        return {"start_s": seconds[0], "impact_s": self.drop.impact_s, "end_s": seconds[-1]}

    @property
    def extent(self) -> tuple[str, str]:
        """How high the ball fell from."""
        return "drop", f"{self.drop.drop_height_m:.3f} m"

    @property
    def step_hz(self) -> float:
        """The simulator's steps a second (and one more at each impact, by default)."""
        if not self.physical:
            return views.PAPER_RATE_HZ
        return 1 / float(np.median(np.diff(self.drop.seconds)))


def drop_problem(found: DropDetection, initial: Array) -> Problem:
    """A simulator with the drop's own height, rate and release.

    Raises:
        NotFoundError: the simulator cannot be set up like it.
        UsageError: the initial value is out of bounds.
    """
    try:
        rig, contact = rig_like(found)
    except UsageError as error:  # the user chose nothing here: the log asks for it
        hint = _too_high(found.drop.drop_height_m)
        raise NotFoundError(f"this drop cannot be simulated: {hint or error}") from error
    simulator = DropSimulator(rig, contact)
    if contact == PAPER:
        view = views.paper_rollout if found.film is None else views.paper_unit_heights
        return Problem(found.target, simulator, view, initial)
    observe = partial(_observe_rollout, rig=rig, contact=contact)
    return Problem(found.target, simulator, observe, initial)


def _too_high(drop_height_m: float) -> str:
    if drop_height_m < _HIGHEST_M:
        return ""
    return f"the ball falls {drop_height_m:.4g} m; are the lengths in mm or cm? give them in m"


def rig_like(found: DropDetection) -> tuple[DropRig, ContactSettings]:
    """The rig whose rollouts show the same drop at the same stamps."""
    drop = found.drop
    if not found.physical:
        gap = drop.release_m - drop.table_m
        start_ns = found.start_ns + round(1e9 * views.paper_start_s(drop))
        return DropRig(gap, views.PAPER_RADIUS_M, views.PAPER_RATE_HZ, start_ns=start_ns), PAPER
    period_s = float(np.median(np.diff(drop.seconds)))
    fall_s = float(np.sqrt(2 * drop.drop_height_m / CALIBRATED.gravity_m_s2))
    hold_s = drop.impact_s - fall_s - drop.seconds[0]
    earlier = max(0, int(np.ceil(-hold_s / period_s)))
    wanted_s = drop.impact_s + (views.CANONICAL_SPAN + 1) * drop.fall_time_s
    last_s = max(float(drop.seconds[-1]), wanted_s)
    first_s = drop.seconds[0] - earlier * period_s
    rig = DropRig(
        gap_m=drop.drop_height_m,
        rate_hz=1 / period_s,
        samples=int(np.ceil((last_s - first_s) / period_s)) + 1,
        hold_s=hold_s + earlier * period_s,
        start_ns=found.start_ns + round(1e9 * first_s),
    )
    return rig, CALIBRATED


def _observe_rollout(episode: Episode, rig: DropRig, contact: ContactSettings) -> Observation:
    return views.canonical(views.rollout_drop(episode, rig, contact))
