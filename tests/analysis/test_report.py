"""The JSON is the contract's, and holds no truth."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from analysis.report import row_of, table, to_json
from analysis.tuning import Options, tune_log
from tests.conftest import record


def test_the_json_has_the_contracts_keys(drop_log: Path):
    report = json.loads(to_json(tune_log(drop_log, Options())))
    assert report["log"] == "drop.mcap"
    assert report["task"] == "drop"
    assert report["verdict"] == "ok"
    assert report["reason"] is None
    restitution = report["parameters"]["restitution"]
    low, high = restitution.pop("interval95")
    assert 0.6999 < low < 0.7 < high < 0.7001
    assert restitution == {"value": pytest.approx(0.7, abs=1e-4), "unit": "1"}
    assert report["method"] == "tunenet+refine"
    assert report["rollouts"] == 6
    assert [step["k"] for step in report["iterations"]] == list(range(6))
    assert report["iterations"][0]["restitution"] == 0
    (bounce,) = report["bounces"]
    assert bounce["impact_speed"] == pytest.approx((2 * 9.80665) ** 0.5, rel=1e-3)
    assert bounce["unit"] == "m/s"
    assert report["cross_check"]["agrees"] is True
    assert report["cross_check"]["value"] == pytest.approx(0.7, abs=1e-3)
    assert all({"name", "passed", "detail"} == set(check) for check in report["checks"])
    assert report["simulator"]["engine"].startswith("pybullet ")
    assert report["simulator"]["preset"] == "default"
    assert report["simulator"]["step_hz"] == pytest.approx(60)
    assert set(report["seconds"]) == {"read", "observe", "tune", "total"}
    assert "truth" not in json.dumps(report)


def test_a_rejected_log_has_a_reason_and_no_number(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.0, height_m=1.0)
    report = json.loads(to_json(tune_log(path, Options())))
    assert report["verdict"] == "rejected"
    assert report["parameters"] is None
    assert report["bounces"] == []
    assert "does not bounce" in report["reason"]


def test_the_table_shows_the_truth_only_where_a_log_states_one(drop_log: Path, tmp_path: Path):
    (tmp_path / "b.mcap").write_text("no log")
    known, unknown = (row_of(tune_log(path, Options())) for path in (drop_log, tmp_path / "b.mcap"))
    assert "truth" in table([known, unknown]).splitlines()[0]
    assert "truth" not in table([unknown]).splitlines()[0]
    assert "is not an MCAP log" in table([unknown])
