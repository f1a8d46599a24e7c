"""MuJoCo's implementation of `recorders.simulators.base.Engine`."""

from __future__ import annotations

from recorders.simulators.installed import named_version
from recorders.simulators.mujoco.arm import inverse_dynamics, position_control
from recorders.simulators.mujoco.ball import MujocoBallWorld

__all__ = ["ball_world", "inverse_dynamics", "name", "position_control"]

name = named_version("mujoco")

ball_world = MujocoBallWorld
