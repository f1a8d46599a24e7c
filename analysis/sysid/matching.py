"""Match a log's signals with a model's joints, actuators and bodies by name.

Names come first, then orientations, poses and wrenches, each by itself, and the user's `--map`; the
last part matches a whole episode by them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from tunenet_logs.episode import UNSTATED, Array, Episode, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.formats.columns.angles import PERCENT, REMEDY
from tunenet_logs.recorders.simulators.model.parameters import MANY_SIDED, element_names
from tunenet_logs.recorders.simulators.model.rollout import (
    Drive,
    Kind,
    SensedSignal,
    Sensor,
    free_joint,
    rotation_in,
)
from tunenet_logs.recorders.simulators.model.servo import servos
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import listed, one_line, short_name

# ---- Names of signals, and how they match a model's

# In a topic's name: what somebody wants, not what is.
_COMMANDS = re.compile(r"command|cmd|target|desired|reference|setpoint|goal|trajectory", re.I)
# In the last part of a topic's name: what is, whatever the parts before it say.
_STATES = re.compile(r"state|measured|actual|feedback", re.I)
# The last part of the name of what is 1 while a servo has power, and 0 without.
_POWER = re.compile(r"(torque|motors?|servos?)?_?(enabled?|powered|power|on)", re.I)
_QUANTITIES = ("position", "velocity", "effort")
# Where a table holds several runs, and a data set several episodes: what ends their topics.
_RUN = re.compile(r"\.((?:run|episode|demo_)\d+)$")
_PARTS = (*_QUANTITIES, "orientation", "force", "torque")  # how the signals of one topic end


def topic_of(signal: str) -> str:
    """Return the topic of a signal, or what a pose is of: without the signal's quantity."""
    topic, _, last = signal.rpartition(".")
    return topic if last in _PARTS else signal


def run_of(signal: str) -> str:
    """Return which run of a table or data set a signal is of, such as "episode3"; "" for none."""
    found = _RUN.search(topic_of(signal))
    return found[1] if found else ""


def runs_of(episode: Episode) -> dict[str, Episode]:
    """Split what holds several runs: each run's signals under its name, without it in theirs.

    Signals that are of none are of each. An episode of one run, or of none, is not split: "".
    """
    runs = dict.fromkeys(filter(None, map(run_of, episode.signals)))
    if len(runs) < 2:
        return {"": episode}
    found: dict[str, Episode] = {}
    for run in runs:
        signals = {
            name.replace(f".{run}", "", 1): one
            for name, one in episode.signals.items()
            if run_of(name) in ("", run)
        }
        signals = {name: replace(one, name=name) for name, one in signals.items()}
        said = () if found else episode.warnings  # once
        found[run] = replace(episode, signals=signals, warnings=said)
    return found


def quantity_of(signal: str) -> str:
    """Return which joint quantity a signal is; "" if it is none."""
    last = signal.rpartition(".")[2]
    return last if last in _QUANTITIES else ""


def is_power(signal: Signal) -> bool:
    """Return whether a signal says when servos have power: by its name and values, 0 and 1."""
    if not _POWER.fullmatch(re.split(r"[/.]", signal.name)[-1]):
        return False
    values = signal.values[np.isfinite(signal.values)]
    return bool(values.size) and bool(np.isin(values, (0.0, 1.0)).all())


def is_wanted(topic: str) -> bool:
    """Return whether a topic is a command rather than a state: by its last part, then by all."""
    last = topic.rpartition("/")[2]
    if _COMMANDS.search(last):
        return True
    return not _STATES.search(last) and _COMMANDS.search(topic) is not None


def named_as(name: str, names: Sequence[str]) -> str | None:
    """Match a name but for prefix, case and marks; None if ambiguous."""
    if name and name in names:
        return name
    for plain in (_plain, lambda one: _plain(one.rpartition("/")[2])):
        wanted = plain(name)
        found = [one for one in names if one and plain(one) == wanted]
        if wanted and found:
            return found[0] if len(found) == 1 else None
    return None


def words_of(name: str) -> list[str]:
    """List candidates of a body's name in a signal's: frame, topic parts, words; last first."""
    frames = name.split(".")
    tails = [".".join(frames[place:]) for place in range(1, min(len(frames), 9))]
    return [*tails, *reversed(name.split("/")), *reversed(re.split(r"[/.@]", name))]


