"""Sources of a simulator: a model's file, or an object of the user's own.

Connected with a log, a source gives rollouts that the log drives, from the initial state that the
log shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.record import TunedModel
from tunenet_logs.analysis.sysid.columns import ComparedColumns, compared, noise_of
from tunenet_logs.analysis.sysid.fit import FITTED, Begun
from tunenet_logs.analysis.sysid.horizons import Unseen
from tunenet_logs.analysis.sysid.matching import rotations
from tunenet_logs.episode import Array, Episode, LeftOut
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import read_small_file
from tunenet_logs.recorders.simulators.base import Parameter, Simulator
from tunenet_logs.recorders.simulators.model.rollout import (
    InitialState,
    SensedSignal,
    free_joint,
    seen_in_world,
)
from tunenet_logs.recorders.simulators.model.servo import ACTUATORS, moved_joints
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import listed, one_line, short_name

if TYPE_CHECKING:
    from tunenet_logs.analysis.sysid.matching import Match
    from tunenet_logs.recorders.simulators.model.parameters import ModelParameter
    from tunenet_logs.recorders.simulators.model.reading import ModelFiles, ModelProcess
    from tunenet_logs.recorders.simulators.model.rollout import ModelSimulator


# ---- Value and slope of sampled curves at a stamp, by their first samples

_SECONDS, _MAX_SAMPLES, _MIN_SAMPLES = 0.12, 40, 4
_MISSES = 2.0  # standard deviations of noise, from which on it misses
Samples = tuple[NDArray[np.int64], Array]  # stamps [ns] and values


def beginning(
    positions: Samples | None, speeds: Samples | None, stamp_ns: int, noise: float | None = None
) -> tuple[tuple[float, float], tuple[float, float], bool] | None:
    """Estimate position and speed at a stamp, with sds, and whether a position was seen.

    One parabola is fitted to the first positions (None if none were seen) and, by its slope, to the
    first speeds, of this noise, or that of their differences. The window shrinks until it fits; the
    standard deviations include the misfit of the shortest one, and disagreement of speeds and
    positions.
    """
    at_s: list[Array] = []
    rows: list[Array] = []
    values: list[Array] = []
    for order, samples in enumerate((positions, speeds)):
        if samples is None or len(samples[0]) < _MIN_SAMPLES:
            continue
        seconds = 1e-9 * (samples[0][:_MAX_SAMPLES] - stamp_ns).astype(np.float64)
        count = max(int(np.sum(seconds <= _SECONDS)), _MIN_SAMPLES)
        scatter = max(noise_of(samples[1]) if noise is None else noise, 1e-9)
        at_s.append(seconds[:count])
        # Rows of 1, t, t²/2, t³/6 and t⁴/24, or of their slopes.
        at = seconds[:count]
        terms = [np.ones_like(at), at, at**2 / 2, at**3 / 6, at**4 / 24]
        terms = [np.zeros_like(at), *terms[:4]] if order else terms
        rows.append(np.column_stack(terms) / scatter)
        values.append(samples[1][:count] / scatter)
    if not rows:
        return None
    window_s = max(float(seconds[-1]) for seconds in at_s)
    counts = [len(seconds) for seconds in at_s]
    while True:
        found, sds, misfit = _parabola(
            np.concatenate([row[:count] for row, count in zip(rows, counts, strict=True)]),
            np.concatenate([value[:count] for value, count in zip(values, counts, strict=True)]),
        )
        window_s *= 0.7  # to this share, a window that a parabola misses
        fewer = [max(int(np.sum(seconds <= window_s)), 1) for seconds in at_s]
        if misfit <= 1 or max(fewer) < _MIN_SAMPLES:
            break
        counts = fewer
    sds = sds * max(misfit, 1.0)
    if len(at_s) == 2 and (alone := beginning(positions, None, stamp_ns, noise)):
        (_, slope), (_, slope_sd), _ = alone
        if abs(slope - found[1]) > _MISSES * slope_sd:  # such as speeds that a driver filters
            sds[1] = max(sds[1], abs(slope - found[1]))
    knows_position = positions is not None and len(positions[0]) >= _MIN_SAMPLES
    return (float(found[0]), float(found[1])), (float(sds[0]), float(sds[1])), knows_position


def _parabola(rows: Array, values: Array) -> tuple[Array, Array, float]:
    """Fit a parabola by least squares, to rows of terms, shape (T, 5), in units of noise."""
    scales = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    first = int(not rows[:, 0].any())  # speeds alone tell no position
    axes, triangle = np.linalg.qr((rows / scales)[:, first:])
    told, own = axes.T @ values, slice(3 - first)
    inverse = np.linalg.pinv(triangle[own, own])
    off = values - axes[:, own] @ told[own]
    left = float(np.linalg.norm(off)) / np.sqrt(max(len(off) - 3, 1))
    misfit = max(left, float(np.abs(told[3 - first : 5 - first]).max())) / _MISSES
    by_next = triangle[3 - first, 3 - first]
    follows = inverse @ triangle[own, 3 - first] / np.where(by_next, by_next, np.inf)
    plain = np.linalg.norm(inverse, axis=1)
    # Speeds change in the first samples: the noise alone says too little.
    sds = np.maximum(3.0 * plain, np.hypot(plain, follows))
    both = np.zeros((2, 3))
    both[:, first:] = inverse @ told[own], sds
    found, sds = both[:, :2] / scales[:2]
    return found, sds, misfit


def stays(samples: Samples | None, stamp_ns: int) -> bool:
    """Return whether a signal only scatters for a while after a stamp."""
    if samples is None:
        return True
    first = samples[1][samples[0] <= stamp_ns + 0.5e9]
    return not len(first) or float(np.std(first)) <= 2.0 * noise_of(samples[1])


# ---- Sources, and what connects them with a log

# Values of all parameters, shape (N, P), in the order of `tuned_first` -> N episodes
Rollouts = Callable[[Array], list[Episode]]


def tuned_first(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Return parameters in the order of a rollout's values: those without a prior come first."""
    return tuple(sorted(parameters, key=lambda one: one.prior_sd is not None))


