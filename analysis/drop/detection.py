"""A drop as it was detected in an episode, and the estimation problem that it poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from analysis.drop import observations as views
from analysis.drop.bounce_fit import BounceFit, fit_bounce
from analysis.drop.bounce_model import BounceSamples
from analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from analysis.drop.bounce_samples import FEWEST_SAMPLES
from analysis.drop.film import FilmedDrop, canonical_film, find_filmed_drop, image_rows
from analysis.drop.free_fall import Drop
from analysis.drop.positions_fit import fit_positions, fitted_drop, samples_of
from analysis.drop.rebounds import fitted_rebounds
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

_HIGHEST_SIMULATED_M = 1000.0
"""Of a drop in the log's unit of length."""

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
        found: the drop by the parabolas of its fall and first flight, with heights along `up`.
        outliers: samples that were left out: no ball can have been there.
        sideways_m: horizontal positions in the drop's window [m], shape (T, any).
        ball: what was dropped, as far as it is known.
        warnings: what a user should know, in words.
    """

    physical: bool
    topic: str
    start_ns: int
    found: Drop
    outliers: int
    sideways_m: Array
    ball: Ball
    warnings: tuple[str, ...]
    film: None = None

    @cached_property
    def posterior(self) -> BallPosterior | None:
        """What the samples say of the ball; None where they are too few for a fit."""
        fit = fit_positions(self.found, self.ball.drag_1_m)
        return None if fit is None else ball_posterior(fit)

    @cached_property
    def drop(self) -> Drop:
        """With the fall as the fitted ball has it: air makes it longer than a parabola does."""
        if not self.physical or self.posterior is None:
            return self.found
        return fitted_drop(self.found, self.posterior.fit)

    @cached_property
    def target(self) -> Observation:
        """o_T.

        Raises:
            NotFoundError: the log is too short for the paper's network.
        """
        if self.physical:
            return views.canonical(self.drop)
        target = views.paper_heights(self.drop)
        if np.isnan(target.values).any():
            raise NotFoundError(TOO_SHORT)
        return target

    @property
    def observed(self) -> BounceSamples:
        """All samples of the drop, in m."""
        return samples_of(self.found, self.ball.drag_1_m)

    def begun(self, until_s: float) -> BounceFit | None:
        """The fit to what is seen until then [s]; None where that is too little."""
        drop = self.found
        count = int(np.searchsorted(drop.seconds, until_s, side="right"))
        if count < FEWEST_SAMPLES or until_s < drop.impact_s:
            return None
        part = replace(drop, seconds=drop.seconds[:count], heights_m=drop.heights_m[:count])
        return fit_positions(part, self.ball.drag_1_m)

    @property
    def window(self) -> Mapping[str, float]:
        """Its first sample, first impact and last sample [s]."""
        return _window(self.drop)

    @property
    def extent(self) -> tuple[str, str]:
        """How high the ball fell from."""
        return "drop", f"{self.drop.drop_height_m:.3f} m"


def _window(drop: Drop) -> Mapping[str, float]:
    first_s, last_s = drop.seconds[[0, -1]]
    return {"start_s": first_s, "impact_s": drop.impact_s, "end_s": last_s}


@dataclass(frozen=True, eq=False)
class FilmDetection:
    """A ball tracked in pictures. The drop that it makes is reconstructed when first needed.

    Attributes:
        physical: whether the preset simulates the ball itself, or the paper's engine.
        topic: where the pictures came from.
        start_ns: where the drop's clock is 0: the first picture.
        track: the ball in every picture.
        ball: what was dropped, as far as it is known.
        height_m: of the drop, as the log says; None where it does not.
        unread: what could not be read of the pictures, in words; "" if nothing.
        taken_ns: when a picture was taken, by its stamp, for those that are stamped later.
        track_warnings: what a user should know of pictures and track, in words.
        outliers: none: what is not the ball was not tracked.
    """

    physical: bool
    topic: str
    start_ns: int
    track: Track
    ball: Ball
    height_m: float | None = None
    unread: str = ""
    taken_ns: Mapping[int, int] = field(default_factory=dict)
    track_warnings: tuple[str, ...] = ()
    outliers: int = 0

    @cached_property
    def film(self) -> FilmedDrop:
        """The drop with the camera that explains the track.

        Raises:
            NotFoundError: the track shows no drop.
        """
        return find_filmed_drop(self.track, self.start_ns, self.ball)

    @property
    def drop(self) -> Drop:
        """Its heights by the film's own scale, which is time."""
        return self.film.drop

    @property
    def posterior(self) -> BallPosterior:
        """What the track says of the ball."""
        return self.film.posterior

    @property
    def window(self) -> Mapping[str, float]:
        """Its first sample, first impact and last sample [s]."""
        return _window(self.drop)

    @cached_property
    def observed(self) -> BounceSamples:
        """The ball in all pictures from the drop's first one on, in px."""
        track, film = self.track, self.film
        found = np.flatnonzero(np.isfinite(track.places_px).all(axis=1))
        stamps_ns, first = np.unique(track.stamps_ns[found], return_index=True)
        along = -(track.places_px[found[first]] @ film.down_px)
        seconds = (stamps_ns - self.start_ns).astype(np.float64) * 1e-9
        inside = (seconds >= self.drop.seconds[0]) & (seconds <= film.end_s)
        return replace(film.fit.samples, seconds=seconds[inside], positions=along[inside])

    def begun(self, until_s: float) -> BounceFit | None:
        """The fit to what is seen until then [s]; None where that is too little."""
        fit = self.film.fit
        samples = fit.samples.only(fit.samples.seconds <= until_s)
        samples = replace(samples, bends_s=tuple(at for at in samples.bends_s if at < until_s))
        if len(samples.seconds) < FEWEST_SAMPLES:
            return None
        return fit_bounce(samples, fit.unknowns, samples.unknowns)

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
            if self.ball.drag_1_m is not None:
                found.append("the ball's mass and size not used: the paper's network has no air")
            return tuple(found)
        film = self.film
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


