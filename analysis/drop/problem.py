"""Estimation problem of a detected drop: a simulator that drops or throws it alike."""

from __future__ import annotations

import numpy as np

from analysis.drop import observations as views
from analysis.drop.contact_clock import contact_clock
from analysis.drop.detection import AnyDetection
from analysis.drop.remedies import DENSER, GOOD_DROP, RIGHT_LENGTHS
from analysis.estimators.base import FitResult, Problem
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from recorders.simulators.drop import DropRig, DropSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError, UsageError

HIGHEST_M = 100.0  # of a drop: from higher up lengths are more likely in mm or cm than in m
# Where the log tells no unit, and what was found is no drop in any.
NO_FALL = (
    "no fall of a ball is seen in it: what moves there falls neither freely nor onto a table "
    "(see --start, --end for a part)"
)

_HIGHEST_SIMULATED_M = 1000.0  # of a drop in the log's unit of length
# Samples after the end of a recording that a rollout may have, for each that was recorded.
_MAX_MISSING = 100

_SHORT = 1e-5  # of a speed that is a difference of two heights [fall times]


def drop_problem(detection: AnyDetection, initial: Array) -> Problem:
    """Set up a simulator with the drop's own height, stamps and release.

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
        if height_m >= HIGHEST_M and detection.units.length_m is None:
            raise NotFoundError(NO_FALL, GOOD_DROP) from error
        is_high = height_m >= HIGHEST_M
        why = f"the ball falls {height_m:.4g} m; are the lengths in mm or cm?" if is_high else error
        remedy = RIGHT_LENGTHS if is_high else GOOD_DROP
        raise NotFoundError(f"this drop cannot be simulated: {why}", remedy) from error
    simulator = DropSimulator(rig, contact)
    height_m = contact.gravity_m_s2 * detection.drop.fall_time_s**2 / 2
    if contact == PAPER:
        view = views.paper_rollout if detection.film is None else views.paper_unit_heights
        return Problem(detection.target, simulator, view, initial)

    def exact_fit(start: Array) -> FitResult | None:
        """Return the ball that explains all samples best, as many values as `start` has."""
        posterior = detection.posterior
        if posterior is None:
            return None
        count = len(start)
        rebounds = detection.rebounds
        return FitResult(posterior.values[:count], posterior.interval95[:count], detail=rebounds)

    return Problem(
        detection.target,
        simulator,
        lambda episode: views.canonical(views.rollout_drop(episode, rig, contact, height_m)),
        initial,
        exact_fit,
        np.array([1.0, 1.0, 1 / height_m])[: len(initial)],
    )


def _at_launch(detection: AnyDetection, drop_height_m: float) -> tuple[float, float]:
    """Return height over contact [m] and upward speed [m/s] of a thrown ball's first sample."""
    posterior = detection.posterior
    if posterior is None:
        raise NotFoundError("too few samples of the ball's flights are seen", DENSER)
    view = posterior.fit.projection()
    at = view.fall_times(np.array([detection.drop.release_s]))[0]
    low, here, high = view.bounce.heights(at + _SHORT * np.array([-1.0, 0.0, 1.0])) * drop_height_m
    return max(float(here), 0.0), float((high - low) / (2 * _SHORT * view.fall_time_s))


def rig_like(detection: AnyDetection) -> tuple[DropRig, ContactSettings]:
    """Build the rig whose rollouts show the same drop at the same stamps."""
    drop, start_ns = detection.drop, detection.start_ns
    if not detection.physical:
        gap = drop.release_m - drop.table_m
        start_ns += round(1e9 * views.paper_start_s(drop))
        return DropRig(gap, views.PAPER_RADIUS_M, views.PAPER_RATE_HZ, start_ns=start_ns), PAPER
    period_s = float(np.median(np.diff(drop.seconds)))
    seconds = detection.observed.seconds
    wanted_s = drop.impact_s + (views.CANONICAL_SPAN + 1) * drop.fall_time_s
    missing = max(0, int(np.ceil((wanted_s - seconds[-1]) / period_s)))
    if missing > _MAX_MISSING * len(seconds):
        raise UsageError("its stamps are too uneven: most are close together, and some far apart")
    seconds = np.concatenate([seconds, seconds[-1] + period_s * np.arange(1, missing + 1)])
    seconds = contact_clock(detection).to_free(seconds)
    first_s = min(float(seconds[0]), drop.release_s)
    gap_m, speed_m_s = CALIBRATED.gravity_m_s2 * drop.fall_time_s**2 / 2, 0.0
    if drop.launched:
        gap_m, speed_m_s = _at_launch(detection, gap_m)
    rig = DropRig(
        gap_m=gap_m,
        speed_m_s=speed_m_s,
        rate_hz=1 / period_s,
        samples=len(seconds),
        hold_s=drop.release_s - first_s,
        start_ns=start_ns + round(1e9 * first_s),
        times_s=tuple((seconds - first_s).tolist()),
    )
    return rig, CALIBRATED
