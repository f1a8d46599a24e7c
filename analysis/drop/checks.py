"""Checks of a drop: tables of what is checked, and what is measured for them.

First those of any recorded drop, then its cross-check, then what only a film shows, then the checks
and the cross-check of a drop that was only heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.checks import (
    TRUE,
    Check,
    CheckSpec,
    CrossCheck,
    at_least,
    at_most,
    table,
    within,
)
from tunenet_logs.analysis.drop.audio import FusedEstimate
from tunenet_logs.analysis.drop.bounce_model import TOUCH, Projection
from tunenet_logs.analysis.drop.bounce_posterior import flight_ratio
from tunenet_logs.analysis.drop.detection import DISAGREEMENT, AnyDetection, FilmDetection
from tunenet_logs.analysis.drop.film import (
    MAX_CLOCK_GAIN,
    MIN_FREE,
    FilmedDrop,
    clock_test,
    free_flight,
    long_steps,
)
from tunenet_logs.analysis.drop.free_flight import Drop, meet
from tunenet_logs.analysis.drop.presets import PAPER_HEIGHT_M
from tunenet_logs.analysis.drop.times.detection import TimesDetection
from tunenet_logs.analysis.drop.times.model import HeardBall, Whitening
from tunenet_logs.analysis.drop.times.search import BallAmong
from tunenet_logs.analysis.estimators.base import FitResult, Observation, Step
from tunenet_logs.analysis.record import SimulationFit, Units
from tunenet_logs.analysis.statistics import correlation_time, noise_of, robust_regression
from tunenet_logs.episode import Array, median_step
from tunenet_logs.recorders.simulators.base import CALIBRATED

# ---- Any recorded drop

_AGAIN = "drop it again without spin, onto a hard and level surface"

DROP = table(
    CheckSpec(
        "first flight seen",
        at_least(0.9, "fall times", ".1f"),
        measures="recorded time after the first impact",
        passes="{limit} fall times or more; of a thrown ball 0.2; of a film in which the ball goes "
        "sideways until the second impact",
        advice="record until the ball lies still",
        invalidates_interval=False,
    ),
    CheckSpec(
        "stays on the table",
        at_most(3, "% of the drop height", ".1f"),
        seen="{value} {unit} below contact",
        measures="how far the ball comes below the contact",
        passes="at most {limit} % of the drop height + 6 times the noise [mm]",
        advice="drop onto the middle of a large, level surface",
    ),
    CheckSpec(
        "falls straight",
        at_most(50, "% of the drop height"),
        seen="{value} {unit} sideways",
        measures="sideways travel (of a film up to the second impact)",
        passes="at most half the drop height, or half of the impact's speed times the recorded "
        "time, if more; of a film a quarter, until the second impact",
        advice="let go without a push, over a level surface",
    ),
    CheckSpec(
        "no samples missing",
        at_most(4, "periods", ".1f"),
        seen="longest gap {value} periods",
        wanted="less than {limit}",
        measures="longest time without a sample",
        passes="less than {limit} sample periods; of a film 0.4 fall times if more, longer where "
        "the ball flies out of the picture",
        advice="keep the ball in sight all the way, and the rate steady",
        invalidates_interval=False,
    ),
    CheckSpec(
        "sure enough",
        at_most(0.02, "", ".2g", fatal=0.1),
        seen="95 % interval of ±{value}",
        measures="half the 95 % interval of the restitution",
        if_not="i; of a film or times r over 0.1",
        advice="drop from higher, or record larger or at a higher rate",
        secondary=True,
        invalidates_interval=False,
    ),
    CheckSpec(
        "simulation fits",
        at_most(0.5, "% of the drop height", ".2f", fatal=15),  # cannot be seen in a review
        seen="{value} % of the drop height apart beyond the noise, rms of {fit.samples} samples",
        more="; {fit.worst_percent:.2f} % at worst",
        measures="tuned rollout less every sample in view, beyond the noise (rms)",
        passes="at most {limit} % of the drop height, a standard error of so many samples above it",
        advice=_AGAIN,
    ),
    CheckSpec(
        "samples are the ball's",
        at_most(5, "%", ".1f g"),
        seen="{fit.left_out} of {count} are elsewhere",
        wanted="at most {limit} %",
        measures="samples that are elsewhere, and left out",
        advice="keep other things that move, or are marked, away from the ball",
    ),
    CheckSpec(
        "hold-out prediction",
        at_most(1, "% of the drop height", ".2f"),
        seen="by the first 60 % of the time the rest is {value} % of the drop height off",
        measures="error of a fit to the first 60 % of the time on the rest, beyond the noise",
        advice="drop from higher, or record more bounces at a higher rate",
        invalidates_interval=False,
    ),
    CheckSpec(
        "sound agrees",
        at_most(1.3, "half widths", ".1f"),
        seen="sound moves the value by {value} {unit} of the interval without it",
        measures="value with the sound less that without it, over half the latter's 95 % interval",
        advice="record the sound and the pictures by one device, the microphone near the ball",
    ),
)

POSITIONS = table(
    CheckSpec(
        "gravity",
        within(5, "%", ".1f g"),  # as the air and a short fall make it
        seen="falls with {drop.gravity_m_s2:.2f} m/s²",
        wanted="wanted: {standard:.2f} within {limit} %",
        measures="the fall's acceleration, where lengths and times have units",
        passes="9.81 m/s² within {limit} %",
        if_not="i where nobody named the units",
        advice="record lengths in m and the true times",
    ),
    CheckSpec(
        "rests where it hit",
        at_most(1, "mm", ".1f"),
        seen="{value} {unit} between impact and rest",
        measures="level of rest less the contact, where the ball rests in view",
        passes="at most 1 mm + 0.1 % of the drop height + 4 standard errors",
        advice="let it come to rest by itself, on a hard and level surface",
    ),
    CheckSpec(
        "flies a parabola",
        TRUE,
        seen="none found in the {count:.0f} samples of the first flight (a filtered track?)",
        measures="first flight of 10 samples or more (listed only where it fails)",
        passes="a parabola is found in it",
        advice="record unfiltered positions, and let go without spin",
    ),
    CheckSpec(
        "rebound stands out",
        at_least(8, "mm", ".1f"),
        seen="{value} mm high",
        wanted="wanted: over {limit}, 8 times the noise",
        measures="height of the first rebound, where there is no interval (`--method tunenet`)",
        passes="over {limit} times the noise [mm]",
        advice="drop from higher, or record with less noise",
        secondary=True,
    ),
)

PAPER = table(
    CheckSpec(
        "as in training",
        TRUE,
        seen="a fall of {height_m:.2f} m by the clock",
        wanted="wanted: {low:g} to {high:g}",
        measures="of a film, the fall by the clock",
        passes="3 to 5 m",
        advice="use the preset default",
    ),
    CheckSpec(
        "simulation fits",
        at_most(3, "% of the drop height", ".2f", fatal=10),
        seen="{value} % of the drop height apart, rms",
        measures="tuned rollout less the positions, noise included (rms)",
        passes="at most {limit} % of the drop height + 1.2 times the noise",
        advice=_AGAIN,
        secondary=True,
    ),
)


def recording_checks(
    drop: Drop,
    sideways_m: Array,
    most_gap_falls: float = 0.0,
    excused_s: Sequence[float] | Array = (),
    most_sideways: float = 0.5,
    sunk_m: float = 0.0,
    least_seen: float | None = None,
) -> list[Check]:
    """Check the recording itself: its length, gaps, table and sideways motion.

    `sideways_m` are horizontal positions (T, any); a gap of `most_gap_falls` fall times may be,
    even of many periods, and a sample at `excused_s` may be missing; `most_sideways` is a fraction
    of the impact's speed; `sunk_m` is how far below the contact the ball is elsewhere; `least_seen`
    fall times after the impact are enough.
    """
    seen, table_level, straight, no_gap, *_ = DROP.values()
    height_m, size, unit = drop.drop_height_m, *_length(drop)
    after = drop.seconds > drop.impact_s
    below = max(drop.contact_m - float(drop.heights_m[after].min(initial=drop.contact_m)), sunk_m)
    # A ball that sinks in by less than 6 times the noise is still on the table.
    floor = table_level.limit.value / 100 * height_m + 6 * drop.noise_m
    drift = float(np.linalg.norm(np.ptp(sideways_m, axis=0)))
    lasts_s = float(drop.seconds[-1] - drop.seconds[0])
    most_m = straight.limit.value / 100 * height_m
    most_m = max(most_m, most_sideways * drop.impact_speed_m_s * lasts_s)
    period_s = median_step(drop.seconds)
    longest_s = float(np.diff(np.union1d(drop.seconds, np.asarray(excused_s))).max())
    most_gap = max(no_gap.limit.value, most_gap_falls * drop.fall_time_s / period_s)
    return [
        seen.measured((drop.seconds[-1] - drop.impact_s) / drop.fall_time_s, least_seen),
        table_level.measured(size * max(below, 0.0), size * floor, unit=unit),
        straight.measured(size * drift, size * most_m, unit=unit),
        no_gap.measured(longest_s / period_s, most_gap),
    ]


def _length(drop: Drop) -> tuple[float, str]:
    """Return the factor and unit that show a drop's lengths: mm, or % of an unscaled height."""
    if drop.scale_known:
        return 1000.0, "mm"
    return 100 / drop.drop_height_m, "% of the drop height"


