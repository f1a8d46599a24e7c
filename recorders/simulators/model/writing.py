"""Write tuned numbers into a user's model: in its own text, where nothing else changes.

What a model inherits from a default class is written at the element itself. The edited text is
compiled again, and every array compared with the tuned model's: what MuJoCo would derive anew, such
as a servo's damping from its damping ratio, is written as it was, and a number that does not come
back is taken back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.child import put_array, set_constants
from tunenet_logs.recorders.simulators.model.parameters import (
    FIELDS,
    TUNED_ARRAYS,
    ModelParameter,
    element_names,
    movable,
)
from tunenet_logs.recorders.simulators.model.reading import ModelFiles, ModelProcess
from tunenet_logs.recorders.simulators.model.servo import unwritten
from tunenet_logs.recorders.simulators.model.text import (
    Element,
    ModelXml,
    number_text,
    own_elements,
    value_of,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import one_line

# ---- Writers: how a compiled number is written


class _Unwritable(Exception):  # noqa: N818 (a value, which is told)
    """A number cannot be written; why, in words."""


@dataclass(frozen=True, eq=False)
class _Place:
    """A field of one element, in the text and in both compiled models."""

    xml: ModelXml
    spec: Any  # of the model as its file has it
    given: Any  # compiled from that
    tuned: Any  # compiled, with the tuned numbers
    kind: str
    quantity: str  # its field, such as damping
    number: int  # index of the element in the compiled model
    index: int  # of the number in a vector
    notes: list[str] = field(default_factory=list[str])  # on how it is written

    @property
    def name(self) -> str:
        """Name of the element; "" where it has none."""
        return "" if self.kind == "option" else element_names(self.given, self.kind)[self.number]

    @cached_property
    def element(self) -> Element:
        """The element itself."""
        count = len(element_names(self.given, self.kind))
        found = self.xml.find(self.kind, self.name, self.number, count)
        if found is None:
            raise _Unwritable(
                f"no element of the file is this {self.kind}: MuJoCo makes it, by a <replicate>, "
                "<attach>, <composite> or <flexcomp>"
            )
        return found

    def numbers(self, array: str) -> Array:
        """Return the element's numbers in an array of the tuned model."""
        return np.atleast_1d(getattr(self.tuned, array)[self.number])


def _write_joint(place: _Place) -> Element:
    element, name = place.element, place.quantity
    if element.tag == "freejoint":
        raise _Unwritable(f'a <freejoint> has no {name}; write it as <joint type="free">')
    found = FIELDS["joint"][name]
    if found.by_dof:
        at = int(place.given.jnt_dofadr[place.number])
    else:
        at = int(place.given.jnt_qposadr[place.number]) if name == "springref" else place.number
    value = float(getattr(place.tuned, found.array)[at])
    hinge = place.given.jnt_type[place.number] == mujoco().mjtJoint.mjJNT_HINGE
    if name == "springref" and hinge and place.spec.compiler.degree:
        value = degrees_for(value)
    if name in ("damping", "stiffness"):
        of_spec = next(
            (one for one in place.spec.joints if one.name == place.name and place.name), None
        )
        if of_spec is not None and np.any(np.asarray(of_spec.springdamper)):
            # Both are derived from it: they stand for themselves from here on.
            element.set("springdamper", None if "springdamper" in element.spans else "0 0")
            at = int(place.given.jnt_dofadr[place.number])
            element.put("damping", [float(place.tuned.dof_damping[at])])
            element.put("stiffness", [float(place.tuned.jnt_stiffness[place.number])])
            return element
    _put_first(element, name, value)
    return element


def _put_first(element: Element, name: str, value: float) -> None:
    """Set the first number of an attribute; others, of a polynomial, stay."""
    words = element.values.get(name, "").split()
    element.put(name, [value, *map(value_of, words[1:])])


def degrees_for(radians: float) -> float:
    """Return the degrees that MuJoCo converts to these radians, or the nearest."""
    factor = math.pi / 180
    best = near = radians / factor
    for toward in (math.inf, -math.inf):
        tried = near
        for _ in range(4):
            if abs(tried * factor - radians) < abs(best * factor - radians):
                best = tried
            tried = math.nextafter(tried, toward)
    return best


