"""Tuned simulator compared with the observation: sample by sample, nothing interpolated.

Positions are compared in m, films in px through the fitted camera, and both are reported in % of
the drop height. What counts is from the release to the last bounce in view. The problem that the
simulator is tuned by comes last.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop import DENSER, GOOD_DROP, RIGHT_LENGTHS
from tunenet_logs.analysis.drop.bounce_fit import MIN_SAMPLES, BounceFit, fit_bounce
from tunenet_logs.analysis.drop.bounce_model import BounceSamples, Projection, ideal_heights
from tunenet_logs.analysis.drop.bounce_posterior import (
    SLOPE_AND_DRAG,
    averaged_ball,
    unidentifiable,
)
from tunenet_logs.analysis.drop.detection import AnyDetection
from tunenet_logs.analysis.drop.presets import (
    CANONICAL_SPAN,
    PAPER_RADIUS_M,
    PAPER_RATE_HZ,
    canonical,
    paper_rollout,
    paper_start_s,
    paper_unit_heights,
    rollout_drop,
)
from tunenet_logs.analysis.estimators.base import FitResult, Problem, Step, Trace
from tunenet_logs.analysis.record import (
    MAX_SAMPLES,
    Curves,
    Equivalent,
    Equivalents,
    Motion,
    SimulationFit,
    excess,
)
from tunenet_logs.analysis.statistics import surer_noise_of
from tunenet_logs.episode import Array, median_step
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulators.ball import DRAG, Bounce, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED, GRAVITY_M_S2, PAPER, ContactSettings

# ---- Clock without contacts: a simulator's are far shorter than those of a ball that was heard


def contact_clock(detection: AnyDetection) -> tuple[Array, Array]:
    """Return when the fitted ball's contacts begin and end, one after the other, on two clocks.

    That of the log, and one that almost stands still while the ball touches, as far as it is seen;
    shape (2 N,) each [s], none where contacts last no time.
    """
    posterior = detection.posterior if detection.physical else None
    if posterior is None or not posterior.fit.samples.bounce(posterior.fit.unknowns).contact > 0:
        return np.zeros(0), np.zeros(0)
    view = posterior.fit.projection()
    ball, fall_s = view.bounce, view.fall_time_s
    until_s = float(detection.observed.seconds[-1])
    ends, _ = ball.flights(max((until_s - view.impact_s) / fall_s, 0.0))
    lasts_s = ball.contact * fall_s
    ends_s = view.impact_s + fall_s * ends
    log_s = np.column_stack([ends_s - lasts_s, ends_s]).ravel()
    # A thousandth of a contact passes, so that stamps increase.
    passed = np.ones(len(log_s)) * (1 - 1e-3) * lasts_s
    passed[::2] = 0.0
    return log_s, log_s - np.cumsum(passed)


def on_clock(seconds: Array, known: Array, wanted: Array) -> Array:
    """Convert times (T,) from one clock to another, by known moments on both, (2 N,) each."""
    if not len(known):
        return seconds
    before, after = wanted[0] - known[0], wanted[-1] - known[-1]
    inside = np.interp(seconds, known, wanted)
    moved = np.where(seconds < known[0], seconds + before, inside)
    return np.where(seconds > known[-1], seconds + after, moved)


# ---- Equivalent ball for simulators without air: one restitution, the same at every impact


def equivalents(view: Projection, seconds: Array, heights: Array) -> Equivalents | None:
    """Fit drag-free balls, dropped alike: to the first rebound, and to all samples.

    Those are of heights [drop heights] from the release to the last bounce in view, shape (T,).
    """
    if not len(seconds):
        return None
    ball = view.bounce
    starts, speeds = ball.flights(max((float(seconds[-1]) - view.impact_s) / view.fall_time_s, 0.0))
    if not len(starts) or not speeds[0]:
        return None
    # The height [drop heights] of a ball that leaves with a speed.
    speed = float(speeds[0])
    rise = (
        speed**2 / 4
        if ball.drag < 1e-7
        else float(np.log1p(ball.drag * speed**2 / 2) / (2 * ball.drag))
    )
    release_s = view.impact_s - view.fall_time_s * ball.fall_time
    times = (seconds - release_s) / view.fall_time_s - 1.0  # it falls for one fall time

    def nearest(tried: Array) -> float:
        """Return the least-squares restitution, all of them compared at once."""
        off = ideal_heights(tried[:, None], times) - heights
        return float(tried[int(np.argmin(np.einsum("rt,rt->r", off, off)))])

    best = nearest(np.linspace(0.02, 1.0, 99))  # the cost has many minima
    best = nearest(np.clip(best + np.linspace(-0.01, 0.01, 81), 0.0, 1.0))
    return Equivalents(
        _equivalent(float(np.sqrt(rise)), view, times, heights),
        _equivalent(best, view, times, heights),
    )


def _equivalent(restitution: float, view: Projection, times: Array, heights: Array) -> Equivalent:
    restitution = float(np.clip(restitution, 0.0, 1.0))
    airless = Bounce(restitution)
    starts, _ = airless.flights(float(times[-1]))
    count = min(int(np.count_nonzero(starts <= times[-1])), 20)  # impacts that are listed
    first_m_s = GRAVITY_M_S2 * view.fall_time_s
    off = airless.heights(times) - heights
    return Equivalent(
        restitution,
        100 * float(np.sqrt(np.mean(off**2))),
        tuple(first_m_s * restitution**bounce for bounce in range(max(count, 1))),
    )


# ---- Comparison of the last rollout with every sample in view, and the hold-out

_SAME_S = 2e-9  # stamps that differ by less are of one moment


def simulated(detection: AnyDetection, step: Step) -> tuple[Array, Array]:
    """Return an iterate's times on the log's clock [s] and heights [drop heights], each (T,)."""
    assert step.evaluation is not None
    episode = step.evaluation.episode
    signal = next(iter(episode.signals.values()))
    seconds = (signal.stamps_ns - detection.start_ns).astype(np.float64) * 1e-9
    log_s, free_s = contact_clock(detection)
    seconds = on_clock(seconds, free_s, log_s)
    rig = episode.info.rig
    heights_m = signal.values[:, 2] - rig["ball_diameter_m"] / 2
    unit_m = rig["drop_height_m"]
    if detection.physical:
        unit_m = CALIBRATED.gravity_m_s2 * detection.drop.fall_time_s**2 / 2
    return seconds, heights_m / unit_m


def simulated_m(detection: AnyDetection, step: Step) -> tuple[Array, Array]:
    """Return an iterate's times on the log's clock [s] and heights on the table [m], each (T,)."""
    seconds, heights = simulated(detection, step)
    assert step.evaluation is not None
    rig_m = step.evaluation.episode.info.rig["drop_height_m"]
    return seconds, heights * (detection.drop.drop_height_m if detection.physical else rig_m)


class _FittedView(NamedTuple):
    """Samples that a ball was fitted to, and that fit's camera."""

    fit: BounceFit
    view: Projection
    samples: BounceSamples
    noise: float  # of the samples by themselves, in their unit

    @property
    def relative_noise(self) -> float:
        """Noise in drop heights."""
        return self.noise / self.view.span

    def inside(self, detection: AnyDetection, seconds: Array) -> NDArray[np.bool_]:
        """Return which times are from the release to the last bounce in view.

        Not in a contact that is seen to last: there the ball is squashed, which no rollout shows.
        """
        end_s = last_bounce_s(self.view, float(seconds[-1]), self.relative_noise)
        if detection.film is not None:  # later flights follow no law that was fitted
            end_s = min(end_s, float(self.fit.samples.seconds[-1]))
        inside = (seconds >= detection.drop.release_s) & (seconds <= end_s)
        if self.samples.is_soft:
            inside &= ~self.view.touches(seconds, self.samples.exposure_s / 2)
        return inside


