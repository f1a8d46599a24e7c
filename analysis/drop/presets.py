"""Presets of the drop: which simulator, observation, network and training go together.

A network sees a drop on the canonical grid, or as the paper has it. With s = (t - t_impact) / T0,
T0 the time of the fall without air, and u the height above contact in drop heights, a bounce is one
curve that depends on the ball alone: on its restitution, on how that falls with speed, and on the
air's drag times the drop height. So one network serves every drop height, table and sampling rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np

from tunenet_logs.analysis.drop.free_flight import Drop
from tunenet_logs.analysis.estimators.base import (
    Estimator,
    Observation,
    Problem,
    Search,
    Trace,
    check_one_parameter,
    resample,
)
from tunenet_logs.analysis.experiment import Training, presets_of
from tunenet_logs.analysis.statistics import noise_of
from tunenet_logs.analysis.tunenet.network import (
    PairSet,
    PaperNetwork,
    Recipe,
    WideNetwork,
    Workers,
    consecutive_pairs,
    mixed_pairs,
    observe_all,
)
from tunenet_logs.analysis.tunenet.weights import Purpose
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.ball import (
    DRAG,
    REAL_BALL,
    RESTITUTION,
    SLOPE,
    TOPIC,
    DropRig,
    DropSimulator,
    lands_after_s,
)
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, BallWorld, ContactSettings
from tunenet_logs.recorders.simulators.camera import PinholeCamera
from tunenet_logs.recorders.simulators.known import engine
from tunenet_logs.terminal import Progress

# The canonical grid: points in each fall time, how many of them are before the first impact, and
# fall times after it. The first moments of a fall are left out: a hand may still be there.
CANONICAL_PER_FALL = 32
CANONICAL_BEFORE = 28
CANONICAL_SPAN = 4
# The simulation of the TuneNet paper: samples and ball.
PAPER_RATE_HZ = 60.0
PAPER_SAMPLES = 400
PAPER_RADIUS_M = 0.5


@cache
def canonical_axis() -> Array:
    """Return the canonical grid [fall times after the first impact], shape (156,), read-only."""
    last = CANONICAL_SPAN * CANONICAL_PER_FALL
    axis = np.setdiff1d(np.arange(-CANONICAL_BEFORE, last + 1), [0]) / CANONICAL_PER_FALL
    axis.flags.writeable = False
    return axis


def canonical_observation(values: Array) -> Observation:
    """Wrap heights [drop heights] on the canonical grid, shape (156,)."""
    axis = canonical_axis()
    return Observation(values[:, None], axis, "time after impact [fall times]", ("[drop heights]",))


def canonical(drop: Drop) -> Observation:
    """Resample a drop to the canonical grid: height [drop heights] against time [fall times].

    The curve is of parabolas u'' = -2 that meet at impacts. Three of them claim each gap between
    samples: the one through its two ends, and those of the gaps on either side, prolonged. Without
    an impact near by they agree; with one in the gap beside it, two agree; with one in the gap
    itself, the two neighbours meet there from above and the gap's own lies over both. The median is
    right every time. A ball at rest is no parabola: there the straight line is the lower bound. If
    it is seen to rest it goes on resting; else what comes after the recording is NaN.
    """
    axis = canonical_axis()
    times = (drop.seconds - drop.impact_s) / drop.fall_time_s
    heights = (drop.heights_m - drop.contact_m) / drop.drop_height_m
    gap = np.clip(np.searchsorted(times, axis, side="right") - 1, 1, len(times) - 3)
    claims: list[Array] = []
    for first in (gap - 1, gap, gap + 1):
        before, after = times[first], times[first + 1]
        slope = (heights[first + 1] - heights[first]) / (after - before)
        since = axis - before
        claims.append(heights[first] + slope * since + since * (after - axis))
    straight = np.interp(axis, times, heights)
    values = np.maximum(np.sort(claims, axis=0)[1], np.minimum(straight, 0.0))
    values[(axis < times[0]) | (axis > times[-1])] = np.nan
    if not np.isnan(drop.rest_m):
        values[axis > times[-1]] = (drop.rest_m - drop.contact_m) / drop.drop_height_m
    return canonical_observation(values)


def rollout_drop(
    episode: Episode, rig: DropRig, contact: ContactSettings, drop_height_m: float | None = None
) -> Drop:
    """Build the drop of a simulated episode, whose rig and release are known exactly.

    Heights are measured by `drop_height_m`; None for the rig's own, of a ball let go.
    """
    height_m = rig.gap_m if drop_height_m is None else drop_height_m
    signal, gravity = episode.signals[TOPIC], contact.gravity_m_s2
    drag_1_m = episode.info.truth.get(DRAG.name, 0.0)  # of a rollout: what it was told
    impact_s = rig.hold_s + lands_after_s(rig.gap_m, rig.speed_m_s, gravity, drag_1_m)
    return Drop(
        first=0,
        seconds=(signal.stamps_ns - rig.start_ns).astype(np.float64) * 1e-9,
        heights_m=signal.values[:, 2],
        release_s=rig.hold_s,
        release_m=rig.radius_m + rig.gap_m,
        impact_s=impact_s,
        contact_m=rig.radius_m,
        impact_speed_m_s=float(np.sqrt(2 * gravity * height_m)),
        flight_restitution=float("nan"),
        flight_restitution_sd=float("nan"),
        gravity_m_s2=gravity,
        flight_gravity_m_s2=gravity,
        fall_s=(rig.hold_s, impact_s),
        flight_s=(impact_s, impact_s),
        noise_m=0.0,
        rest_m=rig.radius_m,
    )


def paper_heights(drop: Drop) -> Observation:
    """Resample z [m] to 400 samples at 60 Hz from the release, as the paper's network has it.

    z is that of a ball of 0.5 m radius on a plane at z = 0. A recording that ends with the ball at
    rest goes on with it at rest; else what is missing is NaN.
    """
    wanted = paper_start_s(drop) + paper_axis()
    values = resample(drop.seconds, drop.heights_m - drop.table_m, wanted)
    if not np.isnan(drop.rest_m):
        values[wanted > drop.seconds[-1]] = 0.0
    return _paper_observation(values + PAPER_RADIUS_M)


def paper_start_s(drop: Drop) -> float:
    """Return when the paper's simulation starts [s]: its k-th sample is k periods later.

    The engine's step (v += -g dt, then z += v dt) puts its k-th sample where free fall is after
    k + 1/2 periods. A recording that starts with the release, to within a sample or so, is taken
    from its first sample on.
    """
    period_s = 1 / PAPER_RATE_HZ
    start_s = drop.release_s + period_s / 2
    if abs(drop.seconds[0] - start_s) < 2 * period_s:
        return float(drop.seconds[0] - period_s)
    return start_s


def paper_rollout(episode: Episode) -> Observation:
    """Return the paper's rollout as it is: z after each of 400 steps."""
    return _paper_observation(episode.signals[TOPIC].values[:, 2])


