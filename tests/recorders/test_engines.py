"""Every engine keeps the same laws, a falling ball's among them; and how one is chosen."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.engines import HAS_PYBULLET, needs_pybullet
from tests.strangers import bounce_heights
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle_at
from tunenet_logs.recorders.simulators.arm.payload import PAPER as PAPER_ROLLOUT
from tunenet_logs.recorders.simulators.arm.payload import (
    joint_efforts_nm,
    roll_out,
)
from tunenet_logs.recorders.simulators.ball import (
    TOPIC,
    Bounce,
    DropRig,
    DropSimulator,
    SpeedLaw,
)
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, ContactSettings
from tunenet_logs.recorders.simulators.known import (
    BALLS,
    ENGINE_VARIABLE,
    ENGINES,
    Ball,
    ball_named,
    completed,
    engine,
    recorded_ball,
    simulated_by,
)
from tunenet_logs.recorders.simulators.shot import (
    STEP_S,
    ShotRig,
    shoot,
    shoot_in_engine,
)

RIG = DropRig(gap_m=1.0, rate_hz=240.0, samples=300)
RADIUS_M = 0.05

every_engine = pytest.mark.usefixtures("each_engine")

# ---- Laws of every engine, beside those of the drop and the arm: impacts, shots, and torques


@every_engine
@pytest.mark.parametrize("share", [0.4, 2 / 3])
def test_an_impact_is_a_rigid_balls(share: float):
    """Newton's law along the normal; across it friction stops the slip, or takes its share."""
    world = engine().ball_world(RADIUS_M, CALIBRATED)
    rng = np.random.default_rng(3)
    for _ in range(50):
        restitution, friction = rng.uniform(0, 1, 2)
        velocity = np.array([*rng.uniform(-4, 4, 2), -rng.uniform(0.05, 8)])
        spin = rng.uniform(-60, 60, 3)
        after, turning = world.impact(velocity, spin, restitution, friction, share)
        slip = velocity + np.cross(spin, [0, 0, -RADIUS_M])
        slip[2] = 0
        slipping = float(np.linalg.norm(slip))
        stop = slipping / (1 + 1 / share)
        taken = min(stop, friction * (1 + restitution) * -velocity[2]) * slip / slipping
        wanted = velocity - taken
        wanted[2] = -restitution * velocity[2]
        assert after == pytest.approx(wanted, abs=1e-3)
        turned = spin + np.cross([0, 0, -1], -taken) / (share * RADIUS_M)
        assert RADIUS_M * turning == pytest.approx(RADIUS_M * turned, abs=1e-3)


@every_engine
def test_an_impact_leaves_nothing_for_the_next():
    world = engine().ball_world(RADIUS_M, CALIBRATED)
    one = (np.array([1.0, 0.5, -2.0]), np.array([10.0, -20.0, 5.0]), 0.7, 0.3, 0.4)
    first = world.impact(*one)
    world.impact(np.array([3.0, 0.0, -5.0]), np.zeros(3), 0.2, 0.9, 2 / 3)
    world.place(1.0, 0.4)
    world.steps(0.01, 100)
    assert np.array_equal(first, world.impact(*one))


@every_engine
@pytest.mark.parametrize("height_m", [0.2, 0.3, 0.45])
def test_a_shot_flies_as_the_closed_form_has_it(height_m: float):
    """Off the plane and off the rim, with spin and air: within a tenth of a millimetre."""
    rig, law = ShotRig(), SpeedLaw(0.74, 0.08)
    wanted = shoot(rig, law, np.array([height_m]))
    found = shoot_in_engine(rig, law, height_m, STEP_S)
    assert found.has_touched == wanted.has_touched
    assert found.is_through == wanted.is_through
    first = slice(None, None) if not wanted.has_touched[0] else slice(0, 200)
    assert found.positions_m[first] == pytest.approx(wanted.positions_m[first], abs=1e-4)


