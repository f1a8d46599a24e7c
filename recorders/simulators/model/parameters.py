"""Tunable parameters of a user's MuJoCo model: `joint/elbow.damping`, `option.gravity[2]`.

An address is looked up in the compiled model, and set there: no file is written, and a model is
compiled once. The search range is the user's, or one about the model's value.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import listed, short_name

# ---- Fields: what can be tuned, by kind of element

Limits = tuple[float, float]

_MAX_VALUE = 1e9
_MIN_VALUE = 1e-9  # where the sign selects a law: 0 belongs to neither


@dataclass(frozen=True)
class ModelField:
    """A tunable quantity of one kind of element.

    Attributes:
        array: of the compiled model, by the element's number or that of its first degree of
            freedom.
        unit: of its values, in SI.
        least: smallest value that physics allows.
        size: values of one element; 1 for a scalar.
        by_dof: whether the array is by degree of freedom.
        usual: search range, if the model's value is in it; else a fifth to five times that.
        within: smallest and largest value by index, where they differ.
        laws: by index, the quantity's meaning above 0, and below, where these differ; empty where
            they do not.
    """

    array: str
    unit: str
    least: float = 0.0
    size: int = 1
    by_dof: bool = False
    usual: Limits | None = None
    within: Mapping[int, Limits] = field(default_factory=dict[int, Limits])
    laws: tuple[tuple[str, str], ...] = ()

    def bounds(self, index: int) -> Limits:
        """Return the bounds of the value at an index."""
        return self.within.get(index, (max(self.least, -_MAX_VALUE), _MAX_VALUE))


_NO_BOUND = -math.inf

FIELDS: Mapping[str, Mapping[str, ModelField]] = {
    "joint": {
        "damping": ModelField("dof_damping", "N·m·s/rad", by_dof=True),
        "frictionloss": ModelField("dof_frictionloss", "N·m", by_dof=True),
        "armature": ModelField("dof_armature", "kg·m²", by_dof=True),
        "stiffness": ModelField("jnt_stiffness", "N·m/rad"),
        "springref": ModelField("qpos_spring", "rad", _NO_BOUND),
    },
    "body": {
        "mass": ModelField("body_mass", "kg", 1e-6),
        "ipos": ModelField("body_ipos", "m", _NO_BOUND, 3),
        "inertia": ModelField("body_inertia", "kg·m²", 1e-9, 3),
    },
    "geom": {
        "friction": ModelField("geom_friction", "1", 0.0, 3, usual=(0.0, 1.5)),
        "solref": ModelField(
            "geom_solref",
            "1",
            _NO_BOUND,
            2,
            laws=(("a time constant", "a stiffness"), ("a damping ratio", "a damping")),
        ),
        "solimp": ModelField(
            "geom_solimp",
            "1",
            0.0,
            5,
            within={0: (0.0, 1.0), 1: (0.0, 1.0), 3: (0.0, 1.0), 4: (1.0, 100.0)},
        ),
    },
    "actuator": {
        "kp": ModelField("actuator_gainprm", "1"),
        "kv": ModelField("actuator_biasprm", "1"),
        "gear": ModelField("actuator_gear", "1", _NO_BOUND, 6),
    },
    "tendon": {
        "damping": ModelField("tendon_damping", "N·s/m"),
        "frictionloss": ModelField("tendon_frictionloss", "N"),
        "stiffness": ModelField("tendon_stiffness", "N/m"),
    },
    "option": {
        "gravity": ModelField("gravity", "m/s²", _NO_BOUND, 3),
        "density": ModelField("density", "kg/m³"),
        "viscosity": ModelField("viscosity", "Pa·s"),
    },
}

# All arrays that a parameter may change in a compiled model.
TUNED_ARRAYS = sorted(
    {
        f"opt.{one.array}" if kind == "option" else one.array
        for kind, fields in FIELDS.items()
        for one in fields.values()
    }
)

# Units of a joint that slides, in place of those of one that turns.
_SLIDING_UNITS = {
    "N·m·s/rad": "N·s/m",
    "N·m": "N",
    "kg·m²": "kg",
    "N·m/rad": "N/m",
    "rad": "m",
}


# ---- Search ranges


def told_range(text: str, low: str, high: str) -> Limits:
    """Parse the user's range.

    Raises:
        UsageError: its ends are no numbers, or not in their order; `text` stands first.
    """
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = math.nan, math.nan
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and ends[0] < ends[1]):
        raise UsageError(f"--tune {short_name(text)}: the range is no LOW:HIGH", "such as =0:5")
    return ends


def usual_range(text: str, field: ModelField, now: float, bounds: Limits) -> Limits:
    """Choose a search range by the model's value `now`.

    Raises:
        UsageError: the value implies no range; `text` stands first.
    """
    if field.usual is not None and field.usual[0] <= now <= field.usual[1]:
        return field.usual
    if not now or not bounds[0] <= now <= bounds[1]:
        raise UsageError(
            f"--tune {short_name(text)}: is {now:g} in the model, which tells no range",
            "add it, such as =0:1",
        )
    ends = (now / 5, now * 5) if now > 0 else (now * 5, now / 5)
    return (max(ends[0], bounds[0]), min(ends[1], bounds[1]))


def one_sided(text: str, laws: tuple[str, str], span: Limits, bounds: Limits) -> Limits:
    """Restrict bounds to the range's side of 0, where the sign selects the law.

    Args:
        text: as the user wrote it.
        laws: the quantity's meaning above 0, and below.
        span: the range.
        bounds: of the value on both sides.

    Raises:
        UsageError: the range reaches 0.
    """
    if span[0] > 0:
        return (_MIN_VALUE, bounds[1])
    if span[1] < 0:
        return (bounds[0], -_MIN_VALUE)
    raise UsageError(
        f"--tune {short_name(text)}: above 0 it is {laws[0]}, below 0 {laws[1]}: two laws",
        "choose a range that ends before 0",
    )


def check_inside(text: str, parameter: Parameter) -> None:
    """Check that a search range is within physical bounds.

    Raises:
        UsageError: it reaches beyond them; `text` stands first.
    """
    (low, high), (least, most) = parameter.training_range, parameter.bounds
    if low < least or high > most:
        raise UsageError(
            f"--tune {short_name(text)}: no {parameter.name} is below {least:g} or over {most:g}",
            "choose a range inside",
        )


# ---- Addresses: found in a model, and set there

# The delay from a command to its effect: the simulator's parameter, not the model's.
DELAY = "delay/commands"

_ADDRESS = re.compile(
    r"(?P<kind>[a-z]+)(?:/(?P<name>.+))?\.(?P<field>[a-z_]+)(?:\[(?P<index>\d{1,9})\])?", re.DOTALL
)
_RANGE = re.compile(r"(?P<address>.*?)(?:=(?P<low>[^:=]+):(?P<high>[^:=]+))?", re.DOTALL)
# An address followed by something else than a range.
_NO_RANGE = re.compile(r".+\.[a-z_]+(\[\d+\])?\s*=[^/\]]*", re.DOTALL)

_MAX_DELAY_S = 1.0
_MAX_NAMES = 8  # names that an error lists

# Joint types, mjJNT_FREE and mjJNT_BALL, whose position is not one number.
_MANY_SIDED = (0, 1)


@dataclass(frozen=True, eq=False)
class ModelParameter:
    """A tunable scalar of a compiled model.

    Attributes:
        parameter: its name is the address, its training range the search range.
        put: sets the value in a compiled model, with all that follows but `mj_setConst`'s; the
            model is one that `movable` returned.
        field: its field, e.g. "damping".
        owner: kind and name of the element, e.g. "joint/elbow".
    """

    parameter: Parameter
    put: Callable[[Any, float], None]
    field: str
    owner: str


def model_parameters(model: Any, wanted: Iterable[str]) -> tuple[ModelParameter, ...]:
    """Parse texts such as `joint/elbow.damping=0:5` into a model's parameters.

    Raises:
        UsageError: no such element or field, or no range; lists the nearest.
    """
    found = [_parsed_parameter(model, text) for text in wanted]
    names = [one.parameter.name for one in found]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"--tune {short_name(name)} is named twice", "leave one out")
    for one in found:
        if one.field == "solref":
            _check_solref(model, one, found)
    return tuple(sorted(found, key=lambda one: one.field == "inertia"))  # masses scale inertias


def _parsed_parameter(model: Any, text: str) -> ModelParameter:
    match = _RANGE.fullmatch(text.strip())
    assert match is not None
    address = match["address"].strip()
    if address == DELAY:
        low, high = _told(text, match) or (0.0, 0.2)
        initial = (low + high) / 2
        delay = Parameter(DELAY, "s", (0.0, _MAX_DELAY_S), (low, high), initial)
        check_inside(text, delay)
        return ModelParameter(delay, _nothing, "delay", DELAY)
    parts = _ADDRESS.fullmatch(address)
    if parts is None and _NO_RANGE.fullmatch(address):
        raise UsageError(f"--tune {short_name(text)}: the range is no LOW:HIGH", "such as =0:5")
    if parts is None or parts["kind"] not in FIELDS:
        kinds = ", ".join(FIELDS)
        raise UsageError(
            f"--tune {short_name(text)} names no parameter",
            f"write KIND/NAME.FIELD with one of {kinds}, such as joint/elbow.damping=0:5, or "
            f"{DELAY}",
        )
    kind, field_name = parts["kind"], parts["field"]
    if field_name not in FIELDS[kind]:
        raise UsageError(
            f"--tune {short_name(text)}: a {kind} has no {short_name(field_name)}",
            f"there is: {', '.join(FIELDS[kind])}",
        )
    field = FIELDS[kind][field_name]
    number = _number(model, kind, parts["name"], text)
    index = int(parts["index"] or 0)
    if index >= field.size or (parts["index"] is None and field.size > 1):
        last = field.size - 1
        remedy = f"write {field_name}[0]" if field.size > 1 else "leave the brackets out"
        remedy += f" to {field_name}[{last}]" if field.size > 1 else ""
        what = f"--tune {short_name(text)}: {field_name} has {field.size} numbers"
        raise UsageError(what if field.size > 1 else f"{what[:-1]}", remedy)
    _check_matters(model, kind, field_name, number, text)
    place = _place(model, kind, field_name, field, number, index)
    owner = kind if parts["name"] is None else f"{kind}/{parts['name']}"
    address = f"{owner}.{field_name}" + (f"[{index}]" if field.size > 1 else "")
    unit = field.unit
    if kind == "joint" and model.jnt_type[number] == mujoco().mjtJoint.mjJNT_SLIDE:
        unit = _SLIDING_UNITS.get(unit, unit)
    now = float(place.get(model))
    bounds = field.bounds(index)
    low, high = _told(text, match) or usual_range(text, field, now, bounds)
    if field.laws:
        bounds = one_sided(text, field.laws[index], (low, high), bounds)
    parameter = Parameter(address, unit, bounds, (low, high), min(max(now, low), high))
    check_inside(text, parameter)
    return ModelParameter(parameter, place.put, field_name, owner)


def _told(text: str, match: re.Match[str]) -> tuple[float, float] | None:
    """Parse the range in a text; None where there is none."""
    return None if match["low"] is None else told_range(text, match["low"], match["high"])


def movable(spec: Any, tuned: Iterable[ModelParameter]) -> Any:
    """Copy a model spec so that tuned centres of mass may move.

    A body whose centre of mass is at its origin may be compiled as a simple one, which has to stay
    one.
    """
    copy = spec.copy()
    for one in tuned:
        if one.field == "ipos":
            copy.body(one.owner.partition("/")[2]).simple = False
    return copy


def _number(model: Any, kind: str, name: str | None, text: str) -> int:
    """Return the element's index in the model; 0 for the options, which are there once."""
    if kind == "option":
        if name is not None:
            raise UsageError(
                f"--tune {short_name(text)}: the options have no name", "write option.gravity[2]"
            )
        return 0
    names = element_names(model, kind)
    if name not in names:
        known = [one for one in names if one]
        near = get_close_matches(name or "", known, _MAX_NAMES, 0.5) or known
        remedy = f"nearest: {listed(near, _MAX_NAMES)}" if near else f"name the {kind} in the model"
        raise UsageError(f"--tune {short_name(text)}: the model has no such {kind}", remedy)
    return names.index(name)


