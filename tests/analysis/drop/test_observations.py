"""The canonical observation depends on the restitution alone."""

from __future__ import annotations

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop import presets as views
from tunenet_logs.analysis.drop.free_flight import find_drops
from tunenet_logs.analysis.estimators.base import resample
from tunenet_logs.recorders.simulators.ball import DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED


def canonical_curve(restitution: float) -> np.ndarray:
    """In closed form: flight n lasts 2 e^n fall times."""
    axis = views.canonical_axis()
    return bounce_heights(restitution, 1.0, axis + 1, gravity=2.0)


@pytest.mark.parametrize("restitution", [0.1, 0.35, 0.6, 0.95])
@pytest.mark.parametrize("gravity", [1.62, 9.81])
@pytest.mark.parametrize("rate", [60.0, 133.0, 240.0])
def test_height_rate_gravity_and_table_drop_out(restitution: float, gravity: float, rate: float):
    exact = canonical_curve(restitution)
    for gap in (0.5, 2.2):
        times = np.arange(int(12 * rate)) / rate
        heights = bounce_heights(restitution, gap, times - 0.3, gravity) - 0.8
        observation = views.canonical(find_drops(times, heights)[0])
        assert np.abs(observation.values[:, 0] - exact).max() < 2e-3


def test_a_rollout_is_observed_as_a_recording_of_it_is():
    rig = DropRig(gap_m=1.7, rate_hz=90, samples=600, hold_s=0.4)
    episode = DropSimulator(rig).rollout({"restitution": 0.6})
    known = views.canonical(views.rollout_drop(episode, rig, CALIBRATED))
    signal = next(iter(episode.signals.values()))
    found = views.canonical(find_drops(signal.seconds, signal.values[:, 2])[0])
    assert np.abs(known.values - found.values).max() < 1e-4


def test_what_the_recording_does_not_show_is_nan():
    times = np.arange(60) / 60
    heights = bounce_heights(0.8, 1.0, times)
    observation = views.canonical(find_drops(times, heights)[0])
    seen = np.isfinite(observation.values[:, 0])
    assert seen[0]
    assert not seen[-1]
    assert np.all(np.diff(seen.astype(int)) <= 0)


def test_resample_is_linear_and_nan_outside():
    out = resample(np.array([0.0, 1.0]), np.array([0.0, 2.0]), np.array([-1.0, 0.25, 2.0]))
    assert out[1] == 0.5
    assert np.isnan(out[[0, 2]]).all()