# ---- Another engine is a module and one line; one is chosen by name


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9, 1.0])
def test_a_drop_runs_in_another_engine(monkeypatch: pytest.MonkeyPatch, restitution: float):
    monkeypatch.setitem(ENGINES, "toy", "tunenet_logs.analysis.evaluation.studies.engines")
    simulator = DropSimulator(RIG, CALIBRATED, engine("toy").ball_world(RIG.radius_m, CALIBRATED))
    episode = simulator.rollout({"restitution": restitution})
    heights_m = episode.signals[TOPIC].values[:, 2] - RIG.radius_m
    fall_s = math.sqrt(2 * RIG.gap_m / CALIBRATED.gravity_m_s2)
    seconds = np.arange(RIG.samples) / RIG.rate_hz - fall_s
    inside = (seconds > 0.2 * restitution * fall_s) & (seconds < 1.8 * restitution * fall_s)
    # A flight between two impacts is z = v t - g t^2 / 2: each sample gives its v.
    t = seconds[inside]
    speeds = heights_m[inside] / t + CALIBRATED.gravity_m_s2 * t / 2
    found = speeds / (CALIBRATED.gravity_m_s2 * fall_s)
    assert found == pytest.approx(np.full(len(t), restitution), abs=1e-3)
    assert simulator.engine == episode.info.source == "exact 1.0"


def test_one_is_chosen_for_a_block_and_the_processes_in_it():
    before = engine()
    assert before is engine("pybullet" if HAS_PYBULLET else "mujoco")  # the first there is
    with simulated_by("mujoco"):
        assert engine().name.startswith("mujoco ")
        with simulated_by(None):
            assert os.environ[ENGINE_VARIABLE] == "mujoco"
    assert engine() is before
    assert ENGINE_VARIABLE not in os.environ


@pytest.mark.parametrize("name", ["gazebo", "no", "MuJoCo"])
def test_an_engine_that_is_none_is_named(monkeypatch: pytest.MonkeyPatch, name: str):
    monkeypatch.setenv(ENGINE_VARIABLE, name)
    with pytest.raises(UsageError, match=r"no engine is named '.*'; there is: pybullet, mujoco"):
        engine()
    monkeypatch.setitem(ENGINES, "absent", "tests.recorders.absent_engine")
    with pytest.raises(UsageError, match="absent is not installed; pip install absent"):
        engine("absent")


# ---- The paper's simulator: PyBullet as it comes, stepped at 60 Hz, and nothing else

HELD = Payload(0.7, (0.01, 0.02, -0.01))


@needs_pybullet
def test_the_papers_rollouts_are_bit_identical_and_many_steps_are_single_ones():
    rig = DropRig(gap_m=2.0)
    simulator = DropSimulator(rig, PAPER)
    first = simulator.rollout({"restitution": 0.6}).signals[TOPIC].values
    simulator.rollout({"restitution": 0.2})
    again = simulator.with_rig(rig).rollout({"restitution": 0.6}).signals[TOPIC].values
    assert np.array_equal(first, again)
    assert np.array_equal(first[:, 2] - rig.radius_m, heights(rig, PAPER, restitution=0.6))
    world = engine().ball_world(0.5, PAPER)
    world.place(4.2, 0.6)
    singly = [world.step(1 / 60)[0] for _ in range(300)]
    world.place(4.2, 0.6)
    assert world.steps(1 / 60, 300) == singly
    assert min(singly) < 0.6 < max(singly[100:])  # it bounced on the way


@needs_pybullet
@pytest.mark.parametrize("hold_s", [0.5, 5.0, 50.0])
def test_a_held_ball_starts_late_with_the_papers_settings(hold_s: float):
    rig = DropRig(gap_m=4.0, radius_m=0.5, samples=100)
    held = round(hold_s * rig.rate_hz)
    curve = heights(replace(rig, hold_s=hold_s), PAPER, restitution=0.5)
    assert np.array_equal(curve[:held], np.full(min(held, 100), 4.0))
    assert np.array_equal(curve[held:], heights(rig, PAPER, restitution=0.5)[: max(100 - held, 0)])