def paper_unit_heights(episode: Episode) -> Observation:
    """Return z from 0 to about 1 [5 m], for a paper's network that sees a video beside it."""
    heights = episode.signals[TOPIC].values[:, 2] / 5.0  # its highest drop
    return Observation(heights[:, None].copy(), paper_axis(), "time [s]", ("z [5 m]",))


def paper_axis() -> Array:
    """Return the times of the paper's samples after the start [s], shape (400,)."""
    return np.arange(1, PAPER_SAMPLES + 1) / PAPER_RATE_HZ


def _paper_observation(heights_m: Array) -> Observation:
    return Observation(heights_m[:, None].copy(), paper_axis(), "time [s]", ("z [m]",))


# ---- Presets of recorded heights, and the pairs of rollouts that their networks learn from

# A rollout to make: rig, settings, values.
Plan = tuple[DropRig, ContactSettings, Mapping[str, float]]

PAPER_HEIGHT_M = (4.0, 5.0)  # of the ball's centre in the paper's training data
PAPER_RESTITUTION = (0.3, 0.7)  # there, likewise
_PAPER_PAIRS = 800
_RATES_HZ = (60.0, 120.0, 240.0)  # that vary how the observation is sampled


@lru_cache(maxsize=1)
def _world(radius_m: float, contact: ContactSettings) -> BallWorld:
    """Return one world a process: making it takes as long as a dozen rollouts."""
    return engine().ball_world(radius_m, contact)


