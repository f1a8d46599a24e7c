"""Tunable parameters of a user's MuJoCo model: `joint/elbow.damping`, `option.gravity[2]`.

An address is looked up in the compiled model, and set there: no file is written, and a model is
compiled once. The search range is the user's, or one about the model's value.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from operator import attrgetter
from typing import Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.servo import (
    ACTUATORS,
    NO_LIMIT,
    TERMS,
    ServoTerm,
    all_terms,
    expected,
    search_range,
    table_of,
    torque_limit,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import listed, short_name

# ---- Fields: what can be tuned, by kind of element

Limits = tuple[float, float]

_MIN_SPREAD_M = 1e-5  # of a mass along an axis, so that an inertia is one of a body with a volume
_MIN_VALUE = 1e-9  # where the sign selects a law: 0 belongs to neither


@dataclass(frozen=True)
class ModelField:
    """A tunable quantity of one kind of element."""

    # Of the compiled model, by the element's number or that of its first degree of freedom.
    array: str
    unit: str  # of its values, in SI
    least: float = 0.0  # smallest value that physics allows
    size: int = 1  # values of one element; 1 for a scalar
    by_dof: bool = False  # whether the array is by degree of freedom
    usual: Limits | None = None  # search range, if it holds the value; else a fifth to 5 times it
    within: Mapping[int, Limits] = field(default_factory=dict[int, Limits])  # bounds by index
    laws: tuple[tuple[str, str], ...] = ()  # by index: what it is above 0, and below


_NO_BOUND = -math.inf

# Without an array: what a sensor adds to what it measures, or multiplies it by.
_WRENCH = {
    "force_offset": ModelField("", "N", _NO_BOUND, 3, usual=(-20.0, 20.0)),
    "torque_offset": ModelField("", "N·m", _NO_BOUND, 3, usual=(-2.0, 2.0)),
}

FIELDS: Mapping[str, Mapping[str, ModelField]] = {
    "joint": {
        "damping": ModelField("dof_damping", "N·m·s/rad", by_dof=True),
        "frictionloss": ModelField("dof_frictionloss", "N·m", by_dof=True),
        "armature": ModelField("dof_armature", "kg·m²", by_dof=True),
        "stiffness": ModelField("jnt_stiffness", "N·m/rad"),
        "springref": ModelField("qpos_spring", "rad", _NO_BOUND),
        "effort_gain": ModelField("", "1", usual=(0.5, 2.0)),
        "effort_offset": ModelField("", "N·m", _NO_BOUND, usual=(-2.0, 2.0)),
    },
    "body": {
        "mass": ModelField("body_mass", "kg", 1e-6),
        "ipos": ModelField("body_ipos", "m", _NO_BOUND, 3),
        "inertia": ModelField("body_inertia", "kg·m²", 1e-9, 3),
        "spread": ModelField(
            "body_inertia", "m", _NO_BOUND, 6, within=dict.fromkeys(range(3), (_MIN_SPREAD_M, 1e3))
        ),
        **_WRENCH,
    },
    "site": _WRENCH,
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
        "forcerange": ModelField("actuator_forcerange", "N·m", 1e-6),
    },
    "servo": {
        one.field: ModelField("numeric_data" if one.slot >= 0 else "", one.unit)
        for one in TERMS
        if one.address.startswith("servo/")
    },
    "tendon": {
        "damping": ModelField("tendon_damping", "N·s/m"),
        "frictionloss": ModelField("tendon_frictionloss", "N"),
        "stiffness": ModelField("tendon_stiffness", "N/m"),
    },
    "option": {
        "gravity": ModelField("opt.gravity", "m/s²", _NO_BOUND, 3),
        "density": ModelField("opt.density", "kg/m³"),
        "viscosity": ModelField("opt.viscosity", "Pa·s"),
    },
}

# All arrays that a parameter may change in a compiled model.
TUNED_ARRAYS = sorted({one.array for fields in FIELDS.values() for one in fields.values()} - {""})
TUNED_ARRAYS = sorted({*TUNED_ARRAYS, "body_iquat"})  # with the inertia of a spread

# Units of a joint that slides, in place of those of one that turns.
_SLIDING_UNITS = {"N·m·s/rad": "N·s/m", "N·m": "N", "kg·m²": "kg", "N·m/rad": "N/m", "rad": "m"}


# ---- Addresses: found in a model, and set there

# The delay from a command to its effect, and by address those of what some sensors measure against
# the joints' positions: the simulator's parameters, not the model's.
DELAY = "delay/commands"
DELAYED: Mapping[str, tuple[str, ...]] = {
    "delay/efforts": ("jointactuatorfrc",),
    "delay/poses": ("framepos", "framexaxis", "framezaxis"),
    "delay/wrenches": ("force", "torque"),
}
_DELAY = ModelField("", "s", usual=(0.0, 0.2), within={0: (0.0, 1.0)})
_LOOKS = 201  # at a delay of a sensor: a millisecond apart in the usual range
_LATE = replace(_DELAY, within={0: (-1.0, 1.0)})  # where the joints are late, it is early

_ADDRESS = re.compile(
    r"(?P<kind>[a-z]+)(?:/(?P<name>.+))?\.(?P<field>[a-z_]+)(?:\[(?P<index>\d{1,9})\])?", re.DOTALL
)
_RANGE = re.compile(r"(?P<address>.*?)(?:=(?P<low>[^:=]+):(?P<high>[^:=]+))?", re.DOTALL)
# An address followed by something else than a range.
_NO_RANGE = re.compile(r".+\.[a-z_]+(\[\d+\])?\s*=[^/\]]*", re.DOTALL)

_MAX_NAMES = 8  # names that an error lists

# Joint types, mjJNT_FREE and mjJNT_BALL, whose position is not one number.
MANY_SIDED = (0, 1)


@dataclass(frozen=True, eq=False)
class ModelParameter:
    """A tunable scalar of a compiled model."""

    parameter: Parameter  # its name is the address, its training range the search range
    put: Callable[[Any, float], None]  # sets it in a model that `movable` returned
    field: str  # its field, e.g. "damping".
    owner: str  # kind and name of the element, e.g. "joint/elbow".
    given: float = 0.0  # its value in the model

    @property
    def is_of_sensor(self) -> bool:
        """Whether it is of a sensor, and nothing of the model."""
        kind = self.owner.partition("/")[0]
        known = FIELDS.get(kind, {}).get(self.field)
        is_added = kind != "servo" and known is not None and not known.array
        return is_added or self.owner in DELAYED


def model_parameters(model: Any, wanted: Iterable[str]) -> tuple[ModelParameter, ...]:
    """Parse texts such as `joint/elbow.damping=0:5` into a model's parameters."""
    texts = [part for text in wanted for part in _of_group(model, text)]
    found: list[ModelParameter] = []
    for text in texts:
        if text.strip() == ACTUATORS:
            found += _of_servos(model)
        else:
            found.append(_parsed_parameter(model, text))
    names = [one.parameter.name for one in found]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"--tune {short_name(name)} is named twice", "leave one out")
    for one in found:
        if one.field == "solref":
            # Check that a solref keeps one law: MuJoCo takes mixed signs for its default.
            address, number = one.parameter.name, 1 - int(one.parameter.name[-2])
            partner = f"{one.owner}.solref[{number}]"
            known = {other.parameter.name: other.parameter.initial for other in found}
            of_model = float(model.geom(one.owner.partition("/")[2]).solref[number])
            value = known.get(partner, of_model)
            if (value > 0) != (one.parameter.initial > 0):
                raise UsageError(
                    f"--tune {short_name(address)}: {short_name(partner)} is {value:g}, and MuJoCo "
                    "ignores a solref of two signs",
                    "choose a range of its sign, or give that one a range of this sign",
                )
    return tuple(sorted(found, key=lambda one: one.field == "inertia"))  # masses scale inertias