@needs_pybullet
def test_the_papers_settings_give_the_papers_restitution_and_no_air():
    """At 60 Hz with PyBullet's defaults .5 gives about .534 (measured over 4 to 5 m)."""
    curve = heights(DropRig(gap_m=4.0, radius_m=0.5), PAPER, restitution=0.5)
    low = int(np.argmin(curve[:90]))
    assert 0.4 < np.sqrt(curve[low:].max() / curve[0]) < 0.6
    assert len(curve) == 400
    assert curve[0] < 4.0  # sampled after the first step
    with pytest.raises(UsageError, match="takes the values restitution, not"):
        DropSimulator(DropRig(), PAPER).rollout({"restitution": 0.5, "drag": 0.1})


@needs_pybullet
@pytest.mark.parametrize(("is_damped", "most_nm"), [(True, 0.02), (False, 1e-9)])
def test_the_papers_rollout_differs_by_its_damping_alone(is_damped: bool, most_nm: float):
    settings = replace(PAPER_ROLLOUT, is_damped=is_damped)
    rollout = roll_out(jaco(), circle_at(settings.times()), HELD, settings)
    efforts = joint_efforts_nm(jaco(), rollout.path, HELD, settings.gravity_m_s2)
    assert np.sqrt(np.mean((rollout.effort_nm - efforts) ** 2)) < most_nm
    assert rollout.effort_nm.shape == (1200, 7)


def test_without_pybullet_there_is_none():
    words = "the preset paper is PyBullet's own behaviour"
    with simulated_by("mujoco"):
        with pytest.raises(UsageError, match=words):
            DropSimulator(DropRig(), PAPER)
        with pytest.raises(UsageError, match=words):
            roll_out(jaco(), circle_at(PAPER_ROLLOUT.times()), HELD, PAPER_ROLLOUT)


# ---- A falling ball in every engine and in closed form: the restitution set is the one that is got


def heights(rig: DropRig, settings: ContactSettings = CALIBRATED, **values: float) -> np.ndarray:
    """Height under the ball [m], shape (T,)."""
    episode = DropSimulator(rig, settings).rollout(values)
    return episode.signals[TOPIC].values[:, 2] - rig.radius_m


@every_engine
@pytest.mark.parametrize(("gap", "radius"), [(0.2, 0.2), (1.3, 0.02), (1.3, 0.5), (5.0, 0.01)])
@pytest.mark.parametrize("rate", [30.0, 60.0, 240.0])
@pytest.mark.parametrize("restitution", [0.0, 0.05, 0.4, 0.8, 1.0])
def test_follows_the_closed_form(gap: float, radius: float, rate: float, restitution: float):
    rig = DropRig(gap_m=gap, radius_m=radius, rate_hz=rate, samples=int(3 * rate), hold_s=0.213)
    times = np.arange(rig.samples) / rate - rig.hold_s
    exact = bounce_heights(restitution, gap, times, CALIBRATED.gravity_m_s2)
    assert np.abs(heights(rig, restitution=restitution) - exact).max() < 1e-4


def test_a_flight_by_itself_lasts_as_among_all_of_a_ball_in_air():
    ball = Bounce(0.8, slope=0.05, drag=0.3)
    starts, speeds = ball.flights(6.0)
    alone = [ball.flight(speed)[0] for speed in speeds[:-1].tolist()]
    assert np.diff(starts) == pytest.approx(alone, rel=1e-12)


