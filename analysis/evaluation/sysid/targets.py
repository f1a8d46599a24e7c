"""Machines: what is tuned of each, what is unidentifiable from a log, and wrong models."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from analysis.evaluation.sysid.arm_logs import arm_log, arm_with_a_brake
from analysis.evaluation.sysid.model_log import ModelLog
from analysis.evaluation.sysid.pendulum import pendulum_log, pendulum_of_unknown_mass
from analysis.evaluation.sysid.sliding_block import block_log, block_of_unknown_mass
from analysis.evaluation.sysid.wrong_models import wrong_arms, wrong_blocks, wrong_pendulums


@dataclass(frozen=True)
class Machine:
    """Kind of machine.

    Attributes:
        name: in words.
        log: of a seed and so many times the usual noise.
        untold: the same with one more parameter, which is unidentifiable.
        wrong: texts of models that are of another machine than a log's, by what is wrong.
    """

    name: str
    log: Callable[[int, float], ModelLog]
    untold: Callable[[int, float], ModelLog]
    wrong: Callable[[ModelLog], Mapping[str, str]]


# `log` and `untold` give the same for the same seed and noise, whatever else is drawn.
MACHINES = (
    Machine("pendulum", pendulum_log, pendulum_of_unknown_mass, wrong_pendulums),
    Machine("arm", arm_log, arm_with_a_brake, wrong_arms),
    Machine("block", block_log, block_of_unknown_mass, wrong_blocks),
)