@lru_cache(maxsize=2)
def _fitted_view(detection: AnyDetection) -> _FittedView | None:
    """Return what a detection's ball was fitted to; None where the preset fits none."""
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        return None
    samples = detection.observed
    count, noise = (
        len(samples.positions),
        samples.noise * float(np.sqrt(1 - samples.distortion_variance_fraction)),
    )
    least = noise / 2 if count > 20 else noise
    noise = max(surer_noise_of(samples.positions, samples.seconds), least) if count > 3 else least
    return _FittedView(posterior.fit, posterior.fit.projection(), samples, noise)


@lru_cache(maxsize=1)
def simulation_fit(detection: AnyDetection, last: Step) -> SimulationFit | None:
    """Compare the last rollout with every sample in view; None where there is no camera for it.

    The checks and the record ask for the same one: it is kept until the next.
    """
    seen = _fitted_view(detection)
    if seen is None:
        return None
    _, view, samples, noise = seen
    simulated_s, heights = simulated(detection, last)
    at, rows = matched(samples.seconds, simulated_s)
    seconds, positions, heights = samples.seconds[at], samples.positions[at], heights[rows]
    inside = seen.inside(detection, seconds)
    if np.count_nonzero(inside) < MIN_SAMPLES:
        return None
    off = view.positions(heights[inside], seconds[inside]) - positions[inside]
    off = np.maximum(np.abs(off) - _blurred(samples, view, seconds[inside]), 0.0) / view.span
    kept = _of_the_ball(off, noise / view.span)
    unsure = np.hypot(noise / view.span, _streaks(samples, view, seconds[inside]))[kept]
    is_film = detection.film is not None
    return SimulationFit(
        rms_percent=100 * float(np.sqrt(np.mean(off[kept] ** 2))),
        worst_percent=100 * float(off[kept].max()),
        noise_percent=100 * float(np.sqrt(np.mean(unsure**2))),
        held_out_percent=held_out_percent(detection),
        samples=int(np.count_nonzero(kept)),
        left_out=int(np.count_nonzero(~kept)) + detection.outliers,
        noise=noise if is_film or detection.tells_speed else noise / view.span,
        unit="px" if is_film else "m" if detection.tells_speed else "1",
    )