def fall_checks(drop: Drop, restitution: float, units: Units) -> list[Check]:
    """Check that the ball falls and flies freely, so that the restitution is its own."""
    gravity, standard = POSITIONS["gravity"], CALIBRATED.gravity_m_s2
    checks: list[Check] = []
    if units.doubt:
        doubt, remedy = units.doubt, units.remedy
        check = gravity.measured(np.inf, detail=doubt, advice=remedy, invalidates_interval=False)
        checks.append(check)
    elif units.tell_speed:
        off = 100 * (drop.gravity_m_s2 / standard - 1)
        checks.append(gravity.measured(off, drop=drop, standard=standard))
    if not np.isnan(drop.rest_m):
        size, unit = _length(drop)
        off, most = size * abs(drop.rest_m - drop.contact_m), size * drop.rest_tolerance_m
        checks.append(POSITIONS["rests where it hit"].measured(off, most, unit=unit))
    count = 2 * restitution * drop.fall_time_s / median_step(drop.seconds)
    # In 10 samples of a first flight a parabola can be found, if there is one.
    if np.isnan(drop.flight_restitution) and count >= 10:
        checks.append(POSITIONS["flies a parabola"].measured(False, count=count))
    return checks


def rebound_check(drop: Drop, restitution: float) -> Check:
    """Check that the first rebound stands out of the noise, where there is no interval."""
    clear = POSITIONS["rebound stands out"]
    hop_m = restitution**2 * drop.drop_height_m
    return clear.measured(1000 * hop_m, 1000 * clear.limit.value * drop.noise_m)


