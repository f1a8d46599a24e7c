"""Parameters of a user's MuJoCo model by name: `joint/elbow.damping`, `option.gravity[2]`.

What an address names is looked up in the compiled model, and set there: no file is written, and a
model is compiled once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from recorders.simulators.base import Parameter
from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import listed, short_name

DELAY = "delay/commands"
"""The address of what lies between a command and its effect; the simulator's, not the model's."""

_ADDRESS = re.compile(
    r"(?P<kind>[a-z]+)(?:/(?P<name>.+))?\.(?P<field>[a-z_]+)(?:\[(?P<index>\d{1,2})\])?"
)
_RANGE = re.compile(r"(?P<address>.+?)(?:=(?P<low>[^:=]+):(?P<high>[^:=]+))?")
_MOST_DELAY_S = 1.0
_MOST_WORDS = 8


@dataclass(frozen=True)
class _Field:
    """A quantity that elements of one kind have.

    Attributes:
        array: of the compiled model, by the element's number or that of its first degree of
            freedom.
        unit: of its values, in SI.
        least: that physics allows.
        size: values of one element; 1 for a number.
        by_dof: whether the array is by degree of freedom.
        usual: range where the model says 0; None where a user has to say one.
    """

    array: str
    unit: str
    least: float = 0.0
    size: int = 1
    by_dof: bool = False
    usual: tuple[float, float] | None = None


_ANY = -math.inf

_FIELDS: Mapping[str, Mapping[str, _Field]] = {
    "joint": {
        "damping": _Field("dof_damping", "N·m·s/rad", by_dof=True),
        "frictionloss": _Field("dof_frictionloss", "N·m", by_dof=True),
        "armature": _Field("dof_armature", "kg·m²", by_dof=True),
        "stiffness": _Field("jnt_stiffness", "N·m/rad"),
        "springref": _Field("qpos_spring", "rad", _ANY),
    },
    "body": {
        "mass": _Field("body_mass", "kg", 1e-6),
        "ipos": _Field("body_ipos", "m", _ANY, 3),
        "inertia": _Field("body_inertia", "kg·m²", 1e-9, 3),
    },
    "geom": {
        "friction": _Field("geom_friction", "1", 0.0, 3, usual=(0.0, 1.5)),
        "solref": _Field("geom_solref", "1", _ANY, 2),
        "solimp": _Field("geom_solimp", "1", 0.0, 5),
    },
    "actuator": {
        "kp": _Field("actuator_gainprm", "1"),
        "kv": _Field("actuator_biasprm", "1"),
        "gear": _Field("actuator_gear", "1", _ANY, 6),
    },
    "tendon": {
        "damping": _Field("tendon_damping", "N·s/m"),
        "frictionloss": _Field("tendon_frictionloss", "N"),
        "stiffness": _Field("tendon_stiffness", "N/m"),
    },
    "option": {
        "gravity": _Field("gravity", "m/s²", _ANY, 3),
        "density": _Field("density", "kg/m³"),
        "viscosity": _Field("viscosity", "Pa·s"),
    },
}

_SLIDING_UNITS = {
    "N·m·s/rad": "N·s/m",
    "N·m": "N",
    "kg·m²": "kg",
    "N·m/rad": "N/m",
    "rad": "m",
}
"""Of a joint that slides, in place of those of one that turns."""


@dataclass(frozen=True, eq=False)
class ModelParameter:
    """A number of a compiled model that can be tuned.

    Attributes:
        parameter: its name is the address, its training range where it is looked for.
        put: gives a compiled model this value, all that follows from it but `mj_setConst`'s.
        field: what it is, e.g. "damping".
        owner: kind and name of the element, e.g. "joint/elbow".
    """

    parameter: Parameter
    put: Callable[[Any, float], None]
    field: str
    owner: str


def model_parameters(model: Any, wanted: Iterable[str]) -> tuple[ModelParameter, ...]:
    """The parameters of a compiled model that texts such as `joint/elbow.damping=0:5` name.

    Raises:
        UsageError: no such element or field, or no range; with the nearest that there are.
    """
    found = [_model_parameter(model, text) for text in wanted]
    names = [one.parameter.name for one in found]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"--tune {short_name(name)} is named twice; leave one out")
    return tuple(found)


def _model_parameter(model: Any, text: str) -> ModelParameter:
    match = _RANGE.fullmatch(text.strip())
    assert match is not None
    address = match["address"].strip()
    if address == DELAY:
        low, high = _range(text, match) or (0.0, 0.2)
        initial = (low + high) / 2
        delay = Parameter(DELAY, "s", (0.0, _MOST_DELAY_S), (low, high), initial)
        _check_inside(text, delay)
        return ModelParameter(delay, _nothing, "delay", DELAY)
    parts = _ADDRESS.fullmatch(address)
    if parts is None or parts["kind"] not in _FIELDS:
        kinds = ", ".join(_FIELDS)
        raise UsageError(
            f"--tune {short_name(text)} names no parameter",
            f"write KIND/NAME.FIELD with one of {kinds}, such as joint/elbow.damping=0:5, or "
            f"{DELAY}",
        )
    kind, field_name = parts["kind"], parts["field"]
    if field_name not in _FIELDS[kind]:
        raise UsageError(
            f"--tune {short_name(text)}: a {kind} has no {short_name(field_name)}",
            f"there is: {', '.join(_FIELDS[kind])}",
        )
    field = _FIELDS[kind][field_name]
    number = _number(model, kind, parts["name"], text)
    index = int(parts["index"] or 0)
    if index >= field.size or (parts["index"] is None and field.size > 1):
        last = field.size - 1
        remedy = f"write {field_name}[0]" if field.size > 1 else "leave the brackets out"
        remedy += f" to {field_name}[{last}]" if field.size > 1 else ""
        what = f"--tune {short_name(text)}: {field_name} has {field.size} numbers"
        raise UsageError(what if field.size > 1 else f"{what[:-1]}", remedy)
    place = _place(model, kind, field_name, field, number, index)
    unit = field.unit
    if kind == "joint" and model.jnt_type[number] == mujoco().mjtJoint.mjJNT_SLIDE:
        unit = _SLIDING_UNITS.get(unit, unit)
    now = float(place.get(model))
    low, high = _range(text, match) or _usual_range(text, field, now)
    most = 1e9
    bounds = (max(field.least, -most), most)
    parameter = Parameter(address, unit, bounds, (low, high), min(max(now, low), high))
    _check_inside(text, parameter)
    owner = kind if parts["name"] is None else f"{kind}/{parts['name']}"
    return ModelParameter(parameter, place.put, field_name, owner)


def _number(model: Any, kind: str, name: str | None, text: str) -> int:
    """Of the element in the model; 0 of the options, which are there once."""
    if kind == "option":
        if name is not None:
            raise UsageError(f"--tune {short_name(text)}: the options have no name; write option.")
        return 0
    names = element_names(model, kind)
    if name not in names:
        known = [one for one in names if one]
        near = get_close_matches(name or "", known, _MOST_WORDS, 0.5) or known
        remedy = (
            f"nearest: {listed(near, _MOST_WORDS)}" if near else f"name the {kind} in the model"
        )
        raise UsageError(f"--tune {short_name(text)}: the model has no such {kind}", remedy)
    return names.index(name)


def element_names(model: Any, kind: str) -> list[str]:
    """Names of all elements of a kind, by their number; "" where there is none."""
    counts = {
        "joint": "njnt",
        "body": "nbody",
        "geom": "ngeom",
        "actuator": "nu",
        "tendon": "ntendon",
    }
    accessor = getattr(model, kind)
    return [accessor(number).name for number in range(getattr(model, counts[kind]))]


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a number stands in a compiled model."""

    get: Callable[[Any], float]
    put: Callable[[Any, float], None]