@every_engine
def test_a_ball_at_rest_stays_and_a_world_that_others_have_used_gives_the_bits_of_a_fresh_one():
    curve = heights(DropRig(gap_m=0.3, rate_hz=60, samples=3000), restitution=0.7)
    assert np.abs(curve[-1000:]).max() < 1e-6
    rig = DropRig(gap_m=0.7, rate_hz=120.0, samples=300, hold_s=0.1)
    values = {"restitution": 0.7, "restitution_slope": 0.05, "drag": 0.1}
    fresh = DropSimulator(rig, CALIBRATED, engine().ball_world(rig.radius_m, CALIBRATED))
    simulator = DropSimulator(DropRig(gap_m=1.9))
    simulator.rollout({"restitution": 0.2})
    runs = [one.rollout(values) for one in (fresh, DropSimulator(rig), simulator.with_rig(rig))]
    first, *others = (run.signals[TOPIC].values for run in runs)
    assert all(np.array_equal(first, other) for other in others)


@every_engine
def test_samples_are_taken_when_they_are_asked_for():
    times_s = (0.0, 0.1, 0.13, 0.4, 1.7)
    uneven = DropSimulator(DropRig(times_s=times_s)).rollout({"restitution": 0.7, "drag": 0.1})
    assert uneven.signals[TOPIC].seconds == pytest.approx(times_s, abs=1e-9)
    even = DropSimulator(DropRig(rate_hz=100.0, samples=200))
    heights_m = even.rollout({"restitution": 0.7, "drag": 0.1}).signals[TOPIC].values[:, 2]
    rows = [round(100 * at_s) for at_s in times_s]
    assert uneven.signals[TOPIC].values[:, 2] == pytest.approx(heights_m[rows], abs=2e-5)


def integrated(
    gap_m: float, ball: tuple[float, float, float], seconds: np.ndarray, gravity: float = 9.80665
) -> np.ndarray:
    """Heights of the underside by a general integrator, NaN after the fifth impact."""
    restitution, slope, drag_1_m = ball

    def rates(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -gravity - drag_1_m * state[1] * abs(state[1])]

    def lands(_: float, state: np.ndarray) -> float:
        return state[0]

    lands.terminal, lands.direction = True, -1  # type: ignore[attr-defined]
    found = np.full(len(seconds), np.nan)
    begin_s, state, first = 0.0, [gap_m, 0.0], 0.0
    for _ in range(5):
        flight = solve_ivp(
            rates, (begin_s, seconds[-1]), state, events=lands, rtol=1e-10, atol=1e-11,
            dense_output=True,
        )  # fmt: skip
        inside = (seconds >= begin_s) & (seconds <= flight.t[-1])
        found[inside] = flight.sol(seconds[inside])[0]
        if not len(flight.t_events[0]):
            break
        begin_s, speed = float(flight.t_events[0][0]), -float(flight.y_events[0][0][1])
        first = first or speed
        state = [1e-14, min(restitution * max(speed, 0.05) ** -slope * first**slope, 1.0) * speed]
    return found


@every_engine
@pytest.mark.parametrize("ball", [(0.9, 0.05, 0.12), (0.75, 0.1, 0.02), (0.5, 0.03, 0.18)])
def test_air_and_slope_move_it_as_an_integrator_has_it(ball: tuple[float, float, float]):
    for gap_m in np.linspace(0.2, 5.0, 25):
        rig = DropRig(gap_m=float(gap_m), rate_hz=100.0, samples=500)
        values = {"restitution": ball[0], "restitution_slope": ball[1], "drag": ball[2]}
        off_m = heights(rig, CALIBRATED, **values) - integrated(
            float(gap_m), ball, np.arange(500) / 100.0
        )
        assert np.nanmax(np.abs(off_m)) < 1e-4
        assert DropSimulator(rig).rollout(values).info.truth == values


# ---- The closed form


