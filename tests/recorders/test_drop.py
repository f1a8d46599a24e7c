"""A falling ball in every engine and in closed form: the restitution set is the one that is got."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.strangers import bounce_heights
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import (
    RESTITUTION,
    TOPIC,
    Bounce,
    DropRig,
    DropSimulator,
)
from tunenet_logs.recorders.simulators.base import CALIBRATED
from tunenet_logs.recorders.simulators.known import (
    BALLS,
    Ball,
    ball_named,
    completed,
    engine,
    recorded_ball,
)

every_engine = pytest.mark.usefixtures("each_engine")


def heights(rig: DropRig, **values: float) -> np.ndarray:
    """Height under the ball [m], shape (T,)."""
    episode = DropSimulator(rig).rollout(values)
    return episode.signals[TOPIC].values[:, 2] - rig.radius_m


def effective_restitution(rig: DropRig, restitution: float) -> float:
    """From the energies in mid-flight, by nothing but the sampled heights."""
    gravity, period = CALIBRATED.gravity_m_s2, 1 / rig.rate_hz
    curve = heights(rig, restitution=restitution)
    first = int(np.sqrt(2 * rig.gap_m / gravity) / period)
    length = 2 * restitution * np.sqrt(2 * rig.gap_m / gravity) / period
    before, after = first // 2, first + 1 + int(length / 2)

    def energy(at: int) -> float:
        speed = (curve[at + 1] - curve[at - 1]) / (2 * period)
        return gravity * curve[at] + speed**2 / 2

    return float(np.sqrt(energy(after) / energy(before)))


@every_engine
@pytest.mark.parametrize("gaps", [3, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize("restitution", [0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0])
def test_effective_restitution_is_the_one_that_was_set(restitution: float, gaps: int):
    for gap, radius in zip(
        np.geomspace(0.2, 5.0, gaps), np.geomspace(0.2, 0.01, gaps), strict=True
    ):
        rig = DropRig(gap_m=float(gap), radius_m=float(radius), rate_hz=480, samples=1500)
        assert abs(effective_restitution(rig, restitution) - restitution) < 0.0005


@every_engine
@pytest.mark.parametrize("radius", [0.02, 0.5])
@pytest.mark.parametrize("rate", [30.0, 60.0, 240.0])
@pytest.mark.parametrize("restitution", [0.0, 0.05, 0.4, 0.8])
def test_follows_the_closed_form(radius: float, rate: float, restitution: float):
    rig = DropRig(gap_m=1.3, radius_m=radius, rate_hz=rate, samples=int(3 * rate), hold_s=0.213)
    times = np.arange(rig.samples) / rate - rig.hold_s
    exact = bounce_heights(restitution, 1.3, times, CALIBRATED.gravity_m_s2)
    assert np.abs(heights(rig, restitution=restitution) - exact).max() < 1e-4


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


@every_engine
@pytest.mark.parametrize(
    ("values", "names"),
    [
        *(({"restitution": value}, "restitution") for value in (-0.1, 1.0001, np.nan, np.inf)),
        ({"friction": 0.5}, "friction"),
        ({"drag": 0.1}, "restitution"),
        ({"restitution": 0.5, "mass": 1.0}, "mass"),
        ({"restitution": 0.5, "drag": -1.0}, "drag"),
    ],
)
def test_the_engine_never_sees_values_that_no_ball_has(values: dict[str, float], names: str):
    with pytest.raises(UsageError, match=names):
        DropSimulator(DropRig()).rollout(values)


@pytest.mark.parametrize(
    "field", [{"gap_m": -1.0}, {"gap_m": float("nan")}, {"radius_m": 0.0}, {"rate_hz": 1e9}]
)
def test_the_engine_never_sees_a_bad_rig(field: dict):
    with pytest.raises(UsageError, match=next(iter(field))):
        DropRig(**field)
    assert (RESTITUTION.checked(0.0), RESTITUTION.checked(1.0)) == (0.0, 1.0)


def integrated(gap_m: float, ball: tuple[float, float, float], seconds: np.ndarray) -> np.ndarray:
    """Heights of the underside by a general integrator, NaN after the fifth impact."""
    restitution, slope, drag_1_m = ball

    def rates(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -9.80665 - drag_1_m * state[1] * abs(state[1])]

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
    """Four bounces, from 25 heights: within 0.1 mm."""
    for gap_m in np.linspace(0.2, 5.0, 25):
        rig = DropRig(gap_m=float(gap_m), rate_hz=100.0, samples=500)
        values = {"restitution": ball[0], "restitution_slope": ball[1], "drag": ball[2]}
        off_m = heights(rig, **values) - integrated(float(gap_m), ball, np.arange(500) / 100.0)
        assert np.nanmax(np.abs(off_m)) < 1e-4
        assert DropSimulator(rig).rollout(values).info.truth == values


# ---- The closed form


@pytest.mark.parametrize("restitution", [0.0, 0.01, 0.1, 0.3, 0.5, 0.72, 0.9, 0.97, 1.0])
def test_it_is_what_the_calibrated_simulator_does(restitution: float):
    rig = DropRig(gap_m=2.0, radius_m=0.05, rate_hz=240.0, samples=1500)
    signal = DropSimulator(rig).rollout({"restitution": restitution}).signals[TOPIC]
    fall_s = np.sqrt(2 * rig.gap_m / 9.80665)
    found = Bounce(restitution).heights((signal.seconds - fall_s) / fall_s)
    assert np.abs(2.0 * found + 0.05 - signal.values[:, 2]).max() < 2e-4


@pytest.mark.parametrize(("slope", "drag"), [(0.0, 0.0), (0.15, 0.0), (0.0, 0.1), (0.1, 0.03)])
def test_slope_and_drag_are_those_of_the_equation_of_motion(slope: float, drag: float):
    """By steps of 1e-4, velocity Verlet; each impact at the step's linear share."""
    ball = Bounce(0.75, slope, drag)
    fall = np.arccosh(np.exp(drag)) / np.sqrt(2 * drag) if drag else 1.0
    places = np.linspace(-fall, 4.0, 500)
    step, clock, height, speed, first = 1e-4, -fall, 1.0, 0.0, 0.0
    times, found = [clock], [height]
    while clock < places[-1]:
        push = -2 - ball.drag * speed * abs(speed)
        after = height + speed * step + push * step**2 / 2
        speed += push * step
        clock += step
        height = after
        if after < 0:
            share = after / speed  # how long ago it was at 0
            first = first or -speed
            speed *= -ball.restitution * (-speed / first) ** -ball.slope
            height = speed * share
        times.append(clock)
        found.append(height)
    assert np.abs(ball.heights(places) - np.interp(places, times, found)).max() < 2e-3


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.95, 1 - 1e-16, 1.0])
def test_the_ball_is_down_at_impacts_and_up_by_e_to_the_2n_between(restitution: float):
    ball = Bounce(restitution)
    places = ball.flights(100.0)[0][:6]
    assert ball.heights(places) == pytest.approx(np.zeros(6), abs=1e-9)
    apexes = (places[1:] + places[:-1]) / 2
    assert ball.heights(apexes) == pytest.approx(restitution ** (2 * np.arange(1, 6)))


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
    with pytest.raises(UsageError, match=r"'cricket'.*table-tennis, tennis, squash"):
        ball_named("cricket")


@pytest.mark.parametrize(
    ("size", "says"),
    [
        ((0.0, 0.01), "diameter is over 0"),
        ((-0.04, None), "diameter is over 0, not -0.04 m"),
        ((0.04, 0.0), "mass is over 0"),
        ((0.04, float("nan")), "mass"),
        ((float("inf"), 0.01), "diameter"),
        ((0.04, 0.00004), "lighter than the air"),
        ((4.0, 0.0027), "diameter in m"),
    ],
)
def test_what_no_ball_can_be_is_refused(size: tuple, says: str):
    with pytest.raises(UsageError, match=says):
        Ball(*size)


def test_a_very_heavy_ball_is_a_ball_that_may_be_a_mistake():
    ball = Ball(0.04, 10.0)
    assert ball.drag_1_m == pytest.approx(3.5e-5, rel=0.05)
    assert ball.is_denser_than_metal
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