def drop_problem(detection: AnyDetection, initial: Array) -> Problem:
    """A simulator with the drop's own height, stamps and release.

    Args:
        detection: the drop.
        initial: restitution, slope and drag [1/m], or the first of these, shape (P,).

    Raises:
        NotFoundError: the track shows no drop, or the simulator cannot be set up like it.
        UsageError: the initial value is out of bounds.
    """
    try:
        if detection.drop.drop_height_m > _HIGHEST_SIMULATED_M:
            raise UsageError("it is too high")
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

    def exact_fit(start: Array) -> FitResult | None:
        """The ball that explains all samples best; more values than `start` has are left away."""
        posterior = detection.posterior
        if posterior is None:
            return None
        count = len(start)
        rebounds = fitted_rebounds(posterior)
        return FitResult(posterior.values[:count], posterior.interval95[:count], detail=rebounds)

    return Problem(
        detection.target,
        simulator,
        lambda episode: views.canonical(views.rollout_drop(episode, rig, contact)),
        initial,
        exact_fit,
        np.array([1.0, 1.0, 1 / rig.gap_m])[: len(initial)],
    )


def rig_like(detection: AnyDetection) -> tuple[DropRig, ContactSettings]:
    """The rig whose rollouts show the same drop at the same stamps."""
    drop, start_ns = detection.drop, detection.start_ns
    if not detection.physical:
        gap = drop.release_m - drop.table_m
        start_ns += round(1e9 * views.paper_start_s(drop))
        return DropRig(gap, views.PAPER_RADIUS_M, views.PAPER_RATE_HZ, start_ns=start_ns), PAPER
    period_s = float(np.median(np.diff(drop.seconds)))
    seconds = detection.observed.seconds
    wanted_s = drop.impact_s + (views.CANONICAL_SPAN + 1) * drop.fall_time_s
    missing = max(0, int(np.ceil((wanted_s - seconds[-1]) / period_s)))
    seconds = np.concatenate([seconds, seconds[-1] + period_s * np.arange(1, missing + 1)])
    first_s = min(float(seconds[0]), drop.release_s)
    rig = DropRig(
        gap_m=CALIBRATED.gravity_m_s2 * drop.fall_time_s**2 / 2,
        rate_hz=1 / period_s,
        samples=len(seconds),
        hold_s=drop.release_s - first_s,
        start_ns=start_ns + round(1e9 * first_s),
        times_s=tuple((seconds - first_s).tolist()),
    )
    return rig, CALIBRATED