def _of_servos(model: Any) -> list[ModelParameter]:
    """Return all terms of all servos, with what others of their size have."""
    terms = all_terms(model)
    if not terms:
        raise UsageError(
            f"--tune {ACTUATORS}: the model has no <position> actuator with a name, on a joint "
            "with one",
            "add one, or name parameters one by one, such as --tune joint/NAME.damping=0:5",
        )
    found: list[ModelParameter] = []
    for address, (term, actuator) in terms.items():
        low, high = search_range(term, expected(model, term, actuator), _given(model, address))
        one = _parsed_parameter(model, f"{address}={low!r}:{high!r}")
        found.append(of_servo(model, one, term, actuator))
    return found


def _given(model: Any, address: str) -> float:
    """Return a term's value in the model; 0 of what a model lacks."""
    kind, _, rest = address.partition("/")
    name, _, field = rest.rpartition(".")
    if kind not in ("joint", "actuator"):
        return 0.0
    number = element_names(model, kind).index(name)
    get, _ = _access(model, kind, field, FIELDS[kind][field], number, 0)
    return get(model)


def of_servo(model: Any, one: ModelParameter, term: ServoTerm, actuator: int) -> ModelParameter:
    """Give a parameter what is usual of servos, from which it starts where the model has none."""
    usual = expected(model, term, actuator)
    initial = one.given if one.given or usual is None or not term.is_base else usual[0]
    initial = min(max(initial, one.parameter.training_range[0]), one.parameter.training_range[1])
    return replace(one, parameter=replace(one.parameter, usual=usual, initial=initial))


