"""Which of a log's signals are what of a model: joints, actuators and bodies, by their names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np

from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_parameters import element_names
from recorders.simulators.mujoco.model_simulator import Drive, Sensed, Sensor
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.terminal import listed, short_name

_COMMANDS = re.compile(r"command|cmd|target|desired|reference|setpoint|goal|trajectory", re.I)
"""In a topic's name: what somebody wants, not what is."""

_QUANTITIES = {"position": "jointpos", "velocity": "jointvel", "effort": "jointactuatorfrc"}
_FEW = 6

IGNORE = "-"
"""As a target of `--map`: the signal is left out."""


@dataclass(eq=False)
class Match:
    """What of a log is what of a model.

    Attributes:
        sensed: what is compared.
        drives: what moves the model.
        used: each signal that is used, and as what, in words.
        unused: each that is not, and why.
    """

    sensed: list[Sensed] = field(default_factory=list)
    drives: list[Drive] = field(default_factory=list)
    used: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)


def matched(episode: Episode, model: Any, told: Mapping[str, str]) -> Match:
    """Match an episode's signals with a compiled model.

    Args:
        episode: the log.
        model: compiled.
        told: signal, topic or SIGNAL.COLUMN -> `joint/NAME`, `actuator/NAME`, `body/NAME`,
            `commands`, `states` or `-`, as a user says where names differ.

    Raises:
        NotFoundError: nothing of the log is in the model; the message names both sides.
        UsageError: what is told is not in the log or not in the model.
    """
    return _Matching(episode, model, told).match()


