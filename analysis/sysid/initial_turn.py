"""Estimate the initial orientation and angular velocity of a freely moving body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.sysid.beginning import beginning
from analysis.sysid.compared import noise_of
from analysis.sysid.orientations import rotations
from recorders.simulators.mujoco.model_sensors import SensedSignal
from tunenet_logs.arrays import Array

_MAX_RAD = 2.5  # turned since the first sample: a rotation vector jumps at a half turn


@dataclass(frozen=True)
class InitialTurn:
    """Orientation and angular velocity of a body at a stamp.

    Attributes:
        quaternion: w, x, y, z, shape (4,).
        quaternion_sd: Of any of these.
        spin: Angular velocity in the body's frame, shape (3,) [rad/s].
        spin_sd: Shape (3,).
    """

    quaternion: Array
    quaternion_sd: float
    spin: Array
    spin_sd: Array

    def is_still(self, quaternion: Array) -> bool:
        """Return whether the body may be at rest at an orientation w, x, y, z, shape (4,)."""
        cosine = min(abs(float(self.quaternion @ quaternion)), 1.0)
        off = 2 * np.arccos(cosine)
        return off < 2 * self.quaternion_sd and bool((np.abs(self.spin) < self.spin_sd).all())


def initial_turn(sensed: SensedSignal, stamp_ns: int) -> InitialTurn | None:
    """Estimate it from the first x and z axes in the world frame; None if undetermined."""
    values = sensed.signal.values
    good = np.isfinite(values).all(axis=1)
    turns = Rotation.from_matrix(rotations(values[good]))
    since_first = (turns[0].inv() * turns).as_rotvec()
    is_far = np.linalg.norm(since_first, axis=1) > _MAX_RAD
    count = int(np.argmax(is_far)) if is_far.any() else len(is_far)
    stamps = sensed.signal.stamps_ns[good][:count]
    # of a rotation, three numbers; of the two axes, six, each moved by two thirds of its variance
    noise = float(np.sqrt(1.5 * np.mean([noise_of(column) ** 2 for column in values[good].T])))
    parts = [
        beginning((stamps, since_first[:count, axis]), None, stamp_ns, noise) for axis in range(3)
    ]
    known = [one for one in parts if one is not None]
    if len(known) < 3:
        return None
    values, sds = (np.array([one[place] for one in known]) for place in (0, 1))
    first = turns[0] * Rotation.from_rotvec(values[:, 0])
    quaternion = np.roll(first.as_quat(), 1)
    return InitialTurn(quaternion, float(sds[:, 0].max()) / 2, values[:, 1], sds[:, 1])