def sure_check(low: float, high: float, *, fatal: bool | None = None) -> Check:
    """Check that a 95 % interval is narrow enough; a far wider one is fatal unless `fatal` is."""
    return DROP["sure enough"].measured((high - low) / 2, fatal=fatal)


def sound_checks(ear: FusedEstimate | None) -> list[Check]:
    """Check that a sound that is used does not pull away from what is seen."""
    if ear is None or ear.touches is None:
        return []
    off = float(ear.posterior.values[0] - ear.pictures.values[0])
    low, high = (ear.pictures.interval95[0] - ear.pictures.values[0]).tolist()
    half = max(high, -low, 1e-4)
    return [DROP["sound agrees"].measured(abs(off) / half)]


def motion_checks(fit: SimulationFit | None) -> list[Check]:
    """Check that the tuned simulator moves as the ball does, and predicts the hold-out.

    A simulator that leaves the observation is not tuned, however narrow the fit's interval is.
    """
    if fit is None:
        return []
    count = fit.samples + fit.left_out
    fits, own = DROP["simulation fits"], DROP["samples are the ball's"]
    checks = [
        fits.measured(fit.excess_percent, fit.highest_excess_percent(fits.limit.value), fit=fit),
        own.measured(100 * fit.left_out / max(count, 1), fit=fit, count=count),
    ]
    if fit.held_out_percent is not None:
        checks.append(DROP["hold-out prediction"].measured(fit.held_out_percent))
    return checks


def paper_fit_check(simulated: Observation, target: Observation, drop: Drop) -> Check:
    """Check that the paper's simulator is as near to the recording as it can be (rms)."""
    spec, height_m = PAPER["simulation fits"], drop.drop_height_m
    off = (simulated.values - target.values) / height_m
    # White noise alone hardly exceeds 1.2 times its standard deviation.
    most = spec.limit.value + 100 * 1.2 * drop.noise_m / height_m
    return spec.measured(100 * float(np.sqrt(np.nanmean(off**2))), most)


def paper_height_check(height_m: float) -> Check:
    """Check that a filmed fall is one that the paper's network has seen."""
    low, high = PAPER_HEIGHT_M
    low -= 1  # [m]: that of the ball's lower edge, and a little more
    passed = low < height_m < high
    return PAPER["as in training"].measured(passed, height_m=height_m, low=low, high=high)


# ---- Cross-check of a drop: a second estimate by sound, flight durations or impact speeds


def _judged(
    method: str, seen: float, value: float, sd: float, margin: float = 0.02, scale: float = 1.0
) -> CrossCheck:
    """Judge a second estimate by its standard error, and a margin [restitution], times a scale.

    The margin is what systematic errors take off the cross-check of a good recording.
    """
    most = scale * (margin + 3 * sd)
    return CrossCheck.judged(method, seen, value, most, sd=scale * sd, advice=DISAGREEMENT)


def flight_cross_check(detection: AnyDetection, estimate: Array) -> CrossCheck | None:
    """Cross-check the restitution by the ratio of two flights, else by the impact's speeds.

    Both are compared with what the fitted ball would show in the same way, so the air's drag, and
    what a smooth curve makes of it, take nothing from them. The first changes with no projection.
    """
    if not detection.physical or detection.posterior is None:
        return None
    fit, value = detection.posterior.fit, float(estimate[0])
    by_ear = None if detection.ear is None else _by_ear(detection.ear, value)
    if by_ear is not None:
        return by_ear
    ratio = flight_ratio(fit)
    if ratio is not None:
        margin = 0.02 if detection.film is None else 0.03  # what systematic errors take off
        # What they tell is the second impact's; the first one's is as much off, at any slope.
        method, scale = "durations of the first two flights", value / ratio.fitted
        return _judged(method, scale * ratio.value, value, ratio.sd, margin, scale)
    if isinstance(detection, FilmDetection):
        return None
    # The speeds just before and after the impact, from parabolas on either side. The same are
    # fitted to the fitted ball: what they are off there, they are off here.
    drop = detection.found
    fall, flight = (
        np.flatnonzero((drop.seconds >= first_s) & (drop.seconds <= last_s))
        for first_s, last_s in (drop.fall_s, drop.flight_s)
    )
    if np.isnan(drop.flight_restitution_sd) or len(fall) < 3 or len(flight) < 3:
        return None
    view = fit.projection()
    ball_m = view.ball(drop.seconds)
    clock = drop.seconds - view.impact_s
    usual = meet(clock, ball_m, fall, flight, drop.noise_m).flight_restitution
    own = drop.flight_restitution, drop.flight_restitution_sd
    if drop.launched:  # its flights were cut where a hand may be
        again = meet(clock, drop.heights_m, fall, flight, drop.noise_m)
        own = again.flight_restitution, again.flight_restitution_sd
    return _judged("speeds at the first impact", value + own[0] - usual, value, own[1])


def _by_ear(ear: FusedEstimate, value: float) -> CrossCheck | None:
    """Cross-check two flights as they are heard against those of the pictures alone.

    None where no three impacts in a row were seen and heard. The contact's duration is the joint
    fit's.
    """
    if ear.touches is None or ear.impacts is None:
        return None
    numbers = ear.touches.numbers
    are_seen = numbers[2:] < len(ear.impacts.times_s)
    in_a_row = np.flatnonzero(are_seen & (numbers[2:] - numbers[:-2] == 2))
    if not len(in_a_row):
        return None
    three = slice(int(in_a_row[0]), int(in_a_row[0]) + 3)
    which = numbers[three]
    heard_s = np.diff(ear.touches.times_s[three])
    seen_s = np.diff(ear.impacts.times_s[which]) + ear.posterior.fit.unknowns[TOUCH]
    off = float(np.log(heard_s[1] / heard_s[0]) - np.log(seen_s[1] / seen_s[0]))
    slopes = np.array([1 / seen_s[0], -1 / seen_s[0] - 1 / seen_s[1], 1 / seen_s[1]])
    covariance = ear.impacts.covariance[np.ix_(which, which)]
    sd = float(np.sqrt(slopes @ (covariance + ear.touches.covariance[three, three]) @ slopes))
    method, seen = "two flights by ear, beside the pictures", value * float(np.exp(off))
    return _judged(method, seen, value, sd, scale=value)