INERTIAL = ".inertial"  # of a body: mass, centre and spread, of which any values are physical


def _of_group(model: Any, text: str) -> list[str]:
    """Return the parameters of `body/NAME.inertial`, with ranges; any other text as it is."""
    address, sign, _ = text.strip().partition("=")
    owner = address.strip().removesuffix(INERTIAL)
    kind, _, name = owner.partition("/")
    if not address.strip().endswith(INERTIAL) or kind != "body":
        return [text]
    if sign:
        raise UsageError(
            f"--tune {short_name(text)}: a group has no range",
            f"leave it out, or name its parts, such as {owner}.mass=LOW:HIGH",
        )
    number = _number(model, "body", name, text)
    factor, centre = _spread(model, number), model.body_ipos[number]
    reach = float(np.abs(factor).max()) + float(np.linalg.norm(centre))
    ranges: dict[str, tuple[float, float]] = {}
    for axis in range(3):
        own = float(centre[axis])
        ranges[f"ipos[{axis}]"] = own - 2 * reach, own + 2 * reach
    for index, at in _FACTOR:
        own = float(factor[at])
        is_along = at[0] == at[1]
        low, high = (own / 5, 5 * own) if is_along else (own - reach, own + reach)
        ranges[f"spread[{index}]"] = max(low, _MIN_SPREAD_M) if is_along else low, high
    parts = (f"{owner}.{part}={low!r}:{high!r}" for part, (low, high) in ranges.items())
    return [f"{owner}.mass", *parts]


