"""What a fit has not seen is predicted on horizons; models of other machines are never `ok`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tunenet_logs as tn
from tests.analysis.sysid.pendulums import START_NS
from tunenet_logs.analysis.evaluation.worlds.machines import MACHINES
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.sysid.columns import compared
from tunenet_logs.analysis.sysid.fit import HeldOut
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal

PREDICTS = "predicts what it was not fitted to"
RNG = np.random.default_rng


def states(seconds: Array, angles: Array, speeds: Array, noise: float, seed: int) -> Episode:
    """Joint states of joints a, b, ..., of shapes (T, J), with a share of their spread as noise."""
    names = tuple("abc"[: angles.shape[1]])
    stamps_ns = START_NS + np.round(1e9 * seconds).astype(np.int64)
    signals: dict[str, Signal] = {}
    for what, unit, values in (("position", "rad", angles), ("velocity", "rad/s", speeds)):
        drawn = RNG((seed, len(signals))).standard_normal(values.shape)
        seen = values + noise * np.std(values, axis=0) * drawn
        name = f"/joint_states.{what}"
        signals[name] = Signal(name, stamps_ns, seen, names, unit)
    return Episode(EpisodeInfo(), signals)


def held_out(tuning: Tuning) -> HeldOut:
    assert tuning.trace is not None
    assert tuning.trace.fit is not None
    return tuning.trace.fit.detail.held_out


def passes(tuning: Tuning) -> bool:
    [check] = [one for one in tuning.checks if one.name == PREDICTS]
    return check.passed


def tuned(log: Episode, model: str, folder: Path, *parameters: str, **more: Episode) -> Tuning:
    path = folder / "model.xml"
    path.write_text(model)
    said = {"model": path, "parameters": list(parameters), **more}
    return tn.tune(log, **said)  # pyright: ignore[reportArgumentType]


def test_topics_that_begin_apart_are_compared_on_one_clock():
    seconds = np.arange(200) / 100
    signals: dict[str, Signal] = {}
    for name, late_s in (("/a", 0.0), ("/b", 0.02)):
        values = np.sin(5 * (seconds + late_s))[:, None]
        stamps_ns = START_NS + np.round(1e9 * (seconds + late_s)).astype(np.int64)
        signals[name] = Signal(name, stamps_ns, values, ("x",), "m")
    log = Episode(EpisodeInfo(), signals)
    target = compared(log, log)
    np.testing.assert_allclose(target.seen_in(log), target.values, atol=1e-9)
    mine = {name: replace(one, stamps_ns=one.stamps_ns - START_NS) for name, one in signals.items()}
    np.testing.assert_allclose(target.seen_in(Episode(EpisodeInfo(), mine)), target.values)


def test_a_part_of_a_log_is_its_samples():
    seconds = np.sort(RNG(0).uniform(0, 10, 500))
    stamps_ns = START_NS + np.round(1e9 * seconds).astype(np.int64)
    log = Episode(EpisodeInfo(), {"/a": Signal("/a", stamps_ns, seconds[:, None], ("x",), "m")})
    target = compared(log, log)
    inside, part = target.between(3.0, 7.0), target.part(3.0, 7.0)
    np.testing.assert_array_equal(part.values, target.values[inside])
    np.testing.assert_array_equal(part.seen_in(log), part.values)  # to the last sample


# ---- Pendulums: a drag that the model has not, and two links, which are chaotic.

SWINGS = """<mujoco><option timestep="0.002" integrator="RK4"/><worldbody>
<body><joint name="a" type="hinge" axis="0 -1 0" damping="0.01"/>
<inertial pos="0 0 -.4" mass="1" diaginertia="1e-3 1e-3 1e-3"/>{more}</body></worldbody></mujoco>"""
SECOND = """<body pos="0 0 -.4"><joint name="b" type="hinge" axis="0 -1 0"/>
<inertial pos="0 0 -.3" mass="{mass}" diaginertia="1e-4 1e-4 1e-4"/></body>"""


def swing(
    seconds: Array, damping: float, drag: float = 0.0, gravity: float = 9.81, angle: float = 0.8
) -> Array:
    """Angle and speed of a pendulum of 1 kg at .4 m, shape (T, 2); drag rises with the speed."""

    def slope(_: float, state: Array) -> list[float]:
        slowed = damping * state[1] + drag * abs(state[1]) * state[1]
        return [state[1], (-gravity * 0.4 * np.sin(state[0]) - slowed) / 0.161]

    span = (0.0, float(seconds[-1]))
    return solve_ivp(slope, span, [angle, 0.0], t_eval=seconds, rtol=1e-9, atol=1e-9).y.T


def test_a_drifting_phase_is_no_wrong_model(tmp_path: Path):
    """Where the damping rises with the speed, a constant one loses the phase over 30 s."""
    seconds = np.arange(0.0, 30.0, 0.02)
    moved = swing(seconds, 0.002, drag=0.001, angle=2.0)
    log = states(seconds, moved[:, :1], moved[:, 1:], 0.003, 1)
    tuning = tuned(log, SWINGS.format(more=""), tmp_path, "joint/a.damping=0:.1")
    assert passes(tuning), tuning.reason
    told = held_out(tuning)
    assert told.count == 1
    assert tuning.trace is not None
    assert tuning.trace.fit is not None
    found = tuning.trace.fit.detail
    later = found.target.seconds > told.from_s.min()
    drifted = found.target.rms(found.solution.residuals, later)
    assert (told.rms < 0.7 * drifted).all()


def two_links(seconds: Array, mass: float = 0.5, kick: float = 0.0) -> Array:
    """Angles and speeds of the model's own two links, shape (T, 4), kicked at each sample."""
    from tunenet_logs.recorders.simulators.mujoco import mujoco

    library = mujoco()
    model = library.MjModel.from_xml_string(SWINGS.format(more=SECOND.format(mass=mass)))
    data = library.MjData(model)
    data.qpos[:] = 2.4, 1.0
    states, rng = np.empty((len(seconds), 4)), RNG(5)
    for row in states:
        row[:] = *data.qpos, *data.qvel
        for _ in range(5):
            library.mj_step(model, data)
        data.qvel[:] += kick * rng.standard_normal(2)
    return states


