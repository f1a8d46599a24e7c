"""Payloads are found in torques that another library made, with all that a driver adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import (
    ARM,
    CLEAN,
    any_log,
    changed,
    circle_log,
    driver,
    motion_of,
    on_topic,
    with_values,
)
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.analysis.payload.experiment import secant
from tunenet_logs.analysis.payload.noise import SeriesNoise
from tunenet_logs.analysis.payload.torque_fit import fit_payload, held
from tunenet_logs.analysis.payload.torque_model import (
    ArmModel,
    ArmMotion,
    Convention,
    arm_motion,
)
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import circle
from tunenet_logs.recorders.simulators.arm.payload import (
    Disturbances,
    driver_episode,
)

MASS_KG = 0.62
HELD = Payload(MASS_KG)


@pytest.fixture(scope="module")
def real():
    """A circle with everything that a real driver does, and its fit."""
    episode = circle_log(HELD, driver(11))
    return episode, fit_payload(ARM, motion_of(episode))


@pytest.mark.parametrize("mass_kg", [0.0, 0.3, 2.0])
def test_a_clean_log_is_answered_to_the_gram(mass_kg):
    fit = fit_payload(ARM, motion_of(circle_log(Payload(mass_kg))))
    assert fit.held.mass_kg == pytest.approx(mass_kg, abs=1e-3)
    assert fit.held.interval95[0] <= mass_kg <= fit.held.interval95[1]
    assert max(fit.scales[name] for name in ("offset", "friction", "rotor", "links")) < 0.1


def test_white_noise_is_answered_at_the_bound():
    noisy = (replace(CLEAN, torque_noise_nm=0.2, noise_seed=seed) for seed in range(3))
    fits = [fit_payload(ARM, motion_of(circle_log(HELD, one))) for one in noisy]
    errors = np.array([fit.held.mass_kg - MASS_KG for fit in fits])
    bounds = np.array([fit.bound_kg for fit in fits])
    assert np.abs(errors).max() < 0.01
    assert np.sqrt(np.mean((errors / bounds) ** 2)) < 3
    assert np.median(bounds) < 0.004


def test_a_real_drivers_log_and_its_interval(real):
    _, fit = real
    assert fit.held.interval95[0] < MASS_KG < fit.held.interval95[1]
    assert abs(fit.held.mass_kg - MASS_KG) < 0.15
    assert 0.02 < fit.held.sd_kg < 0.08
    assert fit.lag_s == pytest.approx(driver(11).lag_s, abs=0.03)
    np.testing.assert_allclose(np.std(fit.residual_nm, axis=0), 0.2, atol=0.03)


def test_a_tare_takes_out_what_both_share():
    disturbances = driver(21)
    tare = motion_of(circle_log(None, disturbances.another_run()))
    fit = fit_payload(ARM, motion_of(circle_log(HELD, disturbances)), [tare])
    assert fit.held.mass_kg == pytest.approx(MASS_KG, abs=0.03)
    assert fit.held.sd_kg < 0.015


def test_a_tare_may_be_another_motion():
    disturbances = driver(31)
    tare = motion_of(any_log(None, 5, disturbances.another_run()))
    fit = fit_payload(ARM, motion_of(any_log(HELD, 6, disturbances)), [tare])
    assert fit.held.mass_kg == pytest.approx(MASS_KG, abs=0.06)
    assert fit.held.interval95[0] < MASS_KG < fit.held.interval95[1]


def test_the_centre_of_mass_is_identifiable_with_a_tare():
    disturbances = driver(41)
    com_m = (0.025, -0.02, 0.015)
    tare = motion_of(circle_log(None, disturbances.another_run()))
    fit = fit_payload(ARM, motion_of(circle_log(Payload(0.9, com_m), disturbances)), [tare])
    assert fit.held.centre.is_identifiable
    assert "separated" in fit.identifiability
    assert fit.held.mass_kg == pytest.approx(0.9, abs=0.04)
    np.testing.assert_allclose(fit.held.centre.com_m, com_m, atol=0.02)
    sds = np.abs(np.array(fit.held.centre.com_m) - com_m) / fit.held.centre.sds_m
    assert sds.max() < 3


def test_without_a_tare_the_centre_stays_open(real):
    _, fit = real
    assert not fit.held.centre.is_identifiable
    assert "cannot separate" in fit.identifiability
    assert "--tare" in fit.identifiability


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("has_gravity", [True, False])
def test_sign_and_gravity_are_found(sign, has_gravity):
    episode = circle_log(HELD, replace(driver(51), rate_hz=60.0, clock=CLEAN.clock, jitter_s=0.0))
    motion = motion_of(episode)
    position, _, _ = motion.at(motion.seconds)
    gravity_nm = 0.0 if has_gravity else ArmModel(ARM).gravity_nm(position)
    converted = replace(motion, effort=sign * (motion.effort - gravity_nm))
    fit = fit_payload(ARM, converted)
    assert fit.convention == Convention(sign, has_gravity)
    assert fit.held.mass_kg == pytest.approx(MASS_KG, abs=0.15)


@pytest.mark.parametrize(
    "change",
    [
        {"position": with_values(lambda q: (np.degrees(q) + 180) % 360 - 180)},
        {"effort": lambda one: on_topic(one, "/joint_states", tuple("1234567"))},
        {"velocity": with_values(np.degrees)},
    ],
    ids=["-180..180", "numbers", "wrong velocities"],
)
def test_however_it_is_written_the_mass_is_the_same(real, change):
    episode, fit = real
    found = fit_payload(ARM, motion_of(changed(episode, **change)))
    assert found.held.mass_kg == pytest.approx(fit.held.mass_kg, abs=1e-6)


def tared_kg(disturbances: Disturbances) -> float:
    tare = motion_of(circle_log(None, disturbances.another_run()))
    return fit_payload(ARM, motion_of(circle_log(HELD, disturbances)), [tare]).held.mass_kg


def test_stale_repeats_jitter_and_slow_drivers():
    """Against the same arm by a driver with new values in each of 120 messages a second."""
    clear = {"clock": CLEAN.clock, "jitter_s": 0.0, "torque_noise_nm": 0.02}
    best_kg = tared_kg(replace(driver(61), rate_hz=120.0, **clear))
    for rate_hz, within_kg in ((65.0, 0.01), (10.0, 0.03)):
        assert tared_kg(driver(61, rate_hz)) == pytest.approx(best_kg, abs=within_kg)


def test_sensors_that_drift_after_the_tare_widen_the_interval():
    disturbances = driver(81)
    off = np.array(disturbances.offset_nm) + 0.15 * np.random.default_rng(8).normal(0, 1, 7)
    drifted = replace(disturbances.another_run(), offset_nm=tuple(off.tolist()))
    tare = motion_of(circle_log(None, drifted))
    fit = fit_payload(ARM, motion_of(circle_log(HELD, disturbances)), [tare])
    assert fit.held.interval95[0] < MASS_KG < fit.held.interval95[1]
    assert fit.held.mass_kg == pytest.approx(MASS_KG, abs=0.05)


@pytest.mark.parametrize("seconds", [10.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_long_log_at_1_khz(seconds):
    disturbances = replace(CLEAN, rate_hz=None, torque_noise_nm=0.2, noise_seed=4)
    motion = motion_of(driver_episode(ARM, circle(1000.0, seconds), HELD, disturbances))
    assert len(motion.seconds) <= 700
    fit = fit_payload(ARM, motion)
    assert fit.held.mass_kg == pytest.approx(MASS_KG, abs=1e-3)
    assert fit.held.sd_kg < 1e-3


def test_spikes_and_a_dead_joint(real):
    episode, fit = real

    def broken(values):
        values[::37, 1] += 40
        values[:, 6] = 0
        return values

    log = read_arm_log(changed(episode, effort=with_values(broken)), ARM)
    found = fit_payload(ARM, arm_motion(log))
    assert list(found.used) == [True] * 6 + [False]
    assert found.held.mass_kg == pytest.approx(fit.held.mass_kg, abs=0.03)


def crossed(motion: ArmMotion, sign: int, tares: Sequence[ArmMotion] = ()) -> float:
    convention, scales_nm = Convention(sign, has_gravity=True), np.full(7, 30.0)
    centre = (0.0, 0.0, 0.0)
    return secant(ARM, motion, convention, 0.0, com_m=centre, scales_nm=scales_nm, tares=tares)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_second_opinion_is_right_whichever_way_torques_count(sign):
    """What the sensors are off by is in both logs: within a gram, as on a clean log."""
    off = replace(CLEAN, offset_nm=(0.3, -0.4, 0.2, 0.5, -0.3, 0.4, -0.2))
    clean, held, empty = (
        replace(motion, effort=sign * motion.effort)
        for motion in map(
            motion_of, (circle_log(HELD), circle_log(HELD, off), circle_log(None, off))
        )
    )
    assert crossed(clean, sign) == pytest.approx(MASS_KG, abs=1e-3)
    assert crossed(held, sign, [empty]) == pytest.approx(MASS_KG, abs=1e-3)


def test_a_tare_that_ends_before_the_log_fits_where_it_is():
    """Along the log's path it covers 93 %: what it is beyond that is nobody's measurement."""
    held, empty = (motion_of(circle_log(load, driver(11))) for load in (HELD, None))
    kept = slice(int(0.07 * len(empty.seconds)), None)
    short = replace(empty, seconds=empty.seconds[kept], effort=empty.effort[kept])
    (left,) = fit_payload(ARM, held, [short]).tare_residuals
    assert len(left.residual_nm) < len(held.seconds)
    np.testing.assert_allclose(np.std(left.residual_nm, axis=0), 0.2, atol=0.05)


def test_the_centres_error_is_that_of_a_ratio():
    """First moments over mass: drawn from their covariance, the quotients spread as is said."""
    rng = np.random.default_rng(3)
    mass_kg, com_m = 0.6, np.array([0.18, -0.05, 0.02])
    root = rng.normal(0.0, 0.004, (4, 4)) + np.diag([0.02, 0.004, 0.004, 0.004])
    means = np.array([mass_kg, *(mass_kg * com_m), *[0.0] * 6])
    covariance = np.diag([0.0] * 4 + [1e-4] * 6)
    covariance[:4, :4] = root @ root.T
    drawn = rng.multivariate_normal(means, covariance, 200_000)
    centre = held(means, covariance).centre
    assert centre.com_m == pytest.approx(com_m)
    assert centre.sds_m == pytest.approx((drawn[:, 1:4] / drawn[:, :1]).std(axis=0), rel=0.03)


def normal(mass_kg, sd_kg, com_m=(0.0, 0.0, 0.0), moments=(0.0,) * 6, inertia_sd=1e-3):
    means = np.array([mass_kg, *(mass_kg * np.array(com_m)), *moments])
    return held(means, np.diag(np.square([sd_kg, *[1e-3] * 3, *[inertia_sd] * 6])))


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


def test_a_mass_near_nothing_has_an_interval_from_0():
    """Whose other end is that of the part above 0; far from it, the interval is the usual one."""
    for mass_kg in (-0.3, -0.05, 0.0, 0.05):
        found = normal(mass_kg, 0.05)
        assert found.interval95[0] == 0
        assert 0.005 < found.interval95[1] < 0.2
        assert found.mass_kg == max(mass_kg, 0)
    drawn = np.random.default_rng(0).normal(0.03, 0.05, 400_000)
    above = np.quantile(drawn[drawn > 0], 0.95)
    assert normal(0.03, 0.05).interval95[1] == pytest.approx(above, rel=0.01)
    assert normal(1.0, 0.1).interval95 == pytest.approx((0.804, 1.196))


@pytest.mark.parametrize("wander", [0.0, 0.3])
def test_it_weighs_as_the_inverse_covariance_does(wander):
    seconds = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.02, 400))
    noise = SeriesNoise(seconds, np.ones(400), 0.2, wander, 0.4)
    apart = np.abs(seconds[:, None] - seconds)
    dense = 0.2**2 * np.eye(400) + wander**2 * np.exp(-apart / 0.4)
    columns = np.random.default_rng(1).normal(0, 1, (400, 3))
    np.testing.assert_allclose(noise.weighed(columns), np.linalg.solve(dense, columns), rtol=1e-6)
    expected = -0.5 * columns[:, 0] @ np.linalg.solve(dense, columns[:, 0])
    expected -= 0.5 * np.linalg.slogdet(dense)[1]
    assert noise.log_likelihood(columns[:, 0]) == pytest.approx(expected, rel=1e-8)
