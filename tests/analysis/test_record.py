"""A record as JSON, which is the contract's and holds no truth, and as tables and words."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import struct
import subprocess
import termios
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tunenet_logs as tn
from tests.analysis.answers import known, trace_of
from tests.analysis.records import drop_record, payload_record
from tests.conftest import BIN, ROOT, Command, record
from tunenet_logs.analysis.estimators.base import ExtraEstimate
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.presentation import (
    half_words,
    interval_words,
    number_words,
    result_words,
    row_of,
    table,
)
from tunenet_logs.analysis.record import record_from, to_json
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.recorders.simulators.known import engine


def test_the_json_has_the_contracts_keys(drop_log: Path):
    report = json.loads(to_json(record_of(tune_log(drop_log, tn.TuneOptions()))))
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
    report = json.loads(to_json(record_of(tune_log(path, tn.TuneOptions()))))
    assert report["verdict"] == "rejected"
    assert report["parameters"] is None
    assert report["bounces"] == []
    assert "does not bounce" in report["reason"]
    (tmp_path / "b.mcap").write_text("no log")
    report = json.loads(to_json(record_of(tune_log(tmp_path / "b.mcap", tn.TuneOptions()))))
    assert report["method"] is None


def test_a_failed_check_says_what_to_do_at_the_next_drop(drop_log: Path):
    tuning = tune_log(drop_log, tn.TuneOptions())
    advice = "record until the ball lies still"
    checks = [replace(one, passed=one.advice != advice) for one in tuning.checks]
    written = json.loads(to_json(record_of(replace(tuning, checks=tuple(checks)))))["checks"]
    failed = [one for one in written if not one["passed"]]
    assert [one["advice"] for one in failed] == [advice]
    assert all("advice" not in one for one in written if one["passed"])
    assert all(one.advice for one in tuning.checks)


def test_where_a_check_fails_nothing_has_an_interval():
    path = ROOT / "sample_logs" / "noisy.mcap"
    tuning = tune_log(path, tn.TuneOptions())
    trace = trace_of(tuning)
    beside = ExtraEstimate("payload_com", "m", np.zeros(3), np.zeros((3, 2)))
    first = replace(tuning.checks[0], passed=False)
    doubted = replace(
        tuning,
        trace=replace(trace, fit=replace(known(trace.fit), extra=(beside,))),
        checks=(first, *tuning.checks[1:]),
        verdict="suspect",
    )
    parameters = json.loads(to_json(record_of(doubted)))["parameters"]
    assert parameters["restitution"]["interval95"] is None
    assert parameters["payload_com"]["interval95"] is None


def whole_record() -> tn.Record:
    """A drop's with all that a record can hold."""
    air = tn.Equivalent(0.69, 1.1, (4.2, 2.9))
    motion = tn.Motion(
        tn.Curves(7, np.array([0.0, 0.5]), np.array([1.0, 0.5]), np.array([1.0, np.nan])),
        tn.SimulationFit(0.2, 0.5, 0.1, None, 400, 2, 0.001, "m"),
        tn.Equivalents(air, replace(air, restitution=0.7)),
        ("drag and slope are seen only together",),
        ("drag",),
        tn.Units(0.001, "gravity", 240.0, "clock"),
        tn.SoundShare(5, 4, -0.002, "", 0.71, (0.7, 0.72)),
    )
    steps = ({"restitution": 0.5}, {"restitution": 0.7})
    return drop_record(slope=(0.05, 0.01), motion=motion, iterations=steps, is_fitted=True)


@pytest.mark.parametrize(
    "known", [whole_record(), payload_record(0.5, 0.01, (0.0, 0.1, 0.2), 0.02)]
)
def test_what_is_read_is_what_was_written(known: tn.Record):
    text = to_json(known)
    again = record_from(json.loads(text))
    assert to_json(again) == text
    for field in fields(tn.Record):
        if field.name != "motion":
            assert getattr(again, field.name) == getattr(known, field.name), field.name
    for field in fields(tn.Motion):
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


# ---- Tables and words


def shown(*tunings: tn.Tuning) -> str:
    return table([row_of(one, record_of(one)) for one in tunings])


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.61981, 0.62032, "0.6198 to 0.6203"),
        (0.7000012, 0.7000391, "0.70000 to 0.70004"),
        (0.3500001, 0.3500034, "0.350000 to 0.350003"),
        (0.34999996, 0.35000003, "0.349999 to 0.350001"),
        (0.0, 0.00002, "0.000000 to 0.000020"),
        (1.69e-4, 1.99e-4, "0.000169 to 0.000199"),
        (-1e-5, 8e-4, "-0.00001 to 0.00080"),
        (2.4e-7, 2.6e-7, "2.40e-7 to 2.60e-7"),
        (-1e-17, 4e-17, "0.000000 to 0.000000"),
    ],
)
def test_no_interval_reads_as_certainty(low: float, high: float, words: str):
    assert interval_words((low, high)) == words


