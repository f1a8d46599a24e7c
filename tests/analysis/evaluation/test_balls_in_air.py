"""The integrator of real balls beside closed forms, and beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, drop_ball, fallen, parabolas
from tunenet_logs.recorders.simulators.ball import Bounce

G = 9.81
BALLS = [
    RealBall(0.9, 0.05, 0.36, 2.0),
    RealBall(0.9, 0.05, 0.131, 1.0),
    RealBall(0.5, 0.12, 0.02, 0.3),
    RealBall(0.92, 0.0, 0.003, 0.5),
]


def impacts_in_closed_form(ball: RealBall, count: int) -> np.ndarray:
    """Times [s] and speeds [m/s], shape (count, 2).

    Falling, d(v²)/dh = 2 g - 2 k v² over the way fallen: v² = g/k (1 - exp(-2 k h)), and v(t) is
    sqrt(g/k) tanh(t sqrt(g k)). Rising, v(t) = sqrt(g/k) tan(phase), 2 k h = ln(1 + k v²/g).
    """
    k = ball.drag_1_m
    terminal, rate = np.sqrt(G / k), np.sqrt(G * k)
    clock, height, first = 0.0, ball.drop_m, 0.0
    rows = []
    for _ in range(count):
        speed = terminal * np.sqrt(-np.expm1(-2 * k * height))
        clock += np.arctanh(speed / terminal) / rate
        rows.append((clock, speed))
        first = first or speed
        kept = min(ball.restitution * (max(speed, 0.05) / first) ** -ball.slope, 1.0)
        clock += np.arctan(kept * speed / terminal) / rate
        height = np.log1p((kept * speed / terminal) ** 2) / (2 * k)
    return np.array(rows)


@pytest.mark.parametrize("ball", BALLS)
def test_impacts_are_those_of_the_closed_form(ball: RealBall):
    path = fallen(ball.values[None], 3.0)
    count = int((path.impacts_s[0] < 3.0).sum())
    count = min(count, int((path.impact_speeds_m_s[0] > 0).sum()))
    known = impacts_in_closed_form(ball, count)
    assert count >= 5
    assert np.allclose(path.impacts_s[0, :count], known[:, 0], atol=2e-7)
    assert np.allclose(path.impact_speeds_m_s[0, :count], known[:, 1], atol=3e-7)


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.95])
@pytest.mark.parametrize(("slope", "drag"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.3), (0.1, 0.05)])
def test_heights_are_those_that_a_simulator_has_in_closed_form(
    restitution: float, slope: float, drag: float
):
    unit_m, seconds = G / 2, np.linspace(-0.5, 8.0, 400)  # a fall from here lasts a second
    fall = drop_ball(RealBall(restitution, slope, drag / unit_m, unit_m), seconds)
    exact = Bounce(restitution, slope, drag).heights(seconds - fall.impacts_s[0])
    assert fall.heights_m / unit_m == pytest.approx(exact, abs=1e-6)


def test_heights_are_those_of_another_integrator():
    ball = BALLS[1]
    path = fallen(ball.values[None], 2.0)
    begin, speed = path.impacts_s[0, 0], path.impact_speeds_m_s[0]
    up = ball.restitution * speed[0]

    def moves(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -G - ball.drag_1_m * state[1] * abs(state[1])]

    times = np.linspace(begin + 1e-6, path.impacts_s[0, 1] - 1e-6, 200)
    whole = (begin, times[-1])
    solved = solve_ivp(moves, whole, [0.0, up], "DOP853", times, rtol=1e-12, atol=1e-12)
    assert np.allclose(path.at(times[None])[0], solved.y[0], atol=2e-8)


def test_without_air_it_flies_along_parabolas():
    times = np.linspace(-0.5, 2.5, 1001)
    height = fallen(np.array([[0.7, 0.0, 0.0, 1.3]]), 3.0).at(times[None])[0]
    fall = np.sqrt(2 * 1.3 / G)
    falling = (times > 0) & (times < fall)
    assert np.allclose(height[times <= 0], 1.3)
    assert np.allclose(height[falling], 1.3 - G / 2 * times[falling] ** 2, atol=1e-12)
    assert np.allclose(height, parabolas(0.7, 1.3, times), atol=2e-6)  # which lies a bit earlier
    apex = drop_ball(RealBall(0.7, 0.0, 0.0, 1.3), np.array([fall * 1.7]))
    assert apex.heights_m == pytest.approx(0.49 * 1.3)


def test_a_long_fall_nears_the_terminal_speed():
    path = fallen(np.array([[0.5, 0.0, 0.3, 40.0]]), 0.0, 400)
    assert path.impact_speeds_m_s[0, 0] == pytest.approx(np.sqrt(G / 0.3), rel=1e-6)


def test_the_air_takes_energy_and_gives_none():
    path = fallen(np.array([[1.0, 0.0, 0.1, 1.0], [1.0, 0.0, 0.0, 1.0]]), 4.0)
    lost, kept = path.impact_speeds_m_s
    assert (np.diff(lost[lost > 0]) < 0).all()
    assert np.allclose(kept[:6], np.sqrt(2 * G))


def test_the_restitution_follows_the_speed_down_to_the_slowest():
    values = np.array([0.6, 0.1, 0.02, 0.5])
    path = fallen(values[None], 10.0)
    hits = path.impact_speeds_m_s[0]
    hits = hits[hits > 0]
    ratio = np.maximum(hits[:-1], 0.05) / hits[0]
    up = 0.6 * ratio**-0.1 * hits[:-1]
    again = np.sqrt(G / 0.02 * -np.expm1(-np.log1p(0.02 * up**2 / G)))
    assert np.allclose(hits[1:], again, atol=1e-9)
    assert np.isfinite(path.rests_s[0])
    assert path.at(path.rests_s[:, None] + 1.0) == 0.0


def test_no_ball_gives_more_than_it_takes():
    path = fallen(np.array([[0.92, 0.3, 0.0, 2.0]]), 5.0)
    assert (np.diff(path.impact_speeds_m_s[0]) <= 1e-9).all()
    assert np.isinf(path.rests_s[0])


def test_balls_together_move_as_each_alone():
    times = np.tile(np.linspace(-0.1, 2.0, 300), (2, 1))
    both = fallen(np.array([ball.values for ball in BALLS[1:3]]), 2.0).at(times)
    for at, ball in enumerate(BALLS[1:3]):
        assert np.allclose(both[at], fallen(ball.values[None], 2.0).at(times[:1])[0], atol=1e-7)