def element_names(model: Any, kind: str) -> list[str]:
    """Return the names of all elements of a kind, by index; "" where unnamed."""
    counts = {
        "joint": "njnt",
        "body": "nbody",
        "geom": "ngeom",
        "site": "nsite",
        "actuator": "nu",
        "tendon": "ntendon",
    }
    accessor = getattr(model, kind)
    return [accessor(number).name for number in range(getattr(model, counts[kind]))]


@dataclass(frozen=True, eq=False)
class _Access:
    """Accessors of a scalar in a compiled model."""

    get: Callable[[Any], float]
    put: Callable[[Any, float], None]


def _place(
    model: Any, kind: str, field_name: str, field: ModelField, number: int, index: int
) -> _Access:
    if kind == "option":
        return _option_place(field, index)
    if kind == "actuator" and field_name in ("kp", "kv"):
        return _servo_place(model, field_name, number)
    if field_name == "mass":
        return _Access(lambda one: one.body_mass[number], _mass_put(number))
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

    return _Access(lambda one: float(view(one)[0]), put)


def _dofs(model: Any, joint: int) -> slice:
    """Return the slice of a joint's degrees of freedom."""
    first = int(model.jnt_dofadr[joint])
    joints_of = np.flatnonzero(model.dof_jntid == joint)
    return slice(first, first + len(joints_of))