@dataclass(frozen=True, eq=False)
class Connected:
    """Simulator that is driven as a log was."""

    simulator: Simulator
    target: ComparedColumns  # columns of the log to compare with
    rollouts: Rollouts  # of it
    finer: Rollouts | None = None  # likewise with half the time step; None if there is none
    # Uncertainty of a parameter due to the time step, one standard deviation, by name.
    unresolved: Mapping[str, float] = field(default_factory=dict)
    used: tuple[str, ...] = ()  # each signal of the log that is used, and its use, in words
    unused: tuple[str, ...] = ()  # each that is not, and why
    doubts: tuple[str, ...] = ()  # which of the used ones may be meant otherwise
    unseen: tuple[Unseen, ...] = ()  # how it begins anew in what is fitted; none if it cannot
    held_out: Unseen | None = None  # likewise in a log that is held out whole
    # Which of several logs each value is of, shape (M,), and which are held out; None for one log.
    logs: tuple[tuple[str, ...], NDArray[np.intp]] | None = None
    later: NDArray[np.bool_] | None = None  # which values are held out, shape (M,), likewise
    # What rolls out with an effect each that is left out; see `fit_simulator`.
    omitted: Sequence[Callable[[Array], Array]] = ()
    joints: Mapping[str, str] = field(default_factory=dict)  # that servos' parameters move, by name
    spent: int = 0  # rollouts by which it was chosen what to tune


