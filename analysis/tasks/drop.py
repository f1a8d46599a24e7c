"""The drop: a ball's coefficient of restitution from its recorded height."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import Problem, Step
from analysis.observe import drop as views
from analysis.observe.base import Observation
from analysis.observe.free_fall import Drop, find_drops
from analysis.observe.quality import Check, fit_check, recording_checks
from analysis.tasks.base import CrossCheck, Preset, Selection
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import AntisymmetricNetwork, Network, PaperNetwork
from analysis.tunenet.pairs import PairSet, consecutive_pairs, mixed_pairs, observe_all
from analysis.tunenet.training import Recipe
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from recorders.simulators.drop import RESTITUTION, TOPIC, DropRig, DropSimulator
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.progress import Progress

Array = NDArray[np.float64]

_AXES = {"+z": (2, 1), "-z": (2, -1), "+y": (1, 1), "-y": (1, -1), "+x": (0, 1), "-x": (0, -1)}
_AGREEMENT = 0.02
_PAPER_HEIGHT_M = (4.0, 5.0)
_PAPER_RESTITUTION = (0.3, 0.7)
_PAPER_PAIRS = 800
_ROLLOUTS = 2048
_PAIRS = 51_200
_TRAINING_RATES_HZ = (60.0, 120.0, 240.0)


@dataclass(frozen=True, eq=False)
class FoundDrop:
    """A drop in an episode, as one preset looks at it.

    Attributes:
        topic: where the ball's position came from.
        drop: with heights along `up`.
        signal: the whole signal.
        start_ns: stamp of the drop's clock's zero.
        sideways_m: horizontal positions in the drop's window [m], shape (T, 2).
        target: o_T.
        warnings: what a user should know, in words.
    """

    preset: str
    topic: str
    drop: Drop
    signal: Signal
    start_ns: int
    sideways_m: Array
    target: Observation
    warnings: tuple[str, ...]


class DropTask:
    """See `Task`."""

    name = "drop"
    parameters = (RESTITUTION,)

    @property
    def presets(self) -> Mapping[str, Preset]:
        """See `Task.presets`."""
        return _PRESETS

    def find(self, episode: Episode, selection: Selection, preset: str) -> FoundDrop:
        """The first drop of the ball's signal; see `Task.find`."""
        reasons: list[str] = []
        for signal in _candidates(episode, selection):
            try:
                return _find_in(_cut(signal, selection), preset)
            except NotFoundError as reason:
                reasons.append(f"{signal.name}: {reason}")
        raise NotFoundError(reasons[0])

    def problem(self, found: FoundDrop, initial: Array) -> Problem:
        """A simulator with the drop's own height, rate and release; see `Task.problem`."""
        rig, contact = _rig_like(found)
        simulator = DropSimulator(rig, contact)
        if contact == PAPER:
            return Problem(found.target, simulator, views.paper_rollout, initial)
        observe = partial(_observe_rollout, rig=rig, contact=contact)
        return Problem(found.target, simulator, observe, initial)

    def checks(self, found: FoundDrop, last: Step) -> tuple[Check, ...]:
        """See `Task.checks`."""
        assert last.look is not None
        scale = found.drop.drop_height_m if found.preset != "default" else 1.0
        fit = fit_check(last.look.observation, found.target, scale)
        return (*recording_checks(found.drop, found.sideways_m), fit)

    def cross_check(self, found: FoundDrop, estimate: Array) -> CrossCheck | None:
        """The speeds just after and just before the impact, by the parabolas on either side."""
        value = found.drop.rebound_speed_m_s / found.drop.impact_speed_m_s
        if np.isnan(value) or not _PRESETS[found.preset].physical:
            return None
        agrees = bool(abs(value - estimate[0]) < _AGREEMENT)
        return CrossCheck("speeds at the first impact", value, agrees)


