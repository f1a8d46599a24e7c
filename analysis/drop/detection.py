"""A drop as it was detected in an episode, and the estimation problem that it poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from analysis.drop import observations as views
from analysis.drop.film import FilmedDrop, canonical_film, find_filmed_drop, image_rows
from analysis.drop.free_fall import Drop
from analysis.estimators.base import FitResult, Observation, Problem
from analysis.tracking.track import Track
from recorders.simulators.balls import Ball
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from recorders.simulators.drop import DropRig, DropSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError, UsageError

HIGHEST_M = 100.0
"""Of a drop: from higher up lengths are more likely in mm or cm than in m."""

DISAGREEMENT = "let go without spin, over a hard and level surface, and compare"
"""What to do where a cross-check of a drop disagrees."""

_SLOW_M = 6.0
"""A fall this high by the clock was more likely filmed in slow motion."""

_MOST_NAMED = 5
"""Later drops that a warning lists."""

TOO_SHORT = (
    "the paper's network needs 400 samples at 60 Hz: record 6.7 s from the release on, "
    "or use --preset default"
)


@dataclass(frozen=True, eq=False)
class DropDetection:
    """A drop in recorded positions, as one preset looks at it.

    Attributes:
        physical: whether the preset simulates the ball itself, or the paper's engine.
        topic: where the ball's position came from.
        start_ns: where the drop's clock is 0: the first sample of the log's signal.
        drop: with heights along `up`.
        sideways_m: horizontal positions in the drop's window [m], shape (T, any).
        target: o_T.
        warnings: what a user should know, in words.
    """

    physical: bool
    topic: str
    start_ns: int
    drop: Drop
    sideways_m: Array
    target: Observation
    warnings: tuple[str, ...]
    film: None = None

    @property
    def window(self) -> Mapping[str, float]:
        """Its first sample, first impact and last sample [s]."""
        first_s, last_s = self.drop.seconds[[0, -1]]
        return {"start_s": first_s, "impact_s": self.drop.impact_s, "end_s": last_s}

    @property
    def extent(self) -> tuple[str, str]:
        """How high the ball fell from."""
        return "drop", f"{self.drop.drop_height_m:.3f} m"


@dataclass(frozen=True, eq=False)
class FilmDetection:
    """A ball tracked in pictures. The drop that it makes is reconstructed when first needed.

    Attributes:
        physical: whether the preset simulates the ball itself, or the paper's engine.
        topic: where the pictures came from.
        start_ns: where the drop's clock is 0: the first picture.
        track: the ball in every picture.
        ball: what was dropped, as far as it is known.
        fit_drag: whether the air's drag is to be found, and not the slope of the restitution.
        height_m: of the drop, as the log says; None where it does not.
        unread: what could not be read of the pictures, in words; "" if nothing.
        taken_ns: when a picture was taken, by its stamp, for those that are stamped later.
        track_warnings: what a user should know of pictures and track, in words.
    """

    physical: bool
    topic: str
    start_ns: int
    track: Track
    ball: Ball
    fit_drag: bool = False
    height_m: float | None = None
    unread: str = ""
    taken_ns: Mapping[int, int] = field(default_factory=dict)
    track_warnings: tuple[str, ...] = ()

    @cached_property
    def film(self) -> FilmedDrop:
        """The drop with the camera that explains the track.

        Raises:
            NotFoundError: the track shows no drop.
        """
        return find_filmed_drop(self.track, self.start_ns, self.ball, fit_drag=self.fit_drag)

    @property
    def drop(self) -> Drop:
        """Its heights by the film's own scale, which is time."""
        return self.film.drop

    @property
    def window(self) -> Mapping[str, float]:
        """Its first sample, first impact and last sample [s]."""
        first_s, last_s = self.drop.seconds[[0, -1]]
        return {"start_s": first_s, "impact_s": self.drop.impact_s, "end_s": last_s}

    @property
    def extent(self) -> tuple[str, str]:
        """How high the ball fell from."""
        return "drop", f"{self.drop.drop_height_m:.3f} m"

    @property
    def sideways_m(self) -> Array:
        """Distance from the image's vertical [m], shape (T, 1)."""
        return self.film.sideways[:, None] * self.film.drop.drop_height_m

    @cached_property
    def target(self) -> Observation:
        """o_T.

        Raises:
            NotFoundError: the film is too short for the paper's network.
        """
        if self.physical:
            return canonical_film(self.film)
        target = image_rows(self.film, views.paper_start_s(self.drop))
        if np.isnan(target.values).any():
            raise NotFoundError(TOO_SHORT)
        return target

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know, in words."""
        found = list(self.track_warnings)
        height_m = self.drop.drop_height_m
        if not self.physical:
            found.append(
                f"a fall of {height_m:.2f} m by this camera; the paper's network was "
                "trained on a ball of 0.5 m radius falling from 4 to 5 m, before the paper's "
                "cameras"
            )
            if self.fit_drag or self.ball.drag_1_m is not None:
                found.append(
                    "the ball's mass and size, --fit-drag not used: the paper's network has no air"
                )
            return tuple(found)
        film = self.film
        last = float(film.projection.fall_times(film.drop.seconds[-1:])[0])
        starts, _ = film.projection.bounce.flights(last)
        if self.fit_drag and (len(starts) < 2 or starts[1] > last):
            found.append(
                "one flight tells little of the air's drag: film more bounces, or --ball NAME"
            )
        if film.later_s:
            at = ", ".join(f"{later:.2f} s" for later in film.later_s[:_MOST_NAMED])
            found.append(
                f"more drops seem to follow, at {at}; the first is used (see --start, --end)"
            )
        if height_m >= _SLOW_M:
            found.append(
                f"falls {height_m:.1f} m by the clock: slow motion? the restitution is the same; "
                "for true heights and speeds record it with tunenet-record --camera FILE --fps RATE"
            )
        return tuple(found)


AnyDetection = DropDetection | FilmDetection


def drop_problem(
    detection: AnyDetection,
    initial: Array,
    exact_fit: Callable[[Array], FitResult | None],
) -> Problem:
    """A simulator with the drop's own height, rate and release; `initial` has the shape (1,).

    Raises:
        NotFoundError: the track shows no drop, or the simulator cannot be set up like it.
        UsageError: the initial value is out of bounds.
    """
    try:
        rig, contact = rig_like(detection)
    except UsageError as error:  # the user chose nothing here: the log asks for it
        height_m = detection.drop.drop_height_m
        unit = f"the ball falls {height_m:.4g} m; are the lengths in mm or cm? give them in m"
        why = unit if height_m >= HIGHEST_M else error
        raise NotFoundError(f"this drop cannot be simulated: {why}") from error
    simulator = DropSimulator(rig, contact)
    if contact == PAPER:
        view = views.paper_rollout if detection.film is None else views.paper_unit_heights
        return Problem(detection.target, simulator, view, initial)
    return Problem(
        detection.target,
        simulator,
        lambda episode: views.canonical(views.rollout_drop(episode, rig, contact)),
        initial,
        exact_fit,
    )


def rig_like(detection: AnyDetection) -> tuple[DropRig, ContactSettings]:
    """The rig whose rollouts show the same drop at the same stamps."""
    drop, start_ns = detection.drop, detection.start_ns
    if not detection.physical:
        gap = drop.release_m - drop.table_m
        start_ns += round(1e9 * views.paper_start_s(drop))
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
        start_ns=start_ns + round(1e9 * first_s),
    )
    return rig, CALIBRATED