class _Matching:
    def __init__(self, episode: Episode, model: Any, told: Mapping[str, str]) -> None:
        self._episode, self._model, self._told = episode, model, told
        self._names = {kind: element_names(model, kind) for kind in ("joint", "actuator", "body")}
        self._found = Match()
        self._check_told()

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
            else:
                self._found.unused.append(f"{name}: neither joints, commands nor a position")
        for signal in states:
            self._state(signal)
        if not self._found.sensed:
            self._refuse()
        return self._found

    def _role(self, name: str, signal: Signal) -> str:
        """What a signal is: "states", "commands", "pose", "-" or ""."""
        told = self._told.get(name) or self._told.get(_topic(name))
        if told in ("commands", "states", IGNORE):
            return told
        if told is not None and told.startswith("body/"):
            return "pose"
        if told is not None and told.startswith("actuator/"):
            return "commands"
        quantity = _quantity(name)
        if quantity or (signal.drives and signal.unit == "1"):
            return "commands" if signal.drives or _COMMANDS.search(name) else "states"
        if signal.columns == ("x", "y", "z") and signal.unit == "m":
            return "pose"
        return ""

    def _state(self, signal: Signal) -> None:
        quantity = _quantity(signal.name)
        kind = _QUANTITIES.get(quantity)
        columns = [
            (place, column, joint)
            for place, column in enumerate(signal.columns)
            if (joint := self._element("joint", signal.name, column)) is not None
            and np.isfinite(signal.values[:, place]).sum() > 1
        ]
        if kind is None or not columns:
            why = f"no joint of the model is called {listed(signal.columns, _FEW)}"
            self._found.unused.append(f"{signal.name}: {why}")
            return
        if quantity == "effort":
            self._efforts(signal, columns)
            return
        sensors = tuple(Sensor(kind, joint) for _, _, joint in columns)
        names = tuple(column for _, column, _ in columns)
        self._sense(Sensed(signal, names, sensors))

    def _efforts(self, signal: Signal, columns: list[tuple[int, str, str]]) -> None:
        """Measured efforts: what actuators give where commands drive them, else what drives."""
        driven = {
            int(self._model.actuator_trnid[target, 0])
            for drive in self._found.drives
            for target in drive.targets
        }
        joints = [self._names["joint"].index(joint) for _, _, joint in columns]
        seen = [one for one, joint in zip(columns, joints, strict=True) if joint in driven]
        if seen:
            sensors = tuple(Sensor("jointactuatorfrc", joint) for _, _, joint in seen)
            self._sense(Sensed(signal, tuple(column for _, column, _ in seen), sensors))
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
        quantity = _quantity(signal.name)
        pairs: list[tuple[int, int]] = []
        for place, column in enumerate(signal.columns):
            actuator = self._actuator(signal, column)
            if actuator is not None and quantity in ("", self._wants(actuator)):
                pairs.append((place, actuator))
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

    def _actuator(self, signal: Signal, column: str) -> int | None:
        """The actuator of a column: of its name, of its joint's, or of its number."""
        actuator = self._element("actuator", signal.name, column)
        if actuator is not None:
            return self._names["actuator"].index(actuator)
        joint = self._element("joint", signal.name, column)
        if joint is not None:
            number = self._names["joint"].index(joint)
            kinds = mujoco().mjtTrn
            for one in range(self._model.nu):
                is_joint = self._model.actuator_trntype[one] in (
                    kinds.mjTRN_JOINT,
                    kinds.mjTRN_JOINTINPARENT,
                )
                if is_joint and self._model.actuator_trnid[one, 0] == number:
                    return one
        if column.isdecimal() and len(signal.columns) == self._model.nu:
            return int(column)
        return None

    def _wants(self, actuator: int) -> str:
        """What an actuator takes: "position", "velocity" or "effort"."""
        _, on_position, on_speed = self._model.actuator_biasprm[actuator, :3]
        if on_position:
            return "position"
        return "velocity" if on_speed else "effort"

    def _pose(self, signal: Signal) -> None:
        told = self._told.get(signal.name, self._told.get(_topic(signal.name), ""))
        body = told.removeprefix("body/") if told else None
        if body is None:
            words = re.split(r"[/.@]", signal.name)
            known = {_plain(name): name for name in self._names["body"][1:] if name}
            body = next(
                (known[_plain(word)] for word in reversed(words) if _plain(word) in known), None
            )
        if body is None:
            self._found.unused.append(f"{signal.name}: no body of the model is called so")
            return
        sensors = tuple(Sensor("framepos", body, axis) for axis in range(3))
        self._sense(Sensed(signal, signal.columns, sensors), f"position of {body}")

    def _sense(self, sensed: Sensed, what: str = "") -> None:
        self._found.sensed.append(sensed)
        what = what or f"{listed([one.name for one in sensed.sensors], _FEW)}"
        self._found.used.append(f"{sensed.signal.name}: compared with {what}")

    def _element(self, kind: str, signal: str, column: str) -> str | None:
        """The element that a column is, by what is told or by its name."""
        for key in (f"{signal}.{column}", f"{_topic(signal)}.{column}", column):
            told = self._told.get(key, "")
            if told.startswith(f"{kind}/"):
                return told.removeprefix(f"{kind}/")
        names = self._names[kind]
        if column in names:
            return column
        plain = {_plain(name): name for name in names if name}
        return plain.get(_plain(column))

    def _check_told(self) -> None:
        signals = self._episode.signals
        known = {*signals, *map(_topic, signals)}
        for name, signal in signals.items():
            for column in signal.columns:
                known |= {f"{name}.{column}", f"{_topic(name)}.{column}", column}
        for key, target in self._told.items():
            if key not in known:
                near = get_close_matches(key, known, _FEW, 0.5) or sorted(known)
                raise UsageError(
                    f"--map {short_name(key)}: the log has no such signal",
                    f"there is: {listed(near, _FEW)}",
                )
            kind, _, name = target.partition("/")
            if target in ("commands", "states", IGNORE):
                continue
            if kind not in self._names or name not in self._names[kind]:
                known_names = [
                    f"{one}/{each}" for one, names in self._names.items() for each in names if each
                ]
                near = get_close_matches(target, known_names, _FEW, 0.5) or known_names
                raise UsageError(
                    f"--map {short_name(key)}={short_name(target)}: is no part of the model",
                    f"there is: commands, states, -, {listed(near, _FEW)}",
                )

    def _refuse(self) -> None:
        of_log: Iterable[str] = dict.fromkeys(
            column
            for name, signal in self._episode.signals.items()
            if _quantity(name)
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


def _topic(signal: str) -> str:
    """The topic of a signal of joints."""
    topic, _, last = signal.rpartition(".")
    return topic if last in _QUANTITIES else signal


def _quantity(signal: str) -> str:
    """What of joints a signal is; "" where it is none."""
    last = signal.rpartition(".")[2]
    return last if last in _QUANTITIES else ""


def _plain(name: str) -> str:
    """A name without its prefix, case and marks: `robot/Elbow-Joint` and `elbow_joint` are one."""
    return re.sub(r"[\W_]", "", name.rpartition("/")[2]).lower()