def without_common(names: Sequence[str]) -> list[str]:
    """Strip names of the words that all begin with, and of those that all end with.

    `main_pan.pos` and `main_lift.pos` are `pan` and `lift`; one name alone is kept.
    """
    found = list(names)
    for _ in range(2):  # from the front, then from the back
        parts = [re.split(r"(?<=[\W_])", name) for name in found]
        shared = 0
        if len(parts) > 1:
            least = min(map(len, parts)) - 1
            equal = (len({one[at] for one in parts}) == 1 for at in range(least))
            shared = next((at for at, is_one in enumerate(equal) if not is_one), least)
        found = ["".join(one[shared:])[::-1] for one in parts]
    return found


def _plain(name: str) -> str:
    """Remove case and marks: `Elbow-Joint` and `elbow_joint` are one."""
    return re.sub(r"[\W_]", "", name).lower()


# ---- Orientations to compare: those that the model begins with, too


@dataclass(frozen=True, eq=False)
class Turned:
    """Orientation in a log."""

    sensed: SensedSignal  # the body's x and z axes
    words: str  # description of its use
    is_sure: bool  # whether the user states that its axes are the body's


def rotations(axes: Array) -> Array:
    """Build rotation matrices, shape (T, 3, 3), from their x and z axes, shape (T, 6)."""
    x, z = axes[:, :3], axes[:, 3:]
    return np.stack([x, np.cross(z, x), z], axis=2)


# ---- Positions and orientations, matched with bodies and frames

# Frames that are taken for the model's world without a word.
_WORLDS = ("world", "map", "odom", "mocap")
_AXES: tuple[Kind, Kind] = ("framexaxis", "framezaxis")


def is_orientation(signal: Signal) -> bool:
    """Return whether a signal is one of quaternions."""
    return signal.columns == ("x", "y", "z", "w") and signal.unit == "1"


def sensed_pose(
    signal: Signal, told: str, bodies: Sequence[str]
) -> tuple[SensedSignal | None, str]:
    """Match a position or an orientation with a model."""
    is_turn = is_orientation(signal)
    if not is_turn and (signal.columns != ("x", "y", "z") or signal.unit != "m"):
        raise UsageError(
            f"--map {short_name(signal.name)}=body/{short_name(told)}: is no position in m",
            "map the topic of a pose, a point or a transform",
        )
    found = (named_as(word, bodies[1:]) for word in words_of(topic_of(signal.name)))
    body = told or next((one for one in found if one is not None), None)
    if body is None:
        return None, "no body of the model is called so"
    if np.isfinite(signal.values).all(axis=1).sum() < 2:
        return None, "fewer than two samples"
    reference = named_as(signal.frame, bodies[1:]) or ""
    if reference == body:
        return None, f"is in {short_name(body)}'s own frame"
    words = f" from {short_name(reference)}" if reference else ""
    if not reference and signal.frame.rpartition("/")[2].lower() not in ("", *_WORLDS):
        words = f", frame {short_name(signal.frame)} taken for the world"
    if is_turn:
        # Convert quaternions to a body's x and z axes, which have no sign ambiguity.
        columns = tuple(f"{one} axis {each}" for one in "xz" for each in "xyz")
        sensors = tuple(Sensor(kind, body, axis, reference) for kind in _AXES for axis in range(3))
        # The x and z axes, shape (T, 6), of quaternions x, y, z, w, shape (T, 4).
        x, y, z, w = (signal.values / np.linalg.norm(signal.values, axis=1, keepdims=True)).T
        axes = np.column_stack(
            [
                1 - 2 * (y * y + z * z),
                2 * (x * y + z * w),
                2 * (x * z - y * w),
                2 * (x * z + y * w),
                2 * (y * z - x * w),
                1 - 2 * (x * x + y * y),
            ]
        )
        return SensedSignal(
            replace(signal, values=axes, columns=columns), columns, sensors
        ), f"orientation of {short_name(body)}{words}"
    sensors = tuple(Sensor("framepos", body, axis, reference) for axis in range(3))
    return SensedSignal(signal, signal.columns, sensors), f"position of {short_name(body)}{words}"


# ---- The user's `--map`, checked against the log and the model

IGNORE = "-"  # as a target of `--map`: the signal is left out
TURNED = "-"  # before a site or a body: the log has the force of the child on its parent
_FEW = 6