def _parsed_parameter(model: Any, text: str) -> ModelParameter:
    match = _RANGE.fullmatch(text.strip())
    assert match is not None
    address = match["address"].strip()
    if address.partition("/")[0] == "servo":
        return _servo_parameter(model, text, match, address)
    if address == DELAY or address in DELAYED:
        delay = _parameter(text, match, address, _LATE if address in DELAYED else _DELAY, 0, 0.0)
        if address == DELAY:
            delay = replace(delay, initial=sum(delay.training_range) / 2)
        else:  # efforts jump with each command, so that a command later they look alike
            delay = replace(delay, looks=_LOOKS)
        return ModelParameter(delay, lambda _model, _value: None, "delay", address)
    parts = _ADDRESS.fullmatch(address)
    if parts is None and _NO_RANGE.fullmatch(address):
        raise UsageError(f"--tune {short_name(text)}: the range is no LOW:HIGH", "such as =0:5")
    if parts is None or parts["kind"] not in FIELDS:
        kinds = ", ".join(FIELDS)
        raise UsageError(
            f"--tune {short_name(text)} names no parameter",
            f"write KIND/NAME.FIELD with one of {kinds}, such as joint/elbow.damping=0:5, or "
            f"{listed([DELAY, *DELAYED])}",
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
    get, put = _access(model, kind, field_name, field, number, index)
    owner = kind if parts["name"] is None else f"{kind}/{parts['name']}"
    address = f"{owner}.{field_name}" + (f"[{index}]" if field.size > 1 else "")
    if kind == "joint" and model.jnt_type[number] == mujoco().mjtJoint.mjJNT_SLIDE:
        field = replace(field, unit=_SLIDING_UNITS.get(field.unit, field.unit))
    now = float(get(model))
    parameter = _parameter(text, match, address, field, index, now)
    return ModelParameter(parameter, put, field_name, owner, now)


def _servo_parameter(model: Any, text: str, match: re.Match[str], address: str) -> ModelParameter:
    """Make the parameter of a servo's term that MuJoCo lacks."""
    terms = all_terms(model)
    if address not in terms or not address.startswith("servo/"):
        own = [one for one in terms if one.startswith("servo/")]
        near = get_close_matches(address, own, _MAX_NAMES, 0.5) or own
        raise UsageError(
            f"--tune {short_name(text)} names no part of a servo",
            f"nearest: {listed(near, _MAX_NAMES)}" if near else "give a <position> a name",
        )
    term, actuator = terms[address]
    low, high = search_range(term, expected(model, term, actuator), 0.0)
    # What turns back to the other side has no least value.
    least = -math.pi if term.field == "zero" else 0.0
    field = ModelField("", term.unit, usual=(low, high), within={0: (least, 1e9)})
    parameter = _parameter(text, match, address, field, 0, 0.0)

    def put(one: Any, value: float) -> None:
        table = table_of(one)
        if table is not None and term.slot >= 0:
            table[actuator, term.slot] = value

    return ModelParameter(parameter, put, term.field, address.rpartition(".")[0])


def _parameter(
    text: str, match: re.Match[str], address: str, field: ModelField, index: int, now: float
) -> Parameter:
    """Make the parameter with the user's range, else one about the value `now`."""
    least, most = field.within.get(index, (max(field.least, -1e9), 1e9))
    what = f"--tune {short_name(text)}"
    if match["low"] is None and field.usual and field.usual[0] <= now <= field.usual[1]:
        low, high = field.usual
    elif match["low"] is None:
        if not now or not least <= now <= most:
            raise UsageError(
                f"{what}: is {now:g} in the model, which tells no range", "add it, such as =0:1"
            )
        low, high = max(min(now / 5, now * 5), least), min(max(now / 5, now * 5), most)
    else:
        try:
            low, high = float(match["low"]), float(match["high"])
        except ValueError:
            low = high = math.nan
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise UsageError(f"{what}: the range is no LOW:HIGH", "such as =0:5")
    if field.laws:  # the sign selects one
        if low <= 0 <= high:
            above, below = field.laws[index]
            raise UsageError(
                f"{what}: above 0 it is {above}, below 0 {below}: two laws",
                "choose a range that ends before 0",
            )
        least, most = (_MIN_VALUE, most) if low > 0 else (least, -_MIN_VALUE)
    if low < least or high > most:
        raise UsageError(
            f"{what}: no {address} is below {least:g} or over {most:g}", "choose a range inside"
        )
    unit = field.unit
    return Parameter(address, unit, (least, most), (low, high), min(max(now, low), high))


def movable(spec: Any, tuned: Iterable[ModelParameter]) -> Any:
    """Copy a model spec so that tuned centres of mass may move, and actuators have limits.

    A body whose centre of mass is at its origin may be compiled as a simple one, which has to stay
    one.
    """
    copy = spec.copy()
    for one in tuned:
        name = one.owner.partition("/")[2]
        if one.field in ("ipos", "spread"):
            copy.body(name).simple = False
        elif one.field == "forcerange":
            actuator = copy.actuator(name)
            if not actuator.forcerange[0] < actuator.forcerange[1]:
                actuator.forcerange = [-NO_LIMIT, NO_LIMIT]
            actuator.forcelimited = True
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
    count = getattr(model, {"joint": "njnt", "actuator": "nu"}.get(kind, f"n{kind}"))
    return [getattr(model, kind)(number).name for number in range(count)]


_Access = tuple[Callable[[Any], float], Callable[[Any, float], None]]  # a getter and a setter


def _access(
    model: Any, kind: str, field_name: str, field: ModelField, number: int, index: int
) -> _Access:
    """Make a getter and a setter of a scalar in a compiled model."""
    if kind == "actuator" and field_name == "forcerange":
        return _limit_access(number)
    if kind == "actuator" and field_name in ("kp", "kv"):
        return _servo_access(model, field_name, number)
    if field_name == "spread":
        return _spread_access(number, index)
    if not field.array:  # of a sensor
        return lambda _: float(field_name.endswith("_gain")), lambda _model, _value: None
    rows = slice(number, number + 1)
    if field.by_dof:
        rows = slice(*np.flatnonzero(model.dof_jntid == number)[[0, -1]] + [0, 1])
    elif field.array == "qpos_spring":
        first = int(model.jnt_qposadr[number])
        rows = slice(first, first + 1)
    elif kind == "option":
        rows = slice(index, index + 1)

    def view(one: Any) -> Array:
        array = np.atleast_1d(attrgetter(field.array)(one))
        return array[rows] if array.ndim == 1 else array[rows, index]

    def put(one: Any, value: float) -> None:
        if kind == "option" and field.size == 1:  # a number of its own, and no array
            setattr(one.opt, field.array.removeprefix("opt."), value)
        else:
            if field_name == "mass" and one.body_mass[number] > 0:  # its shape stays as it is
                one.body_inertia[number] *= value / one.body_mass[number]
            view(one)[:] = value

    return lambda one: float(view(one)[0]), put


def _limit_access(number: int) -> _Access:
    """Access an actuator's force limit, the same to both sides."""

    def get(one: Any) -> float:
        return torque_limit(one, number)

    def put(one: Any, value: float) -> None:
        one.actuator_forcerange[number] = -value, value
        one.actuator_forcelimited[number] = True

    return get, put


# Places of `spread` in a factor: its diagonal, then what is below.
_FACTOR = tuple(enumerate([(0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1)]))


def _spread(model: Any, number: int) -> Array:
    """Return how a body's mass is spread about its centre: a Cholesky factor, shape (3, 3) [m].

    Its square is the mean of x xᵀ over the mass, in the body's frame. With mass and centre it is
    the pseudo-inertia (Wensing et al. 2018): any factor is one of a body that can be.
    """
    turn = np.empty(9)
    mujoco().mju_quat2Mat(turn, model.body_iquat[number])
    axes, inertia = turn.reshape(3, 3), model.body_inertia[number]
    squares = (inertia.sum() / 2 - inertia) / max(float(model.body_mass[number]), 1e-12)
    squares = np.maximum(squares, _MIN_SPREAD_M**2)
    factor = np.linalg.cholesky(axes @ np.diag(squares) @ axes.T)
    return np.asarray(factor, np.float64)


def _spread_access(number: int, index: int) -> _Access:
    """Access a number of a body's spread, in its inertia and the axes of that."""
    place = _FACTOR[index][1]

    def put(one: Any, value: float) -> None:
        factor = _spread(one, number)
        factor[place] = value
        square = factor @ factor.T
        whole = one.body_mass[number] * (np.trace(square) * np.eye(3) - square)
        sizes, axes = np.linalg.eigh(whole)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        one.body_inertia[number] = sizes
        mujoco().mju_mat2Quat(one.body_iquat[number], np.ascontiguousarray(axes).ravel())

    return lambda one: float(_spread(one, number)[place]), put


def _servo_access(model: Any, field_name: str, number: int) -> _Access:
    """Access a servo's position gain (kp) or damping (kv), in its gain and its bias."""
    _, on_position, on_speed = model.actuator_biasprm[number, :3]

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
            if on_speed and not on_position:
                one.actuator_gainprm[number, 0] = value
            one.actuator_biasprm[number, 2] = -value

    return get, put


def _check_matters(model: Any, kind: str, field_name: str, number: int, text: str) -> None:
    """Check that anything depends on the field of this element."""
    why = remedy = ""
    if kind == "body" and model.body_weldid[number] == 0:
        why, remedy = "that body cannot move", "name one with a joint, or of one with a joint"
    elif kind == "geom" and not (model.geom_contype[number] or model.geom_conaffinity[number]):
        why, remedy = "that geom touches nothing", "name one with a contype or a conaffinity"
    elif field_name == "springref" and model.jnt_type[number] in MANY_SIDED:
        why, remedy = "that joint has no single position", "name one that slides or turns"
    elif field_name in ("kp", "kv"):
        _, on_position, on_speed = model.actuator_biasprm[number, :3]
        has_gain = model.actuator_gaintype[number] == mujoco().mjtGain.mjGAIN_FIXED
        has_bias = model.actuator_biastype[number] == mujoco().mjtBias.mjBIAS_AFFINE
        if field_name == "kp" and has_gain and has_bias and on_speed and not on_position:
            why, remedy = "that actuator holds a speed and has no kp", "write kv"
        elif not has_gain or (field_name == "kv" and not has_bias):
            why = f"that actuator has no {field_name}"
            remedy = "name a position or velocity actuator"
    if why:
        raise UsageError(f"--tune {short_name(text)}: {why}", remedy)
