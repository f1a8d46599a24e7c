"""Simulate a user's MuJoCo model, driven by a log's commands and sensed as the log was.

Before that, how a log's signals map to MuJoCo's sensors, and how its body poses are seen from the
model's world; and the model's shapes and poses for drawing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.known import named_version
from tunenet_logs.recorders.simulators.model.child import put_array
from tunenet_logs.recorders.simulators.model.parameters import (
    DELAY,
    DELAYED,
    TUNED_ARRAYS,
    ModelParameter,
)
from tunenet_logs.recorders.simulators.model.reading import ModelProcess
from tunenet_logs.recorders.simulators.model.servo import put_table, servos
from tunenet_logs.recorders.simulators.mujoco import mujoco

# ---- Sensors: a log's signals in MuJoCo

# Of joints; of bodies; of sites.
Kind = Literal[
    "jointpos",
    "jointvel",
    "jointactuatorfrc",
    "framepos",
    "framexaxis",
    "framezaxis",
    "force",
    "torque",
]


class Sensor(NamedTuple):
    """One column of a signal as a sensor in the model."""

    kind: Kind  # MuJoCo's sensor type. Forces and torques are those of a parent on its child.
    name: str  # of the joint, body or site
    axis: int = 0  # component of a vector sensor
    reference: str = ""  # the body whose frame a pose is in; "" for the world
    is_at_body: bool = False  # whether a force or torque is at the origin of that body
    sign: float = 1.0  # 1.0, or -1.0 of a log with forces of the child on its parent

    @property
    def whole(self) -> Sensor:
        """The model's vector sensor that this is a component of."""
        return self._replace(axis=0, sign=1.0)


@dataclass(frozen=True, eq=False)
class SensedSignal:
    """A signal of the log that the model reproduces."""

    signal: Signal
    columns: tuple[str, ...]  # those of its columns that the model has
    sensors: tuple[Sensor, ...]  # their sensors


def put_sensors(spec: Any, sensors: Sequence[Sensor]) -> None:
    """Replace a model's sensors by these, in their order."""
    kinds = mujoco().mjtObj
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for number, one in enumerate(sensors):
        name = one.name
        if one.is_at_body:
            name = f"seen at {number}"
            spec.body(one.name).add_site(name=name)
        # MuJoCo names one kind otherwise.
        kind = "JOINTACTFRC" if one.kind == "jointactuatorfrc" else one.kind.upper()
        sensor = spec.add_sensor(
            name=f"seen {number}", type=getattr(mujoco().mjtSensor, f"mjSENS_{kind}"), objname=name
        )
        sensor.objtype = kinds.mjOBJ_JOINT
        if one.kind.startswith("frame"):
            sensor.objtype = kinds.mjOBJ_XBODY
        elif one.kind in ("force", "torque"):
            sensor.objtype = kinds.mjOBJ_SITE
        if one.reference:
            sensor.reftype, sensor.refname = kinds.mjOBJ_XBODY, one.reference


# ---- Frames: a log's body poses in the model's world


def free_joint(model: Any, body: str) -> int | None:
    """Find a body's free joint; None where it has none."""
    number = model.body(body).id
    first = int(model.body_jntadr[number])
    free = mujoco().mjtJoint.mjJNT_FREE
    return first if first >= 0 and model.jnt_type[first] == free else None


def rotation_in(model: Any, qpos: Array, body: str, reference: str) -> Array:
    """Return a body's rotation in another's frame ("": the world's) at qpos of shape (nq,)."""
    data = mujoco().MjData(model)
    data.qpos[:] = qpos
    mujoco().mj_kinematics(model, data)
    own = data.body(body).xmat.reshape(3, 3)
    return data.body(reference).xmat.reshape(3, 3).T @ own if reference else own.copy()


def seen_in_world(model: Any, sensed: Sequence[SensedSignal]) -> list[SensedSignal]:
    """Transform signals in frames of static bodies to the world; omit those in moving frames."""
    found: list[SensedSignal] = []
    for one in sensed:
        reference = one.sensors[0].reference
        if not reference:
            found.append(one)
        elif model.body_weldid[model.body(reference).id] == 0:
            # Transform a signal of 3-vectors to the world frame.
            data = mujoco().MjData(model)
            mujoco().mj_kinematics(model, data)
            frame = data.body(reference)
            values = one.signal.values.reshape(len(one.signal.values), -1, 3)
            values = values @ frame.xmat.reshape(3, 3).T
            if one.sensors[0].kind == "framepos":
                values = values + frame.xpos
            flat = np.asarray(values).reshape(one.signal.values.shape)
            sensors = tuple(sensor._replace(reference="") for sensor in one.sensors)
            found.append(replace(one, signal=replace(one.signal, values=flat), sensors=sensors))
    return found


