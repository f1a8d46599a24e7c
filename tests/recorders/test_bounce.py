"""The closed form against the engine, which knows nothing of it."""

from __future__ import annotations

import numpy as np
import pytest

from recorders.simulators.bounce import bounce_heights, impact_places
from recorders.simulators.drop import TOPIC, DropRig, DropSimulator


@pytest.mark.parametrize("restitution", [0.0, 0.01, 0.1, 0.3, 0.5, 0.72, 0.9, 0.97, 1.0])
def test_it_is_what_the_calibrated_simulator_does(restitution: float):
    rig = DropRig(gap_m=2.0, radius_m=0.05, rate_hz=240.0, samples=1500)
    signal = DropSimulator(rig).rollout({"restitution": restitution}).signals[TOPIC]
    fall_s = np.sqrt(2 * rig.gap_m / 9.80665)
    heights = bounce_heights((signal.seconds - fall_s) / fall_s, restitution)
    assert np.abs(2.0 * heights + 0.05 - signal.values[:, 2]).max() < 2e-4


def test_impacts_by_hand():
    assert impact_places(0.5, 4) == pytest.approx([0, 1, 1.5, 1.75])
    assert impact_places(1.0, 3) == pytest.approx([0, 2, 4])
    assert impact_places(0.0, 3) == pytest.approx([0, 0, 0])


@pytest.mark.parametrize("restitution", [0.05, 0.5, 0.95, 1.0])
def test_impacts_are_where_the_ball_is_down_and_apexes_at_e_to_the_2n(restitution: float):
    places = impact_places(restitution, 6)
    assert bounce_heights(places, restitution) == pytest.approx(np.zeros(6), abs=1e-9)
    apexes = (places[1:] + places[:-1]) / 2
    heights = restitution ** (2 * np.arange(1, 6))
    assert bounce_heights(apexes, restitution) == pytest.approx(heights)


def test_the_ball_is_up_before_the_fall_and_down_after_the_last_flight():
    assert bounce_heights(np.array([-3.0, -1.0]), 0.5) == pytest.approx([1, 1])
    assert bounce_heights(np.array([2.0, 5.0, 1e6]), 0.5) == pytest.approx([0, 0, 0])
