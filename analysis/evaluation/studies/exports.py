"""Drop balls in the engines: does one bounce as its restitution says?

Measured are PyBullet's contact settings, the file that `tunenet-export` writes for each engine, and
what docs/engines.md promises of MuJoCo, on drops and throws that no constant was chosen on.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from tunenet_logs.analysis.evaluation.studies.engines import (
    CLOCK,
    fine_seconds,
    integrated_m,
    rebound_restitution,
    simulated_m,
)
from tunenet_logs.analysis.evaluation.study import Order, Part, Row, listed, scored
from tunenet_logs.analysis.evaluation.worlds.ball import TABLE_BALLS, fallen
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions, exported
from tunenet_logs.analysis.export.mujoco import ball_text
from tunenet_logs.analysis.export.registry import (
    FORMATS,
    CanDrop,
    ExportFormat,
    export_format,
    texts,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.record import Estimate, Rebound, Record
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload, jaco, read_arm
from tunenet_logs.recorders.simulators.arm.path import random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import (
    CALIBRATED,
    GRAVITY_M_S2,
    PAPER,
    UPRIGHT_GRAVITY_M_S2,
    ContactSettings,
)
from tunenet_logs.recorders.simulators.known import engine, simulated_by
from tunenet_logs.terminal import Progress


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Measure section by section; only the promises are drawn from the first seed."""
    for section in order.sections:
        count = order.targets_of("exports", section)
        if section == "contact":
            cases = [Piece((label, count), 1, label) for label in CONTACTS]
            title = f"Worst |effective - set| in PyBullet, {count} drops of 0.3 to 5 m"
            rows = scored(contact_row, {"": cases}, order, progress, ("contact", "setting"))[""]
        elif section == "files":
            engines = [one for one in map(export_format, FORMATS) if one.LIBRARY is not None]
            missing = [one.NAME for one in engines if not find_spec(one.LIBRARY or "")]
            files = [
                Piece((one.NAME, use, count), 1, use.label)
                for one in engines
                for use in (() if one.NAME in missing else uses(one))
            ]
            # one after the other in a process, as its time is measured
            alone = replace(order, jobs=1)
            rows = scored(file_row, {"": files}, alone, progress, ("dropping", "file"))[""]
            title = f"Worst |effective - wanted|, {count} heights from .3 to 3 m"
            title += f"; not run: {', '.join(missing)}" if missing else ""
        else:
            draws = _Draws(_SEEDS + order.seeds[0], count)
            measures = (_simulator, _file_rebounds, _slip, _file_rest, _air, _torques, _cost)
            asked = [Piece((measure, draws)) for measure in measures]
            rows = scored(measured, {"": asked}, order, progress, ("measuring", "promise"))[""]
            version = import_module("mujoco").__version__
            title = f"MuJoCo {version}, {count} drops of .2 to 5 m; worst of all"
        yield Part(section, listed(rows, title), rows)


# ---- Contact settings of PyBullet: effective restitution by the energies in mid-flight.

_FIXED = replace(CALIBRATED, meet_impacts=False)
# Settings, and steps a second.
CONTACTS: Mapping[str, tuple[ContactSettings, float]] = {
    "defaults, 60 Hz (the paper's)": (PAPER, 60.0),
    "defaults, 240 Hz": (PAPER, 240.0),
    "calibrated, fixed steps, 240 Hz": (_FIXED, 240.0),
    "calibrated, fixed steps, 960 Hz": (_FIXED, 960.0),
    "calibrated, impacts met, 240 Hz": (CALIBRATED, 240.0),
}


def contact_row(case: tuple[str, int]) -> list[Row]:
    """Compute the worst difference of effective and set restitution over so many drops."""
    label, count = case
    off = {
        f"{one:g}": max(
            abs(_effective(*CONTACTS[label], gap_m, one) - one)
            for gap_m in np.geomspace(0.3, 5.0, count).tolist()
        )
        for one in (0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0)
    }
    return [{"set": label, **off}]


def _effective(contact: ContactSettings, rate_hz: float, gap_m: float, restitution: float) -> float:
    rig = DropRig(gap_m=gap_m, radius_m=0.05, rate_hz=rate_hz, samples=int(2.2 * rate_hz))
    values = DropSimulator(rig, contact).rollout({"restitution": restitution}).signals[TOPIC].values
    curve = values[:, 2] - rig.radius_m
    gravity = contact.gravity_m_s2
    fall = np.sqrt(2 * gap_m / gravity) * rate_hz
    before, after = (
        gravity * curve[at] + ((curve[at + 1] - curve[at - 1]) * rate_hz / 2) ** 2 / 2
        for at in (int(fall / 2), int(fall * (1 + restitution)) + 1)
    )
    return float(np.sqrt(max(after, 0.0) / before))