# ---- Scene: shapes and poses of the bodies, for drawing

_BONE = 0.12  # least radius of a mass without a shape, over its distance from the joint


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a body, in the body's frame."""

    # Of a capsule and a cylinder the axis is z, of a plane the normal.
    kind: Literal["box", "ellipsoid", "capsule", "cylinder", "mesh", "plane"]
    body: int  # its index
    position_m: Array  # of its centre, shape (3,)
    rotation: Array  # from its own frame, shape (3, 3)
    # Half sizes along its axes, shape (3,); of a capsule and a cylinder the radius twice and half
    # the length, without caps. 0 of an infinite plane.
    size_m: Array
    vertices_m: Array | None = None  # of a mesh, shape (V, 3)
    triangles: NDArray[np.int32] | None = None  # of a mesh, shape (F, 3)


@dataclass(frozen=True, eq=False)
class ModelScene:
    """The shapes and poses of a compiled model."""

    model: Any  # compiled

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Indices of bodies that are not fixed to the world."""
        return tuple(int(body) for body in np.flatnonzero(self.model.body_weldid != 0))

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """All visible shapes; stand-ins for the masses if no moving body has one."""
        model = self.model
        seen = [int(geom) for geom in np.flatnonzero(model.geom_rgba[:, 3] > 0.02)]
        # Only the first three groups of geoms are shown by MuJoCo's own viewer, too.
        shown = [geom for geom in seen if model.geom_group[geom] < 3]
        if not any(model.body_weldid[model.geom_bodyid[geom]] for geom in shown):
            shown = seen
        left = 100_000  # triangles of all meshes that are drawn; of larger ones the box is
        found: list[Shape] = []
        for geom in sorted(shown, key=self._triangles):
            triangles = self._triangles(geom)
            left -= triangles
            found.append(self._mesh(geom) if triangles and left >= 0 else self._plain(geom))
        if not any(model.body_weldid[shape.body] for shape in found):
            found += [shape for body in self.moving for shape in self._masses(body)]
        return tuple(found)

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Compute B bodies' positions [m] (T, B, 3) and rotations (T, B, 3, 3) at qpos (T, nq)."""
        library = mujoco()
        data = library.MjData(self.model)
        positions = np.empty((len(qpos), self.model.nbody, 3))
        rotations = np.empty((len(qpos), self.model.nbody, 9))
        for moment, row in enumerate(qpos):
            data.qpos[:] = row
            library.mj_kinematics(self.model, data)
            positions[moment], rotations[moment] = data.xpos, data.xmat
        return positions, rotations.reshape(*rotations.shape[:2], 3, 3)

    def _triangles(self, geom: int) -> int:
        """Count the triangles of a geom's mesh."""
        mesh = self.model.geom_dataid[geom]
        kinds = mujoco().mjtGeom
        is_mesh = int(self.model.geom_type[geom]) in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF)
        return int(self.model.mesh_facenum[mesh]) if is_mesh and mesh >= 0 else 0

    def _mesh(self, geom: int) -> Shape:
        model = self.model
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        begin, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        return Shape(
            "mesh",
            int(model.geom_bodyid[geom]),
            model.geom_pos[geom].copy(),
            _rotation(model.geom_quat[geom]),
            model.geom_aabb[geom, 3:].copy(),
            model.mesh_vert[first : first + count].astype(np.float64),
            model.mesh_face[begin : begin + faces].astype(np.int32),
        )

    def _plain(self, geom: int) -> Shape:
        """Make a primitive shape, or the bounding box of another."""
        kinds, model = mujoco().mjtGeom, self.model
        body, size = int(model.geom_bodyid[geom]), model.geom_size[geom]
        rotation, position = _rotation(model.geom_quat[geom]), model.geom_pos[geom].copy()
        kind = int(model.geom_type[geom])  # NumPy's numbers are in no tuple of MuJoCo's
        if kind == kinds.mjGEOM_PLANE:
            return Shape("plane", body, position, rotation, np.array([size[0], size[1], 0.0]))
        if kind == kinds.mjGEOM_SPHERE:
            return Shape("ellipsoid", body, position, rotation, np.full(3, size[0]))
        if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
            name = "capsule" if kind == kinds.mjGEOM_CAPSULE else "cylinder"
            half = np.array([size[0], size[0], size[1]])
            return Shape(name, body, position, rotation, half)
        if kind == kinds.mjGEOM_ELLIPSOID:
            return Shape("ellipsoid", body, position, rotation, size.copy())
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        return Shape("box", body, position + rotation @ middle, rotation, half.copy())

    def _masses(self, body: int) -> list[Shape]:
        """Make stand-ins of a body without a shape: its mass as a ball, and bones from its joint.

        A bone ends at the mass, and at each body that hangs on it.
        """
        model = self.model
        middle = model.body_ipos[body].copy()
        joint = model.body_jntadr[body]
        begin = model.jnt_pos[joint].copy() if joint >= 0 else np.zeros(3)
        children = [one for one in range(1, model.nbody) if model.body_parentid[one] == body]
        ends = [middle, *(model.body_pos[one].copy() for one in children)]
        length = float(np.linalg.norm(middle - begin))
        mass, inertia = max(float(model.body_mass[body]), 1e-9), model.body_inertia[body]
        radius = max(float(np.sqrt(2.5 * inertia.mean() / mass)), 1e-4)
        if length > 0:
            radius = float(np.clip(radius, _BONE * length, length / 2))
        ball = Shape("ellipsoid", body, middle, np.eye(3), np.full(3, radius))
        longest = max(float(np.linalg.norm(end - begin)) for end in ends)
        bones = [_bone(body, begin, end, _BONE * longest / 4) for end in ends]
        return [ball, *(one for one in bones if 2 * one.size_m[2] >= radius)]


