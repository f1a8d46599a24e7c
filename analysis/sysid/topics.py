"""Match a log's signals with a model's joints, actuators and bodies by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from analysis.sysid.names import is_wanted, named_as, quantity_of, topic_of
from analysis.sysid.orientations import Turned, why_not
from analysis.sysid.poses import is_orientation, sensed_pose
from analysis.sysid.told import IGNORE, TURNED, check_told
from analysis.sysid.wrenches import is_wrench, sensed_wrench
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_parameters import element_names
from recorders.simulators.mujoco.model_sensors import SensedSignal, Sensor
from recorders.simulators.mujoco.model_simulator import Drive
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import listed

_Kind = Literal["jointpos", "jointvel", "jointactuatorfrc"]

_BY_QUANTITY: Mapping[str, _Kind] = {
    "position": "jointpos",
    "velocity": "jointvel",
    "effort": "jointactuatorfrc",
}
_UNITS: Mapping[str, str] = {"rad/s": "velocity", "m/s": "velocity", "N·m": "effort", "N": "effort"}
# Units of what a user says is a joint, where its name does not tell the quantity.
_PLACES = ("rad", "m", "1")

_TARGETS = ("joint", "actuator", "body", "site")
_FEW = 6
_MANY_SIDED = (0, 1)  # kinds of joints, free and ball, whose position is no number
_TURN_RAD, _TURN_SLACK_RAD = 2 * np.pi, 0.05
_FASTER = 2.0  # than it is elsewhere, that a joint may be where its angle is cut to one turn


@dataclass(eq=False)
class Match:
    """Match of a log with a model.

    Attributes:
        sensed: Signals to compare.
        drives: Signals that drive the model.
        used: Each signal that is used, and its use, in words.
        unused: Each that is not, and why.
        turned: Orientations, which are compared if the model begins with them.
        joined: Joint angles that were unwrapped, in words.
    """

    sensed: list[SensedSignal] = field(default_factory=list)
    drives: list[Drive] = field(default_factory=list)
    used: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)
    turned: list[Turned] = field(default_factory=list)
    joined: list[str] = field(default_factory=list)

    def choose_turned(self, model: Any, qpos: Array) -> None:
        """Compare those of `turned` that the model begins with, too, at `qpos`, shape (nq,)."""
        for one in self.turned:
            name = one.sensed.signal.name
            if why := why_not(model, qpos, one):
                self.unused.append(f"{name}: {why}")
            else:
                self.sensed.append(one.sensed)
                self.used.append(f"{name}: compared with {one.words}")


def matched(episode: Episode, model: Any, told: Mapping[str, str]) -> Match:
    """Match an episode's signals with a compiled model.

    Args:
        episode: The log.
        model: Compiled.
        told: The user's mapping where names differ: signal, topic or SIGNAL.COLUMN ->
            `joint/NAME`, `actuator/NAME`, `body/NAME`, `site/NAME`, `commands`, `states` or `-`;
            `-site/` and `-body/` for a wrench of the other sign.

    Raises:
        NotFoundError: Nothing of the log is in the model; the message names both sides.
        UsageError: An entry of `told` is not in the log or not in the model.
    """
    return _Matching(episode, model, told).match()


class _Matching:
    def __init__(self, episode: Episode, model: Any, told: Mapping[str, str]) -> None:
        self._episode, self._model, self._told = episode, model, told
        self._names = {kind: element_names(model, kind) for kind in _TARGETS}
        self._found = Match()
        self._by_column: dict[tuple[str, str], list[str | None]] = {}
        check_told(told, episode.signals, self._names)

    def match(self) -> Match:
        states: list[Signal] = []
        for name, signal in self._episode.signals.items():
            role = self._role(name, signal)
            if role == IGNORE:
                self._found.unused.append(f"{name}: left out by --map")
            elif role == "commands":
                self._command(signal)
            elif role == "states":
                states.append(signal)
            elif role == "pose":
                self._pose(signal)
            elif role == "wrench":
                self._wrench(signal)
            else:
                self._found.unused.append(f"{name}: neither joints, commands, pose nor wrench")
        for signal in states:
            self._state(signal)
        if not self._found.sensed:
            self._refuse()
        return self._found

    def _role(self, name: str, signal: Signal) -> str:
        """Return a signal's role: "states", "commands", "pose", "wrench", "-" or ""."""
        told = self._told_signal(signal)
        if told in ("commands", "states", IGNORE):
            return told
        kind = told.partition("/")[0].removeprefix(TURNED)
        if kind == "site" or (kind == "body" and (is_wrench(signal) or told.startswith(TURNED))):
            return "wrench"
        if told:
            return {"body": "pose", "actuator": "commands"}.get(kind, "states")
        quantity = quantity_of(name)
        if quantity or (signal.drives and signal.unit == "1"):
            return "commands" if signal.drives or is_wanted(topic_of(name)) else "states"
        if is_orientation(signal) or (signal.columns == ("x", "y", "z") and signal.unit == "m"):
            return "pose"
        return "wrench" if is_wrench(signal) else ""

    def _state(self, signal: Signal) -> None:
        kind = _BY_QUANTITY.get(_quantity(signal))
        if kind is None:
            self._found.unused.append(f"{signal.name}: [{signal.unit}] is nothing of joints")
            return
        columns: list[tuple[int, str, str]] = []
        reasons: dict[str, list[str]] = {}
        for place, (column, joint) in enumerate(
            zip(signal.columns, self._elements("joint", signal), strict=True)
        ):
            if why := self._why_not(signal, place, joint):
                reasons.setdefault(why, []).append(column)
            else:
                assert joint is not None
                columns.append((place, column, joint))
        for why, names in reasons.items():
            self._found.unused.append(f"{signal.name}: {listed(names, _FEW)}: {why}")
        if not columns:
            return
        if kind == "jointactuatorfrc":
            self._efforts(signal, columns)
            return
        sensors = tuple(Sensor(kind, joint) for _, _, joint in columns)
        names = tuple(column for _, column, _ in columns)
        if kind == "jointpos":
            signal = self._joined(signal, columns)
        self._sense(SensedSignal(signal, names, sensors))

    def _joined(self, signal: Signal, columns: list[tuple[int, str, str]]) -> Signal:
        """Unwrap angles of hinges without limits."""
        values, cut = signal.values.copy(), []
        for place, column, joint in columns:
            number = self._names["joint"].index(joint)
            is_hinge = self._model.jnt_type[number] == int(mujoco().mjtJoint.mjJNT_HINGE)
            if is_hinge and not self._model.jnt_limited[number]:
                good = np.isfinite(values[:, place])
                whole = joined_turns(signal.stamps_ns[good], values[good, place])
                if whole is not None:
                    values[good, place] = whole
                    cut.append(column)
        if not cut:
            return signal
        self._found.joined.append(f"{signal.name}: {listed(cut, _FEW)}: cut to one turn: joined")
        return replace(signal, values=values)

    def _why_not(self, signal: Signal, place: int, joint: str | None) -> str:
        """Say why a column of states is no joint's; "" if it is one's."""
        if self._told_of(signal, signal.columns[place]) == IGNORE:
            return "left out by --map"
        if joint is None:
            return "no joint of the model is called so, or several are"
        number = self._names["joint"].index(joint)
        if self._model.jnt_type[number] in _MANY_SIDED:
            return "that joint has no single position"
        few = np.isfinite(signal.values[:, place]).sum() < 2
        return "fewer than two samples" if few else ""

    def _efforts(self, signal: Signal, columns: list[tuple[int, str, str]]) -> None:
        """Compare measured efforts with those of driven actuators; the others drive."""
        targets = {int(one) for drive in self._found.drives for one in drive.targets}
        driven = {self._joint_of(target) for target in targets}
        joints = [self._names["joint"].index(joint) for _, _, joint in columns]
        seen = [one for one, joint in zip(columns, joints, strict=True) if joint in driven]
        if seen:
            sensors = tuple(Sensor("jointactuatorfrc", joint) for _, _, joint in seen)
            self._sense(SensedSignal(signal, tuple(column for _, column, _ in seen), sensors))
        rest = [
            (place, int(self._model.jnt_dofadr[joint]))
            for (place, _, _), joint in zip(columns, joints, strict=True)
            if joint not in driven and np.nanmax(np.abs(signal.values[:, place])) > 0
        ]
        if rest:
            places, dofs = np.array(rest).T
            self._found.drives.append(Drive(signal, places, dofs, is_effort=True))
            names = [signal.columns[place] for place in places]
            self._found.used.append(f"{signal.name}: drives joints {listed(names, _FEW)}")

    def _command(self, signal: Signal) -> None:
        quantity = quantity_of(signal.name)
        taken = {int(one) for drive in self._found.drives for one in drive.targets}
        pairs: list[tuple[int, int]] = []
        again: list[str] = []
        for place, column in enumerate(signal.columns):
            actuator = self._actuator(signal, column, quantity)
            if actuator is None or not np.isfinite(signal.values[:, place]).any():
                continue
            if actuator in taken:
                again.append(column)
                continue
            taken.add(actuator)
            pairs.append((place, actuator))
        if again:
            why = "another signal commands its actuator; leave one out with --map SIGNAL=-"
            self._found.unused.append(f"{signal.name}: {listed(again, _FEW)}: {why}")
        if not pairs and again:
            return
        if not pairs:
            wanted = listed(
                {
                    f"{name} ({self._wants(number)})" if name else f"{number}"
                    for number, name in enumerate(self._names["actuator"])
                },
                _FEW,
            )
            why = f"no actuator of the model takes it (there is: {wanted or 'none'})"
            self._found.unused.append(f"{signal.name}: {why}")
            return
        columns, targets = np.array(pairs).T
        self._found.drives.append(Drive(signal, columns, targets, is_effort=False))
        names = [self._names["actuator"][target] or str(target) for target in targets]
        self._found.used.append(f"{signal.name}: commands actuators {listed(names, _FEW)}")

    def _actuator(self, signal: Signal, column: str, quantity: str) -> int | None:
        """Find the actuator of a column: by its name, its joint's, or its number."""
        if self._told_of(signal, column) == IGNORE:
            return None
        place = signal.columns.index(column)
        fits = ("", quantity) if quantity else ("", "position", "velocity", "effort")
        actuator = self._elements("actuator", signal)[place]
        if actuator is not None:
            number = self._names["actuator"].index(actuator)
            if self._wants(number) in fits:
                return number
        joint = self._elements("joint", signal)[place]
        if joint is not None:
            joint_number = self._names["joint"].index(joint)
            for one in range(self._model.nu):
                if self._joint_of(one) == joint_number and self._wants(one) in fits:
                    return one
        by_order = not quantity and len(signal.columns) == self._model.nu
        return place if by_order and column.isdecimal() else None

    def _joint_of(self, actuator: int) -> int | None:
        """Return the index of the joint that an actuator moves, or None."""
        kinds = mujoco().mjtTrn
        moves = self._model.actuator_trntype[actuator]
        is_joint = moves in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
        return int(self._model.actuator_trnid[actuator, 0]) if is_joint else None

    def _wants(self, actuator: int) -> str:
        """Return an actuator's input: "position", "velocity" or "effort"."""
        _, on_position, on_speed = self._model.actuator_biasprm[actuator, :3]
        if self._model.actuator_dyntype[actuator] == int(mujoco().mjtDyn.mjDYN_INTEGRATOR):
            return "velocity"
        if on_position:
            return "position"
        return "velocity" if on_speed else "effort"

    def _pose(self, signal: Signal) -> None:
        told = self._told_signal(signal).removeprefix("body/")
        sensed, words = sensed_pose(signal, told, self._names["body"])
        if sensed is None:
            self._found.unused.append(f"{signal.name}: {words}")
        elif is_orientation(signal):
            turned = Turned(sensed, words, is_sure=signal.name in self._told)
            self._found.turned.append(turned)
        else:
            self._sense(sensed, words)

    def _wrench(self, signal: Signal) -> None:
        sensed, words = sensed_wrench(signal, self._told_signal(signal), self._model)
        if sensed is None:
            self._found.unused.append(f"{signal.name}: {words}")
        else:
            self._sense(sensed, words)

    def _told_signal(self, signal: Signal) -> str:
        """Return the user's mapping of a signal, or of its topic; "" if none."""
        return self._told.get(signal.name) or self._told.get(topic_of(signal.name), "")

    def _sense(self, sensed: SensedSignal, what: str = "") -> None:
        self._found.sensed.append(sensed)
        what = what or f"{listed([one.name for one in sensed.sensors], _FEW)}"
        self._found.used.append(f"{sensed.signal.name}: compared with {what}")

    def _told_of(self, signal: Signal, column: str) -> str:
        """Return the user's mapping of a column, or of its one-column signal; "" if none."""
        name = signal.name
        keys = [f"{name}.{column}", f"{topic_of(name)}.{column}", column]
        if len(signal.columns) == 1:
            keys += [name, topic_of(name)]
        return next((self._told[key] for key in keys if key in self._told), "")

    def _elements(self, kind: str, signal: Signal) -> list[str | None]:
        """Match each column with an element, by the mapping or by name; each once."""
        if (kind, signal.name) not in self._by_column:
            names = self._names[kind]
            told = [self._told_of(signal, column) for column in signal.columns]
            found: list[str | None] = []
            for column, target in zip(signal.columns, told, strict=True):
                if target.startswith(f"{kind}/"):
                    found.append(target.removeprefix(f"{kind}/"))
                else:
                    found.append(column if column and column in names else None)
            sure = {one for one in found if one is not None}
            guesses = [named_as(column, names) for column in signal.columns]
            for place, guess in enumerate(guesses):
                is_free = found[place] is None and guess not in sure and guesses.count(guess) == 1
                if is_free:
                    found[place] = guess
            self._by_column[kind, signal.name] = found
        return self._by_column[kind, signal.name]

    def _refuse(self) -> None:
        of_log: Iterable[str] = dict.fromkeys(
            column
            for name, signal in self._episode.signals.items()
            if quantity_of(name)
            for column in signal.columns
        )
        joints = listed(filter(None, self._names["joint"]), _FEW)
        bodies = listed(filter(None, self._names["body"][1:]), _FEW)
        seen = listed(of_log, _FEW) or listed(self._episode.signals, _FEW) or "nothing"
        raise NotFoundError(
            f"nothing of the log is in the model (log: {seen}; model: joints {joints or 'none'}, "
            f"bodies {bodies or 'none'})",
            "say what is what with --map SIGNAL.COLUMN=joint/NAME or --map TOPIC=body/NAME",
        )


def joined_turns(stamps_ns: NDArray[np.int64], angles: Array) -> Array | None:
    """Unwrap angles that were wrapped to one turn, such as at ±π; None if they were not.

    They were if all lie within one turn, some jump by most of one, and the joint, unwrapped there,
    is mostly as fast as elsewhere: glitches and steps are faster.

    Args:
        stamps_ns: Shape (T,), increasing.
        angles: Finite, shape (T,) [rad].
    """
    is_cut = np.abs(np.diff(angles)) > _TURN_RAD / 2
    if not is_cut.any() or is_cut.all() or np.ptp(angles) > _TURN_RAD + _TURN_SLACK_RAD:
        return None
    whole = np.unwrap(angles)
    speeds = np.abs(np.diff(whole)) / np.diff(stamps_ns)
    return whole if np.median(speeds[is_cut]) <= _FASTER * speeds[~is_cut].max() else None


def _quantity(signal: Signal) -> str:
    """Return which joint quantity a signal is, by its name or its unit; "" if it is none."""
    by_unit = "position" if signal.unit in _PLACES else _UNITS.get(signal.unit, "")
    return quantity_of(signal.name) or by_unit
