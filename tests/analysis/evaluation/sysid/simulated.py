"""An owner's model with the true values, simulated as plainly as MuJoCo can be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tunenet_logs.analysis.evaluation.worlds.machines import HeldCommands, ModelLog
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.mujoco import mujoco


@dataclass(frozen=True, eq=False)
class Simulated:
    """Motion of a model, from the log's start on.

    Attributes:
        seconds: of positions, shape (T,).
        late_s: by which velocities are half a step behind the others.
        places: joints' or a free body's positions, shape (T, Q).
        speeds: shape (T, V).
    """

    seconds: Array
    late_s: float
    places: Array
    speeds: Array


def true_model(log: ModelLog) -> Any:
    """The owner's model with the true values."""
    model = mujoco().MjModel.from_xml_string(log.model)
    for address, value in log.truth.items():
        kind, _, rest = address.partition("/")
        name, _, field = rest.partition(".")
        if kind == "joint":
            getattr(model, f"dof_{field}")[model.joint(name).dofadr[0]] = value
        elif kind == "body":
            body = model.body(name).id
            model.body_inertia[body] *= value / model.body_mass[body]
            model.body_mass[body] = value
        elif kind == "geom":
            model.geom(name).friction[0] = value
    mujoco().mj_setConst(model, mujoco().MjData(model))
    return model


def simulated(log: ModelLog, places: Array, speeds: Array) -> Simulated:
    """The model's motion from this state on.

    Args:
        log: with commands or without.
        places: first of all positions of the state; the rest are the model's, shape (Q,).
        speeds: likewise, shape (V,).
    """
    model = true_model(log)
    data, step_s = mujoco().MjData(model), model.opt.timestep
    data.qpos[: len(places)], data.qvel[: len(speeds)] = places, speeds
    last_s = max(one.seconds[-1] for one in log.episode.signals.values())
    count = int(last_s / step_s) + 2
    control = np.zeros((count, model.nu))
    if (told := log.episode.signals.get("/joint_commands.position")) is not None:
        held = HeldCommands(told.seconds, told.values)
        control = held.over_steps(step_s, count, log.truth["delay/commands"])
    rows = []
    for row in control:
        data.ctrl[:] = row
        where, fast = data.qpos.copy(), data.qvel.copy()
        mujoco().mj_step(model, data)
        rows.append((where, fast))
    kinds = [np.array([row[kind] for row in rows]) for kind in range(2)]
    exact = model.opt.integrator == mujoco().mjtIntegrator.mjINT_RK4
    return Simulated(np.arange(count) * step_s, 0.0 if exact else step_s / 2, *kinds)


def read(seconds: Array, values: Array, at: Array) -> Array:
    """Simulated values of shape (S, C) at a sensor's times of shape (T,), shape (T, C)."""
    return np.column_stack([np.interp(at, seconds, column) for column in values.T])


def off(values: Array, log: ModelLog, name: str) -> float:
    """Largest rms difference of a column from what a sensor without noise reads, over its noise."""
    apart = (values - log.clean[name]) / log.noise[name]
    return float(np.max(np.sqrt(np.mean(apart**2, axis=0))))
