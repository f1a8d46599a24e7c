"""Make models of other machines, with which no tuning may be content."""

from __future__ import annotations

import numpy as np

from analysis.evaluation.sysid.arm_logs import arm_model
from analysis.evaluation.sysid.model_log import GRAVITY_M_S2, ModelLog
from analysis.evaluation.sysid.pendulum import pendulum_model
from analysis.evaluation.sysid.planar_arm import LINKS_M
from analysis.evaluation.sysid.sliding_block import FRICTION, MAX_FRICTION, block_model

_MOON, _MARS = 1.62, 3.7

_GRAVITIES = {
    "gravity of 1.62 m/s²": f"0 0 -{_MOON}",
    "gravity of 3.7 m/s²": f"0 0 -{_MARS}",
    "gravity turned by 90 degrees": f"-{GRAVITY_M_S2} 0 0",
}

_OFF = 0.3  # by how much of their lengths another arm's links are off
# Over the largest friction looked for, what a model with too little gravity must need.
_BEYOND = 1.1


def wrong_pendulums(log: ModelLog) -> dict[str, str]:
    """Return texts of models for any log, by what is wrong."""
    del log
    return {name: pendulum_model(gravity=gravity) for name, gravity in _GRAVITIES.items()}


def wrong_arms(log: ModelLog) -> dict[str, str]:
    """Return wrong models for an arm's log: a missing elbow is welded where the log begins."""
    models = {name: arm_model(gravity=gravity) for name, gravity in _GRAVITIES.items()}
    angle_rad = float(log.episode.signals["/joint_states.position"].values[0, 1])
    models["no elbow"] = arm_model(welded_rad=angle_rad)
    for name, factor in (("longer", 1 + _OFF), ("shorter", 1 - _OFF)):
        first_m, second_m = (factor * np.array(LINKS_M)).tolist()
        models[f"links 30 % {name}"] = arm_model(links_m=(first_m, second_m))
    return models


def wrong_blocks(log: ModelLog) -> dict[str, str]:
    """Return wrong models for a block's log, but those that slide alike with other friction.

    A slide determines friction times gravity alone, so that less gravity is seen only where the
    friction that makes up for it is out of range.
    """
    models = {name: block_model(gravity=gravity) for name, gravity in _GRAVITIES.items()}
    for name, gravity_m_s2 in zip(_GRAVITIES, (_MOON, _MARS), strict=False):
        if log.truth[FRICTION] * GRAVITY_M_S2 / gravity_m_s2 < _BEYOND * MAX_FRICTION:
            del models[name]
    return models
