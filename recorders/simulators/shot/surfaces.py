"""What a ball can touch: how far it is away, and which way is out."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.shot.rig import ShotRig
from tunenet_logs.arrays import Array

_SMALLEST_M = 1e-9


class Surface(Protocol):
    """Something fixed."""

    def gaps_m(self, positions_m: Array) -> Array:
        """From the ball's skin to it; negative inside. (N, 3) -> (N,)."""
        ...

    def normals(self, positions_m: Array) -> Array:
        """Unit vectors from it to the ball's centre. (N, 3) -> (N, 3)."""
        ...


class Board:
    """The inclined plane, without end; `holds` says where there is one."""

    def __init__(self, rig: ShotRig) -> None:
        self._normal, self._downhill = rig.plane.normal, rig.plane.downhill
        self._radius_m, self._end_m = rig.ball.radius_m, rig.plane.downhill_m

    def gaps_m(self, positions_m: Array) -> Array:
        """See `Surface`."""
        return positions_m @ self._normal - self._radius_m

    def normals(self, positions_m: Array) -> Array:
        """See `Surface`."""
        return np.broadcast_to(self._normal, positions_m.shape)

    def holds(self, positions_m: Array) -> NDArray[np.bool_]:
        """Whether the board reaches as far down as the balls are, shape (N,)."""
        return positions_m @ self._downhill <= self._end_m


class Rim:
    """The hoop's rim: a torus about the vertical through its centre."""

    def __init__(self, rig: ShotRig) -> None:
        self._center_m, self._ring_m = rig.hoop.center_m, rig.hoop.ring_radius_m
        self._reach_m = rig.ball.radius_m + rig.hoop.rim_m / 2

    def gaps_m(self, positions_m: Array) -> Array:
        """See `Surface`."""
        out, up = self._from_ring(positions_m)
        return np.hypot(out, up) - self._reach_m

    def normals(self, positions_m: Array) -> Array:
        """See `Surface`."""
        offset = positions_m - self._center_m
        out, up = self._from_ring(positions_m)
        across = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), _SMALLEST_M)
        away = np.maximum(np.hypot(out, up), _SMALLEST_M)
        flat = offset[:, :2] * (out / across / away)[:, None]
        return np.column_stack([flat, up / away])

    def is_within(self, positions_m: Array) -> NDArray[np.bool_]:
        """Whether centres lie nearer to the hoop's axis than the rim does, shape (N,)."""
        return self._from_ring(positions_m)[0] < 0

    def _from_ring(self, positions_m: Array) -> tuple[Array, Array]:
        """From the rim's middle line: outwards and up, each of shape (N,)."""
        offset = positions_m - self._center_m
        return np.hypot(offset[:, 0], offset[:, 1]) - self._ring_m, offset[:, 2]