# ---- A filmed drop: what an uncalibrated picture shows of its own faults
# A fit takes up much of what is wrong with a film. So these also look at what it cannot take up: a
# clock that lags from some moment on, and a ball that grows or shrinks as no fitted camera has it.

_LOST = 3.0  # [% of the drop height], rms, from which on nothing is a drop
_FLAT = "let the ball bounce in the middle of a flat table, with nothing in its way"

FILM = table(
    CheckSpec(
        "pictures as they were recorded",
        TRUE,
        measures="pictures that cannot be read",
        passes="none",
        advice="tune the file as it was before it was damaged",
    ),
    CheckSpec(
        "flies freely",
        at_least(100 * MIN_FREE, "%"),
        seen="free flight in {value} % of its way",
        measures="share of the ball's way that is free flight",
        advice="let go above the table and touch nothing, the camera still",
    ),
    CheckSpec(
        "large enough",
        at_least(40, "px"),  # below, the first hop of restitution 0.2 is under 2 px high
        seen="falls {value} px",
        measures="fall in the picture",
        advice="film from closer, the fall over half of the picture's height",
        invalidates_interval=False,
    ),
    CheckSpec(
        "first impact",
        at_most(0),
        seen="{value} deeper falls before it fit no drop",
        wanted="wanted: none",
        measures="earlier, deeper falls that fit no drop",
        passes="none",
        advice=_FLAT,
    ),
    CheckSpec(
        "stays in view",
        at_least(80, "%", fatal=60),
        seen="found in {value} % of the pictures of the drop",
        measures="pictures with the ball found, from mid-fall to four fall times after the impact, "
        "while it is not out of the picture",
        advice="leave room at the sides, a plain background; mark the ball with --preview",
        invalidates_interval=False,
    ),
    CheckSpec(
        "pictures differ",
        at_most(5, "%"),
        seen="{value} % show the moving ball unmoved",
        measures="pictures that show the moving ball unmoved",
        advice="record at a rate that the camera keeps",
    ),
    CheckSpec(
        "no pictures missing",
        at_most(1),  # lost one here, one there; the clock's test is for one moment alone
        seen="{value} steps of the ball are far too long for the stamps",
        measures="steps far too long for their stamps, or a conversion from another rate that the "
        "flight does not tell for sure (one that it tells is undone, and said)",
        advice="use the camera's own file, not a copy at another rate",
    ),
    CheckSpec(
        "bounces along parabolas",
        at_most(2, "% of the drop height", ".2f .0f", fatal=_LOST),
        seen="{value} % of the drop height off, rms",
        measures="track less the fitted bounce (rms)",
        if_not="r over 3, or where 2 % of the samples are over 10",
        advice=_FLAT,
        secondary=True,
    ),
    CheckSpec(
        "bounces alike",
        at_least(2, "flights"),  # the first alone has no other to be compared with
        seen="only until the {last}. impact, what comes later is left out",
        wanted="wanted: {limit} flights or more",
        measures="flights that one law explains (later ones are left out)",
        passes="all that are seen, or {limit}",
        advice="a round ball, a flat and level table",
        invalidates_interval=False,  # what comes later touches no flight that counts
        secondary=True,
    ),
    CheckSpec(
        "bounces upright",
        at_most(35, "% of the impact's speed"),  # friction on a spinning ball does no more
        seen="the first impact turns {value} {unit} sideways",
        measures="change of the sideways speed at the first impact, in the picture",
        advice=_FLAT,
    ),
    CheckSpec(
        "even clock",
        at_most(MAX_CLOCK_GAIN, "", ".1f .0f"),
        seen="log likelihood ratio {value} for missing pictures or another rate, at {at_s:.2f} s",
        more="{left_out}",
        measures="evidence of a clock that jumps or changes its rate (score test; after the second "
        "impact what follows is left out instead)",
        passes="log likelihood ratio of at most {limit}",
        advice="use the camera's own file, not a copy at another rate; name another ball or none, "
        "if one was named; use a lens that bends less",
    ),
    CheckSpec(
        "seen from a distance",
        within(1.4, "", "+.2f g"),  # two standard deviations of its prior
        seen="perspective {value}{side}",
        measures="perspective k of the fitted camera",
        advice="film from farther away, the camera at the height of the bounces",
    ),
    CheckSpec(
        "keeps its distance",
        within(20, "%", "+.0f .0f"),
        seen="grows by {value} %",
        measures="growth of the ball's size at one height",
        passes="at most {limit} % + 4 standard errors either way; of a ball that goes sideways, "
        "off what its way makes of its size, 10 % + 2.5 standard errors; at most 35 %",
        advice="let go without pushing or spinning the ball",
    ),
    CheckSpec(
        "size fits perspective",
        within(0.2, "", "+.2f .2f"),  # light changes a ball's outline
        seen="perspective {value} apart by the ball's size",
        measures="k by the ball's size less the fitted k",
        passes="at most {limit} + 4 standard errors either way",
        advice="keep the camera still and the ball in one piece of light",
    ),
    CheckSpec(
        "frame rate",
        at_most(1.3, "", ".2f g"),
        seen="falls {seen_m:.2f} m by the clock, {known_m:.2f} m by the known size",
        wanted="wanted: within a factor {limit}; or it is not that size",
        measures="drop height by the clock against a known length (the log's, `--ball`)",
        passes="within a factor 1.3 by the drop height, 1.8 by the ball's diameter",
        advice="record slow motion with its true rate: tunenet-record --camera FILE --fps RATE",
    ),
    CheckSpec(
        "rebound stands out",
        at_least(6, "px", ".1f"),
        seen="{value} px high",
        wanted="wanted: over {limit}",
        measures="height of the first rebound, where there is no interval (`--method tunenet`)",
        passes="over {limit} times the noise [px], and 1 px",
        advice="film from closer",
        secondary=True,
    ),
)