def _place(
    model: Any, kind: str, field_name: str, field: _Field, number: int, index: int
) -> _Place:
    if kind == "option":
        return _option_place(field, index)
    if kind == "actuator" and field_name in ("kp", "kv"):
        return _servo_place(field_name, number)
    if field_name == "mass":
        return _Place(lambda one: one.body_mass[number], _mass_put(number))
    rows = slice(number, number + 1)
    if field.by_dof:
        rows = _dofs(model, number)
    elif field.array == "qpos_spring":
        first = int(model.jnt_qposadr[number])
        rows = slice(first, first + 1)

    def view(one: Any) -> Array:
        array = getattr(one, field.array)
        return array[rows] if array.ndim == 1 else array[rows, index]

    def put(one: Any, value: float) -> None:
        view(one)[:] = value

    return _Place(lambda one: float(view(one)[0]), put)


def _dofs(model: Any, joint: int) -> slice:
    """All degrees of freedom of a joint."""
    first = int(model.jnt_dofadr[joint])
    joints_of = np.flatnonzero(model.dof_jntid == joint)
    return slice(first, first + len(joints_of))


def _option_place(field: _Field, index: int) -> _Place:
    def get(one: Any) -> float:
        return float(np.atleast_1d(getattr(one.opt, field.array))[index])

    def put(one: Any, value: float) -> None:
        if field.size > 1:
            getattr(one.opt, field.array)[index] = value
        else:
            setattr(one.opt, field.array, value)

    return _Place(get, put)


