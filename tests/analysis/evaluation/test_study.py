"""`tunenet-eval`: what each study prints and writes, and what is refused before any work."""

from __future__ import annotations

import csv
import json
import shlex
import sys
from importlib import import_module
from pathlib import Path

import cv2
import pytest

from tests.analysis.review.stored import verified
from tests.conftest import ROOT, Command
from tests.engines import needs_pybullet
from tunenet_logs.analysis.evaluation.cli import build_parser, main
from tunenet_logs.analysis.evaluation.study import (
    METHODS,
    STUDIES,
    Order,
)
from tunenet_logs.errors import pip_install
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress


def test_the_help_names_every_study_section_and_method():
    text = build_parser().format_help()
    names = [
        *(one for some in METHODS.values() for one in some),
        *STUDIES,
        *(one for study in STUDIES.values() for one in study.sections),
    ]
    assert all(name in text for name in names)


_FEW = "--pairs 60 --epochs"
# The words of a small run of each study, and what it prints.
SMALL = {
    "payload": (
        f"--sections masses,strangers,conventions,cards {_FEW} 2 --targets 1",
        ("TuneNet, paper's text", "full, twice as large", "wrong and ok", "three tares"),
    ),
    "motion": (f"--targets 2 {_FEW} 1", ("VRNN hybrid",)),
    "intervals": ("--targets 2", ("95 % intervals",)),
    "positions": ("--targets 2", ("5 mm", "speeds")),
    "throws": ("--targets 5", ("dribbled", "tossed")),
    "impact-times": ("--targets 8", ("one missed", "drum roll")),
    "video": (
        "--targets 2 --sections 'slope, set-B,converted,bound' --first-seed 1000",
        ("Set B: falls", "falls with speed", "30 pictures a second converted to 24"),
    ),
    "real-balls": ("--targets 1", ("Restitution at the first impact: films", "best airless")),
    "bounce-shot": ("--targets 2 --pairs 50", ("paper's, on the table", "62 %", "off the table")),
    "engines": ("--targets 1", ("promised of tunenet+refine",)),
    "exports": ("--targets 1", ("calibrated, impacts met", "mujoco, coarse", "bare loop")),
    "network": (
        "--targets 1 --epochs 1",
        ("Payloads [kg]", "lines from the same guess", "Hard, 1 cm"),
    ),
    "sysid": ("--targets 1 --sections tuned,wrong", ("none should come out ok",)),
    "own": (
        f"--model {ROOT}/sample_logs/models/pendulum.xml --tune joint/hinge.damping=0:.2 "
        f"--targets 1 {ROOT}/sample_logs/models/pendulum.mcap",
        ("to a tenth after", "verdicts:"),
    ),
    "sound": ("--targets 1 --sections uneven", ("the law's restitution at the second impact",)),
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
    small, printed = SMALL[study]
    words = [study, "--seeds", "1", "--jobs", "1", "--quiet", *shlex.split(small)]
    words += [str(word) for form, path in files.items() for word in (f"--{form}", path)]
    assert main(words) == 0
    told = capsys.readouterr()
    assert not told.err
    assert all(one in told.out for one in printed)
    assert "nan" not in told.out.lower().replace("tunenet", "")
    record = json.loads(files["json"].read_text())
    rows = list(csv.DictReader(files["csv"].read_text().splitlines()))
    assert (record["experiment"], record["seeds"]) == (
        study,
        [1000 if "1000" in small else 1],
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
        [part.text for part in module.run(Order((1,), 11, sections, jobs), Progress(quiet=True))]
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
    assert told == (f"tunenet-eval: {module} is not installed; {pip_install('eval')}\n")