# ---- Exported files: each drops its ball as a user would let it.
# The balls are simulated, recorded and tuned. Effective is the root of the first rebound's height
# over the drop's.

WANTED = (0.2, 0.3, 0.5, 0.7, 0.9)


class Use(NamedTuple):
    """Way to use an engine's file."""

    label: str  # in the table
    step: str  # in words
    step_s: float | None = None  # given to the file; None for its own
    # Whether each height has a file for its own impact's speed; else it is meant for 1 m.
    for_each: bool = False
    how: tuple[tuple[str, float], ...] = ()  # passed on to `dropped`


def uses(engine: ExportFormat) -> list[Use]:
    """List an engine's file as it comes, and what goes wrong with it."""
    if engine.NAME == "drake":  # by its model, restitution depends on speed
        return [
            Use("drake, a file for 1 m", "continuous"),
            Use("drake, a file for each height", "continuous", for_each=True),
            Use("drake, discrete", "1/1000 s", for_each=True, how=(("step_s", 1e-3),)),
        ]
    step_s = engine.STEP_S
    assert step_s is not None
    return [
        Use(engine.NAME, f"1/{1 / step_s:.0f} s"),
        Use(f"{engine.NAME}, coarse", "1/240 s", step_s=1 / 240),
    ]


def file_row(case: tuple[str, Use, int]) -> list[Row]:
    """Compute the worst differences over so many heights, and the least ms a simulated second."""
    name, use, count = case
    row: Row = {"engine": use.label, "step": use.step}
    heights_m, costs_ms = np.geomspace(0.3, 3.0, count).tolist(), []
    for wanted in WANTED:
        found = [rebound(export_format(name), use, tuned(wanted), one) for one in heights_m]
        row[f"e = {wanted:g}"] = max(abs(one - wanted) for one, _ in found)
        costs_ms += [cost_ms for _, cost_ms in found]
    return [{**row, "ms_per_s": min(costs_ms)}]


@cache
def tuned(restitution: float) -> Record:
    """Tune a ball that fell 1 m in a simulation, recorded for 3 s at 240 Hz."""
    order = DropOrder(restitution=restitution, height_m=1.0, rate_hz=240.0, seconds=3.0)
    return record_of(tune_episode(simulate_drop(order), TuneOptions(task="drop")))


def rebound(engine: ExportFormat, use: Use, record: Record, height_m: float) -> tuple[float, float]:
    """Return the effective restitution of the file's ball, and ms a simulated second."""
    speed_m_s = math.sqrt(2 * GRAVITY_M_S2 * height_m) if use.for_each else None
    item = _ball(record, ExportOptions(speed_m_s=speed_m_s, step_s=use.step_s))
    item = item.in_air() if hasattr(engine, "HAS_AIR") else item
    seconds = math.sqrt(2 * height_m / GRAVITY_M_S2) * (1.2 + 2 * item.restitution)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"ball{engine.SUFFIX}"
        for suffix, text in texts(engine, item).items():
            path.with_suffix(suffix).write_text(text)
        begin_s = time.perf_counter()
        _, heights_m = cast("CanDrop", engine).dropped(path, height_m, seconds, **dict(use.how))
        took_s = time.perf_counter() - begin_s
    return rebound_restitution(heights_m), 1e3 * took_s / seconds


def _ball(record: Record, options: ExportOptions) -> ExportedBall:
    item = exported(record, options)
    assert isinstance(item, ExportedBall)
    return item


# ---- Promises of MuJoCo: its simulator, its exported file, its torques beside Pinocchio's.

_SEEDS = 20_260  # heights, radii and throws are drawn from these and a seed: none is a test's
_TENTHS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def measured(case: tuple[Callable[[_Draws], Iterator[Row]], _Draws]) -> list[Row]:
    """Measure some of the promises."""
    measure, draws = case
    return list(measure(draws))


def promised(what: str, unit: str, limit: float, seen: float) -> Row:
    """Compare the largest that is allowed with the largest of all."""
    return {"what": what, "promised": limit, "seen": seen, "unit": unit, "kept": seen <= limit}


