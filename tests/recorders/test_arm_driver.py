"""A driver's disturbances: each does what it says, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle
from tunenet_logs.recorders.simulators.arm.payload import (
    REAL_ARM,
    Disturbances,
    FieldClock,
    drawn,
    driver_episode,
    joint_efforts_nm,
    perturbed,
    through_kinovas_driver,
)

ARM = jaco()
PATH = circle(240)
HELD = Payload(0.6)
IDEAL = joint_efforts_nm(ARM, PATH, HELD)


def of(episode: Episode, part: str) -> np.ndarray:
    return episode.signals[f"/joint_states.{part}"].values


def effort(**disturbances: object) -> np.ndarray:
    return of(driver_episode(ARM, PATH, HELD, Disturbances(**disturbances)), "effort")  # type: ignore[arg-type]


def test_without_disturbances_torques_are_the_ideal_ones():
    episode = driver_episode(ARM, PATH, HELD, Disturbances())
    assert np.array_equal(of(episode, "effort"), IDEAL)
    assert np.array_equal(of(episode, "position"), PATH.position_rad)
    assert np.array_equal(of(episode, "velocity"), PATH.velocity_rad_s)
    assert episode.info.truth["payload_mass"] == 0.6
    assert dict(episode.info.notes) == {}


def test_noise_is_white_and_as_large_as_was_asked_for():
    off = effort(torque_noise_nm=0.2) - IDEAL
    assert np.std(off, axis=0) == pytest.approx(np.full(7, 0.2), rel=0.1)
    assert np.abs(np.mean(off[1:] * off[:-1], axis=0)).max() < 0.1 * 0.2**2


def test_offsets_gains_and_friction():
    offsets = tuple(np.linspace(-0.3, 0.3, 7))
    assert np.abs(effort(offset_nm=offsets) - IDEAL - offsets).max() < 1e-12
    assert np.abs(effort(gain_error=(0.03,) * 7) - 1.03 * IDEAL).max() < 1e-12
    assert np.abs(effort(viscous_nm_s=(0.5,) * 7) - IDEAL - 0.5 * PATH.velocity_rad_s).max() < 1e-12
    coulomb = effort(coulomb_nm=(0.4,) * 7) - IDEAL
    fast = np.abs(PATH.velocity_rad_s) > 0.05
    assert np.abs(coulomb - 0.4 * np.sign(PATH.velocity_rad_s))[fast].max() < 1e-3
    assert np.abs(coulomb).max() < 0.4 + 1e-9


def test_torques_that_lag():
    late = effort(lag_s=4.4 / 240)
    before = joint_efforts_nm(ARM, circle(240 * 5, 5), HELD)  # a fifth of a sample each
    first = len(PATH.seconds) - len(late)
    wanted = before[5 * first - 22 :: 5][: len(late)]
    assert np.abs(late - wanted).max() < 1e-5


def test_an_arm_that_differs_from_its_description():
    disturbances = Disturbances(
        link_mass_error=(0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0),
        link_com_error_m=((0.0, 0.0, 0.0),) * 6 + ((0.003, 0.0, 0.0),),
    )
    other = perturbed(ARM, disturbances)
    assert other.joints[1].link.mass_kg == pytest.approx(1.05 * 0.8447)
    assert other.joints[6].link.com_m[0] == pytest.approx(0.003)
    assert other.joints[3] == ARM.joints[3]
    efforts = of(driver_episode(ARM, PATH, HELD, disturbances), "effort")
    assert np.array_equal(efforts, joint_efforts_nm(other, PATH, HELD))


def test_fields_are_new_at_their_own_rates_and_repeated_between():
    disturbances = through_kinovas_driver(drawn(3, ARM))
    episode = driver_episode(ARM, PATH, HELD, disturbances)
    stamps = episode.signals["/joint_states.effort"].stamps_ns
    seconds = (stamps[-1] - stamps[0]) * 1e-9
    assert len(stamps) / seconds == pytest.approx(65, rel=0.02)
    assert np.std(np.diff(stamps)) > 1e6  # jitter
    for part, rate_hz in (("position", 30), ("velocity", 16), ("effort", 58)):
        fresh = np.any(np.diff(of(episode, part), axis=0) != 0, axis=1)
        assert np.count_nonzero(fresh) / seconds == pytest.approx(rate_hz, rel=0.03)
    at = np.interp(stamps * 1e-9, PATH.seconds, PATH.position_rad[:, 0])
    assert np.abs(of(episode, "position")[:, 0] - at).max() < 0.1


def test_a_slow_driver_has_nothing_stale():
    episode = driver_episode(ARM, PATH, HELD, through_kinovas_driver(drawn(3, ARM), 10))
    assert episode.signals["/joint_states.effort"].rate_hz == pytest.approx(10, rel=0.02)
    for part in ("position", "velocity", "effort"):
        assert np.all(np.any(np.diff(of(episode, part), axis=0) != 0, axis=1))


def test_the_same_seed_is_the_same_arm_on_another_run():
    disturbances = through_kinovas_driver(drawn(5, ARM))
    first = driver_episode(ARM, PATH, HELD, disturbances)
    again = driver_episode(ARM, PATH, HELD, through_kinovas_driver(drawn(5, ARM)))
    assert np.array_equal(of(first, "effort"), of(again, "effort"))
    assert first.info == again.info
    tare = disturbances.another_run()
    assert replace(tare, noise_seed=disturbances.noise_seed) == disturbances
    empty = driver_episode(ARM, PATH, None, tare)
    assert empty.info.truth["payload_mass"] == 0.0
    other = driver_episode(ARM, PATH, HELD, tare)
    assert not np.array_equal(of(other, "effort"), of(first, "effort"))
    assert first.info.notes["offset_nm"] == empty.info.notes["offset_nm"]


def test_drawn_disturbances_are_as_large_as_stated():
    many = [drawn(seed, ARM) for seed in range(300)]
    for name, size in (
        ("offset_nm", 0.3),
        ("viscous_nm_s", 0.5),
        ("coulomb_nm", 0.5),
        ("gain_error", 0.03),
        ("link_mass_error", 0.05),
        ("link_com_error_m", 0.003),
    ):
        values = np.array([getattr(one, name) for one in many])
        assert np.sqrt(np.mean(values**2)) == pytest.approx(size, rel=0.05)
    assert min(min(one.coulomb_nm) for one in many) >= 0
    lags = [one.lag_s for one in many]
    assert 0 <= min(lags) < 0.003
    assert 0.027 < max(lags) <= 0.03
    either = replace(REAL_ARM, friction_opposes=False)
    assert min(min(drawn(seed, ARM, either).coulomb_nm) for seed in range(3)) < -0.1


@pytest.mark.parametrize(
    "bad",
    [
        {"torque_noise_nm": float("nan")},
        {"torque_noise_nm": -0.1},
        {"lag_s": -0.1},
        {"offset_nm": (float("inf"),) * 7},
        {"rate_hz": 0.0},
    ],
)
def test_bad_disturbances_are_refused(bad: dict[str, object]):
    with pytest.raises(UsageError, match=next(iter(bad))):
        Disturbances(**bad)  # type: ignore[arg-type]


def test_disturbances_of_other_arms_and_paths_too_short_are_refused():
    with pytest.raises(UsageError, match=r"offset_nm.*6 values for 7"):
        effort(offset_nm=(0.0,) * 6)
    with pytest.raises(UsageError, match="position_hz"):
        FieldClock(position_hz=0.0)
    with pytest.raises(UsageError, match="too short"):
        driver_episode(ARM, circle(240, 0.05), None, through_kinovas_driver(drawn(1, ARM)))