def check_told(
    told: Mapping[str, str], signals: Mapping[str, Signal], names: Mapping[str, Sequence[str]]
) -> None:
    """Check that each key of `--map` is in the log and each target in the model."""
    topics = set(map(topic_of, signals))
    known = {*signals, *topics}
    for name, signal in signals.items():
        for column in signal.columns:
            known |= {f"{name}.{column}", f"{topic_of(name)}.{column}", column}
    for key, target in told.items():
        if key not in known:
            near = get_close_matches(key, known, _FEW, 0.5) or sorted(known)
            raise UsageError(
                f"--map {short_name(key)}: the log has no such signal",
                f"there is: {listed(near, _FEW)}",
            )
        kind, _, name = target.partition("/")
        if kind in (f"{TURNED}body", f"{TURNED}site"):
            kind = kind.removeprefix(TURNED)
        is_whole = key in signals or key in topics
        if not is_whole and (target in ("commands", "states") or kind in ("body", "site")):
            raise UsageError(
                f"--map {short_name(key)}={short_name(target)}: is one column alone",
                f"map its signal or topic, or {short_name(key)}=joint/NAME",
            )
        if target in ("commands", "states", IGNORE):
            continue
        if not name or name not in names.get(kind, ()):
            known_names = [f"{one}/{each}" for one, some in names.items() for each in some if each]
            near = get_close_matches(target, known_names, _FEW, 0.5) or known_names
            raise UsageError(
                f"--map {short_name(key)}={short_name(target)}: is no part of the model",
                f"there is: commands, states, -, {listed(near, _FEW)}",
            )


# ---- Forces and torques, matched with sites and bodies, and their sign

_KINDS: dict[str, Kind] = {"N": "force", "N·m": "torque"}
# In a sensor's name: a model has one for each of the two.
_QUANTITY = re.compile(r"(?:(?<![_\W])[_\W]++)?(force|torque)[_\W]*")


def is_wrench(signal: Signal) -> bool:
    """Return whether a signal is a 3D force or torque."""
    return signal.columns == ("x", "y", "z") and signal.unit in _KINDS


def sensed_wrench(signal: Signal, told: str, model: Any) -> tuple[SensedSignal | None, str]:
    """Match a force or torque with a compiled model."""
    if not is_wrench(signal):
        raise UsageError(
            f"--map {short_name(signal.name)}={short_name(told)}: is no force in N or torque in "
            "N·m",
            "map the topic of a wrench to a site",
        )
    if told:
        kind, _, name = told.removeprefix(TURNED).partition("/")
        is_body = kind == "body"
    else:
        is_body, name = _place(signal, model)
    if not name:
        return None, "no force sensor, site or body of the model is called so"
    if np.isfinite(signal.values).all(axis=1).sum() < 2:
        return None, "fewer than two samples"
    body = name if is_body else model.body(int(model.site(name).bodyid[0])).name
    if not model.body(body).id or free_joint(model, body) is not None:
        return None, f"{short_name(name)} hangs on nothing, and no force holds it"
    kind, sign = _KINDS[signal.unit], -1.0 if told.startswith(TURNED) else 1.0
    sensors = tuple(Sensor(kind, name, axis, is_at_body=is_body, sign=sign) for axis in range(3))
    where = f"{'body' if is_body else 'site'} {short_name(name)}"
    words = f"{kind} at {where}, {'of its parent on it' if sign > 0 else 'of it on its parent'}"
    if signal.frame and named_as(signal.frame, [name, body]) is None:
        words += f", frame {short_name(signal.frame)} taken for its axes"
    return SensedSignal(signal, signal.columns, sensors), words


def _place(signal: Signal, model: Any) -> tuple[bool, str]:
    """Return whether it is a body's, and the site or body; "" if none has that name."""
    words = [*filter(None, [signal.frame]), *words_of(topic_of(signal.name))]
    sites = [name for name in element_names(model, "site") if name]
    bodies = [name for name in element_names(model, "body")[1:] if name]
    # The site of each force sensor, by its name with and without `force` in it.
    kinds = mujoco().mjtSensor
    wanted = (int(kinds.mjSENS_FORCE), int(kinds.mjSENS_TORQUE))
    sensors: dict[str, str] = {}
    for number in np.flatnonzero(np.isin(model.sensor_type, wanted)).tolist():
        name = model.sensor(number).name
        site = model.site(int(model.sensor_objid[number])).name
        if name and site:
            sensors[name] = site
            if plain := _QUANTITY.sub("", name):
                sensors.setdefault(plain, site)
    for is_body, names in ((False, list(sensors)), (False, sites), (True, bodies)):
        for word in words:
            if found := named_as(word, names):
                return is_body, sensors.get(found, found)
    return False, ""