def _candidates(episode: Episode, selection: Selection) -> list[Signal]:
    """Position signals in the order in which to try them."""
    if selection.topic is not None:
        if selection.topic in episode.signals:
            return [episode.signals[selection.topic]]
        known = ", ".join(sorted(episode.signals)) or "none"
        raise UsageError(f"no usable topic {selection.topic}; there is: {known}")
    positions = [one for one in episode.signals.values() if one.columns == ("x", "y", "z")]
    if not positions:
        seen = ", ".join(f"{one.topic} ({one.type_name or 'no type'})" for one in episode.channels)
        raise NotFoundError(
            "no channel with the position of a ball (geometry_msgs/msg/PoseStamped); "
            f"channels: {seen or 'none'}"
        )
    return sorted(positions, key=lambda one: (one.name != TOPIC, "ball" not in one.name, one.name))


def _cut(signal: Signal, selection: Selection) -> Signal:
    """The selected part, without the samples that hold no position."""
    seconds = signal.seconds
    keep = np.isfinite(signal.values).all(axis=1)
    if selection.start_s is not None:
        keep &= seconds >= selection.start_s
    if selection.end_s is not None:
        keep &= seconds <= selection.end_s
    return Signal(
        signal.name, signal.stamps_ns[keep], signal.values[keep], signal.columns, signal.unit
    )


def _find_in(signal: Signal, preset: str) -> FoundDrop:
    if not len(signal.stamps_ns):
        raise NotFoundError("no samples in the selected part")
    up, drops = _vertical_drops(signal)
    column, sign = _AXES[up]
    drop = drops[0]
    warnings = [] if up == "+z" else [f"up is {up} in {signal.name}"]
    if len(drops) > 1:
        spans = ", ".join(f"{one.seconds[0]:.2f} to {one.seconds[-1]:.2f} s" for one in drops)
        warnings.append(f"{len(drops)} drops ({spans}); the first is used (see --start, --end)")
    window = slice(drop.first, drop.first + len(drop.seconds))
    target = _VIEWS[preset](drop)
    if preset != "default":
        warnings += _paper_warnings(drop, target)
    return FoundDrop(
        preset=preset,
        topic=signal.name,
        drop=drop,
        signal=signal,
        start_ns=int(signal.stamps_ns[0]),
        sideways_m=np.delete(signal.values, column, axis=1)[window],
        target=target,
        warnings=tuple(warnings),
    )


def _vertical_drops(signal: Signal) -> tuple[str, list[Drop]]:
    """Which way is up, +z if in doubt, and the drops along it."""
    spans = np.ptp(signal.values, axis=0)
    first_reason: NotFoundError | None = None
    for up, (column, sign) in _AXES.items():
        if spans[column] < 0.5 * spans.max():
            continue
        try:
            return up, find_drops(signal.seconds, sign * signal.values[:, column])
        except NotFoundError as reason:
            first_reason = first_reason or reason
    raise first_reason or NotFoundError("the ball does not move")


def _paper_warnings(drop: Drop, target: Observation) -> list[str]:
    if np.isnan(target.values).any():
        raise NotFoundError(
            "the paper's network needs 400 samples at 60 Hz: record 6.7 s from the release on, "
            "or use --preset default"
        )
    height = drop.release_m - drop.contact_m + views.PAPER_RADIUS_M
    low, high = _PAPER_HEIGHT_M
    if low - 0.1 <= height <= high + 0.1:
        return []
    return [
        f"a drop from {height:.2f} m (ball of 0.5 m radius) is outside the {low:g} to {high:g} m "
        "that the paper's network was trained on"
    ]


def _rig_like(found: FoundDrop) -> tuple[DropRig, ContactSettings]:
    """The rig whose rollouts show the same drop at the same stamps."""
    drop = found.drop
    if found.preset != "default":
        gap = drop.release_m - drop.contact_m
        start_ns = found.start_ns + round(1e9 * drop.release_s)
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


def _observe_plans(plans: Sequence[tuple[DropRig, ContactSettings, float]]) -> Array:
    """Observations of rollouts, shape (N, L, 1); runs in the worker processes."""
    curves: list[Array] = []
    simulator = DropSimulator(plans[0][0], plans[0][1])
    for rig, contact, restitution in plans:
        simulator = simulator.with_rig(rig)
        episode = simulator.rollout({RESTITUTION.name: restitution})
        if contact == PAPER:
            curves.append(views.paper_rollout(episode).values)
        else:
            curves.append(_observe_rollout(episode, rig, contact).values)
    return np.array(curves)