@dataclass(frozen=True, eq=False)
class GivenSimulator:
    """Object with `parameters` and `rollout(values) -> Episode`, as a source of a simulator."""

    simulator: Simulator  # that object
    digest = ""  # no file's
    origin = None  # likewise

    @property
    def name(self) -> str:
        """Name in results."""
        return type(self.simulator).__name__

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters to tune; UsageError where there are none."""
        found = tuple(one for one in self.simulator.parameters if one.prior_sd is None)
        if not found:
            raise UsageError(
                f"the simulator {self.name} has no parameters", "give it one or more to tune"
            )
        return found

    def told_as(self) -> Mapping[str, Any]:
        """Return its description in a result, as JSON values."""
        return {"simulator": self.name}

    def connect(self, episode: Episode) -> Connected:
        """Connect it to a log, which is compared with it; NotFoundError where it shows nothing."""
        names = [one.name for one in tuned_first(self.simulator.parameters)]

        def rollouts(values: Array) -> list[Episode]:
            rows = [dict(zip(names, map(float, row), strict=True)) for row in values]
            return [self.simulator.rollout(row) for row in rows]

        initial = np.array([[one.initial for one in tuned_first(self.simulator.parameters)]])
        target = compared(episode, rollouts(initial)[0])
        used = tuple(f"{column.signal}: compared in {column.name}" for column in target.columns)
        unused = tuple(
            f"{name}: the simulator has none"
            for name in episode.signals
            if not any(column.signal == name for column in target.columns)
        )
        return Connected(self.simulator, target, rollouts, used=used, unused=unused)


@dataclass(frozen=True, eq=False)
class ModelSource:
    """MuJoCo model file, as a source of a simulator."""

    path: Path  # MJCF or URDF
    wanted: tuple[str, ...]  # parameters to tune, such as `joint/elbow.damping=0:5`
    told: Mapping[str, str] = field(default_factory=dict)  # names in the log to the model's
    # which of all that `wanted` names, and where a fit begins; None: all, as the model has them
    chosen: Mapping[str, float] | None = None

    @property
    def is_to_choose(self) -> bool:
        """Whether a log has to tell which terms of its servos are tuned."""
        return self.chosen is None and any(one.strip() == ACTUATORS for one in self.wanted)

    @property
    def name(self) -> str:
        """Name in results."""
        return self.path.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters to tune; UsageError where there are none, or the file cannot be read."""
        return tuple(one.parameter for one in self.tuned)

    @property
    def digest(self) -> str:
        """SHA-256 of the model and of what is tuned."""
        import hashlib

        text = self.spec.to_xml() + "\n".join((*self.wanted, *(self.chosen or {})))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def origin(self) -> TunedModel:
        """What a result says of its file."""
        return TunedModel(str(self.path), self.files.sha256)

    def told_as(self) -> Mapping[str, Any]:
        """Return its description in a result, as JSON values."""
        told = {"model": self.name, "parameters": list(self.wanted)}
        return {**told, "mapping": dict(self.told)} if self.told else told

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the names, not what was compiled."""
        return {name: getattr(self, name) for name in ("path", "wanted", "told", "chosen")}

    @cached_property
    def files(self) -> ModelFiles:
        """Its files, read once."""
        from tunenet_logs.recorders.simulators.model.reading import ModelFiles

        return ModelFiles(self.path)

    @cached_property
    def spec(self) -> Any:
        """The model as its file has it."""
        return self.files.spec(self.process)

    @cached_property
    def process(self) -> ModelProcess:
        """Where it is run."""
        from tunenet_logs.recorders.simulators.model.reading import ModelProcess

        return ModelProcess(self.path)

    @cached_property
    def model(self) -> Any:
        """Compiled model."""
        return self.spec.compile()

    @cached_property
    def tuned(self) -> tuple[ModelParameter, ...]:
        """Parameters to tune, as the compiled model has them."""
        from tunenet_logs.recorders.simulators.model.parameters import model_parameters

        if not self.wanted:
            raise UsageError(
                f"{self.path}: nothing is to be tuned",
                "name it with --tune, such as --tune joint/NAME.damping=0:5",
            )
        every = model_parameters(self.model, self.wanted)
        if self.chosen is None:
            return every
        return tuple(one for one in every if one.parameter.name in self.chosen)

    def choosing(self, values: Mapping[str, float]) -> ModelSource:
        """Copy it with these parameters alone, by address; what was compiled stays."""
        source = replace(self, chosen=dict(values))
        source.__dict__.update(files=self.files, spec=self.spec, process=self.process)
        source.__dict__["model"] = self.model
        return source

    def connect(self, episode: Episode) -> Connected:
        """Connect it to a log, which drives it and is compared with it; NotFoundError likewise."""
        from tunenet_logs.analysis.sysid.matching import Match, doubts
        from tunenet_logs.recorders.simulators.model.parameters import DELAY, DELAYED, movable
        from tunenet_logs.recorders.simulators.model.rollout import ModelSimulator

        match = Match(episode, self.model, self.told)
        stamps = [one.signal.stamps_ns for one in match.sensed]
        start_ns = min(int(stamp[0]) for stamp in stamps)
        end_ns = max(int(stamp[-1]) for stamp in stamps)
        state = initial_state(self.model, match.starts(), start_ns)
        match.choose_turned(state.qpos)
        for one in self.tuned:
            if one.owner in DELAYED:
                low, high = one.parameter.training_range
                end_ns += round(max(-low, 0.0) * 1e9)
                self._await(match, DELAYED[one.owner], start_ns + round(max(high, 0.0) * 1e9))
        simulator = ModelSimulator(
            movable(self.spec, self.tuned),
            self.tuned,
            tuple(match.sensed),
            tuple(match.drives),
            state,
            end_ns,
            self.process,
        )
        rollout = simulator.rollout({})
        seen = {one.signal.name: one.signal for one in match.sensed}
        target = compared(replace(episode, signals={**episode.signals, **seen}), rollout)
        # A delay is unsure by .2 steps (sd): a command that comes within a step is spread over it.
        return Connected(
            simulator,
            target,
            simulator.rollouts,
            simulator.finer().rollouts,
            {DELAY: 0.2 / simulator.step_hz},
            tuple(match.used),
            tuple(match.unused),
            (*match.joined, *match.guessed, *doubts(match.sensed, rollout)),
            (
                Unseen(
                    target,
                    partial(_begun, self.model, simulator, match.starts(), target),
                    FITTED * target.end_s,
                ),
            ),
            joints=moved_joints(self.model),
        )

    def _await(self, match: Match, kinds: tuple[str, ...], from_ns: int) -> None:
        """Compare what comes late from a stamp on: before, it shows what was before the rollout."""
        for place, one in enumerate(match.sensed):
            name, kind = one.sensors[0].name, one.sensors[0].kind
            if kind not in kinds:
                continue
            if kind.startswith("frame") and free_joint(self.model, name) is not None:
                raise UsageError(
                    f"--tune delay/poses: they tell where body {short_name(name)} begins, and when",
                    "tune delay/commands in its place",
                )
            cut = _cut(one, from_ns, int(one.signal.stamps_ns[-1]))
            if cut is None:
                raise UsageError(
                    f"{one.signal.name}: is not longer than the delay may be",
                    "choose a lower range",
                )
            match.sensed[place] = cut


def _begun(
    model: Any,
    simulator: ModelSimulator,
    starts: Sequence[SensedSignal],
    target: ComparedColumns,
    from_s: float,
    until_s: float,
) -> Begun | None:
    """Begin a model anew inside a log; None where the log does not show its whole state."""
    part = target.part(from_s, until_s)
    end_ns = part.start_ns + round(part.end_s * 1e9)
    # What comes late shows at first what was before.
    start_ns = max(part.start_ns - round(1e9 * simulator.latest_s), simulator.initial.stamp_ns)
    sensed, shown = (
        [cut for one in some if (cut := _cut(one, first_ns, end_ns)) is not None]
        for some, first_ns in ((simulator.sensed, part.start_ns), (starts, start_ns))
    )
    if not shows_state(model, shown):
        return None
    state = initial_state(model, shown, start_ns)
    again = replace(simulator, sensed=tuple(sensed), initial=state, end_ns=end_ns)
    finer = again.finer()
    return Begun(
        part,
        state.unsure,
        lambda rows: seen_at(part, again.rollouts(rows)),
        lambda rows: seen_at(part, finer.rollouts(rows)),
    )


def _cut(sensed: SensedSignal, from_ns: int, until_ns: int) -> SensedSignal | None:
    """Cut a signal between two stamps; None if it has no samples there."""
    signal = sensed.signal
    kept = (signal.stamps_ns >= from_ns) & (signal.stamps_ns <= until_ns)
    if not kept.any():
        return None
    cut = replace(signal, stamps_ns=signal.stamps_ns[kept], values=signal.values[kept])
    return replace(sensed, signal=cut)


def seen_at(target: ComparedColumns, episodes: Sequence[Episode]) -> Array:
    """Interpolate rollouts at a log's stamps, shape (N, M)."""
    return np.stack([target.seen_in(episode) for episode in episodes])


