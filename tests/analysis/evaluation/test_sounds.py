"""The bounces whose sound is made: their times and restitutions, what a phone hears, what an app
reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tunenet_logs.analysis.evaluation.studies.audio import events_over
from tunenet_logs.analysis.evaluation.worlds.audio import draw_sound
from tunenet_logs.analysis.evaluation.worlds.ball import GRAVITY_M_S2, BounceOrder, bounced

ORDER = BounceOrder(height_m=1.1, restitution=0.8, slope=0.05, drag_1_m=0.13, contact_s=0.002)


def test_flights_are_those_of_the_equation_of_motion():
    """Integrated by SciPy, from each impact to the next."""
    history = bounced(ORDER)
    ups = history.speeds_m_s * history.restitutions
    for at in range(4):

        def moved(_: float, state: np.ndarray) -> list[float]:
            return [state[1], -GRAVITY_M_S2 - ORDER.drag_1_m * state[1] * abs(state[1])]

        def lands(_: float, state: np.ndarray) -> float:
            return float(state[0])

        lands.terminal, lands.direction = True, -1  # type: ignore[attr-defined]
        flown = solve_ivp(moved, (0, 3), [1e-12, ups[at]], events=lands, rtol=1e-10, atol=1e-12)
        begin_s = history.touches_s[at] + history.contacts_s[at]
        assert history.touches_s[at + 1] - begin_s == pytest.approx(flown.t[-1], abs=1e-6)
        assert history.speeds_m_s[at + 1] == pytest.approx(-flown.y[1, -1], abs=1e-6)


def test_impacts_keep_to_the_law_or_differ_from_it_by_as_much_as_is_asked_for():
    law = bounced(ORDER)
    speeds = law.speeds_m_s / law.speeds_m_s[0]
    assert law.by_law == pytest.approx(np.minimum(0.8 * speeds**-0.05, 0.975))
    assert np.array_equal(law.restitutions, law.by_law)
    uneven = [bounced(replace(ORDER, uneven=0.003, seed=seed)) for seed in range(40)]
    off = np.concatenate([np.log(one.restitutions / one.by_law)[:20] for one in uneven])
    assert np.std(off) == pytest.approx(0.003, rel=0.1)
    assert abs(np.mean(off)) < 0.0005


@pytest.mark.parametrize("snr_db", [10.0, 30.0])
def test_the_background_is_as_much_softer_as_is_asked_for(snr_db: float):
    """In the same clip, 10 dB more: the rest of the sound stays the same."""
    soft, loud = (draw_sound(3, 1, background="noise", snr_db=db) for db in (snr_db + 10, snr_db))
    quiet = slice(0, int(0.8 * soft.impacts_s[0] * soft.rate_hz))
    powers = [float(np.mean(one.samples[quiet].astype(float) ** 2)) for one in (soft, loud)]
    assert 10 * np.log10(powers[1] / powers[0]) == pytest.approx(10, abs=2)


def test_an_app_s_events_are_the_first_samples_over_its_threshold():
    samples = np.zeros(44_100, np.float32)
    for at in (4410, 4415, 13_230, 30_870):
        samples[at] = 0.5
    assert events_over(samples, 44_100, 0.1) == pytest.approx([0.1, 0.3, 0.7])