class _Draws(NamedTuple):
    """What is drawn anew for each seed."""

    seed: int
    drops: int

    def numbers(self, low: float, high: float, which: int) -> list[float]:
        """Draw `drops` numbers, uniform in their logarithm."""
        rng = np.random.default_rng([self.seed, which])
        return np.exp(rng.uniform(np.log(low), np.log(high), self.drops)).tolist()

    def sizes(self) -> Iterator[tuple[float, float]]:
        """Yield heights and radii."""
        return zip(self.numbers(0.2, 5.0, 1), self.numbers(0.01, 0.2, 2), strict=True)

    def throws(self) -> list[tuple[float, float]]:
        """Draw speeds along the floor and down to it [m/s]."""
        rng = np.random.default_rng([self.seed, 3])
        ratios = rng.uniform(0.05, 2.0, self.drops).tolist()
        downs = self.numbers(1.5, 10.0, 4)
        return [(ratio * down, down) for ratio, down in zip(ratios, downs, strict=True)]


def _simulator(draws: _Draws) -> Iterator[Row]:
    worst = 0.0
    for height_m, radius_m in draws.sizes():
        rig = DropRig(height_m, radius_m, times_s=tuple(fine_seconds(height_m).tolist()))
        dropped = DropSimulator(rig, CALIBRATED, engine("mujoco").ball_world(radius_m, CALIBRATED))
        for restitution in _TENTHS:
            episode = dropped.rollout({"restitution": restitution})
            heights_m = episode.signals[TOPIC].values[:, 2] - radius_m
            worst = max(worst, abs(rebound_restitution(heights_m) - restitution))
    yield promised("(a) simulator: effective - set restitution, .1 to 1", "", 0.002, worst)


def _file_rebounds(draws: _Draws) -> Iterator[Row]:
    """Measure rebounds by the energy right after the impact."""
    worst = 0.0
    for height_m, radius_m in draws.sizes():
        for restitution in _TENTHS[1:]:
            model, data = _scene(restitution, radius_m)
            data.qpos[2] = radius_m + height_m
            _step_until_it_rises(model, data)
            energy = data.qvel[2] ** 2 / 2 + GRAVITY_M_S2 * (data.qpos[2] - radius_m)
            found = math.sqrt(energy / (GRAVITY_M_S2 * height_m))
            worst = max(worst, abs(found - restitution))
    yield promised("(b) file, stepped plainly: effective - tuned, .2 to 1", "", 0.005, worst)


def _scene(restitution: float, radius_m: float = 0.02) -> tuple[Any, Any]:
    """Load the exported file of a ball, and a state of it."""
    found = (Estimate("restitution", "1", restitution, None),)
    rebounds = (Rebound(0.0, restitution, None, math.sqrt(2 * GRAVITY_M_S2)),)
    record = Record("made.mcap", "drop", "ok", None, found, rebounds=rebounds)
    item = _ball(record, ExportOptions(radius_m=radius_m))
    library = import_module("mujoco")
    model = library.MjModel.from_xml_string(ball_text(item.in_air()))
    return model, library.MjData(model)


def _step_until_it_rises(model: Any, data: Any) -> None:
    step = import_module("mujoco").mj_step
    while data.qvel[2] <= 0:
        step(model, data)


def kept_m_s(along_m_s: float, down_m_s: float, restitution: float, friction: float) -> float:
    """Return the speed along the floor that a rigid solid ball without spin keeps."""
    most = friction * (1 + restitution) * down_m_s  # that Coulomb's law takes
    return along_m_s - min(2 / 7 * along_m_s, most)


def slid_in_file(along_m_s: float, down_m_s: float, restitution: float, friction: float) -> float:
    """Return that speed after an impact of the file's ball, let go 10 mm over the floor."""
    model, data = _scene(restitution)
    model.pair_friction[0, :2] = friction
    data.qpos[2] = 0.02 + 0.01
    data.qvel[0] = along_m_s
    data.qvel[2] = -math.sqrt(down_m_s**2 - 2 * GRAVITY_M_S2 * 0.01)
    _step_until_it_rises(model, data)
    return float(data.qvel[0])


def slid_in_simulator(
    along_m_s: float, down_m_s: float, restitution: float, friction: float
) -> float:
    """Return that speed by the impact of a simulated shot."""
    world = engine("mujoco").ball_world(0.02, CALIBRATED)
    before_m_s = np.array([along_m_s, 0.0, -down_m_s])
    after_m_s, _ = world.impact(before_m_s, np.zeros(3), restitution, friction, 0.4)
    return float(after_m_s[0])


def _slip(draws: _Draws) -> Iterator[Row]:
    """Yield the relative errors of the speed along the floor."""
    for name, slid in (("simulator", slid_in_simulator), ("file", slid_in_file)):
        for friction, law in ((1.0, "5/7 of the speed"), (0.1, "Coulomb's law")):
            worst = max(
                abs(slid(*throw, one, friction) / kept_m_s(*throw, one, friction) - 1)
                for one in (0.3, 0.6, 0.9)
                for throw in draws.throws()
            )
            what = f"(c) {name}, friction {friction:g}: slip, against {law}"
            yield promised(what, "%", 3, 100 * worst)