def fit_excess_percent(detection: AnyDetection) -> float | None:
    """Return how far the fit is from the samples in view, beyond their noise [%]."""
    seen = _fitted_view(detection)
    if seen is None:
        return None
    samples, noise = seen.samples, seen.relative_noise
    samples = samples.only(seen.inside(detection, samples.seconds))
    if len(samples.seconds) < MIN_SAMPLES:
        return None
    off = np.abs(samples.residuals(seen.fit.unknowns)) / seen.view.span
    kept = _of_the_ball(off, noise)
    off, unsure = off[kept], np.hypot(noise, _streaks(samples, seen.view, samples.seconds))[kept]
    return 100 * excess(*(float(np.sqrt(np.mean(one**2))) for one in (off, unsure)))


def held_out_percent(detection: AnyDetection) -> float | None:
    """Return the hold-out error of a fit to the first 60 % of the time [% of the drop height].

    The noise, and what chance makes of it in few samples, is taken off; None where too little is
    seen in either part.
    """
    seen = _fitted_view(detection)
    if seen is None:
        return None
    view, samples, noise = seen.view, seen.samples, seen.relative_noise
    seconds = samples.seconds
    inside = seen.inside(detection, seconds)
    if not inside.any():
        return None
    begin_s, end_s = detection.drop.release_s, float(seconds[inside][-1])
    until_s = begin_s + 0.6 * (end_s - begin_s)
    rest = inside & (seconds > until_s)
    impacts = view.impacts(until_s)
    if len(impacts) < 2:  # before the second no fit can know how the ball bounces
        return None
    fit = detection.begun(until_s)
    if fit is None or np.count_nonzero(rest) < 6:
        return None
    begun = averaged_ball(fit)
    later = samples.only(rest)
    # Sideways it may go anew after each impact: that is the camera's matter, and no prediction.
    own = seen.fit.samples
    later = replace(later, moves_s=own.moves_s, sized=own.sized, is_soft=begun.samples.is_soft)
    new = later.moving[len(begun.samples.moves_s) :]
    unknowns = begun.unknowns
    if new:
        unknowns = fit_bounce(later, unknowns, new, scale=seen.noise).unknowns
    off = np.abs(later.residuals(unknowns))
    off = np.maximum(off - _blurred(samples, view, later.seconds), 0.0) / view.span
    kept = _of_the_ball(off, noise)
    off, streaks = off[kept], _streaks(samples, view, later.seconds)[kept]
    # One in twenty has more.
    chance = 1 + 1.64 * np.sqrt(2 / len(off))  # of a mean square of so few samples
    # What the beginning leaves open of the rest, in the mean [drop heights²].
    normal, _ = begun.normal_equations()
    moves = later.jacobian(begun.unknowns, begun.free)
    left = np.einsum("ti,ij,tj->t", moves, np.linalg.pinv(normal), moves).mean() / view.span**2
    unsure = 1.64**2 * begun.samples_as_one * float(left)
    return 100 * excess(
        float(np.sqrt(np.mean(off**2))),
        float(np.sqrt((noise**2 + np.mean(streaks**2)) * chance + unsure)),
    )