def doubts(sensed: Sequence[SensedSignal], rollout: Episode) -> tuple[str, ...]:
    """Describe forces that oppose those of a rollout at their beginning."""
    found: list[str] = []
    for one in sensed:
        first = one.sensors[0]
        if first.kind != "force":
            continue
        seen, simulated = _beginning(one.signal), _beginning(rollout.signals[one.signal.name])
        sizes = float(np.linalg.norm(seen)), float(np.linalg.norm(simulated))
        # A force under a fifth of the simulated one, as of a tared sensor, shows no sign.
        is_seen = sizes[0] > 0.2 * sizes[1] > 0
        # They are opposed by the cosine between them.
        if is_seen and float(seen @ simulated) < -0.9 * sizes[0] * sizes[1]:
            place = f"{'body' if first.is_at_body else 'site'}/{short_name(first.name)}"
            target = f"{TURNED}{place}" if first.sign > 0 else place
            found.append(
                f"{one.signal.name}: at the start it points against what is simulated; of the "
                f"other sign it is with --map {short_name(topic_of(one.signal.name))}={target}"
            )
    return tuple(found)


def _beginning(signal: Signal) -> Array:
    """Return the mean of a signal's first tenth of a second, shape (C,); 0 if it has none."""
    first = signal.values[signal.stamps_ns <= signal.stamps_ns[0] + 100_000_000]
    good = first[np.isfinite(first).all(axis=1)]
    return good.mean(axis=0) if len(good) else np.zeros(signal.values.shape[1])


# ---- Prefixes: `--map 'main_*=joint/*'` maps every column that begins so

_ANY = "*"