SimulatorSource = GivenSimulator | ModelSource


def with_joints(reason: str, source: Any) -> str:
    """Say of a table's columns that tell nothing how a model's are named, not a ball's."""
    what, asks, _ = reason.partition("; say which they are")
    if not asks or not isinstance(source, ModelSource):
        return reason
    from tunenet_logs.recorders.simulators.model.parameters import element_names

    joints = [name for name in element_names(source.model, "joint") if name]
    if not joints:
        return reason
    first = joints[0]
    return (
        f"{what}; name them by the model's joints ({listed(joints, 8)}): "
        f"t,position_{first},effort_{first}, or --columns t=...,position_1=..., then --map "
        f"joints.position.joint1=joint/{first}"
    )


def part_of(episode: Episode, start_s: float | None, end_s: float | None) -> Episode:
    """Cut an episode between two times [s since its first sample]."""
    if start_s is None and end_s is None:
        return episode
    first = min((int(one.stamps_ns[0]) for one in episode.signals.values()), default=0)
    low = -np.inf if start_s is None else first + start_s * 1e9
    high = np.inf if end_s is None else first + end_s * 1e9
    signals = {}
    for name, signal in episode.signals.items():
        kept = (signal.stamps_ns >= low) & (signal.stamps_ns <= high)
        if kept.any():
            stamps_ns, values = signal.stamps_ns[kept], signal.values[kept]
            signals[name] = replace(signal, stamps_ns=stamps_ns, values=values)
    return replace(episode, signals=signals)