def _write_body(place: _Place) -> Element:
    element = place.element
    before, now = float(place.given.body_mass[place.number]), float(place.numbers("body_mass")[0])
    share = now / before if before else 1.0
    if place.quantity == "mass":
        place.notes.append("its inertia with it")
    parts, inertial = _merged(place, element), element.child("inertial")
    if len(parts) > 1:
        if place.quantity != "mass":
            raise _Unwritable(
                "MuJoCo merges links that are fixed to it into it, and no single one has this value"
            )
        place.notes.append(f"with {len(parts) - 1} links that are fixed to it")
        for part in parts:
            if (own := part.child("inertial")) is not None:
                _scale_inertial(own, share, is_urdf=place.xml.is_urdf)
        return inertial or element
    if place.xml.is_urdf:
        if inertial is None:
            raise _Unwritable("that link has no <inertial>")
        _write_link(place, inertial, share)
        return inertial
    by_geoms = mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if place.spec.compiler.inertiafromgeom == by_geoms:
        if place.quantity != "mass":
            raise _Unwritable(
                'the compiler takes it from the geoms (inertiafromgeom="true"), which have no such '
                "number"
            )
        _scale_geoms(place, element, share)
        return element
    return _write_inertial(place, element, inertial)


def _write_inertial(place: _Place, element: Element, inertial: Element | None) -> Element:
    """Write mass, centre and inertia of an MJCF's body; return where a remark belongs."""
    if element.added:  # for another of its numbers
        return element
    turn = place.numbers("body_iquat")
    values = {"pos": place.numbers("body_ipos"), "mass": place.numbers("body_mass")}
    is_turned = not np.array_equal(turn, [1, 0, 0, 0])
    if inertial is None and is_turned:
        values["quat"] = turn
    elif inertial is not None and "fullinertia" in inertial.values:
        place.notes.append("the inertia by its axes, which MuJoCo takes it to")
        inertial.set("fullinertia", None)
        values["quat"] = turn
    elif inertial is not None and not np.array_equal(turn, place.given.body_iquat[place.number]):
        for name in ("euler", "axisangle", "xyaxes", "zaxis"):
            inertial.set(name, None)
        values["quat"] = turn
    values["diaginertia"] = place.numbers("body_inertia")
    if inertial is None:
        place.notes.append("until now by its geoms")
        element.added["inertial"] = {
            name: " ".join(map(number_text, numbers)) for name, numbers in values.items()
        }
        return element
    for name, numbers in values.items():
        inertial.put(name, numbers.tolist(), len(numbers))
    return inertial


def _merged(place: _Place, element: Element) -> list[Element]:
    """List a body's element and those of bodies that MuJoCo merges into it."""
    known = set(element_names(place.given, "body"))
    found = [element]
    if not place.spec.compiler.fusestatic:
        return found
    if not place.xml.is_urdf:
        for one in found:
            found += [
                body
                for body in one.children
                if body.tag == "body"
                and body.values.get("name", "") not in known
                and body.child("joint", "freejoint") is None
            ]
        return found
    links = {one.values.get("name", ""): one for one in place.xml.elements("body")}
    for one in found:
        for joint in place.xml.elements("joint"):
            ends = [end.values.get("link") for end in map(joint.child, ("parent", "child")) if end]
            if len(ends) == 2 and ends[0] == one.values.get("name") and ends[1] not in known:
                found += [
                    link for link in (links.get(ends[1] or ""),) if link not in (None, *found)
                ]
    return found


def _scale_inertial(inertial: Element, share: float, *, is_urdf: bool) -> None:
    """Multiply mass and inertia of an <inertial> by a share."""
    if is_urdf:
        owners = [(inertial.child("mass"), ("value",))]
        owners += [(inertial.child("inertia"), ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))]
    else:
        owners = [(inertial, ("mass", "diaginertia", "fullinertia"))]
    for owner, names in owners:
        for name in names:
            if owner is not None and name in owner.values:
                owner.put(name, [share * value_of(one) for one in owner.given[name].split()])