def spread_told(
    told: Mapping[str, str], signals: Mapping[str, Signal], names: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """Return `--map` with each key that ends with * as those of the columns that begin so.

    What stands for the * in a column stands for it in the target.
    """
    found = {key: target for key, target in told.items() if not key.endswith(_ANY)}
    for key, target in told.items():
        if not key.endswith(_ANY):
            continue
        kind, _, wanted = target.partition("/")
        said = f"--map {short_name(key)}={short_name(target)}"
        if kind not in ("joint", "actuator") or not wanted.endswith(_ANY):
            raise UsageError(
                f"{said}: a * stands for the rest of a joint's name", "write PREFIX*=joint/PREFIX*"
            )
        columns = {
            (of.name, column): column.removeprefix(key[:-1])
            for of in signals.values()
            for column in of.columns
            if column.startswith(key[:-1]) and (quantity_of(of.name) or of.drives)
        }
        pairs = {one: f"{kind}/{wanted[:-1]}{rest}" for one, rest in columns.items()}
        known = {one: to for one, to in pairs.items() if to.partition("/")[2] in names[kind]}
        if not known:
            what = "no column of the log begins so" if not columns else "no such part of the model"
            near = listed([one for one in names[kind] if one], _FEW) or "none"
            raise UsageError(f"{said}: {what}", f"there is: {near}")
        found |= {f"{name}.{column}": to for (name, column), to in known.items()}
    return found


# ---- A whole episode: states, commands, poses and wrenches

_BY_QUANTITY: Mapping[str, Kind] = {
    "position": "jointpos",
    "velocity": "jointvel",
    "effort": "jointactuatorfrc",
}
_UNITS: Mapping[str, str] = {"rad/s": "velocity", "m/s": "velocity", "N·m": "effort", "N": "effort"}
# Units of what a user says is a joint, where its name does not tell the quantity.
_PLACES = ("rad", "m", "1")
# What joints without names are called, from 0 or 1 on.
_NUMBERED = re.compile(r"(?:(?:joint|j|dof|motor|servo)[ _]?)?(\d{1,3})", re.I)
_TARGETS = ("joint", "actuator", "body", "site")


class Match:
    """Match of an episode's signals with a compiled model, by `--map` or by name."""

    def __init__(self, episode: Episode, model: Any, told: Mapping[str, str]) -> None:
        self.sensed: list[SensedSignal] = []  # signals to compare
        self.drives: list[Drive] = []  # signals that drive the model
        self.used: list[str] = []  # each signal that is used, and its use, in words
        self.unused: list[str] = []  # each that is not, and why
        self.turned: list[Turned] = []  # orientations, compared if the model begins with them
        self.joined: list[str] = []  # joint angles that were unwrapped, in words
        self.guessed: list[str] = []  # joints that are matched by their numbers, in words
        self._episode, self._model = episode, model
        self._names = {kind: element_names(model, kind) for kind in _TARGETS}
        self._told = spread_told(told, episode.signals, self._names)
        check_told(self._told, episode.signals, self._names)
        states: list[Signal] = []
        runs = list(dict.fromkeys(filter(None, map(run_of, self._episode.signals))))
        if runs[1:]:
            others = f"{listed(runs[1:], _FEW)}: other runs than {runs[0]}, which is used"
            self.unused.append(f"{others}; --together takes all of them")
        for name, signal in self._episode.signals.items():
            if run_of(name) in runs[1:]:
                continue
            role = self._role(name, signal)
            if role == IGNORE:
                self.unused.append(f"{name}: left out by --map")
            elif signal.unit == UNSTATED and self._is_untold(signal, role):
                self.unused.append(f"{name}: {self._untold(signal)}")
            elif role == "commands":
                self._command(self._in_radians(signal))
            elif role == "states":
                states.append(self._in_radians(signal))
            elif role in ("pose", "wrench"):
                mapped = self._told_signal(signal)
                if role == "wrench":
                    sensed, words = sensed_wrench(signal, mapped, model)
                else:
                    bodies = self._names["body"]
                    sensed, words = sensed_pose(signal, mapped.removeprefix("body/"), bodies)
                if sensed is None:
                    self.unused.append(f"{name}: {words}")
                elif role == "pose" and is_orientation(signal):
                    self.turned.append(Turned(sensed, words, is_sure=name in told))
                else:
                    self._sense(sensed, words)
            else:
                self.unused.append(f"{name}: neither joints, commands, pose nor wrench")
        for signal in states:
            self._state(signal)
        if not self.sensed:
            self._refuse()

    def starts(self) -> list[SensedSignal]:
        """List what a rollout starts from: orientations of freely moving bodies, too."""
        turned = [one.sensed for one in self.turned]
        free = [one for one in turned if free_joint(self._model, one.sensors[0].name) is not None]
        return [*self.sensed, *free]

    def choose_turned(self, qpos: Array) -> None:
        """Compare the orientations that the model begins with, too, at `qpos`, shape (nq,).

        A tracker has axes of its own, which nobody may have turned as the model's.
        """
        for one in self.turned:
            signal, (sensor, *_) = one.sensed.signal, one.sensed.sensors
            first = rotations(signal.values[np.isfinite(signal.values).all(axis=1)][:1])[0]
            own = rotation_in(self._model, qpos, sensor.name, sensor.reference)
            cosine = (np.trace(first.T @ own) - 1) / 2
            degrees = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
            if one.is_sure or degrees <= 20.0:
                self.sensed.append(one.sensed)
                self.used.append(f"{signal.name}: compared with {one.words}")
                continue
            body = short_name(sensor.name)
            self.unused.append(
                f"{signal.name}: turned by {degrees:.0f} degrees from body/{body} at the start; "
                f"where its axes are that body's, say --map {short_name(signal.name)}=body/{body}"
            )

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
        if is_power(signal):
            return "commands"
        quantity = quantity_of(name)
        if quantity or (signal.drives and signal.unit == "1"):
            return "commands" if signal.drives or is_wanted(topic_of(name)) else "states"
        if is_orientation(signal) or (signal.columns == ("x", "y", "z") and signal.unit == "m"):
            return "pose"
        return "wrench" if is_wrench(signal) else ""

    def _state(self, signal: Signal) -> None:
        by_unit = "position" if signal.unit in _PLACES else _UNITS.get(signal.unit, "")
        kind = _BY_QUANTITY.get(quantity_of(signal.name) or by_unit)
        if kind is None:
            self.unused.append(f"{signal.name}: [{signal.unit}] is nothing of joints")
            return
        columns: list[tuple[int, str, str]] = []
        reasons: dict[str, list[str]] = {}
        for place, (column, joint) in enumerate(
            zip(signal.columns, self._elements("joint", signal), strict=True)
        ):
            why = ""
            if self._told_of(signal, column) == IGNORE:
                why = "left out by --map"
            elif joint is None:
                why = "no joint of the model is called so, or several are"
            elif self._model.jnt_type[self._names["joint"].index(joint)] in MANY_SIDED:
                why = "that joint has no single position"
            elif np.isfinite(signal.values[:, place]).sum() < 2:
                why = "fewer than two samples"
            if why or joint is None:
                reasons.setdefault(why, []).append(column)
            else:
                columns.append((place, column, joint))
        for why, names in reasons.items():
            self.unused.append(f"{signal.name}: {listed(names, _FEW)}: {why}")
        if not columns:
            return
        if kind == "jointactuatorfrc":
            # Compare measured efforts with those of driven actuators; the others drive.
            drives = [drive for drive in self.drives if not drive.is_switch]
            targets = {int(one) for drive in drives for one in drive.targets}
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
                self.drives.append(Drive(signal, places, dofs, is_effort=True))
                names = [signal.columns[place] for place in places]
                self.used.append(f"{signal.name}: drives joints {listed(names, _FEW)}")
            return
        sensors = tuple(Sensor(kind, joint) for _, _, joint in columns)
        names = tuple(column for _, column, _ in columns)
        if kind == "jointpos":
            signal = self._joined(signal, columns)
        self._sense(SensedSignal(signal, names, sensors))

    def _is_untold(self, signal: Signal, role: str) -> bool:
        """Return whether a signal without a unit is of joints, and not said to be commands."""
        is_said = self._told_signal(signal) == "commands" and not quantity_of(signal.name)
        return not is_said and (signal.drives or role in ("states", "commands", ""))

    @staticmethod
    def _untold(signal: Signal) -> str:
        if signal.drives and not quantity_of(signal.name):
            topic = short_name(signal.name)
            return f"nothing tells what of the joints it commands; say --map {topic}=commands"
        return f"nothing tells its unit; {REMEDY}"

    def _in_radians(self, signal: Signal) -> Signal:
        """Convert per cent of the joints' ranges, -100 to 100, to the model's own positions."""
        if signal.unit != PERCENT:
            return signal
        values, lacking = np.full_like(signal.values, np.nan), list[str]()
        for place, joint in enumerate(self._elements("joint", signal)):
            number = -1 if joint is None else self._names["joint"].index(joint)
            if number < 0 or not self._model.jnt_limited[number]:
                lacking += [signal.columns[place]] * (joint is not None)
                continue
            low, high = self._model.jnt_range[number]
            values[:, place] = (low + high + (high - low) * signal.values[:, place] / 100) / 2
        if lacking:
            why = "per cent of a range that the model's joint does not have"
            self.unused.append(f"{signal.name}: {listed(lacking, _FEW)}: {why}")
        if np.isfinite(values).any():
            self._say_once(
                self.guessed,
                "per cent are taken for those of the ranges of the model's joints; where the "
                "servos were calibrated to others, record degrees or radians",
            )
        return replace(signal, values=values, unit="rad")

    def _joined(self, signal: Signal, columns: list[tuple[int, str, str]]) -> Signal:
        """Unwrap angles of hinges without limits that were wrapped to one turn, such as at ±π.

        They were if all lie within one turn, some jump by most of one, and the joint, unwrapped
        there, is mostly as fast as elsewhere: glitches and steps are faster.
        """
        values, cut = signal.values.copy(), []
        for place, column, joint in columns:
            number = self._names["joint"].index(joint)
            is_hinge = self._model.jnt_type[number] == int(mujoco().mjtJoint.mjJNT_HINGE)
            if not is_hinge or self._model.jnt_limited[number]:
                continue
            good = np.isfinite(values[:, place])
            angles = values[good, place]
            jumps = np.abs(np.diff(angles)) > np.pi
            if not jumps.any() or jumps.all() or np.ptp(angles) > 2 * np.pi + 0.05:
                continue
            whole = np.unwrap(angles)
            speeds = np.abs(np.diff(whole)) / np.diff(signal.stamps_ns[good])
            # Where its angle is cut to one turn, a joint may be twice as fast as elsewhere.
            if np.median(speeds[jumps]) <= 2.0 * speeds[~jumps].max():
                values[good, place] = whole
                cut.append(column)
        if not cut:
            return signal
        self.joined.append(f"{signal.name}: {listed(cut, _FEW)}: cut to one turn: joined")
        return replace(signal, values=values)

    def _command(self, signal: Signal) -> None:
        if is_power(signal):
            self._power(signal)
            return
        quantity, pairs, again = quantity_of(signal.name), list[tuple[int, int]](), list[str]()
        drives = [drive for drive in self.drives if not drive.is_switch]
        taken = {int(one) for drive in drives for one in drive.targets}
        actuators, joints = self._elements("actuator", signal), self._elements("joint", signal)
        for place, column in enumerate(signal.columns):
            is_left_out = self._told_of(signal, column) == IGNORE
            if is_left_out or not np.isfinite(signal.values[:, place]).any():
                continue
            # The actuator of its name, of its joint's, or of its number.
            named, joint = actuators[place], joints[place]
            near = [] if named is None else [self._names["actuator"].index(named)]
            if joint is not None:
                number = self._names["joint"].index(joint)
                near += [one for one in range(self._model.nu) if self._joint_of(one) == number]
            fits = (one for one in near if not quantity or self._wants(one) == quantity)
            by_order = not quantity and len(signal.columns) == self._model.nu and column.isdecimal()
            actuator = next(fits, place if by_order else None)
            if actuator in taken:
                again.append(column)
            elif actuator is not None:
                taken.add(actuator)
                pairs.append((place, actuator))
        if again:
            why = "another signal commands its actuator; leave one out with --map SIGNAL=-"
            self.unused.append(f"{signal.name}: {listed(again, _FEW)}: {why}")
        if pairs:
            columns, targets = np.array(pairs).T
            self.drives.append(Drive(signal, columns, targets, is_effort=False))
            names = [self._names["actuator"][target] or str(target) for target in targets]
            self.used.append(f"{signal.name}: commands actuators {listed(names, _FEW)}")
        elif not again:
            numbered = enumerate(self._names["actuator"])
            words = [f"{name} ({self._wants(one)})" if name else f"{one}" for one, name in numbered]
            there = listed(dict.fromkeys(words), _FEW) or "none"
            why = f"no actuator of the model takes it (there is: {there})"
            self.unused.append(f"{signal.name}: {why}")

    def _power(self, signal: Signal) -> None:
        """Match the power of servos: by their names or joints'; one alone is of all."""
        found = dict(servos(self._model))
        if not (signal.values == 0).any():
            self.used.append(f"{signal.name}: servos have power all the time")
            return
        actuators, joints = self._elements("actuator", signal), self._elements("joint", signal)
        pairs: list[tuple[int, int]] = []
        for place, names in enumerate(zip(actuators, joints, strict=True)):
            named = [
                actuator
                for actuator, joint in found.items()
                if self._names["actuator"][actuator] == names[0]
                or self._names["joint"][joint] == names[1]
            ]
            pairs += [(place, actuator) for actuator in named]
        if not pairs and len(signal.columns) == 1:
            pairs = [(0, actuator) for actuator in found]
        if not pairs:
            self.unused.append(f"{signal.name}: no servo of the model is called so")
            return
        columns, targets = np.array(pairs).T
        self.drives.append(Drive(signal, columns, targets, is_effort=False, is_switch=True))
        names = [self._names["actuator"][target] or str(target) for target in targets]
        self.used.append(f"{signal.name}: power of actuators {listed(names, _FEW)}")

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

    def _told_signal(self, signal: Signal) -> str:
        """Return the user's mapping of a signal, or of its topic; "" if none."""
        return self._told.get(signal.name) or self._told.get(topic_of(signal.name), "")

    def _sense(self, sensed: SensedSignal, what: str = "") -> None:
        self.sensed.append(sensed)
        what = what or listed([one.name for one in sensed.sensors], _FEW)
        self.used.append(f"{sensed.signal.name}: compared with {what}")

    def _told_of(self, signal: Signal, column: str) -> str:
        """Return the user's mapping of a column, or of its one-column signal; "" if none."""
        name = signal.name
        keys = [f"{name}.{column}", f"{topic_of(name)}.{column}", column]
        if len(signal.columns) == 1:
            keys += [name, topic_of(name)]
        return next((self._told[key] for key in keys if key in self._told), "")

    def _elements(self, kind: str, signal: Signal) -> list[str | None]:
        """Match each column with an element, by the mapping or by name; each once."""
        names = self._names[kind]
        found: list[str | None] = []
        for column in signal.columns:
            target = self._told_of(signal, column)
            own = column if column and column in names else None
            told = target.startswith(f"{kind}/")
            found.append(target.removeprefix(f"{kind}/") if told else own)
        sure = {one for one in found if one is not None}
        known = [name for name in names if name]
        plain = dict(zip(without_common(known), known, strict=True))
        own = without_common(signal.columns)
        for guesses in (
            [named_as(column, names) for column in signal.columns],
            [named_as(column, names) for column in own],
            [plain.get(named_as(column, list(plain)) or "") for column in signal.columns],
        ):
            for place, guess in enumerate(guesses):
                if found[place] is None and guess not in sure and guesses.count(guess) == 1:
                    found[place] = guess
            if any(found):
                return found
        return self._by_number(signal) if kind == "joint" else found

    def _by_number(self, signal: Signal) -> list[str | None]:
        """Match joints that have a number for a name: with those that actuators move, else all.

        There must be as many, and a position must lie within its joint's limits.
        """
        nothing: list[str | None] = [None] * len(signal.columns)
        if all(map(str.isdecimal, signal.columns)):  # of plain numbers in the actuators' order
            return nothing
        pairs = zip(signal.columns, without_common(signal.columns), strict=True)
        found = [_NUMBERED.fullmatch(a) or _NUMBERED.fullmatch(b) for a, b in pairs]
        numbers = [int(one[1]) for one in found if one]
        first = min(numbers, default=2)
        if first > 1 or sorted(numbers) != list(range(first, first + len(signal.columns))):
            return nothing
        kinds = self._model.jnt_type
        scalar = [one for one in range(self._model.njnt) if kinds[one] not in MANY_SIDED]
        driven = [self._joint_of(one) for one in range(self._model.nu)]
        is_of_driven = len(set(driven)) == len(driven) == len(numbers) and None not in driven
        joints = [one for one in driven if one is not None] if is_of_driven else scalar
        if len(joints) != len(numbers):
            return nothing
        names = self._names["joint"]
        matched: list[str | None] = [names[joints[number - first]] for number in numbers]
        if not all(matched):
            return nothing
        words = [f"{a} is {b}" for a, b in zip(signal.columns, matched, strict=True)]
        said = "joints go by their numbers"
        if is_of_driven and len(scalar) == len(joints) and scalar != joints:
            why = f"{said}, and the model's actuators have another order than its joints"
            self._say_once(self.unused, f"{signal.name}: {why}; say which is which with --map")
            return nothing
        beyond = [one for one in range(len(joints)) if self._is_beyond(signal, one, matched[one])]
        if beyond:
            outside = listed([words[one] for one in beyond], _FEW)
            why = f"{said}, and leave the limits of the model's ({outside})"
            self._say_once(self.unused, f"{signal.name}: {why}; say which is which with --map")
            return nothing
        self._say_once(self.guessed, f"{said}: {listed(words, _FEW)}; if not, say so with --map")
        return matched

    def _is_beyond(self, signal: Signal, place: int, joint: str | None) -> bool:
        """Return whether a column's positions leave their joint's range by a tenth of it."""
        number = self._names["joint"].index(joint or "")
        is_place = quantity_of(signal.name) == "position" and signal.unit != PERCENT
        if not is_place or signal.drives or not self._model.jnt_limited[number]:
            return False
        low, high = self._model.jnt_range[number]
        own = signal.values[:, place]
        off = max(low - np.nanmin(own, initial=low), np.nanmax(own, initial=high) - high)
        return bool(off > 0.1 * (high - low))

    @staticmethod
    def _say_once(said: list[str], words: str) -> None:
        if words not in said:
            said.append(words)

    def _refuse(self) -> None:
        of_log: Iterable[str] = dict.fromkeys(
            column
            for name, signal in self._episode.signals.items()
            if quantity_of(name)
            for column in signal.columns
        )
        every = {kind: [*filter(None, self._names[kind])] for kind in ("joint", "body")}
        joints, bodies = listed(every["joint"], _FEW), listed(every["body"][1:], _FEW)
        seen = listed(of_log, _FEW) or listed(self._episode.signals, _FEW) or "nothing"
        raise NotFoundError(
            f"nothing of the log is in the model (log: {seen}; model: joints {joints or 'none'}, "
            f"bodies {bodies or 'none'})",
            self._example(every["joint"], every["body"][1:]),
        )

    def _example(self, joints: Sequence[str], bodies: Sequence[str]) -> str:
        """Return an order that names the log's own signals and the model's own parts."""
        for name, signal in self._episode.signals.items():
            if quantity_of(name) and joints:
                example = f"--map {signal.columns[0]}=joint/{joints[0]}"
            elif not quantity_of(name) and bodies:
                example = f"--map {name}=body/{bodies[0]}"
            else:
                continue
            return f"say what is what, for example {one_line(example)}"
        return "record the joints' positions or torques, their commands, or poses of bodies"