@dataclass(frozen=True, eq=False)
class SimulatorDetection:
    """Log that shows what a simulator simulates; see `Detection`."""

    source: SimulatorSource  # of the simulator
    connected: Connected  # the simulator, driven as the log was
    offset_s: float  # from the log's first sample to the first that is compared
    left_out: tuple[LeftOut, ...] = ()  # samples missing from each compared signal
    others: Mapping[str, Episode] = field(default_factory=dict)  # other logs of it, by their names

    @property
    def topic(self) -> str:
        """First signal that is compared."""
        return self.connected.target.columns[0].signal

    @property
    def window(self) -> Mapping[str, float]:
        """Times at which the comparison begins and ends [s since the log's first sample]."""
        return {"start": self.offset_s, "end": self.offset_s + self.connected.target.end_s}

    @property
    def extent(self) -> tuple[str, str]:
        """Duration of the comparison."""
        return "motion", f"{self.connected.target.end_s:.1f} s"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Signals that are not used, and those whose meaning is doubtful."""
        unused = (f"not used: {words}" for words in self.connected.unused)
        said = (f"{name}: {one}" for name, log in self.others.items() for one in log.warnings)
        return (*said, *unused, *self.connected.doubts)


# ---- Initial orientation and angular velocity of a freely moving body


@dataclass(frozen=True)
class InitialTurn:
    """Orientation and angular velocity of a body at a stamp."""

    quaternion: Array  # w, x, y, z, shape (4,)
    quaternion_sd: float  # of any of these
    spin: Array  # angular velocity in the body's frame, shape (3,) [rad/s]
    spin_sd: Array  # shape (3,)

    def is_still(self, quaternion: Array) -> bool:
        """Return whether the body may be at rest at an orientation w, x, y, z, shape (4,)."""
        cosine = min(abs(float(self.quaternion @ quaternion)), 1.0)
        off = 2 * np.arccos(cosine)
        return off < 2 * self.quaternion_sd and bool((np.abs(self.spin) < self.spin_sd).all())


def initial_turn(sensed: SensedSignal, stamp_ns: int) -> InitialTurn | None:
    """Estimate it from the first x and z axes in the world frame; None if undetermined."""
    from scipy.spatial.transform import Rotation

    values = sensed.signal.values
    good = np.isfinite(values).all(axis=1)
    turns = Rotation.from_matrix(rotations(values[good]))
    since_first = (turns[0].inv() * turns).as_rotvec()
    # A rotation vector jumps at a half turn.
    is_far = np.linalg.norm(since_first, axis=1) > 2.5
    count = int(np.argmax(is_far)) if is_far.any() else len(is_far)
    stamps = sensed.signal.stamps_ns[good][:count]
    # of a rotation, three numbers; of the two axes, six, each moved by two thirds of its variance
    noise = float(np.sqrt(1.5 * np.mean([noise_of(column) ** 2 for column in values[good].T])))
    parts = [
        beginning((stamps, since_first[:count, axis]), None, stamp_ns, noise) for axis in range(3)
    ]
    known = [one for one in parts if one is not None]
    if len(known) < 3:
        return None
    values, sds = (np.array([one[place] for one in known]) for place in (0, 1))
    first = turns[0] * Rotation.from_rotvec(values[:, 0])
    quaternion = np.roll(first.as_quat(), 1)
    return InitialTurn(quaternion, float(sds[:, 0].max()) / 2, values[:, 1], sds[:, 1])


# ---- Initial state: positions and speeds, with uncertainty


def initial_state(model: Any, sensed: Sequence[SensedSignal], stamp_ns: int) -> InitialState:
    """Estimate the state of a compiled model at a stamp, by what the log shows right after.

    Unobserved coordinates are as the model has them, at rest.
    """
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    if model.nkey:
        qpos = model.key_qpos[0].copy()
    unsure: list[Parameter] = []
    places: list[tuple[bool, int]] = []
    sensed = seen_in_world(model, sensed)
    shown = _shown(model, sensed)
    for (label, unit, place_q, place_v), (positions, speeds) in shown.items():
        found = beginning(positions, speeds, stamp_ns)
        if found is None:
            continue
        (position, speed), (position_sd, speed_sd), knows_position = found
        is_near = abs(position - qpos[place_q]) < position_sd and abs(speed) < speed_sd
        if is_near and stays(positions, stamp_ns) and stays(speeds, stamp_ns):
            continue  # as the model has it, such as a body that lies on the ground
        if knows_position:
            qpos[place_q] = position
            unsure.append(_unsure(f"initial/{label}.position", unit, position, position_sd))
            places.append((False, place_q))
        qvel[place_v] = speed
        unsure.append(_unsure(f"initial/{label}.velocity", f"{unit}/s", speed, speed_sd))
        places.append((True, place_v))
    # Orientations of bodies with a free joint, by the first signal of each.
    turned: set[int] = set()
    for one in sensed:
        is_turn = one.sensors[0].kind == "framexaxis"
        joint = free_joint(model, one.sensors[0].name) if is_turn else None
        if joint is None or joint in turned or not (turn := initial_turn(one, stamp_ns)):
            continue
        turned.add(joint)
        place_q, place_v = int(model.jnt_qposadr[joint]) + 3, int(model.jnt_dofadr[joint]) + 3
        if turn.is_still(qpos[place_q : place_q + 4]):
            continue
        qpos[place_q : place_q + 4] = turn.quaternion
        qvel[place_v : place_v + 3] = turn.spin
        body = model.body(int(model.jnt_bodyid[joint])).name
        # Three numbers of a quaternion suffice: they and its length determine the largest.
        largest = int(np.argmax(np.abs(turn.quaternion)))
        for number, axis in enumerate("wxyz"):
            if number != largest:
                value, name = float(turn.quaternion[number]), f"initial/{body}.orientation.{axis}"
                unsure.append(_unsure(name, "1", value, turn.quaternion_sd))
                places.append((False, place_q + number))
        for number, axis in enumerate("xyz"):
            value, sd = float(turn.spin[number]), float(turn.spin_sd[number])
            unsure.append(_unsure(f"initial/{body}.spin.{axis}", "rad/s", value, sd))
            places.append((True, place_v + number))
    return InitialState(stamp_ns, qpos, qvel, tuple(unsure), tuple(places))


def shows_state(model: Any, sensed: Sequence[SensedSignal]) -> bool:
    """Return whether signals show the place of every joint, and nothing else has a state."""
    sensed = seen_in_world(model, sensed)
    seen = {
        place_v
        for (*_, place_v), (positions, _) in _shown(model, sensed).items()
        if positions is not None and len(positions[0]) >= _MIN_SAMPLES
    }
    for one in sensed:
        is_turn = one.sensors[0].kind == "framexaxis" and len(one.signal.values) >= _MIN_SAMPLES
        joint = free_joint(model, one.sensors[0].name) if is_turn else None
        if joint is not None:
            first = int(model.jnt_dofadr[joint]) + 3
            seen |= set(range(first, first + 3))
    return len(seen) == model.nv and not model.na


def _shown(
    model: Any, sensed: Sequence[SensedSignal]
) -> dict[tuple[str, str, int, int], tuple[Samples | None, Samples | None]]:
    """Collect each coordinate's samples: name, unit and addresses -> positions and speeds."""
    shown: dict[tuple[str, str, int, int], tuple[Samples | None, Samples | None]] = {}
    for one in sensed:
        for column, sensor in zip(one.columns, one.sensors, strict=True):
            name, unit, joint = sensor.name, "rad", None
            if sensor.kind == "framepos":
                joint = free_joint(model, name)
                name, unit = f"{name}.{'xyz'[sensor.axis]}", "m"
            elif sensor.kind in ("jointpos", "jointvel"):
                joint = int(model.joint(name).id)
                is_sliding = model.jnt_type[joint] == mujoco().mjtJoint.mjJNT_SLIDE
                unit = "m" if is_sliding else "rad"
            if joint is None:
                continue
            values = one.signal.values[:, one.signal.columns.index(column)]
            good = np.isfinite(values)
            samples = one.signal.stamps_ns[good], values[good]
            place_q, place_v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            key = name, unit, place_q + sensor.axis, place_v + sensor.axis
            positions, speeds = shown.get(key, (None, None))
            is_speed = sensor.kind == "jointvel"
            shown[key] = (positions, samples) if is_speed else (samples, speeds)
    return shown


