"""Shapes and body poses of a MuJoCo model, for drawing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.arrays import Array

_SHOWN_GROUPS = 3  # the first groups of geoms are those that MuJoCo's own viewer shows, too
_MAX_TRIANGLES = 100_000  # of all meshes that are drawn as they are; of larger ones the box is
# Half the thickness of what stands for a body without a shape, of its distance from its joint.
_BONE = 0.12

_MIN_ALPHA = 0.02


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a body, in the body's frame.

    Attributes:
        kind: of a capsule and a cylinder the axis is z, of a plane the normal.
        body: its index.
        position_m: of its centre, shape (3,).
        rotation: from its own frame, shape (3, 3).
        size_m: half sizes along its axes, shape (3,); of a capsule and a cylinder the radius twice
            and half the length, without caps. 0 of an infinite plane.
        vertices_m: of a mesh, shape (V, 3).
        triangles: of a mesh, shape (F, 3).
    """

    kind: Literal["box", "ellipsoid", "capsule", "cylinder", "mesh", "plane"]
    body: int
    position_m: Array
    rotation: Array
    size_m: Array
    vertices_m: Array | None = None
    triangles: NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class ModelScene:
    """The shapes and poses of a compiled model.

    Attributes:
        model: compiled.
    """

    model: Any

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Indices of bodies that are not fixed to the world."""
        return tuple(int(body) for body in np.flatnonzero(self.model.body_weldid != 0))

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """All visible shapes; stand-ins for the masses if no moving body has one."""
        model = self.model
        seen = [int(geom) for geom in np.flatnonzero(self._has_alpha)]
        shown = [geom for geom in seen if model.geom_group[geom] < _SHOWN_GROUPS]
        if not any(model.body_weldid[model.geom_bodyid[geom]] for geom in shown):
            shown = seen
        left = _MAX_TRIANGLES
        found: list[Shape] = []
        for geom in sorted(shown, key=self._triangles):
            triangles = self._triangles(geom)
            left -= triangles
            found.append(self._mesh(geom) if triangles and left >= 0 else self._plain(geom))
        if not any(model.body_weldid[shape.body] for shape in found):
            found += [shape for body in self.moving for shape in self._masses(body)]
        return tuple(found)

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Compute the poses of all B bodies.

        Args:
            qpos: shape (T, nq).

        Returns:
            Positions [m], shape (T, B, 3), and rotations from their frames, (T, B, 3, 3).
        """
        library = mujoco()
        data = library.MjData(self.model)
        positions = np.empty((len(qpos), self.model.nbody, 3))
        rotations = np.empty((len(qpos), self.model.nbody, 9))
        for moment, row in enumerate(qpos):
            data.qpos[:] = row
            library.mj_kinematics(self.model, data)
            positions[moment], rotations[moment] = data.xpos, data.xmat
        return positions, rotations.reshape(*rotations.shape[:2], 3, 3)

    @property
    def _has_alpha(self) -> NDArray[np.bool_]:
        """Whether each geom is visible."""
        return self.model.geom_rgba[:, 3] > _MIN_ALPHA

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
        """Make stand-ins of a body without a shape: a rod from its joint, its mass as a ball."""
        model = self.model
        middle = model.body_ipos[body].copy()
        joint = model.body_jntadr[body]
        begin = model.jnt_pos[joint].copy() if joint >= 0 else np.zeros(3)
        away = middle - begin
        length = float(np.linalg.norm(away))
        mass, inertia = max(float(model.body_mass[body]), 1e-9), model.body_inertia[body]
        radius = max(float(np.sqrt(2.5 * inertia.mean() / mass)), 1e-4)
        if length > 0:
            radius = float(np.clip(radius, _BONE * length, length / 2))
        ball = Shape("ellipsoid", body, middle, np.eye(3), np.full(3, radius))
        if length < radius:
            return [ball]
        thin = _BONE * length / 4
        turn = _towards(away / length)
        rod = Shape("capsule", body, begin + away / 2, turn, np.array([thin, thin, length / 2]))
        return [ball, rod]


def _rotation(quaternion: Array) -> Array:
    """Convert w, x, y, z to a rotation, shape (3, 3)."""
    found = np.empty(9)
    mujoco().mju_quat2Mat(found, quaternion)
    return found.reshape(3, 3)


def _towards(direction: Array) -> Array:
    """Return a rotation that turns z into a unit direction, shape (3, 3)."""
    quaternion = np.empty(4)
    mujoco().mju_quatZ2Vec(quaternion, direction)
    return _rotation(quaternion)