_SDS = 4.0  # standard errors that are allowed on top of a threshold
# The same for a ball that goes sideways by the fit; and what is allowed at most: else its size
# tells nothing of the way.
_MOVED_SDS, _MOST_GROWTH_PERCENT = 2.5, 35.0


def film_checks(film: FilmedDrop) -> list[Check]:
    """Check whether a track is a drop's, in view, along parabolas and on an even clock."""
    span_px, parabolas = film.projection.span, FILM["bounces along parabolas"]
    residual = 100 * film.projection.residual_rms / span_px
    worst = 100 * float(np.quantile(np.abs(film.posterior.fit.residuals) / span_px, 0.98))
    lost = residual > _LOST  # then no step is expected
    # The fraction of pictures with the ball found, of those from mid-fall for four fall times
    # without those that it flies out of; and with it unmoved, of those with a moving ball.
    fit, best, track = film.projection, film.posterior.fit, film.track
    end_s = min(float(film.drop.seconds[-1]), fit.impact_s + 4.0 * fit.fall_time_s)
    seconds, is_out = _out_of_view(film)
    wanted = (seconds > fit.impact_s - fit.fall_time_s / 2) & (seconds <= end_s)
    wanted &= ~is_out
    seen = float(np.mean(track.found[wanted])) if wanted.any() else 0.0
    positions = best.samples.positions
    expected = np.abs(np.diff(positions + best.residuals))
    whole = not np.any(track.places_px[film.used] % 1)  # then noise may hide a step
    step_px = 1.5  # that a ball has to move by, or it is no fault of the pictures if it does not
    moving = expected > (max(step_px, _SDS * best.samples.noise) if whole else step_px)
    moving &= fit.fall_times(best.samples.seconds[1:]) > -1
    same = np.abs(np.diff(positions)) < 0.02  # [px]
    repeated = float(np.mean(same[moving])) if np.count_nonzero(moving) > 3 else 0.0
    across = track.places_px[film.used] @ np.array([film.down_px[1], -film.down_px[0]])
    across_px = max(noise_of(across, film.drop.seconds), 0.45 if whole else 0.1)  # when rounded
    gains, moments_s = clock_test(film.searched)
    gain, moment_s = float(gains.max()), float(moments_s[gains.argmax()])
    uneven_s = film.uneven_s
    left_out = "" if uneven_s is None else f"; what comes after {uneven_s:.2f} s is left out"
    impacts_s = fit.impact_s + fit.fall_time_s * fit.impacts(float(film.drop.seconds[-1]))
    start_s = float(track.stamps_ns[film.used][0]) * 1e-9 - float(film.drop.seconds[0])
    gravity_px = 2 * span_px / fit.fall_time_s**2 * film.down_px  # an arc may include a hand's way
    falling = replace(track, gravity_px=gravity_px)
    flight = free_flight(falling, film.used, start_s + impacts_s)
    flights = np.inf if film.flights is None else film.flights
    return [
        FILM["flies freely"].measured(100 * flight.share, passed=not flight.is_carried),
        FILM["large enough"].measured(span_px),
        FILM["first impact"].measured(film.left_out),
        FILM["stays in view"].measured(100 * seen),
        FILM["pictures differ"].measured(100 * repeated),
        _missing_check(film, 0 if lost else long_steps(film.posterior.fit, across_px)),
        parabolas.measured(residual, fatal=lost or worst > 10),  # [%] of 2 % of the samples
        FILM["bounces alike"].measured(
            flights,
            detail="all that are seen" if film.flights is None else None,
            last=flights + 1,
        ),
        FILM["bounces upright"].measured(100 * _turned(film)),
        FILM["even clock"].measured(gain, at_s=moment_s, left_out=left_out),
        *_distance_checks(film),
    ]


def _turned(film: FilmedDrop) -> float:
    """Return by how much the first impact changes the speed sideways, over the impact's speed."""
    view, seconds = film.projection, film.drop.seconds
    times = view.fall_times(seconds)
    impacts = view.impacts(float(seconds[-1]))
    end = float(impacts[1]) if len(impacts) > 1 else np.inf
    speeds: list[float] = []
    for part in ((times > -0.7) & (times < 0), (times > 0) & (times < end)):
        if np.count_nonzero(part) < 3:
            return 0.0
        speeds.append(float(np.polyfit(times[part], film.sideways[part], 1)[0]))
    return abs(speeds[1] - speeds[0]) / view.bounce.impact_speed


def _missing_check(film: FilmedDrop, steps: int) -> Check:
    """Check that no pictures are missing; a conversion that could not be undone is the reason."""
    missing, converted = FILM["no pictures missing"], film.converted
    if converted is None or converted.is_sure:
        return missing.measured(steps)
    detail = f"pictures in a regular pattern: most likely converted {converted.how.words}"
    return missing.measured(steps, passed=False, detail=detail)


