"""The JSON is the contract's, and holds no truth."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.records import drop_record, payload_record
from tests.conftest import ROOT, record
from tunenet_logs.analysis.estimators.base import ExtraEstimate
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import (
    Curves,
    Equivalent,
    Equivalents,
    Motion,
    Record,
    SimulationFit,
    SoundShare,
    Units,
    record_from,
    to_json,
)
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.recorders.simulators.known import engine


def test_the_json_has_the_contracts_keys(drop_log: Path):
    report = json.loads(to_json(record_of(tune_log(drop_log, TuneOptions()))))
    assert report["log"] == "drop.mcap"
    assert report["task"] == "drop"
    assert report["verdict"] == "ok"
    assert report["reason"] is None
    restitution = report["parameters"]["restitution"]
    low, high = restitution.pop("interval95")
    assert 0.6999 < low < 0.7 < high < 0.7001
    assert restitution == {"value": pytest.approx(0.7, abs=1e-4), "unit": "1"}
    assert report["method"] == "tunenet+refine"
    assert report["rollouts"] == 7
    assert [step["k"] for step in report["iterations"]] == list(range(7))
    assert report["iterations"][0]["restitution"] == 0
    bounce = report["bounces"][0]
    assert bounce["impact_speed"] == pytest.approx((2 * 9.80665) ** 0.5, rel=1e-3)
    assert bounce["unit"] == "m/s"
    assert report["cross_check"]["agrees"] is True
    assert report["cross_check"]["value"] == pytest.approx(0.7, abs=1e-3)
    numbers = {"name", "passed", "detail", "wanted", "value", "limit", "unit"}
    assert all(numbers == set(check) for check in report["checks"])
    assert report["simulator"]["engine"] == engine().name
    assert report["simulator"]["preset"] == "default"
    assert report["simulator"]["step_hz"] == pytest.approx(60)
    assert set(report["seconds"]) == {"read", "observe", "tune", "total"}
    assert "truth" not in json.dumps(report)


def test_a_rejected_log_has_a_reason_and_no_number(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.0, height_m=1.0)
    report = json.loads(to_json(record_of(tune_log(path, TuneOptions()))))
    assert report["verdict"] == "rejected"
    assert report["parameters"] is None
    assert report["bounces"] == []
    assert "does not bounce" in report["reason"]
    (tmp_path / "b.mcap").write_text("no log")
    report = json.loads(to_json(record_of(tune_log(tmp_path / "b.mcap", TuneOptions()))))
    assert report["method"] is None


def test_a_failed_check_says_what_to_do_at_the_next_drop(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    advice = "record until the ball lies still"
    checks = [replace(one, passed=one.advice != advice) for one in tuning.checks]
    written = json.loads(to_json(record_of(replace(tuning, checks=tuple(checks)))))["checks"]
    failed = [one for one in written if not one["passed"]]
    assert [one["advice"] for one in failed] == [advice]
    assert all("advice" not in one for one in written if one["passed"])
    assert all(one.advice for one in tuning.checks)


def test_where_a_check_fails_nothing_has_an_interval():
    path = ROOT / "sample_logs" / "noisy.mcap"
    tuning = tune_log(path, TuneOptions())
    assert tuning.trace is not None
    assert tuning.trace.fit is not None
    beside = ExtraEstimate("payload_com", "m", np.zeros(3), np.zeros((3, 2)))
    first = replace(tuning.checks[0], passed=False)
    doubted = replace(
        tuning,
        trace=replace(tuning.trace, fit=replace(tuning.trace.fit, extra=(beside,))),
        checks=(first, *tuning.checks[1:]),
        verdict="suspect",
    )
    parameters = json.loads(to_json(record_of(doubted)))["parameters"]
    assert parameters["restitution"]["interval95"] is None
    assert parameters["payload_com"]["interval95"] is None


def whole_record() -> Record:
    """A drop's with all that a record can hold."""
    air = Equivalent(0.69, 1.1, (4.2, 2.9))
    motion = Motion(
        Curves(7, np.array([0.0, 0.5]), np.array([1.0, 0.5]), np.array([1.0, np.nan])),
        SimulationFit(0.2, 0.5, 0.1, None, 400, 2, 0.001, "m"),
        Equivalents(air, replace(air, restitution=0.7)),
        ("drag and slope are seen only together",),
        ("drag",),
        Units(0.001, "gravity", 240.0, "clock"),
        SoundShare(5, 4, -0.002, "", 0.71, (0.7, 0.72)),
    )
    steps = ({"restitution": 0.5}, {"restitution": 0.7})
    return drop_record(slope=(0.05, 0.01), motion=motion, iterations=steps, is_fitted=True)


@pytest.mark.parametrize(
    "known", [whole_record(), payload_record(0.5, 0.01, (0.0, 0.1, 0.2), 0.02)]
)
def test_what_is_read_is_what_was_written(known: Record):
    text = to_json(known)
    again = record_from(json.loads(text))
    assert to_json(again) == text
    for field in fields(Record):
        if field.name != "motion":
            assert getattr(again, field.name) == getattr(known, field.name), field.name
    for field in fields(Motion):
        if field.name != "curves":
            assert getattr(again.motion, field.name) == getattr(known.motion, field.name)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("verdict", "splendid"),
        ("verdict", None),
        ("log", 5),
        ("physical", "yes"),
        ("rollouts", 7.5),
        ("rollouts", True),
        ("warnings", "all of them"),
        ("checks", [{"name": "a", "passed": 1, "detail": "b"}]),
        ("checks", [{"name": "a", "passed": True, "detail": "b", "value": float("nan")}]),
        ("bounces", [{"restitution": 0.7, "interval95": [0.1], "impact_speed": 1, "time_s": 0}]),
        ("bounces", [0.7]),
        ("seconds", {"total": float("inf")}),
        ("window", [1, 2]),
        ("simulation_fit", {"rms_percent": 1.0}),
        ("cross_check", {"method": "m", "value": "0.7", "agrees": True}),
        ("provenance", {"version": "1"}),
        ("parameters", {"restitution": {"value": True, "interval95": None}}),
        ("parameters", {"restitution": {"value": 0.7, "interval95": [[0.1, 0.2]]}}),
        ("parameters", {"restitution": {"value": [0.7, [0.1]], "interval95": None}}),
        ("iterations", [{"k": 0, "restitution": "0.7"}]),
    ],
)
def test_a_value_that_no_tuning_has_is_refused(key: str, value: Any):
    known = json.loads(to_json(whole_record()))
    with pytest.raises((ValueError, TypeError, LookupError)):
        record_from({**known, key: value})
