"""A pendulum that no engine simulated: logs and models; a simulator that is a function."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from tunenet_logs.analysis.sysid.columns import Column, ComparedColumns, noise_of
from tunenet_logs.analysis.sysid.least_squares import Run
from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.base import Parameter

START_NS = 1_700_000_000_000_000_000
MASS_KG, LENGTH_M, INERTIA_KG_M2 = 1.0, 0.4, 0.005
DAMPING = 0.06
FLOOR = '<geom type="plane" size="1 1 .1" pos="0 0 -0.6"/>'
SHAPES = """
<geom type="capsule" size=".012" fromto="0 0 0 0 0 -.4"/>
<geom type="sphere" size=".06" pos="0 0 -.4"/>
<geom type="mesh" mesh="fin" pos="0 0 -.4"/>
"""
MODEL = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <asset><mesh name="fin" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset>
  <worldbody>{floor}
    <body name="bob"><joint name="hinge" type="hinge" axis="0 -1 0"/>
      <inertial pos="0 0 -0.4" mass="1" diaginertia=".005 .005 .005"/>{shapes}
    </body>
  </worldbody>
</mujoco>
"""


def model_source(folder: Path, *, has_shapes: bool = True) -> ModelSource:
    """The pendulum's model in a file, its damping to be tuned."""
    text = MODEL.format(floor=FLOOR, shapes=SHAPES) if has_shapes else MODEL
    path = folder / "pendulum.xml"
    path.write_text(text.replace("{floor}", "").replace("{shapes}", ""))
    return ModelSource(path, ("joint/hinge.damping=0:.2",))


def swing(seconds: Array) -> Array:
    """Angle and speed of the pendulum, shape (T, 2)."""
    inertia = MASS_KG * LENGTH_M**2 + INERTIA_KG_M2

    def slope(_: float, state: Array) -> list[float]:
        weight = -MASS_KG * 9.81 * LENGTH_M * np.sin(state[0])
        return [state[1], (weight - DAMPING * state[1]) / inertia]

    until = (0.0, float(seconds[-1]))
    solved = solve_ivp(slope, until, [1.4, 0.0], t_eval=seconds, rtol=1e-8, atol=1e-9)
    return solved.y.T


def pendulum_episode(spoiled: float = 0.0) -> Episode:
    """Four seconds of joint states; with a motion in them that no pendulum makes."""
    seconds = np.arange(0.0, 4.0, 0.01)
    values = swing(seconds) + 0.01 * np.random.default_rng(0).standard_normal((len(seconds), 2))
    values += spoiled * np.sin(40 * seconds)[:, None]
    stamps = (START_NS + seconds * 1e9).astype(np.int64)
    signals = [
        Signal("/joint_states.position", stamps, values[:, :1], ("hinge",), "rad"),
        Signal("/joint_states.velocity", stamps, values[:, 1:], ("hinge",), "rad/s"),
    ]
    return Episode(EpisodeInfo(), {one.name: one for one in signals})


SECONDS = np.linspace(0, 10, 400)
Shape = Callable[[Array], Array]


def target_of(values: Array) -> ComparedColumns:
    spread = float(np.std(values))
    return ComparedColumns(0, (Column("s", "c", "m", SECONDS, values, noise_of(values), spread),))


def run_of(shape: Shape) -> Run:
    return lambda rows: np.stack([shape(row) for row in rows])


def parameter(name: str, low: float = -5.0, high: float = 5.0) -> Parameter:
    return Parameter(name, "1", (low, high), (low, high), (low + high) / 2)


def line(values: Array) -> Array:
    return values[0] + values[1] * np.sin(SECONDS)
