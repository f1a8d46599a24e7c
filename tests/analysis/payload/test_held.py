"""What is held is a body that there can be, with an interval that says what is not known."""

import numpy as np
import pytest

from tunenet_logs.analysis.payload.torque_fit import held


def normal(mass_kg, sd_kg, com_m=(0.0, 0.0, 0.0), moments=(0.0,) * 6, inertia_sd=1e-3):
    means = np.array([mass_kg, *(mass_kg * np.array(com_m)), *moments])
    return held(means, np.diag(np.square([sd_kg, *[1e-3] * 3, *[inertia_sd] * 6])))


@pytest.mark.parametrize("mass_kg", [-0.3, -0.05, 0.0, 0.05])
def test_a_mass_near_nothing_has_an_interval_from_0(mass_kg):
    found = normal(mass_kg, 0.05)
    assert found.interval95[0] == 0
    assert 0.005 < found.interval95[1] < 0.2
    assert found.mass_kg == max(mass_kg, 0)


def test_the_end_from_0_is_that_of_the_part_above_it():
    drawn = np.random.default_rng(0).normal(0.03, 0.05, 400_000)
    above = np.quantile(drawn[drawn > 0], 0.95)
    assert normal(0.03, 0.05).interval95[1] == pytest.approx(above, rel=0.01)


def test_a_mass_far_from_0_has_the_usual_interval():
    assert normal(1.0, 0.1).interval95 == pytest.approx((0.804, 1.196))


def test_inertia_is_given_where_it_is_told_and_is_a_bodys():
    # A rod of 2 kg and 0.4 m along x: xx, xy, yy, xz, yz, zz beyond those of a ball.
    rod, ball = 2 * 0.4**2 / 12, 0.4 * 2 * 0.04**2
    moments = (1e-4 - ball, 0.0, rod - ball, 0.0, 0.0, rod - ball)
    told = normal(2.0, 0.01, moments=moments, inertia_sd=5e-4)
    assert told.inertia is not None
    xx, xy, yy, xz, yz, zz = told.inertia.kg_m2
    assert (yy, zz) == pytest.approx((rod, rod), rel=0.1)
    values = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert values[0] >= 0
    assert values[2] <= values[0] + values[1]
    for (low, high), value in zip(told.inertia.interval95, told.inertia.kg_m2, strict=True):
        assert low <= value <= high
    assert normal(2.0, 0.01, moments=moments, inertia_sd=2e-2).inertia is None