def chaotic_log() -> Episode:
    seconds = np.arange(600) / 100
    moved = two_links(seconds)
    return states(seconds, moved[:, :2], moved[:, 2:], 0.002, 2)


def test_a_chaotic_machine_begins_anew(tmp_path: Path):
    model = SWINGS.format(more=SECOND.format(mass=0.5))
    tuning = tuned(chaotic_log(), model, tmp_path, "joint/a.damping=0:.1")
    told = held_out(tuning)
    assert told.horizon_s is not None
    assert told.count > 1
    assert told.horizon_s < 2.4
    assert passes(tuning), tuning.reason


def test_a_chaotic_motion_that_is_kicked_is_fitted_begun_anew(tmp_path: Path):
    """Kicks of a thousandth of its speed: after seconds no start follows the log any more."""
    seconds = np.arange(600) / 100
    moved = two_links(seconds, kick=0.005)
    log = states(seconds, moved[:, :2], moved[:, 2:], 0.002, 2)
    model = SWINGS.format(more=SECOND.format(mass=0.5))
    tuning = tuned(log, model, tmp_path, "joint/a.damping=0:.1")
    assert tuning.trace is not None
    assert tuning.trace.fit is not None
    found = tuning.trace.fit.detail
    assert found.is_begun_anew
    assert tuning.verdict != "rejected", tuning.reason
    assert abs(tuning.trace.estimate[0] - 0.01) < 0.005