def _option_place(field: ModelField, index: int) -> _Access:
    def get(one: Any) -> float:
        return float(np.atleast_1d(getattr(one.opt, field.array))[index])

    def put(one: Any, value: float) -> None:
        if field.size > 1:
            getattr(one.opt, field.array)[index] = value
        else:
            setattr(one.opt, field.array, value)

    return _Access(get, put)


def _servo_place(model: Any, field_name: str, number: int) -> _Access:
    """Access a servo's position gain (kp) or damping (kv), in its gain and its bias."""
    _, on_position, on_speed = model.actuator_biasprm[number, :3]
    is_of_speed = bool(on_speed and not on_position)

    def get(one: Any) -> float:
        if field_name == "kp":
            return float(one.actuator_gainprm[number, 0])
        return float(-one.actuator_biasprm[number, 2])

    def put(one: Any, value: float) -> None:
        if field_name == "kp":
            one.actuator_gainprm[number, 0] = value
            if on_position:
                one.actuator_biasprm[number, 1] = -value
        else:
            if is_of_speed:
                one.actuator_gainprm[number, 0] = value
            one.actuator_biasprm[number, 2] = -value

    return _Access(get, put)


def _check_matters(model: Any, kind: str, field_name: str, number: int, text: str) -> None:
    """Check that anything depends on the field of this element.

    Raises:
        UsageError: nothing does, or MuJoCo cannot change it.
    """
    why = remedy = ""
    if kind == "body" and model.body_weldid[number] == 0:
        why, remedy = "that body cannot move", "name one with a joint, or of one with a joint"
    elif kind == "geom" and not (model.geom_contype[number] or model.geom_conaffinity[number]):
        why, remedy = "that geom touches nothing", "name one with a contype or a conaffinity"
    elif field_name == "springref" and model.jnt_type[number] in _MANY_SIDED:
        why, remedy = "that joint has no single position", "name one that slides or turns"
    elif field_name in ("kp", "kv"):
        why, remedy = _no_servo(model, field_name, number)
    if why:
        raise UsageError(f"--tune {short_name(text)}: {why}", remedy)