def _scale_geoms(place: _Place, element: Element, share: float) -> None:
    """Multiply the masses of a body's geoms by a share."""
    body = next((one for one in place.spec.bodies if one.name == place.name), None)
    geoms = [one for one in own_elements(element) if one.tag == "geom"]
    if body is None or len(geoms) != len(body.geoms):
        raise _Unwritable("the compiler takes it from geoms that MuJoCo makes of others")
    place.notes.append("in each of its geoms")
    for geom, of_spec in zip(geoms, body.geoms, strict=True):
        has_mass = math.isfinite(of_spec.mass)
        name, value = ("mass", of_spec.mass) if has_mass else ("density", of_spec.density)
        geom.put(name, [share * float(value)])


def _write_link(place: _Place, inertial: Element, share: float) -> None:
    """Write a link's <inertial> of a URDF."""
    mass, origin = inertial.child("mass"), inertial.child("origin")
    matrix = inertial.child("inertia")
    if mass is None or matrix is None:
        raise _Unwritable("that link has no <mass> or no <inertia>")
    mass.put("value", [float(place.numbers("body_mass")[0])])
    position = place.numbers("body_ipos")
    if not np.array_equal(position, place.given.body_ipos[place.number]):
        if origin is None:
            words = " ".join(map(number_text, position))
            inertial.added["origin"] = {"xyz": words, "rpy": "0 0 0"}
        else:
            origin.put("xyz", position.tolist(), 3)
    inertia = place.numbers("body_inertia")
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    if np.allclose(inertia, place.given.body_inertia[place.number] * share, rtol=1e-12, atol=0):
        if share != 1.0:
            for name in names:
                matrix.put(name, [share * value_of(matrix.given.get(name, "0"))])
        return
    if origin is not None and any(map(value_of, origin.values.get("rpy", "").split())):
        raise _Unwritable("its inertia stands in a turned frame (rpy), where it is six numbers")
    turn = np.empty(9)
    mujoco().mju_quat2Mat(turn, place.numbers("body_iquat"))
    axes = turn.reshape(3, 3)
    whole = axes @ np.diag(inertia) @ axes.T
    for name, (row, column) in zip(
        names, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True
    ):
        matrix.put(name, [float(whole[row, column])])


def _write_geom(place: _Place) -> Element:
    numbers = place.numbers(FIELDS["geom"][place.quantity].array).tolist()
    place.element.put(place.quantity, numbers, place.index + 1)
    return place.element


def _write_actuator(place: _Place) -> Element:
    element, name = place.element, place.quantity
    gain, bias = place.numbers("actuator_gainprm"), place.numbers("actuator_biasprm")
    if name == "gear":
        element.put("gear", place.numbers("actuator_gear").tolist(), place.index + 1)
    elif element.tag == "general" and name != "forcerange":
        changed = gain != place.given.actuator_gainprm[place.number]
        if changed.any():
            element.put("gainprm", gain.tolist(), int(np.flatnonzero(changed)[-1]) + 1)
        changed = bias != place.given.actuator_biasprm[place.number]
        if changed.any():
            element.put("biasprm", bias.tolist(), int(np.flatnonzero(changed)[-1]) + 1)
    elif name == "kp" and element.tag in ("position", "intvelocity"):
        element.put("kp", [float(gain[0])])
    elif name == "forcerange":
        element.put("forcerange", place.numbers("actuator_forcerange").tolist(), 2)
        if not place.given.actuator_forcelimited[place.number]:
            element.set("forcelimited", "true")
    elif name == "kv" and element.tag in ("position", "intvelocity", "velocity"):
        element.set("dampratio", None)
        element.put("kv", [float(-bias[2])])
    else:
        raise _Unwritable(f"a <{element.tag}> has no {name}; write it as <general>")
    return element


_SPRING_LENGTH = "springlength"  # of a tendon, which is not tuned


def _write_tendon(place: _Place) -> Element:
    if place.quantity == _SPRING_LENGTH:
        place.element.put(_SPRING_LENGTH, place.numbers("tendon_lengthspring").tolist(), 2)
        return place.element
    _put_first(
        place.element,
        place.quantity,
        float(place.numbers(FIELDS["tendon"][place.quantity].array)[0]),
    )
    return place.element


