"""Log shapes of a model's bodies, each in its body's frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from analysis.review.drawing import Color
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_scene import Shape
from tunenet_logs.arrays import Array

_HALF = 128  # Opacity of what is not solid


def log_shapes(
    stream: rr.RecordingStream,
    entity: str,
    shapes: Sequence[Shape],
    color: Color,
    *,
    is_solid: bool,
) -> None:
    """Log shapes in the frame of the body that they belong to."""
    by_kind: dict[str, list[Shape]] = defaultdict(list)
    for shape in shapes:
        by_kind["box" if shape.kind == "plane" else shape.kind].append(shape)
    rgba = (*color, 255 if is_solid else _HALF)
    for kind, some in by_kind.items():
        if kind == "mesh":
            for number, shape in enumerate(some):
                _log_mesh(stream, f"{entity}/mesh_{number}", shape, rgba)
            continue
        sizes = np.array([shape.size_m for shape in some])
        middles = np.array([shape.position_m for shape in some])
        style: dict[str, Any] = {
            "quaternions": [rr.Quaternion(xyzw=_xyzw(shape.rotation)) for shape in some],
            "colors": [rgba],
            "fill_mode": "solid",
        }
        if kind == "box":
            drawn = rr.Boxes3D(centers=middles, half_sizes=sizes, **style)
        elif kind == "ellipsoid":
            drawn = rr.Ellipsoids3D(centers=middles, half_sizes=sizes, **style)
        elif kind == "cylinder":
            lengths, radii = 2 * sizes[:, 2], sizes[:, 0]
            drawn = rr.Cylinders3D(centers=middles, lengths=lengths, radii=radii, **style)
        else:
            begins = middles - np.array([one.rotation[:, 2] * one.size_m[2] for one in some])
            lengths, radii = 2 * sizes[:, 2], sizes[:, 0]
            drawn = rr.Capsules3D(translations=begins, lengths=lengths, radii=radii, **style)
        stream.log(f"{entity}/{kind}", drawn, static=True)


def _log_mesh(
    stream: rr.RecordingStream, entity: str, shape: Shape, rgba: tuple[int, int, int, int]
) -> None:
    assert shape.vertices_m is not None
    assert shape.triangles is not None
    # Each triangle has its own corners, so that its side is flat and shaded by one normal.
    corners = shape.vertices_m[shape.triangles] @ shape.rotation.T + shape.position_m
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    mesh = rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3).astype(np.float32),
        vertex_normals=np.repeat(normals, 3, axis=0).astype(np.float32),
        albedo_factor=rgba,
    )
    stream.log(entity, mesh, static=True)


def _xyzw(rotation: Array) -> Array:
    """Convert a rotation to a quaternion x, y, z, w, shape (4,)."""
    found = np.empty(4)
    mujoco().mju_mat2Quat(found, np.ascontiguousarray(rotation).ravel())
    return found[[1, 2, 3, 0]]