def tuned_motion(detection: AnyDetection, trace: Trace) -> Motion:
    """Compare both curves at the observation's own stamps, and find drag-free equivalents."""
    last, seen = trace.steps[-1], _fitted_view(detection)
    found = None
    if seen is not None:
        samples = seen.samples.only(seen.inside(detection, seen.samples.seconds))
        heights = seen.view.heights(samples.positions, samples.seconds)
        found = equivalents(seen.view, samples.seconds, heights)
        if found is not None and not detection.tells_speed:
            found = Equivalents(*(replace(one, speeds_m_s=()) for one in (found.first, found.all)))
    posterior = detection.posterior if detection.physical else None
    asked = len(trace.estimate) > SLOPE_AND_DRAG
    return Motion(
        curves=_curves(detection, last),
        fit=simulation_fit(detection, last) if detection.physical else None,
        equivalents=found,
        unidentifiable=unidentifiable(posterior) if posterior is not None and asked else (),
        unknown=() if detection.tells_speed else (DRAG.name,),
        units=detection.units,
        sound=None if detection.ear is None else detection.ear.share,
    )


def last_bounce_s(view: Projection, until_s: float, noise: float) -> float:
    """Return when the last bounce ends that is high enough to be seen, and in view [s]."""
    last = (until_s - view.impact_s) / view.fall_time_s
    starts, speeds = view.bounce.flights(last)
    high = speeds**2 / 4 > max(0.003, 3.0 * noise)  # lower ones are not in view
    ends = int(np.flatnonzero(high)[-1]) + 1 if high.any() else 0
    return view.impact_s + view.fall_time_s * float(starts[min(ends, len(starts) - 1)])


def _blurred(samples: BounceSamples, view: Projection, seconds: Array) -> Array:
    """Return how far an open shutter may blur the ball from its place, about an impact.

    While the shutter is open the ball comes down and goes up again: what is seen is a mean of both.
    """
    half_s = samples.exposure_s / 2
    times = view.fall_times(seconds)
    starts, _ = view.bounce.flights(float(times.max(initial=0.0)))
    near = np.abs(times[:, None] - starts).min(axis=1) * view.fall_time_s < half_s
    at, early, late = (
        view.positions(view.bounce.heights(times + shift / view.fall_time_s), seconds)
        for shift in (0.0, -half_s, half_s)
    )
    return np.where(near, np.maximum(np.abs(early - at), np.abs(late - at)), 0.0)


_STREAK_SHARE = 0.03  # of the length of a streak, by which its middle is unsure


def _streaks(samples: BounceSamples, view: Projection, seconds: Array) -> Array:
    """Return how unsure the places of a fast ball are that an open shutter draws out, (T,)."""
    apart_s = 1e-3 * view.fall_time_s
    early, late = (view.ball(seconds + shift) for shift in (-apart_s / 2, apart_s / 2))
    length = samples.exposure_s * np.abs(late - early) / apart_s
    return np.asarray(_STREAK_SHARE * length / view.span, dtype=np.float64)


