"""The closed form against the engine, and against integration in small steps."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.recorders.simulators.ball import TOPIC, Bounce, DropRig, DropSimulator


@pytest.mark.parametrize("restitution", [0.0, 0.01, 0.1, 0.3, 0.5, 0.72, 0.9, 0.97, 1.0])
def test_it_is_what_the_calibrated_simulator_does(restitution: float):
    rig = DropRig(gap_m=2.0, radius_m=0.05, rate_hz=240.0, samples=1500)
    signal = DropSimulator(rig).rollout({"restitution": restitution}).signals[TOPIC]
    fall_s = np.sqrt(2 * rig.gap_m / 9.80665)
    heights = Bounce(restitution).heights((signal.seconds - fall_s) / fall_s)
    assert np.abs(2.0 * heights + 0.05 - signal.values[:, 2]).max() < 2e-4


def integrated(ball: Bounce, places: np.ndarray, release: float) -> np.ndarray:
    """Steps of 1e-4, velocity Verlet; each impact at the step's linear share."""
    step, clock, height, speed, first = 1e-4, release, 1.0, 0.0, 0.0
    times, heights = [clock], [height]
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
        heights.append(height)
    return np.interp(places, times, heights)


@pytest.mark.parametrize(("slope", "drag"), [(0.0, 0.0), (0.15, 0.0), (0.0, 0.1), (0.1, 0.03)])
def test_slope_and_drag_are_those_of_the_equation_of_motion(slope: float, drag: float):
    ball = Bounce(0.75, slope, drag)
    fall = np.arccosh(np.exp(drag)) / np.sqrt(2 * drag) if drag else 1.0
    places = np.linspace(-fall, 4.0, 500)
    assert np.abs(ball.heights(places) - integrated(ball, places, -fall)).max() < 2e-3


def test_impacts_by_hand():
    assert Bounce(0.5).flights(1.6)[0][:4] == pytest.approx([0, 1, 1.5, 1.75])
    assert Bounce(1.0).flights(3.9)[0] == pytest.approx([0, 2, 4])
    assert Bounce(0.0).flights(9.0)[0] == pytest.approx([0])


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.95, 1 - 1e-16, 1.0])
def test_the_ball_is_down_at_impacts_and_up_by_e_to_the_2n_between(restitution: float):
    ball = Bounce(restitution)
    places = ball.flights(100.0)[0][:6]
    assert ball.heights(places) == pytest.approx(np.zeros(6), abs=1e-9)
    apexes = (places[1:] + places[:-1]) / 2
    assert ball.heights(apexes) == pytest.approx(restitution ** (2 * np.arange(1, 6)))


def test_the_ball_is_up_before_the_fall_and_down_after_the_last_flight():
    assert Bounce(0.5).heights(np.array([-3.0, -1.0])) == pytest.approx([1, 1])
    assert Bounce(0.5).heights(np.array([2.0, 5.0, 1e6])) == pytest.approx([0, 0, 0], abs=1e-9)
    assert Bounce(0.5, 0.1, 0.05).heights(np.array([5.0, 1e6])) == pytest.approx([0, 0], abs=1e-9)