def _observe_plans(plans: Sequence[Plan]) -> Array:
    """Simulate and observe plans, shape (N, L, 1); runs in the worker processes."""
    curves: list[Array] = []
    rig, contact, _ = plans[0]
    simulator = DropSimulator(rig, contact, _world(rig.radius_m, contact))
    for rig, contact, values in plans:
        simulator = simulator.with_rig(rig)
        episode = simulator.rollout(values)
        if contact == PAPER:
            curves.append(paper_rollout(episode).values)
        else:
            curves.append(canonical(rollout_drop(episode, rig, contact)).values)
    return np.array(curves)


def observe_paper_drops(
    releases_m: Array, restitutions: Array, workers: Workers, progress: Progress
) -> Array:
    """Simulate the paper's drops as its network sees them, shape (N, 400, 1).

    `releases_m` are heights of the ball's centre, shape (N,).
    """
    plans: list[Plan] = []
    for height, value in zip(releases_m.tolist(), restitutions.tolist(), strict=True):
        rig = DropRig(height - PAPER_RADIUS_M, PAPER_RADIUS_M, PAPER_RATE_HZ)
        plans.append((rig, PAPER, {RESTITUTION.name: value}))
    return observe_all(_observe_plans, plans, workers, progress)


def _paper_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Simulate both rollouts of a pair from one height, U(4, 5) m; restitutions U(.3, .7)."""
    count = count or _PAPER_PAIRS
    rng = np.random.default_rng(seed)
    heights = np.repeat(rng.uniform(*PAPER_HEIGHT_M, count), 2)
    values = rng.uniform(*PAPER_RESTITUTION, 2 * count)
    observations = observe_paper_drops(heights, values, workers, progress)
    return PairSet(observations, values[:, None], *consecutive_pairs(count))


def _canonical_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Simulate real balls, evenly over their ranges; any rig will do, so heights and rates vary."""
    count = count or 204_800  # pairs
    rollouts = min(4096, 2 * count)  # a pair among them costs nothing more
    rng = np.random.default_rng(seed)
    # Of the drag times the drop height: more than a table-tennis ball's from 3 m.
    ranges = np.array([one.training_range for one in (RESTITUTION, SLOPE)] + [(0.0, 0.5)])
    shares = (np.arange(rollouts) + rng.random((3, rollouts))) / rollouts
    shares = np.array([rng.permutation(share) for share in shares])
    values = (ranges[:, :1] + np.ptp(ranges, axis=1)[:, None] * shares).T
    gaps = rng.uniform(0.3, 5.0, rollouts)  # [m]
    rates = rng.choice(_RATES_HZ, rollouts)
    plans: list[Plan] = []
    for gap, rate, (restitution, slope, drag) in zip(gaps, rates, values.tolist(), strict=True):
        fall_s = np.sqrt(2 * gap / CALIBRATED.gravity_m_s2)
        samples = int(np.ceil((CANONICAL_SPAN + 1 + drag) * fall_s * rate)) + 3
        rig = DropRig(float(gap), rate_hz=float(rate), samples=samples, hold_s=rng.random() / rate)
        ball = {RESTITUTION.name: restitution, SLOPE.name: slope, DRAG.name: drag / float(gap)}
        plans.append((rig, CALIBRATED, ball))
    observations = observe_all(_observe_plans, plans, workers, progress)
    return PairSet(observations, values, *mixed_pairs(values, count, rng))