@pytest.mark.parametrize(
    ("value", "ends", "words"),
    [
        (0.74, (0.7388, 0.7418), "0.7400 ± 0.0015"),
        (1.84e-4, (1.69e-4, 1.99e-4), "0.000184 ± 0.000015"),
        (-1e-4, (-0.0047, 0.0045), "-0.0001 ± 0.0046"),
        (1e-5, (0.9e-5, 1.1e-5), "1.00e-5 ± 1.0e-6"),
        (0.7098, (0.709791, 0.709809), "0.70980 ± 0.00001"),
        (1.84e-4, None, "0.000184"),
        (1e-5, None, "1.00e-5"),
        (-1e-17, None, "0.0000"),
    ],
)
def test_a_value_has_the_digits_of_its_interval(
    value: float, ends: tuple[float, float] | None, words: str
):
    said = number_words(value, ends) + ("" if ends is None else f" ± {half_words(ends)}")
    assert said == words


@pytest.fixture(scope="module")
def tuning(tmp_path_factory: pytest.TempPathFactory) -> tn.Tuning:
    path = tmp_path_factory.mktemp("drop") / "drop.mcap"
    return tune_log(record(path, restitution=0.7, height_m=1.0), tn.TuneOptions())


def test_the_table_shows_the_truth_only_where_a_log_states_one(tuning: tn.Tuning, tmp_path: Path):
    (tmp_path / "b.mcap").write_text("no log")
    unknown = tune_log(tmp_path / "b.mcap", tn.TuneOptions())
    assert "truth" in shown(tuning, unknown).splitlines()[0]
    assert "truth" not in shown(unknown).splitlines()[0]
    assert "is not an MCAP log" in shown(unknown)


def test_what_an_airless_simulator_needs_and_what_the_log_leaves_open_is_said(tuning: tn.Tuning):
    assert "without air" not in shown(tuning)  # the same there
    made = record_of(tuning)
    without = tn.Equivalents(tn.Equivalent(0.486, 1.05, (6.7,)), tn.Equivalent(0.49, 1.0, (6.7,)))
    motion = tn.Motion(equivalents=without, unidentifiable=("drag and slope: no",))
    words = table([replace(row_of(tuning, made), record=replace(made, motion=motion))])
    assert "without air: 0.486 for the first rebound (1.1 % rms), 0.490 for all (1.0 %)" in words
    assert "drag and slope: no" in words


@pytest.mark.parametrize(
    ("name", "has"),
    [
        ("no samples missing", True),
        ("first flight seen", True),
        ("simulation fits", False),
        ("gravity", False),
    ],
)
def test_an_interval_is_given_unless_a_check_doubts_the_value_itself(
    tuning: tn.Tuning, name: str, has: bool
):
    assert name in {check.name for check in tuning.checks}
    checks = tuple(replace(check, passed=check.name != name) for check in tuning.checks)
    doubted = replace(tuning, checks=checks, verdict="suspect", reason=name)
    assert (doubted.interval95 is not None) == has
    assert (" (suspect)" in shown(doubted)) == has
    words = result_words(record_of(doubted), tuning.preset, "drop")
    assert "95 % interval (suspect)" in words or not has
    assert words.index(name) < words.index("| restitution")


def seen(columns: int, *words: object) -> list[str]:
    """The lines that tunenet-tune shows in a pseudo-terminal of so many columns."""
    ours, its = pty.openpty()
    try:
        fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        environment = {name: text for name, text in os.environ.items() if name != "COLUMNS"}
        process = subprocess.Popen(
            [str(BIN / "tunenet-tune"), *map(str, words), "--no-review"],
            stdout=its,
            stderr=its if "--json" in words else subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
            env=environment,
        )
    finally:
        os.close(its)
    text = b""
    with os.fdopen(ours, "rb", buffering=0) as terminal:
        try:
            while part := terminal.read(4096):
                text += part
        except OSError:  # the other end is closed
            pass
    assert process.wait(timeout=60) == 0
    return text.decode().splitlines()


def test_a_table_fits_the_terminal_and_a_pipe_has_it_whole(
    drop_log: Path, command: Command, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(drop_log.parent)
    lines = seen(80, drop_log.name)
    upright = lines[: lines.index("")]
    cells = {name: cell.strip() for name, cell in (line.split("  ", 1) for line in upright)}
    assert max(map(len, upright)) <= 80
    assert cells["verdict"] == "ok"
    assert float(cells["restitution"]) == pytest.approx(0.7, abs=1e-3)
    whole = {"95 % interval", "drag [1/m]", "rollouts", "truth"}
    assert whole <= set(cells)
    piped = command("tunenet-tune", drop_log.name, "--no-review").stdout.splitlines()[0]
    assert seen(250, drop_log.name)[0].split() == piped.split()
    assert all(name in piped for name in (*whole, "slope", "fits", "cross-check", "time"))
    [line] = seen(80, drop_log.name, "--json", "-")  # no bars, though it is the same terminal
    assert json.loads(line)["verdict"] == "ok"
    record(drop_log.with_name("other.mcap"), restitution=0.5)
    lines = seen(80, "other.mcap", drop_log.name, "-o", "out", "--jobs", 1)
    several = lines[: lines.index("")]
    assert max(map(len, several)) <= 80
    assert {"verdict", "restitution"} <= set(several[0].split())
    assert "rollouts" not in several[0]
    said = " ".join(several[3:])
    assert said.startswith("(left out, too wide for this terminal: ")
    assert "rollouts" in said