def hop_check(film: FilmedDrop, restitution: float) -> Check:
    """Check that the first bounce can be seen at all, where there is no interval."""
    clear, span_px = FILM["rebound stands out"], film.projection.span
    noise_px = film.drop.noise_m / film.drop.drop_height_m * span_px
    return clear.measured(restitution**2 * span_px, max(clear.limit.value * noise_px, 1.0))


def _distance_checks(film: FilmedDrop) -> list[Check]:
    """Check the perspective, and the ball's size where that is seen."""
    fit, track = film.projection, film.track
    near, grows = FILM["seen from a distance"], FILM["keeps its distance"]
    fits = FILM["size fits perspective"]
    is_near = abs(fit.perspective) > near.limit.value
    side = (", from below" if fit.perspective > 0 else ", from above") if is_near else ""
    checks = [near.measured(fit.perspective, side=side)]
    along = -(track.places_px[film.used] @ film.down_px)
    trend = size_trend(film.drop.seconds, along, track.radius_px[film.used], fit)
    if trend is None:
        return checks
    most = grows.limit.value + 100 * _SDS * trend.grows_sd
    if fit.moves:  # a way that the size has to confirm
        most = grows.limit.value / 2 + 100 * _MOVED_SDS * trend.grows_sd
    apart = fits.limit.value + _SDS * trend.perspective_sd
    return [
        *checks,
        grows.measured(100 * trend.grows, min(most, _MOST_GROWTH_PERCENT)),
        fits.measured(trend.perspective, apart),
    ]


def scale_checks(detection: FilmDetection) -> list[Check]:
    """Check that the film's frame rate is its true one, where a length is known.

    A film that plays at another rate than it was filmed shows another gravity. The restitution is
    the same, the drop height, speeds and drag are not.
    """
    if not detection.is_timed or detection.known_height is None:
        return []
    (known_m, factor), seen_m = detection.known_height, detection.film.drop.drop_height_m
    apart = max(seen_m / known_m, known_m / seen_m)
    passed = not detection.contradicted_scale
    rate = FILM["frame rate"]
    return [rate.measured(apart, factor, passed=passed, seen_m=seen_m, known_m=known_m)]


def seconds_out_of_view(film: FilmedDrop) -> Array:
    """Return the times at which the ball is out of the picture, shape (N,) [s]."""
    seconds, is_out = _out_of_view(film)
    return seconds[is_out & ~film.track.found]


def _out_of_view(film: FilmedDrop) -> tuple[Array, NDArray[np.bool_]]:
    """Return all pictures' times on the drop's clock [s], and which cut the ball in flight, (T,).

    That is, well away from an impact.
    """
    fit, track = film.projection, film.track
    seconds = track.stamps_ns * 1e-9
    seconds = seconds + film.drop.seconds[0] - seconds[film.used][0]
    times = fit.fall_times(seconds)
    starts, _ = fit.bounce.flights(float(times[-1]))
    apart = np.abs(times[:, None] - starts).min(axis=1)
    across_px = np.array([film.down_px[1], -film.down_px[0]])
    known = np.flatnonzero(track.found)
    across = np.interp(seconds, seconds[known], track.places_px[known] @ across_px)
    places = across[:, None] * across_px - fit.ball(seconds)[:, None] * film.down_px
    radius = float(np.nanmedian(track.radius_px[film.used]))
    far = np.array(track.size_px) - 1 - radius
    cut = np.any((places < radius) | (places > far), axis=1)
    return seconds, cut & (apart > 0.25)  # fall times, beyond which no impact is hidden


@dataclass(frozen=True)
class SizeTrend:
    """Change of the ball's size in the picture, beyond what the fitted camera predicts."""

    grows: float  # by what fraction from the first used picture to the last, at one height
    grows_sd: float  # its standard error
    perspective: float  # k by the ball's size less that by the fit
    perspective_sd: float  # its standard error


def size_trend(
    seconds: Array, along_px: Array, radius_px: Array, projection: Projection
) -> SizeTrend | None:
    """Regress log radius on height, time and speed, reweighted; None for too few samples.

    A ball at height u is 1 / (1 + (e^k - 1) u) as large as at contact; a long exposure draws it out
    by its speed, which is therefore fitted too. Positions are along the image's vertical, radii NaN
    where they are not known, shape (T,) each.
    """
    heights = np.clip(projection.heights(along_px, seconds), 0.0, 1.2)
    times = projection.fall_times(seconds)
    last = float(projection.impacts(float(seconds[-1]))[-1])
    # Sizes count for one fall time of a rest; fewer than 12 test nothing.
    good = np.isfinite(radius_px) & (radius_px > 0) & (times > -1) & (times < last + 1.0)
    if np.count_nonzero(good) < 12:
        return None
    nearly = projection.perspective or 1e-6
    depth = np.log1p(np.expm1(nearly) * heights) / nearly
    # By how much the fit has it nearer: where it goes sideways.
    nearer = -np.log1p(projection.farther(seconds) / (1 + np.expm1(nearly) * heights))
    speed = np.abs(np.gradient(along_px, seconds))
    speed = speed / max(float(speed.max()), 1e-9)
    length = float(np.ptp(times[good]))
    columns = np.column_stack([np.ones(len(times)), depth, times / length, speed])[good]
    sizes = np.log(radius_px[good]) - nearer[good]
    found, off, spread, _ = robust_regression(columns, sizes)
    # Light and background change a size for many pictures in turn.
    sds = spread * np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    sds *= np.sqrt(correlation_time(off, columns.shape[1]))
    return SizeTrend(
        grows=float(found[2]),
        grows_sd=float(sds[2]),
        perspective=float(-found[1] - projection.perspective),
        perspective_sd=float(sds[1]),
    )