def matched(seconds: Array, of_rollout: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of samples and of the rollout's at the same moments."""
    rows = np.clip(np.searchsorted(of_rollout, seconds - _SAME_S), 0, len(of_rollout) - 1)
    at = np.flatnonzero(np.abs(of_rollout[rows] - seconds) <= _SAME_S)
    return at, rows[at]


def _of_the_ball(off: Array, noise: float) -> NDArray[np.bool_]:
    """Flag all samples but those far off, as long as these are few; in drop heights."""
    far = off > 6.0 * noise + 0.01  # farther off it is something else, as long as few are
    return ~far if np.count_nonzero(far) <= 0.05 * len(off) else np.ones_like(far)


def _curves(detection: AnyDetection, last: Step) -> Curves | None:
    """Return both curves; None where they share fewer than two stamps."""
    drop = detection.drop
    seen, seconds = _fitted_view(detection), drop.seconds
    if seen is None:
        heights_m, end_s = drop.heights_m - drop.table_m, float(seconds[-1])
    else:
        view, seconds = seen.view, seen.samples.seconds
        heights_m = view.heights(seen.samples.positions, seconds) * drop.drop_height_m
        end_s = last_bounce_s(view, float(seconds[-1]), seen.relative_noise)
        end_s += drop.fall_time_s
    # A quarter of a fall time before the release is enough to see that the ball was still.
    inside = (seconds >= drop.release_s - 0.25 * drop.fall_time_s) & (seconds <= end_s)
    inside &= np.isfinite(heights_m)
    every = max(1, -(-int(np.count_nonzero(inside)) // MAX_SAMPLES))
    seconds, heights_m = seconds[inside][::every], heights_m[inside][::every]
    if len(seconds) < 2:
        return None
    simulated_s, rollout_m = simulated_m(detection, last)
    curve_m = np.full(len(seconds), np.nan)
    if seen is None:  # the paper's simulator has stamps of its own
        curve_m = np.interp(seconds, simulated_s, rollout_m)
    else:
        at, rows = matched(seconds, simulated_s)
        curve_m[at] = rollout_m[rows]
    if np.count_nonzero(np.isfinite(curve_m)) < 2:
        return None
    if not detection.tells_speed:  # drop heights are all that is known
        heights_m, curve_m = heights_m / drop.drop_height_m, curve_m / drop.drop_height_m
    return Curves(int(detection.start_ns), seconds, heights_m, curve_m)


# ---- Estimation problem of a detected drop: a simulator that drops or throws it alike

HIGHEST_M = 100.0  # of a drop: from higher up lengths are more likely in mm or cm than in m
# Where the log tells no unit, and what was found is no drop in any.
NO_FALL = (
    "no fall of a ball is seen in it: what moves there falls neither freely nor onto a table "
    "(see --start, --end for a part)"
)

_HIGHEST_SIMULATED_M = 1000.0  # of a drop in the log's unit of length


def drop_problem(detection: AnyDetection, initial: Array) -> Problem:
    """Pose the estimation problem, with a simulator of the drop's own height, stamps and release.

    `initial` are restitution, slope and drag [1/m], or the first of these.
    """
    height_m = detection.drop.drop_height_m
    try:
        if height_m > _HIGHEST_SIMULATED_M:
            raise UsageError("it is too high")
        rig, contact = rig_like(detection)
    except UsageError as error:  # the user chose nothing here: the log asks for it
        is_high, why = height_m >= HIGHEST_M, f"{error}"
        if is_high and detection.units.length_m is None:
            raise NotFoundError(NO_FALL, GOOD_DROP) from error
        if is_high:
            why = f"the ball falls {height_m:.4g} m; are the lengths in mm or cm?"
        remedy = RIGHT_LENGTHS if is_high else GOOD_DROP
        raise NotFoundError(f"this drop cannot be simulated: {why}", remedy) from error
    simulator = DropSimulator(rig, contact)
    height_m = contact.gravity_m_s2 * detection.drop.fall_time_s**2 / 2
    if contact == PAPER:
        view = paper_rollout if detection.film is None else paper_unit_heights
        return Problem(detection.target, simulator, view, initial)

    def exact_fit(start: Array) -> FitResult | None:
        """Return the ball that explains all samples best, as many values as `start` has."""
        if (found := detection.posterior) is None:
            return None
        asked = slice(len(start))
        return FitResult(found.values[asked], found.interval95[asked], detail=detection.rebounds)

    return Problem(
        detection.target,
        simulator,
        lambda episode: canonical(rollout_drop(episode, rig, contact, height_m)),
        initial,
        exact_fit,
        np.array([1.0, 1.0, 1 / height_m])[: len(initial)],
    )


def rig_like(detection: AnyDetection) -> tuple[DropRig, ContactSettings]:
    """Build the rig whose rollouts show the same drop at the same stamps."""
    drop, start_ns = detection.drop, detection.start_ns
    if not detection.physical:
        gap = drop.release_m - drop.table_m
        start_ns += round(1e9 * paper_start_s(drop))
        return DropRig(gap, PAPER_RADIUS_M, PAPER_RATE_HZ, start_ns=start_ns), PAPER
    period_s = median_step(drop.seconds)
    seconds = detection.observed.seconds
    wanted_s = drop.impact_s + (CANONICAL_SPAN + 1) * drop.fall_time_s
    missing = max(0, int(np.ceil((wanted_s - seconds[-1]) / period_s)))
    if missing > 100 * len(seconds):
        raise UsageError("its stamps are too uneven: most are close together, and some far apart")
    seconds = np.concatenate([seconds, seconds[-1] + period_s * np.arange(1, missing + 1)])
    seconds = on_clock(seconds, *contact_clock(detection))
    first_s = min(float(seconds[0]), drop.release_s)
    gap_m, speed_m_s = CALIBRATED.gravity_m_s2 * drop.fall_time_s**2 / 2, 0.0
    if drop.launched:
        # Height over contact [m] and upward speed [m/s] of a thrown ball's first sample.
        posterior = detection.posterior
        if posterior is None:
            raise NotFoundError("too few samples of the ball's flights are seen", DENSER)
        view = posterior.fit.projection()
        at = view.fall_times(np.array([detection.drop.release_s]))[0]
        short = 1e-5  # of a speed that is a difference of two heights [fall times]
        low, here, high = view.bounce.heights(at + short * np.array([-1.0, 0.0, 1.0])) * gap_m
        gap_m = max(float(here), 0.0)
        speed_m_s = float((high - low) / (2 * short * view.fall_time_s))
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