def _unsure(name: str, unit: str, value: float, sd: float) -> Parameter:
    sd = max(sd, 1e-4)  # of a value that is known exactly
    far = (value - 50.0 * sd, value + 50.0 * sd)  # within which it is looked for
    return Parameter(name, unit, far, (value - sd, value + sd), value, prior_sd=sd)


# ---- Tuned parameters from a YAML file: a line per address, with its range

_MAX_BYTES, _MAX_LINES, _MAX_DEPTH = 64_000, 200, 3
_SHAPE = "write lines such as joint/elbow.damping: [0, 5]"
_PAIRS = [[low, high] for low in (int, float) for high in (int, float)]


def listed_parameters(texts: Sequence[str]) -> tuple[str, ...]:
    """Expand YAML files among addresses with ranges, in place."""
    found: list[str] = []
    for text in texts:
        if not text.endswith((".yaml", ".yml")):
            found.append(text)
            continue
        for address, limits in _mapping(Path(text)).items():
            what = f"{Path(text)}: {short_name(address)} has"
            if limits is None:
                found.append(str(address))
                continue
            if not isinstance(limits, list) or list(map(type, limits)) not in _PAIRS:
                raise UsageError(f"{what} no [LOW, HIGH]", _SHAPE)
            try:
                low, high = map(float, limits)
            except OverflowError as error:
                raise UsageError(f"{what} a limit that is too large", _SHAPE) from error
            found.append(f"{address}={low!r}:{high!r}")
    return tuple(found)


def _mapping(path: Path) -> dict[Any, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    try:
        data = read_small_file(path, _MAX_BYTES)
        depth = 0
        for event in YAML(typ="safe", pure=True).parse(data):
            depth += isinstance(event, CollectionStartEvent)
            depth -= isinstance(event, CollectionEndEvent)
            if depth > _MAX_DEPTH or isinstance(event, AliasEvent):  # few may stand for millions
                raise UsageError(f"{path}: has nested lists or aliases (*NAME)", _SHAPE)
        found = YAML(typ="safe", pure=True).load(data)
    except (OSError, LogError, ValueError, TypeError, RecursionError) as error:
        why = getattr(error, "strerror", None) or one_line(error)
        raise UsageError(f"{path}: cannot be read ({short_name(why)})", _SHAPE) from error
    except YAMLError as error:
        raise UsageError(f"{path}: is no YAML ({one_line(error)[:80]})", _SHAPE) from error
    if not isinstance(found, dict) or not 0 < len(found) <= _MAX_LINES:
        raise UsageError(f"{path}: holds no addresses", _SHAPE)
    return found
