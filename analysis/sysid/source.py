"""Sources of a simulator: a model's file, or an object of the user's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from analysis.sysid.compared import ComparedColumns, compared
from recorders.simulators.base import Parameter, Simulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from recorders.simulators.mujoco.model_parameters import ModelParameter
    from recorders.simulators.mujoco.model_process import ModelProcess

# Of a delay, one standard deviation: a command that comes within a step is spread over it.
_UNRESOLVED_STEPS = 0.2

Rollouts = Callable[[Array], list[Episode]]  # values of all parameters, shape (N, P) -> N episodes


@dataclass(frozen=True, eq=False)
class Connected:
    """Simulator that is driven as a log was.

    Attributes:
        simulator: Its parameters without a prior are those that are tuned; they come first.
        target: Columns of the log to compare with.
        rollouts: Of it.
        finer: Likewise with half the time step; None if there is none.
        unresolved: Uncertainty of a parameter due to the time step, one standard deviation, by
            name.
        used: Each signal of the log that is used, and its use, in words.
        unused: Each that is not, and why.
        doubts: Which of the used ones may be meant otherwise.
    """

    simulator: Simulator
    target: ComparedColumns
    rollouts: Rollouts
    finer: Rollouts | None = None
    unresolved: Mapping[str, float] = field(default_factory=dict)
    used: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


class SimulatorSource(Protocol):
    """Source of a simulator for a log."""

    @property
    def name(self) -> str:
        """Name in results."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters to tune.

        Raises:
            UsageError: There are none, or the file that names them cannot be read.
        """
        ...

    @property
    def digest(self) -> str:
        """SHA-256 of the model and of what is tuned; "" for an object."""
        ...

    def told_as(self) -> Mapping[str, Any]:
        """Return its description in a result, as JSON values."""
        ...

    def connect(self, episode: Episode) -> Connected:
        """Connect it to a log, which drives it and is compared with it.

        Raises:
            NotFoundError: The log shows nothing of it.
        """
        ...


@dataclass(frozen=True, eq=False)
class GivenSimulator:
    """Object with `parameters` and `rollout(values) -> Episode`.

    Attributes:
        simulator: That object.
    """

    simulator: Simulator

    @property
    def name(self) -> str:
        """See `SimulatorSource`."""
        return type(self.simulator).__name__

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See `SimulatorSource`."""
        found = tuple(one for one in self.simulator.parameters if one.prior_sd is None)
        if not found:
            raise UsageError(
                f"the simulator {self.name} has no parameters", "give it one or more to tune"
            )
        return found

    @property
    def digest(self) -> str:
        """See `SimulatorSource`."""
        return ""

    def told_as(self) -> Mapping[str, Any]:
        """See `SimulatorSource`."""
        return {"simulator": self.name}

    def connect(self, episode: Episode) -> Connected:
        """See `SimulatorSource`."""
        names = [one.name for one in self.simulator.parameters]

        def rollouts(values: Array) -> list[Episode]:
            rows = [dict(zip(names, map(float, row), strict=True)) for row in values]
            return [self.simulator.rollout(row) for row in rows]

        initial = np.array([[one.initial for one in self.simulator.parameters]])
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
    """MuJoCo model file.

    Attributes:
        path: MJCF or URDF.
        wanted: Parameters to tune, such as `joint/elbow.damping=0:5`.
        told: Mapping of the log's names to the model's; see `topics.matched`.
    """

    path: Path
    wanted: tuple[str, ...]
    told: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """See `SimulatorSource`."""
        return self.path.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See `SimulatorSource`."""
        return tuple(one.parameter for one in self._tuned)

    @property
    def digest(self) -> str:
        """See `SimulatorSource`."""
        import hashlib

        text = self.spec.to_xml() + "\n".join(self.wanted)
        return hashlib.sha256(text.encode()).hexdigest()

    def told_as(self) -> Mapping[str, Any]:
        """See `SimulatorSource`."""
        told = {"model": self.name, "parameters": list(self.wanted)}
        return {**told, "mapping": dict(self.told)} if self.told else told

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the names, not what was compiled."""
        return {name: getattr(self, name) for name in ("path", "wanted", "told")}

    @cached_property
    def spec(self) -> Any:
        """The model as its file has it."""
        from recorders.simulators.mujoco.model_file import read_model

        return read_model(self.path, process=self._process)

    @cached_property
    def _process(self) -> ModelProcess:
        from recorders.simulators.mujoco.model_process import ModelProcess

        return ModelProcess(self.path)

    @cached_property
    def model(self) -> Any:
        """Compiled model."""
        return self.spec.compile()

    @cached_property
    def _tuned(self) -> tuple[ModelParameter, ...]:
        from recorders.simulators.mujoco.model_parameters import model_parameters

        if not self.wanted:
            raise UsageError(
                f"{self.path}: nothing is to be tuned",
                "name it with --tune, such as --tune joint/NAME.damping=0:5",
            )
        return model_parameters(self.model, self.wanted)

    def connect(self, episode: Episode) -> Connected:
        """See `SimulatorSource`."""
        from analysis.sysid.initial_state import initial_state
        from analysis.sysid.orientations import orients_start
        from analysis.sysid.topics import matched
        from analysis.sysid.wrenches import doubts
        from recorders.simulators.mujoco.model_parameters import DELAY, movable
        from recorders.simulators.mujoco.model_simulator import ModelSimulator

        match = matched(episode, self.model, self.told)
        stamps = [one.signal.stamps_ns for one in match.sensed]
        start_ns = min(int(stamp[0]) for stamp in stamps)
        end_ns = max(int(stamp[-1]) for stamp in stamps)
        shown = [*match.sensed, *orients_start(self.model, match.turned)]
        state = initial_state(self.model, shown, start_ns)
        match.choose_turned(self.model, state.qpos)
        simulator = ModelSimulator(
            movable(self.spec, self._tuned),
            self._tuned,
            tuple(match.sensed),
            tuple(match.drives),
            state,
            end_ns,
            self._process,
        )
        rollout = simulator.rollout({})
        seen = {one.signal.name: one.signal for one in match.sensed}
        target = compared(replace(episode, signals={**episode.signals, **seen}), rollout)
        return Connected(
            simulator,
            target,
            simulator.rollouts,
            simulator.finer().rollouts,
            {DELAY: _UNRESOLVED_STEPS / simulator.step_hz},
            tuple(match.used),
            tuple(match.unused),
            (*match.joined, *doubts(match.sensed, rollout)),
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
            signals[name] = replace(
                signal, stamps_ns=signal.stamps_ns[kept], values=signal.values[kept]
            )
    return replace(episode, signals=signals)


def told_by(texts: Sequence[str]) -> dict[str, str]:
    """Parse `--map` options, SIGNAL=TARGET.

    Raises:
        UsageError: One of them is no pair, or two are of one signal.
    """
    told: dict[str, str] = {}
    for text in texts:
        key, sign, target = text.partition("=")
        if not (key and sign and target):
            raise UsageError(f"--map {text!r} is no SIGNAL=TARGET", "such as /arm/j1=joint/elbow")
        if key in told:
            raise UsageError(f"--map {key} is given twice", "leave one out")
        told[key] = target
    return told
