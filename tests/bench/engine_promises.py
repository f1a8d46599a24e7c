"""Check the engines' promised accuracies by measurement: docs/engines.md's second table.

`python -m tests.bench.engine_promises` measures MuJoCo's simulator and its exported file on drops
and throws that no constant was chosen on, its torques beside Pinocchio's, and the cost of its steps
beside a bare loop.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tunenet_logs.analysis.evaluation.studies.engines import (
    CLOCK,
    fine_seconds,
    integrated_m,
    rebound_restitution,
    simulated_m,
)
from tunenet_logs.analysis.evaluation.worlds.ball import TABLE_BALLS, fallen
from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions, exported
from tunenet_logs.analysis.export.mujoco import ball_text
from tunenet_logs.analysis.record import Estimate, Rebound, Record
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload, jaco, read_arm
from tunenet_logs.recorders.simulators.arm.path import random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED, GRAVITY_M_S2, UPRIGHT_GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import engine, simulated_by

library: Any = mujoco
dynamics: Any = import_module("pinocchio")

DROPS, SEED = 40, 20_261  # heights, radii and throws are drawn anew: none is a test's
HEIGHTS_M, RADII_M, SPEEDS_M_S = (0.2, 5.0), (0.01, 0.2), (1.5, 10.0)
SET = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
EXPORTED = SET[1:]
SLIDING, STICKING = 0.1, 1.0  # coefficients of friction of the throws
BOUNCES = 4
STEPS, STEP_S, ROUNDS = 6_400, 1 / 240, 60
HELD = (None, Payload(0.8, (0.03, -0.02, 0.01)), Payload(2.0))
PATHS = 5


@dataclass(frozen=True)
class Promised:
    """Line of the table: the largest that is allowed, and what was seen."""

    what: str
    unit: str
    limit: float
    seen: float

    def line(self) -> str:
        """Format the line, marking what is missed."""
        kept = "" if self.seen <= self.limit else "  MISSED"
        return f"{self.what:66}{self.limit:10.4g}{self.seen:12.3g} {self.unit:5}{kept}"


def drawn(low_high: tuple[float, float], seed: int) -> list[float]:
    """Draw `DROPS` numbers, uniform in their logarithm."""
    low, high = np.log(low_high)
    return np.exp(np.random.default_rng([SEED, seed]).uniform(low, high, DROPS)).tolist()


def heights_and_radii() -> Iterator[tuple[float, float]]:
    return zip(drawn(HEIGHTS_M, 1), drawn(RADII_M, 2), strict=True)


def simulator() -> Promised:
    worst = 0.0
    for height_m, radius_m in heights_and_radii():
        seconds = fine_seconds(height_m)
        rig = DropRig(gap_m=height_m, radius_m=radius_m, times_s=tuple(seconds.tolist()))
        dropped = DropSimulator(rig, CALIBRATED, engine("mujoco").ball_world(radius_m, CALIBRATED))
        for restitution in SET:
            episode = dropped.rollout({"restitution": restitution})
            heights_m = episode.signals[TOPIC].values[:, 2] - radius_m
            worst = max(worst, abs(rebound_restitution(heights_m) - restitution))
    return Promised("(a) simulator: effective - set restitution, .1 to 1", "", 0.002, worst)


def scene(restitution: float, radius_m: float = 0.02) -> tuple[Any, Any]:
    """Load the exported file of a ball, and a state of it."""
    record = Record(
        log="made.mcap",
        task="drop",
        verdict="ok",
        reason=None,
        estimates=(Estimate("restitution", "1", restitution, None),),
        rebounds=(Rebound(0.0, restitution, None, math.sqrt(2 * GRAVITY_M_S2)),),
    )
    item = exported(record, ExportOptions(radius_m=radius_m))
    assert isinstance(item, ExportedBall)
    model = library.MjModel.from_xml_string(ball_text(item.in_air()))
    return model, library.MjData(model)


def file_rebounds() -> Promised:
    """Measure rebounds by the energy right after the impact."""
    worst = 0.0
    for height_m, radius_m in heights_and_radii():
        for restitution in EXPORTED:
            model, data = scene(restitution, radius_m)
            data.qpos[2] = radius_m + height_m
            step_until_it_rises(model, data)
            energy = data.qvel[2] ** 2 / 2 + GRAVITY_M_S2 * (data.qpos[2] - radius_m)
            found = math.sqrt(energy / (GRAVITY_M_S2 * height_m))
            worst = max(worst, abs(found - restitution))
    return Promised("(b) file, stepped plainly: effective - tuned, .2 to 1", "", 0.005, worst)


def step_until_it_rises(model: Any, data: Any) -> None:
    while data.qvel[2] <= 0:
        library.mj_step(model, data)


@dataclass(frozen=True)
class Throw:
    """Ball without spin that hits the floor at an angle."""

    along_m_s: float
    down_m_s: float

    def left_m_s(self, restitution: float, friction: float) -> float:
        """Return the speed along the floor that a rigid solid ball keeps."""
        most = friction * (1 + restitution) * self.down_m_s  # that Coulomb's law takes
        return self.along_m_s - min(2 / 7 * self.along_m_s, most)


def throws() -> list[Throw]:
    ratios = np.random.default_rng([SEED, 3]).uniform(0.05, 2.0, DROPS).tolist()
    downs_m_s = drawn(SPEEDS_M_S, 4)
    return [Throw(ratio * down, down) for ratio, down in zip(ratios, downs_m_s, strict=True)]


def slid_in_file(throw: Throw, restitution: float, friction: float) -> float:
    """Return the speed along the floor after an impact, of a ball let go 10 mm over it."""
    model, data = scene(restitution)
    model.pair_friction[0, :2] = friction
    data.qpos[2] = 0.02 + 0.01
    data.qvel[0] = throw.along_m_s
    data.qvel[2] = -math.sqrt(throw.down_m_s**2 - 2 * GRAVITY_M_S2 * 0.01)
    step_until_it_rises(model, data)
    return float(data.qvel[0])


def slid_in_simulator(throw: Throw, restitution: float, friction: float) -> float:
    """Return that speed by the impact of a simulated shot."""
    world = engine("mujoco").ball_world(0.02, CALIBRATED)
    before_m_s = np.array([throw.along_m_s, 0.0, -throw.down_m_s])
    after_m_s, _ = world.impact(before_m_s, np.zeros(3), restitution, friction, 0.4)
    return float(after_m_s[0])


def slip() -> Iterator[Promised]:
    """Yield the relative errors of the speed along the floor."""
    for name, slid in (("simulator", slid_in_simulator), ("file", slid_in_file)):
        for friction, law in ((STICKING, "5/7 of the speed"), (SLIDING, "Coulomb's law")):
            worst = max(
                abs(slid(throw, one, friction) / throw.left_m_s(one, friction) - 1)
                for one in (0.3, 0.6, 0.9)
                for throw in throws()
            )
            what = f"(c) {name}, friction {friction:g}: slip, against {law}"
            yield Promised(what, "%", 3, 100 * worst)


def file_rest() -> Iterator[Promised]:
    """Measure 10 s of rest, after 5 s in which the ball bounces and comes to rest."""
    jitter_m = sinking_m = 0.0
    for restitution in (0.0, 0.3, 0.6, 0.8):
        model, data = scene(restitution)
        data.qpos[2] = 0.02 + 0.1
        step_s = float(model.opt.timestep)
        library.mj_step(model, data, round(5 / step_s))
        heights_m = []
        for _ in range(1000):
            library.mj_step(model, data, round(0.01 / step_s))
            heights_m.append(float(data.qpos[2]) - 0.02)
        jitter_m = max(jitter_m, max(heights_m) - min(heights_m))
        sinking_m = max(sinking_m, -min(heights_m))
    yield Promised("(d) file, at rest for 10 s: jitter", "mm", 0.1, 1e3 * jitter_m)
    yield Promised("(d) file, at rest for 10 s: sinking", "mm", 1, 1e3 * sinking_m)


def air() -> Promised:
    """Measure balls of a table, with slope and drag, up to the impact that ends their bounces."""
    worst_m = 0.0
    for table_ball in TABLE_BALLS:
        for height_m in drawn(HEIGHTS_M, 5):
            ball = table_ball.dropped(height_m)
            impacts_s = CLOCK * fallen(ball.values[None], 20.0).impacts_s[0]
            seconds = np.arange(0.0, float(impacts_s[BOUNCES]), 1 / 240)
            off_m = simulated_m("mujoco", ball, seconds) - integrated_m(ball, seconds)
            worst_m = max(worst_m, float(np.abs(off_m).max()))
    what = f"(e) simulator: slope and drag, {BOUNCES} bounces of {len(TABLE_BALLS)} kinds of balls"
    return Promised(what, "mm", 0.2, 1e3 * worst_m)


def arms() -> Iterator[tuple[str, Arm]]:
    """Yield the shipped arm, and those that come with PyBullet where it is installed."""
    yield "Jaco", jaco()
    try:
        import pybullet_data  # pyright: ignore[reportMissingImports]  (not on every Python)
    except ModuleNotFoundError:
        return
    folder = Path(pybullet_data.getDataPath())
    yield "iiwa", read_arm(folder / "kuka_iiwa" / "model.urdf", "lbr_iiwa_link_7")
    yield "Panda", read_arm(folder / "franka_panda" / "panda.urdf", "panda_hand")


def torques(name: str, arm: Arm) -> Promised:
    worst_nm = 0.0
    for payload in HELD:
        model = dynamics.buildModelFromXML(arm.urdf(payload))
        model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
        data = model.createData()
        for seed in range(SEED, SEED + PATHS):
            path = random_path(arm, seed)
            with simulated_by("mujoco"):
                found_nm = joint_efforts_nm(arm, path, payload)
            motion = (path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2)
            rows = zip(*motion, strict=True)
            known_nm = np.stack([dynamics.rnea(model, data, *row).copy() for row in rows])
            worst_nm = max(worst_nm, float(np.abs(found_nm - known_nm).max()))
    return Promised(f"(f) torques of a {name}, MuJoCo - Pinocchio", "N·m", 1e-6, worst_nm)


def cost() -> Promised:
    """Measure the CPU time of a world's steps over a bare loop's, least of many."""
    world: Any = engine("mujoco").ball_world(0.05, CALIBRATED)
    model, data = (vars(world)[name] for name in ("_model", "_data"))
    step = library.mj_step
    ours_s, bare_s = [], []
    for _ in range(ROUNDS):
        world.place(1.0, 0.7)
        begin_s = time.process_time()
        world.steps(STEP_S, STEPS)
        ours_s.append(time.process_time() - begin_s)
        world.place(1.0, 0.7)  # the model keeps the time step and the contact
        begin_s = time.process_time()
        for _ in range(STEPS):
            step(model, data)
        bare_s.append(time.process_time() - begin_s)
    what = f"(g) {STEPS} steps over a bare loop, least of {ROUNDS} each"
    return Promised(what, "", 1.3, min(ours_s) / min(bare_s))


def main() -> None:
    """Print every line as soon as it is measured."""

    def rows() -> Iterator[Promised]:
        yield simulator()
        yield file_rebounds()
        yield from slip()
        yield from file_rest()
        yield air()
        for name, arm in arms():
            yield torques(name, arm)
        yield cost()

    drops = f"{library.__name__} {library.__version__}, {DROPS} drops of .2 to 5 m; worst of all"
    print(f"{drops:66}{'promised':>10}{'seen':>12}")
    for row in rows():
        print(row.line(), flush=True)


if __name__ == "__main__":
    main()