def _bone(body: int, begin: Array, end: Array, radius: float) -> Shape:
    """Make a rod between two places in a body's frame."""
    away = end - begin
    length = float(np.linalg.norm(away))
    quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    if length > 0:  # turned so that z is the unit direction
        mujoco().mju_quatZ2Vec(quaternion, away / length)
    half = np.array([radius, radius, length / 2])
    return Shape("capsule", body, begin + away / 2, _rotation(quaternion), half)


def _rotation(quaternion: Array) -> Array:
    """Convert w, x, y, z to a rotation, shape (3, 3)."""
    found = np.empty(9)
    mujoco().mju_quat2Mat(found, quaternion)
    return found.reshape(3, 3)


# ---- Simulator: rollouts driven by a log

MAX_STEPS = 300_000  # of one rollout: five minutes at 1 ms
STOPPED = "stopped"  # in a rollout's notes: what stopped it before its end; "" where nothing did
_MEMORY_IS_FULL = "its working memory is full"


@dataclass(frozen=True, eq=False)
class Drive:
    """A signal that drives the model."""

    signal: Signal
    columns: NDArray[np.intp]  # indices of its columns that drive something, shape (C,)
    targets: NDArray[np.intp]  # the actuator or degree of freedom that each drives, shape (C,)
    # Whether its values are measured efforts, interpolated and applied at joints; else commands to
    # actuators, each of which holds until the next one (zero-order hold).
    is_effort: bool
    is_switch: bool = False  # whether its values, 0 or 1, are the power of actuators


@dataclass(frozen=True, eq=False)
class InitialState:
    """The initial state of a rollout, and its uncertainty."""

    stamp_ns: int
    qpos: Array  # shape (nq,)
    qvel: Array  # shape (nv,)
    unsure: tuple[Parameter, ...] = ()  # what the log leaves uncertain, each with its prior
    places: tuple[tuple[bool, int], ...] = ()  # of each: is it a speed? its index in its vector