def balanced_log(damping: float) -> Episode:
    """A pendulum that torques hold upright, and push about there."""
    seconds = np.arange(0.0, 8.0, 0.005)

    def torque(at_s: float | Array, angle: Array, speed: Array) -> Array:
        return 12 * (np.pi + 0.3 * np.sin(3 * at_s) - angle) - 1.5 * speed

    def slope(at_s: float, state: Array) -> list[float]:
        pull = torque(at_s, *state) - damping * state[1] - 9.81 * 0.4 * np.sin(state[0])
        return [state[1], float(pull) / 0.161]

    until = (0.0, float(seconds[-1]))
    moved = solve_ivp(slope, until, [2.8, 0.0], t_eval=seconds, rtol=1e-9, atol=1e-9).y
    log = states(seconds, moved[:1].T, moved[1:].T, 0.003, 6)
    stamps_ns = START_NS + np.round(1e9 * seconds).astype(np.int64)
    efforts = torque(seconds, *moved)[:, None]
    effort = Signal("/joint_states.effort", stamps_ns, efforts, ("a",), "N·m")
    return replace(log, signals={**log.signals, effort.name: effort})


def test_what_no_start_follows_to_its_end_is_fitted_begun_anew(tmp_path: Path):
    """An error of the start grows by e five times a second: in 8 s to all that there is."""
    tuning = tuned(balanced_log(0.15), SWINGS.format(more=""), tmp_path, "joint/a.damping=0:.5")
    assert tuning.trace is not None
    assert tuning.trace.fit is not None
    assert tuning.trace.fit.detail.is_begun_anew
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.interval95 is not None
    [(low, high)] = tuning.interval95
    assert low < 0.15 < high
    assert high - low < 0.03


# ---- Models of other machines.

SERVO = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body><joint name="a" type="hinge" axis="0 -1 0" damping=".3" armature=".01"/>
<inertial pos="0 0 -.3" mass="{mass}" diaginertia="1e-5 1e-5 1e-5"/></body></worldbody>
<actuator><position name="a" joint="a" kp="20"/></actuator></mujoco>"""
OF_SERVO = ("joint/a.damping=0:3", "joint/a.armature=0:.2")


def servo_log(play_rad: float, *, at_link: bool) -> Episode:
    """A servo that swings .8 kg at .3 m through gears with play; seen at its motor or the link."""
    rng, seconds = RNG(0), np.arange(0.0, 8.0, 0.01)
    phases, sizes, rates = rng.uniform(0, 6, 3), np.array([0.5, 0.35, 0.2]), [0.3, 0.7, 1.3]
    told_s = np.arange(0.0, 8.0, 0.02)
    turns = 2 * np.pi * np.outer(told_s, rates) + phases
    told = np.sin(turns) @ sizes - np.sin(phases) @ sizes

    def slope(at_s: float, state: Array) -> list[float]:
        motor, link, motor_speed, link_speed = state
        off = motor - link
        beyond = off - np.clip(off, -play_rad / 2, play_rad / 2)
        push = 400 * beyond + 0.6 * (motor_speed - link_speed) * (beyond != 0)
        wanted = told[min(int(at_s / 0.02 + 1e-9), len(told) - 1)]
        pull = 20 * (wanted - motor) - 0.6 * motor_speed - push
        weight = 0.8 * 9.81 * 0.3 * np.sin(link) + 0.02 * link_speed
        return [motor_speed, link_speed, pull / 0.02, (push - weight) / 0.072]

    until = (0.0, 8.0)
    solved = solve_ivp(
        slope, until, np.zeros(4), t_eval=seconds, max_step=0.005, rtol=1e-6, atol=1e-8
    )
    moved = solved.y
    which = int(at_link)
    log = states(seconds, moved[which, :, None], moved[2 + which, :, None], 0.002, 3)
    stamps_ns = START_NS + np.round(1e9 * told_s).astype(np.int64)
    commands = Signal("/joint_commands.position", stamps_ns, told[:, None], ("a",), "rad")
    return replace(log, signals={**log.signals, commands.name: commands})


def pendulum_log(seed: int, gravity: float = 9.81) -> Episode:
    seconds = np.arange(0.0, 8.0, 0.01)
    moved = swing(seconds, 0.02, gravity=gravity)
    return states(seconds, moved[:, :1], moved[:, 1:], 0.01, seed)


def test_a_servo_without_play_is_ok(tmp_path: Path):
    tuning = tuned(servo_log(0.0, at_link=True), SERVO.format(mass=0.8), tmp_path, *OF_SERVO)
    assert tuning.verdict == "ok", tuning.reason


FREE = ("joint/a.damping=0:.1", "joint/a.armature=0:.3")
WRONG: dict[str, tuple[str, str, tuple[str, ...]]] = {
    **{
        f"play of {play} rad at the {at}": (f"play {play} {at}", SERVO.format(mass=0.8), OF_SERVO)
        for play in (0.05, 0.1, 0.2)
        for at in ("motor", "link")
    },
    **{
        f"a servo that carries {mass} kg": ("play 0.0 link", SERVO.format(mass=mass), OF_SERVO)
        for mass in (0.4, 0.5, 1.2, 1.4)
    },
    "no second link": ("two links", SWINGS.format(more=""), FREE[:1]),
    "no second link, armature free": ("two links", SWINGS.format(more=""), FREE),
    **{
        f"a second link of {mass} kg": (
            "two links",
            SWINGS.format(more=SECOND.format(mass=mass)),
            FREE[:1],
        )
        for mass in (0.25, 0.4, 0.6, 1.0)
    },
    **{
        f"gravity of {gravity}": (f"gravity {gravity}", SWINGS.format(more=""), FREE[:1])
        for gravity in (8.9, 9.5, 10.1, 11.0)
    },
}
QUICK = ("play of 0.1 rad at the link", "a servo that carries 1.2 kg", "gravity of 9.5")


def log_of(what: str) -> Episode:
    kind, *said = what.split()
    if kind == "play":
        return servo_log(float(said[0]), at_link=said[1] == "link")
    return chaotic_log() if kind == "two" else pendulum_log(5, float(said[0]))


@pytest.mark.parametrize(
    "what",
    [pytest.param(one, marks=[] if one in QUICK else [pytest.mark.slow]) for one in WRONG],
)
def test_another_machines_model_is_not_ok(what: str, tmp_path: Path):
    log, model, parameters = WRONG[what]
    assert tuned(log_of(log), model, tmp_path, *parameters).verdict != "ok"


def test_a_state_that_is_not_all_seen_is_rolled_from_the_start(tmp_path: Path):
    """A block's orientation is in no log of its position."""
    log = MACHINES[2].log(7, 1.0)
    told = held_out(tuned(log.episode, log.model, tmp_path, *log.tune))
    assert told.horizon_s is None