def _paper_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Both rollouts of a pair from one height, U(4, 5) m; restitutions U(.3, .7)."""
    count = count or _PAPER_PAIRS
    rng = np.random.default_rng(seed)
    heights = np.repeat(rng.uniform(*_PAPER_HEIGHT_M, count), 2)
    values = rng.uniform(*_PAPER_RESTITUTION, 2 * count)
    radius = views.PAPER_RADIUS_M
    plans = [
        (DropRig(float(height) - radius, radius, views.PAPER_RATE_HZ), PAPER, float(value))
        for height, value in zip(heights, values, strict=True)
    ]
    observations = observe_all(_observe_plans, plans, jobs, progress)
    return PairSet(observations, values[:, None], *consecutive_pairs(count))


def _canonical_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Restitutions over all of [0, 1], evenly; any rig will do, so heights and rates vary."""
    rng = np.random.default_rng(seed)
    values = (np.arange(_ROLLOUTS) + rng.random(_ROLLOUTS)) / _ROLLOUTS
    gaps = rng.uniform(0.3, 5.0, _ROLLOUTS)
    rates = rng.choice(_TRAINING_RATES_HZ, _ROLLOUTS)
    plans = []
    for gap, rate, value in zip(gaps, rates, values, strict=True):
        fall_s = np.sqrt(2 * gap / CALIBRATED.gravity_m_s2)
        samples = int(np.ceil((views.CANONICAL_SPAN + 1) * fall_s * rate)) + 3
        rig = DropRig(float(gap), rate_hz=float(rate), samples=samples, hold_s=rng.random() / rate)
        plans.append((rig, CALIBRATED, float(value)))
    observations = observe_all(_observe_plans, plans, jobs, progress)
    return PairSet(observations, values[:, None], *mixed_pairs(values, count or _PAIRS, rng))


def _preset(
    name: str,
    network: Network,
    recipe: Recipe,
    make_pairs: Callable[[int | None, int, int | None, Progress], PairSet],
) -> Preset:
    ours = name == "default"
    seen = "height after impact, 32 places a fall time, 4 fall times"
    purpose = Purpose(
        task="drop",
        preset=name,
        observation=seen if ours else "z, 400 samples at 60 Hz from the release",
        inputs=len(views.canonical_axis()) if ours else views.PAPER_SAMPLES,
        outputs=1,
        rates_hz=_TRAINING_RATES_HZ if ours else (views.PAPER_RATE_HZ,),
    )
    return Preset(purpose, network, recipe, make_pairs, physical=ours)


_VIEWS: dict[str, Callable[[Drop], Observation]] = {
    "default": views.canonical,
    "paper": views.paper_heights,
    "paper-code": views.paper_heights,
}

_PRESETS = {
    "default": _preset(
        "default",
        AntisymmetricNetwork(),
        Recipe(
            optimizer="adamw",
            learning_rate=3e-3,
            weight_decay=0.01,
            loss="relative",
            scaling="standard",
            epochs=20,
            batch=256,
            noise=0.01,
            cut_share=0.2,
        ),
        _canonical_pairs,
    ),
    "paper": _preset(
        "paper",
        PaperNetwork(),
        Recipe(
            optimizer="sgd",
            learning_rate=1e-2,
            decay=0.99,
            decay_epochs=5,
            weight_decay=1e-2,
            loss="norm",
            scaling="unit",
            epochs=200,
            batch=50,
        ),
        _paper_pairs,
    ),
    "paper-code": _preset(
        "paper-code",
        PaperNetwork(),
        Recipe(
            optimizer="sgd",
            learning_rate=1e-1,
            decay=0.99,
            decay_epochs=1,
            weight_decay=1e-2,
            loss="squared",
            scaling="raw",
            epochs=200,
            batch=50,
        ),
        _paper_pairs,
    ),
}