def _paper_training(
    task: str,
    name: str,
    observation: str,
    recipe: Recipe,
    make_pairs: Callable[[int | None, int, Workers, Progress], PairSet],
) -> Training:
    rates_hz = (PAPER_RATE_HZ,)
    purpose = Purpose(task, name, observation, inputs=PAPER_SAMPLES, outputs=1, rates_hz=rates_hz)
    return Training(purpose, PaperNetwork(), recipe, make_pairs)


OUR_TRAINING = Recipe(
    optimizer="adamw",
    learning_rate=3e-3,
    weight_decay=0.01,
    loss="relative",
    scaling="standard",
    epochs=20,
    batch=256,
    cut_share=0.2,
)

_OURS = Training(
    Purpose(
        task="drop",
        preset="default",
        observation="height [drop heights] about the first impact, 32 places a fall time, from 28 "
        "places before it to 4 fall times after; restitution, slope, drag times drop height",
        inputs=len(canonical_axis()),
        outputs=3,
        rates_hz=_RATES_HZ,
    ),
    WideNetwork(),
    replace(OUR_TRAINING, noise=0.004, epochs=30, scaling="ranges", cut_share=0.3),
    _canonical_pairs,
)

PAPERS_TEXT = Recipe(
    optimizer="sgd",
    learning_rate=1e-2,
    decay=0.99,
    decay_epochs=5,
    weight_decay=1e-2,
    loss="norm",
    scaling="unit",
    epochs=200,
    batch=50,
)

PAPERS_CODE = replace(
    PAPERS_TEXT, learning_rate=1e-1, decay_epochs=1, loss="squared", scaling="raw"
)

_PAPERS_VIEW = "z, 400 samples at 60 Hz from the release"

TRAININGS = {
    "default": _OURS,
    "paper": _paper_training("drop", "paper", _PAPERS_VIEW, PAPERS_TEXT, _paper_pairs),
    "paper-code": _paper_training("drop", "paper-code", _PAPERS_VIEW, PAPERS_CODE, _paper_pairs),
}

PRESETS = presets_of(TRAININGS, REAL_BALL, (RESTITUTION,))


# ---- Presets of the filmed drop: what a network sees of simulation and video


# A drop to simulate: rig, restitution, and the seed of the camera that films it, or None.
FilmPlan = tuple[DropRig, float, int | None]


def _observe_paper_plans(plans: Sequence[FilmPlan]) -> Array:
    """Simulate z, or the image's y of a filmed drop; shape (N, 400, 1)."""
    curves: list[Array] = []
    simulator = DropSimulator(plans[0][0], PAPER)
    for rig, restitution, seed in plans:
        simulator = simulator.with_rig(rig)
        episode = simulator.rollout({RESTITUTION.name: restitution})
        if seed is None:
            curves.append(paper_unit_heights(episode).values)
            continue
        rows = paper_rows(episode.signals[TOPIC].values, np.random.default_rng(seed))
        curves.append(filled(rows)[:, None])
    return np.array(curves)


def paper_rows(positions_m: Array, rng: np.random.Generator) -> Array:
    """Project a ball, (T, 3), into a random camera of the paper: y from 0 at the top to 1."""
    # Places in m, pictures of 100 by 100 px and 60 degrees, a detector's noise of 0.2 px.
    distance, angle = rng.uniform(5.0, 10.0), rng.uniform(0.0, 2 * np.pi)
    place = (distance * np.cos(angle), distance * np.sin(angle), rng.uniform(5.0, 8.0))
    camera = PinholeCamera(place, (0.0, 0.0, 2.0), (100, 100), 60.0)
    places = camera.image_from_world(positions_m)
    places = places + rng.normal(0.0, 1.0, places.shape) * 0.2
    inside = np.all((places > 0) & (places < np.array(camera.size_px) - 1), axis=1)
    return np.where(inside, places[:, 1], np.nan) / camera.size_px[1]