def _write_option(place: _Place) -> Element:
    numbers = np.atleast_1d(getattr(place.tuned.opt, place.quantity)).tolist()
    sections = place.xml.elements("option")
    if place.xml.is_urdf:
        extension = place.xml.root.child("mujoco")
        sections = [one for one in extension.children if one.tag == "option"] if extension else []
        if not sections:
            raise _Unwritable(f"a URDF has no {place.quantity}")
    having = [one for one in sections if place.quantity in one.values]
    if not sections:
        words = " ".join(map(number_text, numbers))
        place.xml.root.added.setdefault("option", {})[place.quantity] = words
        return place.xml.root
    element = (having or sections)[-1]
    element.put(place.quantity, numbers, len(numbers))
    return element


def _write_urdf_joint(place: _Place) -> Element:
    names = {"damping": "damping", "frictionloss": "friction"}
    if place.quantity not in names:
        raise _Unwritable(f"a URDF's joint has no {place.quantity}")
    element = place.element
    at = int(place.given.jnt_dofadr[place.number])
    value = float(getattr(place.tuned, FIELDS["joint"][place.quantity].array)[at])
    dynamics = element.child("dynamics")
    if dynamics is None:
        added = element.added.setdefault("dynamics", {})
        added[names[place.quantity]] = number_text(value)
        return element
    dynamics.put(names[place.quantity], [value])
    return dynamics


_WRITERS = {
    "joint": _write_joint,
    "body": _write_body,
    "geom": _write_geom,
    "actuator": _write_actuator,
    "tendon": _write_tendon,
    "option": _write_option,
}
_URDF_WRITERS = {"joint": _write_urdf_joint, "body": _write_body, "option": _write_option}


def _write(place: _Place) -> Element:
    """Write one field into the elements; return the one at which a remark belongs."""
    writer = (_URDF_WRITERS if place.xml.is_urdf else _WRITERS).get(place.kind)
    if writer is None:
        raise _Unwritable(f"a URDF has no {place.kind} with {place.quantity}")
    return writer(place)


# ---- Comparison of compiled models: every array, bit by bit

_ROUNDING = 1e-12  # of an array's largest number: what is off by less is off by rounding


def arrays_of(model: Any) -> dict[str, np.ndarray[Any, Any]]:
    """Return all numbers of a compiled model that move it, by name."""
    found = {"stat.meaninertia": np.asarray(model.stat.meaninertia)}  # others are for drawing
    for prefix, owner in (("", model), ("opt.", model.opt)):
        for name in dir(owner):
            value = None if name.startswith("_") else getattr(owner, name)
            if isinstance(value, np.ndarray | float | int) and name != "signature":
                array = np.asarray(value)
                if array.dtype.kind in "fiub":
                    found[prefix + name] = array
    return found


def differences(one: Any, other: Any) -> dict[str, float]:
    """Return by how much each array of two models differs that does, over its largest number.

    Infinite where they cannot be compared: whole numbers and shapes.
    """
    found: dict[str, float] = {}
    others = arrays_of(other)
    for name, array in arrays_of(one).items():
        its = others[name]
        if array.shape == its.shape and array.tobytes() == its.tobytes():
            continue
        found[name] = math.inf
        if array.shape == its.shape and array.dtype.kind == "f":
            size = max(float(np.abs(array).max(initial=0.0)), 1e-300)
            off = float(np.abs(array - its).max(initial=0.0)) / size
            found[name] = off if math.isfinite(off) else math.inf
    return {name: off for name, off in found.items() if off}


TEST_S, _MAX_TEST_STEPS = 2.0, 20_000


