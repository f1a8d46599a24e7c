"""Motions with pauses, whose truth is known: an arm that stops on its way."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tests.analysis.payload.arm_logs import FULL_HZ
from tunenet_logs.recorders.simulators.arm.path import JointPath, eased

EASED_S = 0.8


def paused(
    path: JointPath,
    cuts_s: Sequence[float],
    pause_s: float = 2.0,
    *,
    before_s: float = 0.0,
    after_s: float = 0.0,
) -> JointPath:
    """The same way with stops at some of its times; from rest to rest."""
    edges = [0, *(round(cut * FULL_HZ) for cut in cuts_s), len(path.seconds) - 1]
    parts = [
        eased(path.part(slice(begin, end + 1)), EASED_S, FULL_HZ) for begin, end in pairwise(edges)
    ]
    rows = [np.zeros((0, 3, path.position_rad.shape[1]))]
    for index, part in enumerate(parts):
        rows.append(_at_rest(part, 0, pause_s if index else before_s))
        fields = (part.position_rad, part.velocity_rad_s, part.acceleration_rad_s2)
        rows.append(np.stack(fields, axis=1)[:-1])
    rows.append(_at_rest(parts[-1], -1, after_s + 1 / FULL_HZ))
    position, velocity, acceleration = np.moveaxis(np.concatenate(rows), 1, 0)
    return JointPath(np.arange(len(position)) / FULL_HZ, position, velocity, acceleration)


def _at_rest(part: JointPath, row: int, seconds: float) -> np.ndarray:
    """Position and zeros for so long, shape (T, 3, J)."""
    rest = np.zeros((round(seconds * FULL_HZ), 3, part.position_rad.shape[1]))
    rest[:, 0] = part.position_rad[row]
    return rest