@pytest.mark.parametrize(
    "values", [(0.75, 0.15, 0.0), (0.75, 0.0, 0.1), (0.75, 0.1, 0.03), (0.3, 0, 0), (0.97, 0, 0)]
)
def test_slope_and_drag_are_those_of_the_equation_of_motion(values: tuple[float, float, float]):
    """In its units, in which a fall from 1 takes 1 without air, gravity is 2."""
    ball, drag = Bounce(*values), values[2]
    fall = np.arccosh(np.exp(drag)) / np.sqrt(2 * drag) if drag else 1.0
    places = np.linspace(-fall, 4.0, 500)
    seen = (ball.restitution, ball.slope, ball.drag)
    wanted = integrated(1.0, seen, places + fall, gravity=2.0)
    assert np.isfinite(wanted).mean() > 0.3
    assert np.nanmax(np.abs(ball.heights(places) - wanted)) < 1e-6


def test_impacts_by_hand_before_the_fall_and_after_the_last_flight():
    assert Bounce(0.5).flights(1.6)[0][:4] == pytest.approx([0, 1, 1.5, 1.75])
    assert Bounce(1.0).flights(3.9)[0] == pytest.approx([0, 2, 4])
    assert Bounce(0.0).flights(9.0)[0] == pytest.approx([0])
    assert Bounce(0.5).heights(np.array([-3.0, -1.0])) == pytest.approx([1, 1])
    assert Bounce(0.5).heights(np.array([2.0, 5.0, 1e6])) == pytest.approx([0, 0, 0], abs=1e-9)
    assert Bounce(0.5, 0.1, 0.05).heights(np.array([5.0, 1e6])) == pytest.approx([0, 0], abs=1e-9)


# ---- Balls by name: what the air does to them, and what no ball can be


@pytest.mark.parametrize("name", sorted(BALLS))
def test_each_ball_of_the_table_is_one(name: str):
    ball = BALLS[name]
    assert ball.density_kg_m3 is not None
    assert 50 < ball.density_kg_m3 < 1300  # hollow, or hard rubber
    assert 0.4 < ball.drag_coefficient < 0.7
    assert not ball.is_denser_than_metal


def test_light_and_large_balls_are_slowed_most():
    # by how much air slows the end of a fall from 1 m: about drag * height / 2
    slowed = {"table-tennis": 0.066, "tennis": 0.010, "golf": 0.0047, "basketball": 0.011}
    for name, share in slowed.items():
        drag = ball_named(name).drag_1_m
        assert drag is not None
        assert drag / 2 == pytest.approx(share, rel=0.1)
        if name == "table-tennis":  # terminal speeds of 8.1 to 9.3 m/s
            assert sqrt(9.81 / drag) == pytest.approx(8.7, abs=0.6)


def test_a_very_heavy_ball_is_a_ball_that_may_be_a_mistake():
    assert Ball(0.04, 10.0).drag_1_m == pytest.approx(3.5e-5, rel=0.05)
    assert Ball(0.04, 10.0).is_denser_than_metal
    assert not Ball(0.04, 0.26).is_denser_than_metal  # steel


def test_what_a_log_says_of_its_ball_and_what_a_user_knows_better():
    tennis = Ball(0.067, 0.058, 0.55)
    info = EpisodeInfo(notes={"ball": "tennis"}, rig={"ball_mass_kg": 0.058})
    assert recorded_ball(info) == tennis
    assert recorded_ball(EpisodeInfo(notes={"ball": "red rubber"})) == Ball()
    nobody_measured = EpisodeInfo(rig={"ball_diameter_m": 0.04, "ball_mass_kg": 0.0})
    assert recorded_ball(nobody_measured) == Ball(0.04)
    floats = EpisodeInfo(rig={"ball_diameter_m": 4.0, "ball_mass_kg": 0.0027})
    assert recorded_ball(floats) == Ball()
    assert completed(Ball(), tennis) == tennis
    assert completed(Ball(0.040), tennis) == Ball(0.040, 0.058)
    assert completed(BALLS["golf"], tennis) == BALLS["golf"]
    assert completed(Ball(4.0), Ball(None, 0.0027)) == Ball(4.0)