# ---- A drop that was heard, and its cross-check

_ONE_BALL = "record one ball that bounces freely"
_SURE_ODDS = 100.0  # to 1, against noises at random times and other balls
_MAX_AS_LOUD = 2  # knocks of others while a ball bounces, as loud as its own

TIMES = table(
    CheckSpec(
        "enough impacts",
        at_least(5, "impacts"),  # from which on other rhythms than a ball's can be told from it
        seen="{value} impacts heard",
        measures="impacts heard (nothing tests that three are a ball's)",
        advice="let it bounce longer",
    ),
    CheckSpec(
        "times are the ball's",
        at_most(40, "%"),
        seen="{how}{odds:.3g} to 1 against noises at random times (wanted: {sure:.0f} to 1); "
        "{missed} impacts missed, {false} noises between {count} impacts: {value} % wrong",
        measures="odds against noises at random times; impacts missed, and noises among the times",
        passes="100 to 1 or more; at most {limit} %",
        if_not="i; r over 40, or under 1 to 1",
        advice="record five bounces or more in a quiet room",
    ),
    CheckSpec(
        "times are sharp",
        at_most(6, "ms", ".1f"),
        seen="they scatter by {value} ms about a ball's",
        measures="scatter of the times (standard deviation)",
        passes="under {limit} ms, and 3 % of a mean flight",
        advice="put the microphone near the impact, and set its threshold low",
    ),
    CheckSpec(
        "one ball alone",
        at_most(_SURE_ODDS, "to 1", ".3g .0f"),
        seen="{value} to 1 {second}",
        more=", {as_loud} other knocks as loud as its own (at most {most_as_loud})",
        measures="in a sound, the odds for a second ball or earlier knocks; other knocks as loud",
        passes="under {limit} to 1; at most 2",
        advice="let one ball bounce alone, or choose one drop with --start and --end",
        invalidates_interval=False,
    ),
    CheckSpec(
        "softens as a ball does",
        at_least(0.2, "to 1", ".3g g"),  # claps have a hundredth
        seen="{value} to 1 against knocks that stay as loud",
        wanted="wanted: {limit} to 1",
        more="; {clipped} of its knocks are clipped",
        measures="in a sound, the odds against knocks that stay as loud",
        passes="over {limit} to 1",
        advice=f"{_ONE_BALL}, the microphone farther away, without automatic gain",
    ),
    CheckSpec(
        "a ball rather than a rhythm",
        at_least(20, "to 1", ".3g .0f", fatal=1),
        seen="{value} to 1 against {rhythm}",
        wanted="wanted: {limit} to 1",
        measures="odds against the best rhythm that is no ball's",
        passes="over {limit} to 1",
        if_not="s; r under 1 to 1",
        advice="record more bounces of one ball, near the microphone",
    ),
    CheckSpec(
        "flights shorten as a ball's",
        at_most(0.95, "", ".3f"),
        seen="each lasts {value} of the one before",
        wanted="at most {limit}: no ball that is heard keeps more",
        measures="each flight's duration over the one before",
        advice=_ONE_BALL,
    ),
    CheckSpec(
        "slows as balls do",
        at_least(-0.01, "", ".3f g"),  # flights that shorten by one time each look so
        seen="its restitution {falls} with speed, by a power of {by}",
        wanted="it may grow by {most:g} at most",
        measures="power of speed by which the restitution falls, its interval's upper end",
        passes="over {limit}",
        advice=_ONE_BALL,
    ),
    CheckSpec(
        "height fits the times",
        at_most(3.5, "standard deviations", ".1f"),
        seen="{value} standard deviations off",
        measures="`--height` against the drop height by the times",
        advice="measure from the ball's underside, and record its first impact",
    ),
    CheckSpec(
        "simulation fits",
        at_most(0.5, "ms", ".2f"),
        seen="its impacts are {value} ms from those heard, rms of {count} beside the "
        "{scatter:.2g} % by which each bounce is its own",
        wanted="at most {limit}, by their jitter of {jitter_ms:.2f} ms",
        more="; {worst_ms:.2f} ms at worst",
        measures="tuned rollout's impacts less those heard (rms)",
        passes="at most twice the jitter + {limit} ms",
        advice=_AGAIN,
    ),
)