def _servo_place(field_name: str, number: int) -> _Place:
    """A servo's gain on position (kp) or damping on speed (kv), in its gain and its bias."""

    def get(one: Any) -> float:
        if field_name == "kp":
            return float(one.actuator_gainprm[number, 0])
        return float(-one.actuator_biasprm[number, 2])

    def put(one: Any, value: float) -> None:
        if field_name == "kp":
            one.actuator_gainprm[number, 0] = value
            if one.actuator_biasprm[number, 1]:
                one.actuator_biasprm[number, 1] = -value
        else:
            if not one.actuator_biasprm[number, 1] and one.actuator_biasprm[number, 2]:
                one.actuator_gainprm[number, 0] = value  # a servo of speed alone
            one.actuator_biasprm[number, 2] = -value

    return _Place(get, put)


def _mass_put(number: int) -> Callable[[Any, float], None]:
    """A body's mass, and its moments of inertia with it: its shape stays as it is."""

    def put(one: Any, value: float) -> None:
        if one.body_mass[number] > 0:
            one.body_inertia[number] *= value / one.body_mass[number]
        one.body_mass[number] = value

    return put


def _range(text: str, match: re.Match[str]) -> tuple[float, float] | None:
    """The range that a text names; None where it names none."""
    if match["low"] is None:
        return None
    try:
        low, high = float(match["low"]), float(match["high"])
    except ValueError:
        low = high = math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UsageError(f"--tune {short_name(text)}: the range is no LOW:HIGH", "such as =0:5")
    return low, high


def _usual_range(text: str, field: _Field, now: float) -> tuple[float, float]:
    """Where to look for a parameter of which the model alone says what it may be."""
    if field.usual is not None and field.usual[0] <= now <= field.usual[1]:
        return field.usual
    if not now:
        raise UsageError(
            f"--tune {short_name(text)}: is 0 in the model, which tells no range",
            "add it, such as =0:1",
        )
    ends = (now / 5, now * 5) if now > 0 else (now * 5, now / 5)
    return (max(ends[0], field.least), ends[1])


def _check_inside(text: str, parameter: Parameter) -> None:
    (low, high), (least, most) = parameter.training_range, parameter.bounds
    if low < least or high > most:
        raise UsageError(
            f"--tune {short_name(text)}: no {parameter.name} is below {least:g} or over {most:g}",
            "choose a range inside",
        )


def _nothing(model: Any, value: float) -> None:
    """Of the model, nothing changes."""