def rolled(model: Any, process: ModelProcess) -> tuple[Array, str]:
    """Roll out `TEST_S` of a compiled model that is pushed and commanded; return qpos (T, nq).

    With what stopped it; "" if nothing did.
    """
    qpos = model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()
    qvel = 0.1 * np.cos(1.0 + np.arange(model.nv))
    step_s = float(model.opt.timestep)
    steps = int(min(TEST_S / step_s, _MAX_TEST_STEPS)) + 1
    low, high = model.actuator_ctrlrange.T if model.nu else np.zeros((2, 0))
    limited = np.asarray(model.actuator_ctrllimited, bool)
    middle, reach = np.where(limited, (low + high) / 2, 0), np.where(limited, (high - low) / 2, 1)
    phases = 2.0 * np.arange(steps)[:, None] * step_s + np.arange(model.nu)
    control = middle + 0.2 * reach * np.sin(phases)
    _, (why,), found = process.run(
        model,
        rows=[([], qpos, qvel, 0)],
        controls=[control],
        columns=list(range(model.nu)),
        wants_qpos=True,
        steps=steps,
        step_s=step_s,
        is_late=False,
    )
    return found["qpos"][0], why


# ---- A model with tuned numbers


@dataclass(frozen=True, eq=False)
class WrittenModel:
    """A model's text with tuned numbers."""

    xml: ModelXml  # edited
    tuned: Any  # compiled model with the numbers that are written
    model: Any  # compiled from the text
    unwritten: Mapping[str, str]  # addresses of other numbers, and why each is not written
    kept: tuple[str, ...]  # what is written as it was, for MuJoCo would derive it anew
    off: Mapping[str, float]  # arrays that differ by rounding; see `differences`


def tuned_models(
    spec: Any, tuned: Sequence[ModelParameter], rows: Sequence[Mapping[str, float]]
) -> Iterator[Any]:
    """Compile a spec, and yield that one model with values set as a rollout has them, row by row.

    UsageError where MuJoCo takes no such values.
    """
    model = movable(spec, tuned).compile()
    data = mujoco().MjData(model)
    given = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
    for values in rows:
        for name, array in given.items():
            put_array(model, name, array)
        for one in tuned:
            if one.parameter.name in values:
                one.put(model, values[one.parameter.name])
        try:
            set_constants(model, data)
        except mujoco().FatalError as error:
            raise UsageError(f"MuJoCo takes no such values: {one_line(error)}") from error
        yield model


def write_model(
    files: ModelFiles,
    tuned: Sequence[ModelParameter],
    values: Mapping[str, float],
    remarks: Mapping[str, str],
    process: ModelProcess,
) -> WrittenModel:
    """Write values, by address, into a model's text, with a remark at each.

    What cannot be written so that it comes back is left out, and named.
    """
    spec = files.spec(process)
    wanted = [one for one in tuned if one.parameter.name in values]
    left: dict[str, str] = {}
    good: list[ModelParameter] = []
    model = spec.compile()
    for one in wanted:
        if one.is_of_sensor:
            left[one.parameter.name] = "it is the sensor's: a model measures without it"
        elif why := unwritten(one.parameter.name, values, model):
            left[one.parameter.name] = why
        else:
            good.append(one)
    attempt = _Attempt(files, spec, process, values, remarks)
    found = attempt.written(good)
    if isinstance(found, dict):
        left |= found
        good = [one for one in good if one.parameter.name not in left]
        found = attempt.written(good)
    if not isinstance(found, WrittenModel):  # one by one, to find those that do not come back
        kept: list[ModelParameter] = []
        found = attempt.written(kept)
        for one in good:
            tried = attempt.written([*kept, one])
            if isinstance(tried, WrittenModel):
                found = tried
                kept.append(one)
            else:
                left[one.parameter.name] = tried if isinstance(tried, str) else tried.popitem()[1]
    if not isinstance(found, WrittenModel):
        raise UsageError(f"{files.named}: {found}", "check that this MuJoCo reads the model")
    return WrittenModel(found.xml, found.tuned, found.model, left, found.kept, found.off)


