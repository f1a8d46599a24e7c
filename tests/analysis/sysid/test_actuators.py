"""Which terms of a servo a log tells: found, left out by name, and never wrong and `ok`."""

from __future__ import annotations

from pathlib import Path

import pytest

import tunenet_logs as tn
from tunenet_logs.analysis.evaluation.worlds.machines import ModelLog
from tunenet_logs.analysis.evaluation.worlds.servos import NAME, servo_log, slow_servo_log
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.sysid.fit import SimulatorFit
from tunenet_logs.analysis.sysid.least_squares import correlation_length


def tuned(log: ModelLog, folder: Path) -> Tuning:
    path = folder / "servo.xml"
    path.write_text(log.model)
    return tn.tune(log.episode, model=path, parameters=["actuators"])


def found(tuning: Tuning) -> dict[str, float]:
    assert tuning.trace is not None
    names = (one.name for one in tuning.parameters)
    return dict(zip(names, map(float, tuning.trace.estimate), strict=True))


def test_a_servo_with_a_limit_and_a_delay_is_recovered(tmp_path: Path) -> None:
    log = servo_log(0)
    tuning = tuned(log, tmp_path)
    values = found(tuning)
    assert tuning.verdict == "ok", tuning.reason
    told = {f"actuator/{NAME}.forcerange", "delay/commands"}
    assert told < values.keys()
    # What this servo lacks is not tuned, but named.
    assert not any(name.startswith("servo/") for name in values)
    (words,) = [one for one in tuning.warnings if "cannot be told" in one]
    assert all(name in words for name in ("load_friction", "zero", "dead_band"))
    # The steps begin at what the model says.
    assert tuning.trace is not None
    given = [one.initial for one in tuning.parameters]
    assert tuning.trace.steps[0].values.tolist() == given
    for name, value in values.items():
        slack = 1e-3 if name == "delay/commands" else 0.0
        assert value == pytest.approx(log.truth[name], rel=0.03, abs=slack), name


def test_terms_of_which_one_hides_another_are_found(tmp_path: Path) -> None:
    # Without its delay an offset is no better, and without that, no delay.
    log = servo_log(71_000_001)
    tuning = tuned(log, tmp_path)
    assert tuning.verdict == "ok", tuning.reason
    values = found(tuning)
    for name, rel in ((f"servo/{NAME}.zero", 0.02), ("delay/commands", 0.02)):
        assert values[name] == pytest.approx(log.truth[name], rel=rel), name


def test_a_doubt_names_what_the_first_part_does_not_tell(tmp_path: Path) -> None:
    tuning = tuned(servo_log(71_000_002), tmp_path)  # reaches its torque limit late
    assert tuning.verdict == "suspect"
    assert tuning.reason is not None
    assert f"which does not tell actuator/{NAME}.forcerange" in tuning.reason
    assert "record twice as long" in tuning.reason


@pytest.mark.parametrize("seed", [12, 97_000_005])
def test_a_slow_rise_does_not_tell_a_gain_from_friction_by_load(seed: int, tmp_path: Path) -> None:
    log = slow_servo_log(seed)  # of a servo with friction by load, which a fit without it explains
    assert log.truth[f"servo/{NAME}.load_friction"] > 0
    tuning = tuned(log, tmp_path)
    assert tuning.trace is not None
    assert tuning.trace.fit is not None
    fit: SimulatorFit = tuning.trace.fit.detail
    hidden = {one.name for one in fit.unidentifiable}
    assert hidden
    assert tuning.verdict != "ok"
    assert tuning.reason is not None
    assert all(name in tuning.reason for name in hidden)
    assert any("left out: " in one and "load_friction" in one for one in tuning.warnings)
    # What is left out though it may be there is in the interval.
    gain = [one.name for one in tuning.parameters].index(f"actuator/{NAME}.kp")
    low, high = tuning.trace.fit.interval95[gain]
    assert low < log.truth[f"actuator/{NAME}.kp"] < high


def test_how_long_residuals_hang_together() -> None:
    import numpy as np

    white = np.random.default_rng(0).standard_normal(4000)
    assert correlation_length(white) < 1.3
    held = np.repeat(white[:400], 10)
    assert 7 < correlation_length(held) < 13
    assert correlation_length(np.zeros(5)) == 1.0