def filled(rows: Array) -> Array:
    """Fill missing rows by linear interpolation, for a network that needs every one."""
    known, numbers = np.isfinite(rows), np.arange(len(rows))
    return np.interp(numbers, numbers[known], rows[known])


def _filmed_paper_pairs(
    count: int | None, seed: int, workers: Workers, progress: Progress
) -> PairSet:
    """Simulate both rollouts of a pair from one height; the second one is filmed."""
    count = count or _PAPER_PAIRS
    rng = np.random.default_rng(seed)
    plans: list[FilmPlan] = []
    for _ in range(count):
        height, radius = float(rng.uniform(*PAPER_HEIGHT_M)), PAPER_RADIUS_M
        rig = DropRig(height - radius, radius, PAPER_RATE_HZ)
        plans.append((rig, float(rng.uniform(*PAPER_RESTITUTION)), None))
        value, camera = float(rng.uniform(*PAPER_RESTITUTION)), int(rng.integers(2**62))
        plans.append((rig, value, camera))
    observations = observe_all(_observe_paper_plans, plans, workers, progress)
    values = np.array([[restitution] for _, restitution, _ in plans])
    return PairSet(observations, values, *consecutive_pairs(count))


FILM_TRAININGS = {
    "default": TRAININGS["default"],  # the canonical observation knows no camera
    "paper": _paper_training(
        "drop-video",
        "paper",
        "z [5 m] of the simulation, y of the picture from 0 to 1, 400 samples at 60 Hz from the "
        "release",
        PAPERS_TEXT,
        _filmed_paper_pairs,
    ),
}

FILM_PRESETS = presets_of(FILM_TRAININGS, REAL_BALL, (RESTITUTION,))


# ---- Secant method on the first flight's duration

_CLOSE = 1e-9  # change of the restitution that ends a search: far below what any recording tells
_LOW = 0.15  # below it a flight may be too short to be seen, and the cost has one minimum
_MIN_SAMPLES = 4  # of a fall, and of a flight: one more than a parabola has coefficients


class FlightSecant(Estimator):
    """Secant search for the restitution at which the simulated ball flies as long as the target's.

    The duration is nearly proportional to the restitution: the first step goes by that, the others
    by the secant through the last two rollouts. A ball that is not seen to leave the table flies
    for 0 s. Where the target does, or low durations come no closer, the cost takes their place:
    Brent's method between the restitutions that flew shorter and longer. One parameter.
    """

    name = "secant"
    takes_one_parameter = True

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Search for the restitution by the secant method; see `Estimator.estimate`."""
        if check_one_parameter(problem, self.name) != RESTITUTION:
            raise NotFoundError(
                "the method secant compares flights", "leave --method out: it is for drops"
            )
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: _optimize(search, problem))


def _optimize(search: Search, problem: Problem) -> None:
    """Run the secant method; Brent's on the cost where durations lead no further."""
    wanted = _duration(problem.target)
    (bounds,) = (parameter.bounds for parameter in problem.parameters)
    value, last = float(problem.initial[0]), None
    low, high = bounds[0], _LOW if wanted == 0 else 2 * _LOW
    while True:
        evaluation = search.evaluate(np.array([value]))
        flown = _duration(evaluation.observation)
        if flown > wanted:
            high = min(high, value)
        elif wanted > 0 and value < high:
            low = max(low, value)
        # Durations lead no further where the target's is unseen, or low ones come no closer.
        is_lost = wanted == 0
        if last is not None and value <= _LOW:
            is_lost |= flown == 0 or abs(flown - wanted) > abs(last[1] - wanted) / 2
        if is_lost:
            cost = float(np.linalg.norm(problem.misfit(evaluation))) if value <= high else np.inf
            _least_cost(search, (low, high), cost)
            return
        slope = _slope((value, flown), last)
        if slope > 0:
            following = float(np.clip(value + (wanted - flown) / slope, *bounds))
        else:
            following = sum(bounds) / 2  # a ball that did not fly says nothing of how far to go
        if abs(following - value) < _CLOSE:
            return
        last, value = (value, flown), following
        search.answer(np.array([value]))