def _no_servo(model: Any, field_name: str, number: int) -> tuple[str, str]:
    """Explain why an actuator lacks such a gain, with a remedy; two "" where it has one."""
    library = mujoco()
    _, on_position, on_speed = model.actuator_biasprm[number, :3]
    has_gain = model.actuator_gaintype[number] == library.mjtGain.mjGAIN_FIXED
    has_bias = model.actuator_biastype[number] == library.mjtBias.mjBIAS_AFFINE
    if field_name == "kp" and has_gain and has_bias and on_speed and not on_position:
        return "that actuator holds a speed and has no kp", "write kv"
    if not has_gain or (field_name == "kv" and not has_bias):
        return f"that actuator has no {field_name}", "name a position or velocity actuator"
    return "", ""


def _mass_put(number: int) -> Callable[[Any, float], None]:
    """Make a setter of a body's mass that scales its inertia: its shape stays as it is."""

    def put(one: Any, value: float) -> None:
        if one.body_mass[number] > 0:
            one.body_inertia[number] *= value / one.body_mass[number]
        one.body_mass[number] = value

    return put


def _check_solref(model: Any, tuned: ModelParameter, others: Iterable[ModelParameter]) -> None:
    """Check that a solref keeps one law: MuJoCo takes mixed signs for its default.

    Raises:
        UsageError: the other number, tuned or the model's, has another sign.
    """
    owner, address = tuned.owner, tuned.parameter.name
    number = 1 - int(address[-2])
    partner = f"{owner}.solref[{number}]"
    known = {one.parameter.name: one.parameter.initial for one in others}
    value = known.get(partner, float(model.geom(owner.partition("/")[2]).solref[number]))
    if (value > 0) != (tuned.parameter.initial > 0):
        raise UsageError(
            f"--tune {short_name(address)}: {short_name(partner)} is {value:g}, and MuJoCo ignores "
            "a solref of two signs",
            "choose a range of its sign, or give that one a range of this sign",
        )


def _nothing(model: Any, value: float) -> None:
    """Change nothing in the model."""
