"""`tunenet-eval`: what each study prints and writes, and what is refused before any work."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import cv2
import pytest

from tests.analysis.drop.test_review import verified
from tests.conftest import ROOT, Command
from tests.engines import needs_pybullet
from tunenet_logs.analysis.evaluation.cli import build_parser, main
from tunenet_logs.analysis.evaluation.study import (
    METHODS,
    STUDIES,
    Order,
    Part,
    csv_text,
    short,
    table,
)
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress


@pytest.mark.parametrize(
    ("error", "text"),
    [
        *((0.25, ".2500"), (0.0012, ".0012"), (0.00018, ".00018"), (2e-6, "2.0e-6")),
        *((0, "<1e-9"), (None, "-")),
    ],
)
def test_small_errors_keep_two_digits(error: float, text: str):
    assert short(error) == text


def test_a_cell_of_a_table_reaches_over_empty_ones():
    lines = [["", "two of a kind", "", "", "x"], ["a", "1", "2", "3", "4"], ["long name"]]
    assert table(lines, "title").splitlines() == [
        "title",
        "   two of a kind  x",
        "a  1  2  3  4",
        "long name",
    ]


def test_rows_of_csv_are_those_of_json_without_lists():
    parts = [
        Part("one", "", [{"a": 1, "b": float("nan"), "c": [1, 2]}]),
        Part("two", "", [{"a": 2, "d": "x, y"}]),
    ]
    rows = list(csv.DictReader(io.StringIO(csv_text("video", parts))))
    assert rows[0] == {"tunenet_eval": "video", "section": "one", "a": "1", "b": "", "d": ""}
    assert rows[1] == {"tunenet_eval": "video", "section": "two", "a": "2", "b": "", "d": "x, y"}


def test_targets_are_split_between_processes_and_none_is_lost():
    portions = Order((1, 2), 12).portions(5)
    assert [len(numbers) for _, numbers in portions] == [5, 5, 2] * 2
    assert {(seed, one) for seed, numbers in portions for one in numbers} == {
        (seed, one) for seed in (1, 2) for one in range(12)
    }


def test_the_help_names_every_study_section_and_method():
    text = build_parser().format_help()
    names = [
        *(one for some in METHODS.values() for one in some),
        *STUDIES,
        *(one for study in STUDIES.values() for one in study.sections),
    ]
    assert all(name in text for name in names)


# The words of a small run of each study, the rows that it gives, and what it prints.
SMALL = {
    "payload": (
        *("--sections", "masses,strangers,conventions,cards", "--pairs", "60", "--epochs", "2"),
        *("--targets", "1"),
    ),
    "motion": ("--targets", "2", "--pairs", "60", "--epochs", "1"),
    "intervals": ("--targets", "2"),
    "positions": ("--targets", "2"),
    "throws": ("--targets", "5"),
    "impact-times": ("--targets", "8"),
    "video": ("--targets", "2", "--sections", "slope, set-B,bound", "--first-seed", "1000"),
    "real-balls": ("--targets", "1"),
    "bounce-shot": ("--targets", "2", "--pairs", "50"),
    "engines": ("--targets", "1"),
    "exports": ("--targets", "1"),
    "network": ("--targets", "1", "--epochs", "1"),
    "sysid": ("--targets", "1", "--sections", "tuned,wrong"),
    "sound": ("--targets", "1", "--sections", "uneven"),
}
PRINTED = {
    "payload": ("TuneNet, paper's text", "full, twice as large", "wrong and ok", "three tares"),
    "motion": ("VRNN hybrid",),
    "intervals": ("95 % intervals",),
    "positions": ("5 mm", "speeds"),
    "throws": ("dribbled", "tossed"),
    "impact-times": ("one missed", "drum roll"),
    "video": ("Set B: falls", "falls with speed"),
    "real-balls": ("Restitution at the first impact: films", "best airless"),
    "bounce-shot": ("paper's, on the table", "62 %", "off the table"),
    "engines": ("promised of tunenet+refine",),
    "exports": ("calibrated, impacts met", "mujoco, coarse", "bare loop"),
    "network": ("Payloads [kg]", "lines from the same guess", "Hard, 1 cm"),
    "sysid": ("none should come out ok",),
    "sound": ("the law's restitution at the second impact",),
}


@needs_pybullet
@pytest.mark.parametrize(
    "study",
    [pytest.param(name, marks=() if name == "sound" else pytest.mark.slow) for name in SMALL],
)
def test_a_study_prints_and_writes_the_same_rows(
    study: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    files = {form: tmp_path / f"a.{form}" for form in ("json", "csv")}
    words = [study, "--seeds", "1", "--jobs", "1", "--quiet", *SMALL[study]]
    words += [str(word) for form, path in files.items() for word in (f"--{form}", path)]
    assert main(words) == 0
    told = capsys.readouterr()
    assert not told.err
    assert all(one in told.out for one in PRINTED[study])
    assert "nan" not in told.out.lower().replace("tunenet", "")
    record = json.loads(files["json"].read_text())
    rows = list(csv.DictReader(files["csv"].read_text().splitlines()))
    assert (record["experiment"], record["seeds"]) == (
        study,
        [1000 if "1000" in SMALL[study] else 1],
    )
    assert len(rows) == len(record["rows"]) > 0
    for mine, other in zip(rows, record["rows"], strict=True):
        flat = {name: one for name, one in other.items() if not isinstance(one, (list, dict))}
        assert {name: "" if one is None else str(one) for name, one in flat.items()} == {
            name: mine[name] for name in flat
        }
    assert sorted(tmp_path.iterdir()) == sorted(files.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "sections"), [("video", ("bad",)), ("real-balls", ("positions",))]
)
def test_the_same_figures_however_many_processes_there_are(study: str, sections: tuple[str, ...]):
    module = import_module(f"tunenet_logs.analysis.evaluation.studies.{STUDIES[study].module}")
    alone, together = (
        [part.text for part in module.run(Order((-1,), 11, sections, jobs), Progress(quiet=True))]
        for jobs in (1, 2)
    )
    assert alone == together


@needs_pybullet
def test_drop_writes_all_that_it_is_asked_for(command: Command, tmp_path: Path):
    files = {name: tmp_path / f"drop.{name}" for name in ("json", "csv", "png", "rrd")}
    words = [word for name, path in files.items() for word in (f"--{name}", path)]
    order = ("drop", "--seeds", 1, "--targets", 1, "--methods", "mean,secant", "--jobs", 1)
    done = command("tunenet-eval", *order, *words)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert "Easy, the paper's simulator" in done.stdout
    assert f"rerun {files['rrd']}" in done.stdout
    assert sorted(tmp_path.iterdir()) == sorted(files.values())
    picture = cv2.imread(str(files["png"]))
    assert picture is not None
    assert picture.shape[1] > 1000
    assert (picture < 250).any(axis=2).mean() > 0.02  # lines, not an empty page
    verified(files["rrd"])
    told = json.loads(files["json"].read_text())
    assert {one["method"] for one in told["curves"]} == {"mean", "secant"}
    assert "intervals" not in told  # not measured where methods are chosen


@pytest.mark.slow
def test_a_campaign_keeps_its_logs_and_outcomes(command: Command, tmp_path: Path):
    folder, told = tmp_path / "shots", tmp_path / "shots.json"
    words = ("--seeds", 1, "--targets", 2, "--sections", "campaigns", "--quiet", "--pairs", 50)
    result = command("tunenet-eval", "bounce-shot", *words, "--campaign", folder, "--json", told)
    assert result.returncode == 0, result.stderr
    record = json.loads(told.read_text())
    assert len(record["rows"]) == 2
    assert record["shares"][0] == {"name": "paper's, all", **record["shares"][0]}
    assert record["shares"][0]["of"] == 2
    assert len(list(folder.glob("outcome_*.mcap"))) == 2
    for trial in record["rows"]:
        logs = sorted(folder.glob(f"drop_{trial['trial']:03d}_*.mcap"))
        assert len(logs) == trial["drops"] == len(trial["verdicts"].split())
        assert read_episode(logs[0]).info.kind == "drop"
        if trial["restitution"] is not None and trial["round"]:
            assert trial["restitution"] == pytest.approx(trial["truth_at_shot"], abs=0.02)


@pytest.mark.slow
def test_an_interrupt_ends_it_at_once_and_leaves_nothing(tmp_path: Path):
    words = ["drop", "--methods", "tpe", "--targets", "1000", "--jobs", "2"]
    words += ["--json", str(tmp_path / "a.json")]
    running = subprocess.Popen(
        [sys.executable, "-m", "tunenet_logs.analysis.evaluation.cli", *words],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
    try:
        while running.poll() is None and len(children.read_text().split()) < 3:
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)
        _, told = running.communicate(timeout=60)
    finally:
        if running.poll() is None:
            os.killpg(running.pid, signal.SIGKILL)
    assert running.returncode == 130
    assert told == "tunenet-eval: interrupted\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("drop --methods mean,best", "no 'best'; there is: mean, entropy-search"),
        ("drop --methods ", "--methods names none; there is: mean, entropy-search"),
        ("drop --methods ,", "--methods names none"),
        ("drop --methods difference --png a.png", "--png: no method chosen has a"),
        ("drop --methods difference --rrd a.rrd", "--rrd: no method chosen has a"),
        ("motion --csv -", "--csv -: only --json goes to standard output"),
        ("drop --png a.jpg", "a.jpg: --png writes .png"),
        ("drop --rrd a", "a: --rrd writes .rrd"),
        ("intervals --methods mean", "--methods is for drop, not intervals"),
        ("drop --json /nowhere/a.json", "/nowhere: no such folder"),
        ("drop --png .", "is a folder; give --png another file"),
        ("drop --json a --csv a", "both --json and --csv name it"),
        ("drop --seeds 0", "not a whole number"),
        ("drop --rollouts 0", "not a whole number"),
        ("drop --rollouts 101", "--rollouts"),
        ("motion --rollouts 5", "--rollouts is for drop, not motion"),
        ("motion --png a.png", "--png is for drop, not motion"),
        ("video --rrd a.rrd", "--rrd is for drop, not video"),
        ("video --sections set-D", "no 'set-D'; there is: set-A, set-B"),
        ("video --sections ,", "--sections names none; there is: set-A"),
        ("payload --sections bad", "there is: masses, logs"),
        ("drop --sections bad", "sysid and sound, not drop; leave it out"),
        ("video --campaign a", "--campaign is for bounce-shot, not video"),
        (f"bounce-shot --campaign {ROOT}", "is there already"),
        ("everything", "invalid choice"),
        ("", "required"),
    ],
)
def test_wrong_usage_is_one_line_before_any_work(
    words: str,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert main(words.split(" ") if words else []) == 2
    told = capsys.readouterr()
    assert says in told.err
    assert told.err.count("\n") == 1
    assert not told.out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("optuna", "--methods tpe"),
        ("sbi", "--methods npe"),
        ("matplotlib", "--methods mean --png a.png"),
    ],
)
def test_a_library_that_is_missing_is_one_line(
    module: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["drop", *words.split()]) == 2
    told = capsys.readouterr().err
    assert told == (f"tunenet-eval: {module} is not installed; pip install 'tunenet-logs[eval]'\n")