@pytest.mark.parametrize("gravity", [9.81, 7.0])
def test_a_rest_at_the_end_is_predicted_from_the_start(gravity: float, tmp_path: Path):
    """Any model predicts a pendulum that hangs still."""
    seconds = np.arange(0.0, 8.0, 0.02)
    moved = swing(seconds, 0.6, gravity=gravity)
    log = states(seconds, moved[:, :1], moved[:, 1:], 0.003, 4)
    model = SWINGS.format(more="").replace('damping="0.01"', 'damping="0.3"')
    tuning = tuned(log, model, tmp_path, "joint/a.damping=0:2")
    assert held_out(tuning).horizon_s is None
    assert (tuning.verdict == "ok") == (gravity == 9.81)


def test_where_it_rests_at_the_end_the_fit_itself_is_judged(tmp_path: Path):
    """Gravity 5 % off, a damping that is fitted: within 5 % of the motion, by a wrong damping."""
    seconds = np.arange(0.0, 8.0, 0.01)
    moved = swing(seconds, 0.5, gravity=9.81, angle=1.4)
    log = states(seconds, moved[:, :1], moved[:, 1:], 0.03, 4)
    for gravity in (9.81, 9.32):
        model = SWINGS.format(more="").replace("<option ", f'<option gravity="0 0 -{gravity}" ')
        tuning = tuned(log, model, tmp_path, "joint/a.damping=0:2")
        assert (tuning.verdict == "ok") == (gravity == 9.81), tuning.reason