def _file_rest(_draws: _Draws) -> Iterator[Row]:
    """Measure 10 s of rest, after 5 s in which the ball bounces and comes to rest."""
    step = import_module("mujoco").mj_step
    jitter_m = sinking_m = 0.0
    for restitution in (0.0, 0.3, 0.6, 0.8):
        model, data = _scene(restitution)
        data.qpos[2] = 0.02 + 0.1
        step_s = float(model.opt.timestep)
        step(model, data, round(5 / step_s))
        heights_m = []
        for _ in range(1000):
            step(model, data, round(0.01 / step_s))
            heights_m.append(float(data.qpos[2]) - 0.02)
        jitter_m = max(jitter_m, max(heights_m) - min(heights_m))
        sinking_m = max(sinking_m, -min(heights_m))
    yield promised("(d) file, at rest for 10 s: jitter", "mm", 0.1, 1e3 * jitter_m)
    yield promised("(d) file, at rest for 10 s: sinking", "mm", 1, 1e3 * sinking_m)


def _air(draws: _Draws) -> Iterator[Row]:
    """Measure balls of a table, with slope and drag, up to the impact that ends their bounces."""
    worst_m = 0.0
    for table_ball in TABLE_BALLS:
        for height_m in draws.numbers(0.2, 5.0, 5):
            ball = table_ball.dropped(height_m)
            impacts_s = CLOCK * fallen(ball.values[None], 20.0).impacts_s[0]
            seconds = np.arange(0.0, float(impacts_s[4]), 1 / 240)
            off_m = simulated_m("mujoco", ball, seconds) - integrated_m(ball, seconds)
            worst_m = max(worst_m, float(np.abs(off_m).max()))
    what = f"(e) simulator: slope and drag, 4 bounces of {len(TABLE_BALLS)} kinds of balls"
    yield promised(what, "mm", 0.2, 1e3 * worst_m)


def _torques(draws: _Draws) -> Iterator[Row]:
    """Measure the shipped arm, and those that come with PyBullet where it is installed."""
    arms: dict[str, Arm] = {"Jaco": jaco()}
    if find_spec("pybullet_data"):
        folder = Path(import_module("pybullet_data").getDataPath())
        arms["iiwa"] = read_arm(folder / "kuka_iiwa" / "model.urdf", "lbr_iiwa_link_7")
        arms["Panda"] = read_arm(folder / "franka_panda" / "panda.urdf", "panda_hand")
    dynamics = import_module("pinocchio")
    seeds = range(draws.seed, draws.seed + min(5, draws.drops))
    for name, arm in arms.items():
        worst_nm = 0.0
        for payload in (None, Payload(0.8, (0.03, -0.02, 0.01)), Payload(2.0)):
            model = dynamics.buildModelFromXML(arm.urdf(payload))
            model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
            data = model.createData()
            for path in (random_path(arm, seed) for seed in seeds):
                with simulated_by("mujoco"):
                    found_nm = joint_efforts_nm(arm, path, payload)
                motion = (path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2)
                rows = zip(*motion, strict=True)
                known_nm = np.stack([dynamics.rnea(model, data, *row).copy() for row in rows])
                worst_nm = max(worst_nm, float(np.abs(found_nm - known_nm).max()))
        yield promised(f"(f) torques of a {name}, MuJoCo - Pinocchio", "N·m", 1e-6, worst_nm)


def _cost(draws: _Draws) -> Iterator[Row]:
    """Measure the CPU time of a world's steps over a bare loop's, least of many."""
    world: Any = engine("mujoco").ball_world(0.05, CALIBRATED)
    model, data = (vars(world)[name] for name in ("_model", "_data"))
    step = import_module("mujoco").mj_step

    def bare() -> None:
        for _ in range(steps):
            step(model, data)

    ours_s, bare_s = [], []
    steps, rounds = 6_400, min(60, 2 * draws.drops)
    for _ in range(rounds):
        for work, spent_s in ((lambda: world.steps(1 / 240, steps), ours_s), (bare, bare_s)):
            world.place(1.0, 0.7)  # the model keeps the time step and the contact
            begin_s = time.process_time()
            work()
            spent_s.append(time.process_time() - begin_s)
    what = f"(g) {steps} steps over a bare loop, least of {rounds} each"
    yield promised(what, "", 1.3, min(ours_s) / min(bare_s))