@dataclass(frozen=True, eq=False)
class ModelSimulator:
    """A compiled model, driven and sensed as in a log."""

    spec: Any  # the model; not compiled with `sensed` yet
    tuned: tuple[ModelParameter, ...]  # its tuned parameters
    sensed: tuple[SensedSignal, ...]  # signals to compare
    drives: tuple[Drive, ...]  # signals that drive it
    initial: InitialState
    end_ns: int
    process: ModelProcess  # where it is run
    step_s: float | None = None  # of its integrator; None for the model's own

    @property
    def engine(self) -> str:
        """Library with its version."""
        return named_version("mujoco")

    @property
    def step_hz(self) -> float:
        """Rate of the integrator's steps."""
        return 1.0 / self._step_s

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Tuned parameters, and uncertain ones of the initial state."""
        return (*(one.parameter for one in self.tuned), *self.initial.unsure)

    @property
    def latest_s(self) -> float:
        """Longest delay of a sensor that is looked for."""
        late = (one.parameter for one in self.tuned if one.owner in DELAYED)
        return max((0.0, *(one.training_range[1] for one in late)))

    def finer(self) -> ModelSimulator:
        """Copy with half the step, to measure the discretisation error."""
        half = replace(self, step_s=self._step_s / 2)
        half.__dict__["_model"] = self._model  # compiled once
        return half

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Roll out one episode: signals of `sensed` at their stamps; see `Simulator`."""
        row = [one.checked(values.get(one.name, one.initial)) for one in self.parameters]
        found = self.rollouts(np.array([row]))[0]
        if found.info.notes[STOPPED].startswith(_MEMORY_IS_FULL):
            more_mb = max(self._model.narena * 4 // 1_000_000, 10)
            raise LogError(
                f"{self.process.path}: {found.info.notes[STOPPED]}",
                f'give it more, such as <size memory="{more_mb}M"/>',
            )
        return found

    def rollouts(self, values: Array) -> list[Episode]:
        """Roll out N episodes at values (N, P), on all cores; NaN from where MuJoCo stops one.

        Rows that differ in what sensors add are one rollout.
        """
        own = [not one.is_of_sensor for one in self.tuned]
        own += [True] * len(self.initial.unsure)
        moving = np.column_stack([np.zeros(len(values)), values[:, own]])
        _, rows, which = np.unique(moving, axis=0, return_index=True, return_inverse=True)
        # At most 64 at once, and 50 MB of sensor values.
        each_bytes = 8 * self._steps * (self._model.nsensordata + len(self._driven))
        count = int(np.clip(50_000_000 // each_bytes, 1, 64))
        found: dict[int, Episode] = {}
        for first in range(0, len(rows), count):
            kept, why, arrays = self._rolled(values[rows[first : first + count]])
            for place, (seen, steps, stop) in enumerate(
                zip(arrays["sensed"], kept, why, strict=True), first
            ):
                words = _stop_in_words(stop, steps * self._step_s)
                for number in np.flatnonzero(which.ravel() == place).tolist():
                    found[number] = self._episode(seen, values[number], words)
        return [found[number] for number in range(len(values))]

    def coordinates(self, values: Array) -> tuple[Array, Array]:
        """Roll out at values (P,); return seconds (T,) and qpos (T, nq) while it goes on."""
        (kept,), _, found = self._rolled(values[None], wants_qpos=True)
        places = np.arange(self._steps + 1)
        seconds = np.asarray(self._step_s * places, np.float64)
        return seconds, found["qpos"][0][np.minimum(places, kept)]

    @cached_property
    def _model(self) -> Any:
        """Compiled model, with sensors of the compared signals alone; one for logs alike."""
        key = tuple(self._distinct), tuple(one.parameter.name for one in self.tuned)
        if key not in self.process.models:
            self.process.models[key] = self._compiled()
        return self.process.models[key]

    def _compiled(self) -> Any:
        spec = self.spec.copy()
        put_sensors(spec, self._distinct)
        if any(one.owner.startswith("servo/") for one in self.tuned):
            put_table(spec)
        return spec.compile()

    @property
    def _step_s(self) -> float:
        return float(self._model.opt.timestep if self.step_s is None else self.step_s)

    @cached_property
    def _distinct(self) -> list[Sensor]:
        """Each vector sensor once."""
        every = (sensor.whole for sensed in self.sensed for sensor in sensed.sensors)
        return list(dict.fromkeys(every))

    @cached_property
    def _steps(self) -> int:
        seconds, step_s = (self.end_ns - self.initial.stamp_ns) * 1e-9, self._step_s
        if seconds / step_s > MAX_STEPS:
            raise UsageError(
                f"the log is longer than {MAX_STEPS} steps of {step_s:g} s",
                f"choose a part of at most {MAX_STEPS * step_s:.0f} s with --start and --end",
            )
        return int(np.ceil(seconds / step_s)) + 2

    @cached_property
    def _driven(self) -> NDArray[np.intp]:
        """Indices of what is driven, among controls and then the efforts of joints."""
        drives = [one for one in self.drives if not one.is_switch]
        targets = [one.targets + self._model.nu * one.is_effort for one in drives]
        return np.unique(np.concatenate([np.zeros(0, np.intp), *targets]))

    @cached_property
    def _switched(self) -> NDArray[np.intp]:
        """Actuators whose power the log tells."""
        targets = [one.targets for one in self.drives if one.is_switch]
        return np.unique(np.concatenate([np.zeros(0, np.intp), *targets]))

    @cached_property
    def _zeros(self) -> tuple[tuple[int, int, int], ...]:
        """Tuned zeros of encoders: the parameter's place, its actuator and its joint."""
        joints = dict(servos(self._model))
        actuators = {self._model.actuator(one).name: one for one in joints}
        found: list[tuple[int, int, int]] = []
        for place, one in enumerate(self.tuned):
            kind, _, name = one.owner.partition("/")
            if kind == "servo" and one.field == "zero":
                found.append((place, actuators[name], joints[actuators[name]]))
        return tuple(found)

    def _rolled(
        self, values: Array, *, wants_qpos: bool = False
    ) -> tuple[list[int], list[str], dict[str, Array]]:
        """Roll out rows; return the steps of each, what stopped it, and sensor values."""
        names = [one.parameter.name for one in self.tuned]
        delays = [float(row[names.index(DELAY)]) if DELAY in names else 0.0 for row in values]
        zeros = [tuple(float(row[place]) for place, _, _ in self._zeros) for row in values]
        told = list(zip(delays, zeros, strict=True))
        known = sorted(set(told))
        rows: list[tuple[list[tuple[str, Array]], Array, Array, int]] = []
        for row, own in zip(values, told, strict=True):
            qpos, qvel = self.initial.qpos.copy(), self.initial.qvel.copy()
            unsure = row[len(self.tuned) :]
            for value, (is_speed, place) in zip(unsure, self.initial.places, strict=True):
                (qvel if is_speed else qpos)[place] = value
            for zero, (_, _, joint) in zip(own[1], self._zeros, strict=True):
                qpos[self._model.jnt_qposadr[joint]] += zero
            rows.append((self._changed(row), qpos, qvel, known.index(own)))
        return self.process.run(
            self._model,
            rows=rows,
            controls=[self._control(*one) for one in known],
            columns=self._driven.tolist(),
            switches=self._switched.tolist(),
            steps=self._steps,
            step_s=self._step_s,
            is_late=self._is_late,
            wants_qpos=wants_qpos,
        )

    def _changed(self, row: Array) -> list[tuple[str, Array]]:
        """Return the model's arrays that these values change, by name."""
        model = self._model
        before = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
        for one, value in zip(self.tuned, row, strict=False):
            one.put(model, float(value))
        after = {name: np.array(attrgetter(name)(model)) for name in TUNED_ARRAYS}
        for name, values in before.items():
            put_array(model, name, values)
        return [(name, after[name]) for name in before if (after[name] != before[name]).any()]

    def _control(self, delay_s: float, zeros: tuple[float, ...] = ()) -> Array:
        """Compute the controls of each step, then power, shape (steps, `_driven` + `_switched`)."""
        step_s = self._step_s
        # a step kicks speeds of half a step before to those of half a step after its begin
        edges_s = np.arange(self._steps + 1, dtype=np.float64)
        edges_s = step_s * (edges_s - 0.5 * self._is_late)
        control = np.zeros((self._steps, len(self._driven) + len(self._switched)))
        for drive in self.drives:
            since_ns = drive.signal.stamps_ns - self.initial.stamp_ns
            at_s = np.asarray(since_ns, np.float64) * 1e-9
            places = np.searchsorted(self._driven, drive.targets + self._model.nu * drive.is_effort)
            if drive.is_switch:
                places = len(self._driven) + np.searchsorted(self._switched, drive.targets)
            for column, place in zip(drive.columns, places, strict=True):
                values = drive.signal.values[:, column]
                good = np.isfinite(values)
                seconds, values = at_s[good], values[good]
                if drive.is_effort:
                    middle_s = edges_s[:-1] + step_s / 2
                    control[:, place] = np.interp(middle_s, seconds, values)
                else:
                    control[:, place] = held_means(seconds, values, edges_s - delay_s)
        for zero, (_, actuator, _) in zip(zeros, self._zeros, strict=True):
            place = np.flatnonzero(self._driven == actuator)
            control[:, place] += zero * self._model.actuator_gear[actuator, 0]
        return control

    @property
    def _is_late(self) -> bool:
        # Integrators that step speeds first, then positions with them: their speeds are those of
        # half a step before, to second order.
        late = ("mjINT_EULER", "mjINT_IMPLICIT", "mjINT_IMPLICITFAST")
        kinds = mujoco().mjtIntegrator
        return self._model.opt.integrator in [getattr(kinds, one) for one in late]

    def _measured(self, row: Array) -> dict[Sensor, tuple[float, float]]:
        """Return gain and offset of each sensor that has tuned ones."""
        found: dict[Sensor, tuple[float, float]] = {}
        for one, value in zip(self.tuned, row.tolist(), strict=False):
            if not one.is_of_sensor or one.owner in DELAYED:
                continue
            kind, _, name = one.owner.partition("/")
            quantity, _, part = one.field.partition("_")
            axis = int(one.parameter.name[-2]) if one.parameter.name.endswith("]") else 0
            of: Kind = "force" if quantity == "force" else "torque"
            of = "jointactuatorfrc" if quantity == "effort" else of
            sensor = Sensor(of, name, axis, is_at_body=kind == "body")
            gain, offset = found.get(sensor, (1.0, 0.0))
            found[sensor] = (value, offset) if part == "gain" else (gain, value)
        return found

    def _episode(self, seen: Array, row: Array, stopped: str) -> Episode:
        """Resample sensor values, shape (steps, S), as the log's signals."""
        step_s = self._step_s
        at_s = step_s * np.arange(self._steps)  # sensors see the state that a step begins with
        offsets = {self._model.joint(joint).name: row[place] for place, _, joint in self._zeros}
        measured, delays = self._measured(row), zip(self.tuned, row.tolist(), strict=False)
        delayed = {kind: value for one, value in delays for kind in DELAYED.get(one.owner, ())}
        signals: dict[str, Signal] = {}
        for sensed in self.sensed:
            wanted_s = (sensed.signal.stamps_ns - self.initial.stamp_ns) * 1e-9
            values = np.empty((len(wanted_s), len(sensed.columns)))
            for place, sensor in enumerate(sensed.sensors):
                number = self._distinct.index(sensor.whole)
                gain, offset = measured.get(sensor._replace(sign=1.0), (1.0, 0.0))
                track = sensor.sign * seen[:, self._model.sensor_adr[number] + sensor.axis]
                if sensor.kind == "jointpos":
                    track = track - offsets.get(sensor.name, 0.0)
                track = gain * track + offset
                late_s = delayed.get(sensor.kind, 0.0)
                late_s -= step_s / 2 if sensor.kind == "jointvel" and self._is_late else 0.0
                values[:, place] = np.interp(wanted_s - late_s, at_s, track, right=np.nan)
            name, stamps_ns, unit = sensed.signal.name, sensed.signal.stamps_ns, sensed.signal.unit
            signals[name] = Signal(name, stamps_ns, values, sensed.columns, unit)
        names = [one.name for one in self.parameters]
        truth = dict(zip(names, map(float, row), strict=True))
        info = EpisodeInfo(source=self.engine, truth=truth, notes={STOPPED: stopped})
        return Episode(info, signals)


def held_means(at_s: Array, values: Array, edges_s: Array) -> Array:
    """Average a zero-order hold, shape (T,), between edges (N + 1,); the first holds before it."""
    if not len(at_s):
        return np.zeros(len(edges_s) - 1)
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(at_s))])
    place = np.clip(np.searchsorted(at_s, edges_s, "right") - 1, 0, len(at_s) - 1)
    until = area[place] + values[place] * (edges_s - at_s[place])
    return np.diff(until) / np.diff(edges_s)


def _stop_in_words(stop: str, at_s: float) -> str:
    """Describe why a rollout stopped; "" where it did not."""
    if not stop:
        return ""
    # By the begin of MuJoCo's names of what stops a rollout; any other is of memory.
    stops = {
        "mjWARN_INERTIA": "a mass or inertia is next to nothing",
        "mjWARN_BAD": "it moves beyond all bounds",
        "time": "it stops",
    }
    what = next((said for begin, said in stops.items() if stop.startswith(begin)), _MEMORY_IS_FULL)
    rest = ", and MuJoCo leaves contacts out" if what == _MEMORY_IS_FULL else ""
    return f"{what} after {at_s:.3g} s of the rollout{rest}"