@dataclass(frozen=True, eq=False)
class _Attempt:
    files: ModelFiles
    spec: Any
    process: ModelProcess
    values: Mapping[str, float]
    remarks: Mapping[str, str]

    def written(self, wanted: Sequence[ModelParameter]) -> WrittenModel | dict[str, str] | str:
        """Write these parameters; else return which cannot be and why, or why not all together."""
        chosen = {one.parameter.name: self.values[one.parameter.name] for one in wanted}
        given = self.spec.compile()
        (tuned,) = tuned_models(self.spec, wanted, [chosen])
        pins: list[tuple[str, str, int]] = []
        while True:
            xml = ModelXml(self.files)
            refused: dict[str, str] = {}
            for one in wanted:
                address = one.parameter.name
                kind, _, name = one.owner.partition("/")
                index = int(address[-2]) if address.endswith("]") else 0
                number = 0 if kind == "option" else element_names(given, kind).index(name)
                place = _Place(xml, self.spec, given, tuned, kind, one.field, number, index)
                try:
                    element = _write(place)
                    words = (self.remarks[address], *place.notes)
                    element.remarks[address] = "; ".join(words)
                except _Unwritable as error:
                    refused[address] = str(error)
            kept: list[str] = []
            for kind, field_name, number in pins:
                place = _Place(xml, self.spec, given, tuned, kind, field_name, number, 0)
                address = f"{kind}/{place.name or number}.{field_name}"
                try:
                    _write(place).remarks[address] = "as it was; MuJoCo would derive another"
                except _Unwritable as error:
                    return str(error)
                kept.append(address)
            if refused:
                return refused
            try:
                files = ModelFiles(self.files.named, texts=xml.texts())
                model = files.spec(self.process).compile()
            except UsageError as error:
                return f"MuJoCo does not take the file with it: {one_line(error.what)}"
            off = differences(tuned, model)
            more = [one for one in _derived(tuned, model, off) if one not in pins]
            if more and len(pins) < 1000:
                pins += more
                continue
            worst = max(off, key=lambda name: off[name], default="")
            if worst and off[worst] > _ROUNDING:
                by = f"by {off[worst]:.2g} of its size" if math.isfinite(off[worst]) else "in shape"
                return f"loaded again, MuJoCo's {worst} differs {by}, as it derives it from others"
            return WrittenModel(xml, tuned, model, {}, tuple(kept), off)


def _derived(tuned: Any, model: Any, off: Mapping[str, float]) -> list[tuple[str, str, int]]:
    """List fields whose numbers the compiled text has otherwise: kind, field, element's number."""
    found: list[tuple[str, str, int]] = []
    if off.get("actuator_biasprm", 0.0) > 0:
        rows = (tuned.actuator_biasprm != model.actuator_biasprm).any(axis=1)
        found += [("actuator", "kv", int(number)) for number in np.flatnonzero(rows)]
    if off.get("tendon_lengthspring", 0.0) > 0:
        rows = (tuned.tendon_lengthspring != model.tendon_lengthspring).any(axis=1)
        found += [("tendon", _SPRING_LENGTH, int(number)) for number in np.flatnonzero(rows)]
    for name in ("dof_damping", "jnt_stiffness"):
        if off.get(name, 0.0) > 0:
            rows = np.flatnonzero(getattr(tuned, name) != getattr(model, name))
            joints = {
                int(tuned.dof_jntid[row]) if name == "dof_damping" else int(row) for row in rows
            }
            found += [("joint", "damping", number) for number in sorted(joints)]
    return list(dict.fromkeys(found))


def rollouts_differ(one: Any, other: Any, process: ModelProcess) -> tuple[float, float, str]:
    """Roll out two compiled models alike; return the largest difference of any coordinate.

    0.0 where they are the same to the last bit; with the time until which it is under 1e-6, and
    what stopped them.
    """
    ours, why = rolled(one, process)
    theirs, _ = rolled(other, process)
    step_s = float(one.opt.timestep)
    if ours.tobytes() == theirs.tobytes():
        return 0.0, step_s * len(ours), why
    off = np.abs(ours - theirs)
    off = np.where(np.isnan(ours) & np.isnan(theirs), 0.0, np.where(np.isnan(off), np.inf, off))
    apart = np.flatnonzero(np.any(off > 1e-6, axis=1))
    count = int(apart[0]) if len(apart) else len(off)
    return float(off.max(initial=0.0)), step_s * count, why