def _least_cost(search: Search, bounds: tuple[float, float], least: float) -> None:
    """Minimise the cost by Brent's method, squared so that parabolas fit it."""
    from scipy.optimize import minimize_scalar

    if np.isinf(least):
        search.answer(np.array([sum(bounds) / 2]))

    def squared(value: float) -> float:
        nonlocal least
        cost = search.cost(np.array([value]))
        if cost < least:
            least = cost
            search.answer(np.array([value]))
        return cost**2

    options = {"xatol": _CLOSE, "maxiter": max(search.left, 1)}
    minimize_scalar(squared, bounds=bounds, method="bounded", options=options)


def _slope(here: tuple[float, float], last: tuple[float, float] | None) -> float:
    """Return seconds of flight for a unit of restitution; 0 where that cannot be determined.

    Sampling makes the duration uneven over very small changes: a slope that is far from the
    proportional one is none of the ball's.
    """
    value, flown = here
    proportional = flown / value if value > 0 else 0.0
    if last is None:
        return proportional
    slope = (flown - last[1]) / (value - last[0])
    if proportional == 0 or proportional / 2 < slope < 2 * proportional:
        return slope
    return proportional


def _duration(observation: Observation) -> float:
    """Return the first flight's duration, in the unit of the observation's axis."""
    seconds, heights = observation.axis, observation.values[:, 0]
    seen = np.isfinite(heights)
    seconds, heights = seconds[seen], heights[seen]
    if np.array_equal(observation.axis, canonical_axis()):  # falls are alike, and may be unseen
        after = seconds > 0
        fall = np.arange(-CANONICAL_PER_FALL, 1) / CANONICAL_PER_FALL
        seconds = np.concatenate([fall, seconds[after]])
        heights = np.concatenate([1 - (fall + 1) ** 2, heights[after]])
    return first_flight_s(seconds, heights)


def first_flight_s(seconds: Array, heights: Array) -> float:
    """Measure the duration of the flight between the first two impacts; 0 where it is not seen.

    The first impact is where the parabolas of fall and flight meet, the second one where the
    flight's is as low again. So the second impact itself, which falls anywhere in the step of an
    engine, plays no part: the duration changes evenly with the restitution. Drag biases it, alike
    in two curves that are compared.
    """
    low = heights < (heights.max() + heights.min()) / 2
    stops = np.flatnonzero(low[:-1] & (np.diff(heights) >= 0))
    if not len(stops) or stops[0] < _MIN_SAMPLES or len(heights) - stops[0] < _MIN_SAMPLES:
        return 0.0
    impact = int(stops[0])  # the lowest sample of the first fall
    rest = float(np.quantile(heights[impact:], 0.05))  # the table, where most samples rest on it
    least = 6 * noise_of(heights) + 1e-3 * float(np.ptp(heights))
    top = np.maximum.accumulate(heights[impact:])
    # A flight is over below 0.3 of its height: it is fitted up to there.
    over = (top > rest + least) & (heights[impact:] < rest + 0.3 * (top - rest))
    if not over.any():
        return 0.0
    flight = slice(impact + 1, impact + int(np.argmax(over)))
    if flight.stop - flight.start < _MIN_SAMPLES:
        return 0.0
    clock = seconds - seconds[impact]
    falling = heights[:impact] < rest + 0.98 * (heights[0] - rest)
    down = np.polyfit(clock[:impact][falling], heights[:impact][falling], 2)
    up = np.polyfit(clock[flight], heights[flight], 2)
    if not 0.5 * down[0] > up[0] > 2 * down[0]:  # noise about a ball at rest is no free flight
        return 0.0
    apex = -up[1] / (2 * up[0])
    crossings = np.roots(down - up)
    near = crossings[np.argmin(np.abs(crossings))]
    return float(max(0.0, 2 * (apex - near.real)))