def times_checks(detection: TimesDetection, last: Step, fit: FitResult | None) -> tuple[Check, ...]:
    """Check the times themselves, and whether the tuned simulator keeps them."""
    heard, among = detection.heard, detection.among
    count, wrong = len(heard.times_s), heard.reading.missed + heard.reading.false
    share = 100 * wrong / (count + wrong)
    is_ball = heard.log_odds > np.log(_SURE_ODDS)
    # Whether the times are a ball's rather than a beat's.
    softening_odds = (among and among.softening_odds) or 0.0
    name, log_odds = heard.rhythm
    odds = _odds(log_odds + softening_odds)  # a beat keeps its loudness
    surely_softer = softening_odds > np.log(_SURE_ODDS)
    least = float(heard.interval95[0, 0] if surely_softer else heard.values[0])
    rhythm = (
        TIMES["a ball rather than a rhythm"].measured(odds, rhythm=name),
        TIMES["flights shorten as a ball's"].measured(least),
    )
    is_beat = not any(check.passed for check in rhythm)
    how = "a ball is hardly heard: " if heard.log_odds > 0 else "no bouncing ball is heard: "
    own, sharp = TIMES["times are the ball's"], TIMES["times are sharp"]
    too_many = share > own.limit.value
    mean_ms = 1000 * float(np.diff(heard.predicted_s).mean())
    checks = [
        TIMES["enough impacts"].measured(count, secondary=not is_ball or is_beat),
        own.measured(
            share,
            passed=not too_many and is_ball,
            fatal=too_many or heard.log_odds < 0,
            invalidates_interval=too_many,
            how="" if is_ball else how,
            odds=_odds(heard.log_odds),
            sure=_SURE_ODDS,
            missed=heard.reading.missed,
            false=heard.reading.false,
            count=count,
        ),
        # A hand's clapping scatters by more than .03 mean flights.
        sharp.measured(1000 * heard.jitter_s, min(sharp.limit.value, 0.03 * mean_ms)),
    ]
    if among is not None:
        start_s = float(heard.times_s[0])
        checks += _sound_checks(among, start_s, secondary=not is_ball or is_beat)
    checks += rhythm
    slope, slows = float(heard.interval95[1, 1]), TIMES["slows as balls do"]
    checks.append(
        slows.measured(
            slope,
            falls="may fall" if slope > 0 else "grows",
            by=f"{'up to' if slope > 0 else 'at least'} {abs(slope):.3f}",
            most=-slows.limit.value,
        )
    )
    if heard.rig.height_m is not None:
        checks.append(TIMES["height fits the times"].measured(heard.height_sds))
    if fit is not None:
        checks.append(sure_check(*fit.interval95[0]))
    return (*checks, _simulation_check(heard, off_s(detection, last)))


def _odds(log_odds: float) -> float:
    """Return odds to 1, within what anybody wants to read."""
    return float(np.exp(np.clip(log_odds, -20.0, 20.0)))


def _sound_checks(among: BallAmong, first_s: float, *, secondary: bool) -> tuple[Check, Check]:
    """Check that one ball alone is heard, and that its knocks soften."""
    earlier_s, alone = among.earlier_s, TIMES["one ball alone"]
    second = "for a second ball at the same time"
    if len(earlier_s) and among.second_odds > 0:
        second = (
            f"that the {len(earlier_s)} knocks from {earlier_s[0]:.2f} to {earlier_s[-1]:.2f} s, "
            f"just before its first at {first_s:.2f} s, are the same ball's, or of one like it"
        )
    odds, clipped, detail = _odds(among.second_odds), among.clipped, None
    if among.softening_odds is None:
        detail = f"too few whole knocks to tell how it softens; {clipped} of its knocks are clipped"
    return (
        alone.measured(
            odds,
            passed=odds < alone.limit.value and among.as_loud <= _MAX_AS_LOUD,
            secondary=secondary,
            second=second,
            as_loud=among.as_loud,
            most_as_loud=_MAX_AS_LOUD,
        ),
        TIMES["softens as a ball does"].measured(
            np.nan if among.softening_odds is None else _odds(among.softening_odds),
            detail=detail,
            invalidates_interval=detail is None,
            clipped=clipped,
        ),
    )


def off_s(detection: TimesDetection, step: Step) -> Array:
    """Return an iterate's impacts less those heard, shape (I,) [s]; NaN where one is none."""
    assert step.evaluation is not None
    off = step.evaluation.observation.values - detection.target.values
    return off[:, 0] / detection.heard.seconds_s


def _simulation_check(heard: HeardBall, off: Array) -> Check:
    """Check the rollout's impacts against those heard, whitened by each bounce's own scatter."""
    spec, known = TIMES["simulation fits"], np.isfinite(off)
    rms_s, worst_s = np.inf, 0.0
    if known.any():
        numbers = np.flatnonzero(known) + heard.told
        times_s = heard.predicted_s[numbers]
        ratio = heard.scatter / heard.jitter_s
        own = Whitening.of(times_s, numbers - numbers[0], ratio).rows @ off[known]
        rms_s, worst_s = float(np.sqrt(np.mean(own**2))), float(np.abs(off[known]).max())
    jitter_ms = 1000 * heard.jitter_s
    return spec.measured(
        1000 * rms_s,
        2 * jitter_ms + spec.limit.value,
        count=known.sum(),
        scatter=100 * heard.scatter,
        jitter_ms=jitter_ms,
        worst_ms=1000 * worst_s,
    )


def ratio_cross_check(detection: TimesDetection, estimate: Array) -> CrossCheck | None:
    """Cross-check by plain ratios of successive flights' durations; None without two whole ones.

    Each is compared with that of the fitted ball, so that the air takes nothing from it.
    """
    heard, value = detection.heard, float(estimate[0])
    numbers, times_s, fitted_s = heard.numbers, heard.times_s, heard.predicted_s
    whole = np.flatnonzero((np.diff(numbers[:-1]) == 1) & (np.diff(numbers[1:]) == 1))
    if not len(whole):
        return None
    before, after = np.diff(times_s)[whole], np.diff(times_s)[whole + 1]
    at = numbers[whole]
    usual = np.diff(fitted_s)[at + 1] / np.diff(fitted_s)[at]
    each = after / before / usual
    sds = heard.jitter_s * np.sqrt(before**-2 + after**-2 + (1 / before + 1 / after) ** 2)
    sds = np.hypot(sds, heard.scatter)
    best = int(np.argmin(sds))
    weights = sds**-2 / np.sum(sds**-2)
    method, seen = "ratios of the flights' durations", value * float(weights @ each)
    return _judged(method, seen, value, value * float(sds[best]))
