"""The drop in every engine: the restitution that is set is the one that is got."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.strangers import bounce_heights
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import RESTITUTION, TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED
from tunenet_logs.recorders.simulators.known import engine

pytestmark = pytest.mark.usefixtures("each_engine")


def heights(rig: DropRig, restitution: float) -> np.ndarray:
    """Height under the ball [m], shape (T,)."""
    episode = DropSimulator(rig).rollout({"restitution": restitution})
    return episode.signals[TOPIC].values[:, 2] - rig.radius_m


def effective_restitution(rig: DropRig, restitution: float) -> float:
    """From the energies in mid-flight, by nothing but the sampled heights."""
    gravity, period = CALIBRATED.gravity_m_s2, 1 / rig.rate_hz
    curve = heights(rig, restitution)
    first = int(np.sqrt(2 * rig.gap_m / gravity) / period)
    length = 2 * restitution * np.sqrt(2 * rig.gap_m / gravity) / period
    before, after = first // 2, first + 1 + int(length / 2)

    def energy(at: int) -> float:
        speed = (curve[at + 1] - curve[at - 1]) / (2 * period)
        return gravity * curve[at] + speed**2 / 2

    return float(np.sqrt(energy(after) / energy(before)))


@pytest.mark.parametrize("gaps", [3, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize("restitution", [0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0])
def test_effective_restitution_is_the_one_that_was_set(restitution: float, gaps: int):
    for gap, radius in zip(
        np.geomspace(0.2, 5.0, gaps), np.geomspace(0.2, 0.01, gaps), strict=True
    ):
        rig = DropRig(gap_m=float(gap), radius_m=float(radius), rate_hz=480, samples=1500)
        assert abs(effective_restitution(rig, restitution) - restitution) < 0.0005


@pytest.mark.parametrize("radius", [0.02, 0.5])
@pytest.mark.parametrize("rate", [30.0, 60.0, 240.0])
@pytest.mark.parametrize("restitution", [0.0, 0.05, 0.4, 0.8])
def test_follows_the_closed_form(radius: float, rate: float, restitution: float):
    rig = DropRig(gap_m=1.3, radius_m=radius, rate_hz=rate, samples=int(3 * rate), hold_s=0.213)
    times = np.arange(rig.samples) / rate - rig.hold_s
    exact = bounce_heights(restitution, 1.3, times, CALIBRATED.gravity_m_s2)
    assert np.abs(heights(rig, restitution) - exact).max() < 1e-4


def test_a_ball_at_rest_stays():
    curve = heights(DropRig(gap_m=0.3, rate_hz=60, samples=3000), 0.7)
    assert np.abs(curve[-1000:]).max() < 1e-6


def test_repeated_rollouts_are_bit_identical():
    rig = DropRig(gap_m=2.0)
    simulator = DropSimulator(rig)
    first = simulator.rollout({"restitution": 0.6}).signals[TOPIC].values
    simulator.rollout({"restitution": 0.2})
    again = simulator.with_rig(rig).rollout({"restitution": 0.6}).signals[TOPIC].values
    fresh = DropSimulator(rig).rollout({"restitution": 0.6}).signals[TOPIC].values
    assert np.array_equal(first, again)
    assert np.array_equal(first, fresh)


@pytest.mark.parametrize("value", [-0.1, 1.0001, float("nan"), float("inf")])
def test_the_engine_never_sees_a_bad_restitution(value: float):
    simulator = DropSimulator(DropRig())
    with pytest.raises(UsageError, match="restitution"):
        simulator.rollout({"restitution": value})


def test_other_parameters_are_refused():
    with pytest.raises(UsageError, match="friction"):
        DropSimulator(DropRig()).rollout({"friction": 0.5})


@pytest.mark.parametrize(
    "field", [{"gap_m": -1.0}, {"gap_m": float("nan")}, {"radius_m": 0.0}, {"rate_hz": 1e9}]
)
def test_the_engine_never_sees_a_bad_rig(field: dict[str, float]):
    with pytest.raises(UsageError, match=next(iter(field))):
        DropRig(**field)  # type: ignore[arg-type]


def test_bounds_are_inclusive():
    assert RESTITUTION.checked(0.0) == 0.0
    assert RESTITUTION.checked(1.0) == 1.0


def integrated(gap_m: float, ball: tuple[float, float, float], seconds: np.ndarray) -> np.ndarray:
    """Heights of the underside by a general integrator, NaN after the fifth impact."""
    restitution, slope, drag_1_m = ball

    def rates(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -9.80665 - drag_1_m * state[1] * abs(state[1])]

    def lands(_: float, state: np.ndarray) -> float:
        return state[0]

    lands.terminal, lands.direction = True, -1  # type: ignore[attr-defined]
    heights = np.full(len(seconds), np.nan)
    begin_s, state, first = 0.0, [gap_m, 0.0], 0.0
    for _ in range(5):
        flight = solve_ivp(
            rates, (begin_s, seconds[-1]), state, events=lands, rtol=1e-10, atol=1e-11,
            dense_output=True,
        )  # fmt: skip
        inside = (seconds >= begin_s) & (seconds <= flight.t[-1])
        heights[inside] = flight.sol(seconds[inside])[0]
        if not len(flight.t_events[0]):
            break
        begin_s, speed = float(flight.t_events[0][0]), -float(flight.y_events[0][0][1])
        first = first or speed
        state = [1e-14, min(restitution * max(speed, 0.05) ** -slope * first**slope, 1.0) * speed]
    return heights


@pytest.mark.parametrize("ball", [(0.9, 0.05, 0.12), (0.75, 0.1, 0.02), (0.5, 0.03, 0.18)])
def test_air_and_slope_move_it_as_an_integrator_has_it(ball: tuple[float, float, float]):
    """Four bounces, from 25 heights: within 0.1 mm."""
    for gap_m in np.linspace(0.2, 5.0, 25):
        rig = DropRig(gap_m=float(gap_m), rate_hz=100.0, samples=500)
        values = {"restitution": ball[0], "restitution_slope": ball[1], "drag": ball[2]}
        episode = DropSimulator(rig).rollout(values)
        heights_m = episode.signals[TOPIC].values[:, 2] - rig.radius_m
        off_m = heights_m - integrated(float(gap_m), ball, np.arange(500) / 100.0)
        assert np.nanmax(np.abs(off_m)) < 1e-4
        assert episode.info.truth == values


def test_samples_are_taken_when_they_are_asked_for():
    times_s = (0.0, 0.1, 0.13, 0.4, 1.7)
    uneven = DropSimulator(DropRig(times_s=times_s)).rollout({"restitution": 0.7, "drag": 0.1})
    assert uneven.signals[TOPIC].seconds == pytest.approx(times_s, abs=1e-9)
    even = DropSimulator(DropRig(rate_hz=100.0, samples=200))
    heights_m = even.rollout({"restitution": 0.7, "drag": 0.1}).signals[TOPIC].values[:, 2]
    rows = [round(100 * at_s) for at_s in times_s]
    assert uneven.signals[TOPIC].values[:, 2] == pytest.approx(heights_m[rows], abs=2e-5)


@pytest.mark.parametrize(
    "values",
    [{"drag": 0.1}, {"restitution": 0.5, "mass": 1.0}, {"restitution": 0.5, "drag": -1.0}],
)
def test_values_that_no_ball_has_are_refused(values: dict[str, float]):
    with pytest.raises(UsageError):
        DropSimulator(DropRig()).rollout(values)


def test_a_world_that_others_have_used_gives_the_bits_of_a_fresh_one():
    rig = DropRig(gap_m=0.7, rate_hz=120.0, samples=300, hold_s=0.1)
    values = {"restitution": 0.7, "restitution_slope": 0.05, "drag": 0.1}
    fresh = DropSimulator(rig, CALIBRATED, engine().ball_world(rig.radius_m, CALIBRATED))
    DropSimulator(DropRig(gap_m=1.9)).rollout({"restitution": 0.2})
    again = DropSimulator(rig).rollout(values)
    assert np.array_equal(again.signals[TOPIC].values, fresh.rollout(values).signals[TOPIC].values)
