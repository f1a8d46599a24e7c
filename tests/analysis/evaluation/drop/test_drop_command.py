"""`tunenet-eval drop`: what it is asked for, and what it refuses before any work."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from tests.analysis.drop.test_review import verified
from tests.conftest import ROOT, Command
from tests.engines import needs_pybullet
from tunenet_logs.analysis.evaluation.cli import build_parser, main
from tunenet_logs.analysis.evaluation.studies.drop_methods import NAMES
from tunenet_logs.analysis.evaluation.study import METHODS


def test_the_help_names_every_method():
    assert METHODS == NAMES
    text = build_parser().format_help()
    assert all(name in text for name in NAMES)


@needs_pybullet
def test_the_command_writes_what_it_is_asked_for(command: Command, tmp_path: Path):
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
    assert len(files["csv"].read_text().splitlines()) == len(told["rows"]) + 1


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
        (("drop", "--methods", "mean,best"), "no method 'best'; there is: mean, entropy-search"),
        (("drop", "--methods", ""), "--methods names none; there is: mean, entropy-search"),
        (("drop", "--methods", " , ,"), "--methods names none"),
        (("drop", "--methods", "difference", "--png", "a.png"), "--png: no method chosen has a"),
        (("drop", "--methods", "difference", "--rrd", "a.rrd"), "--rrd: no method chosen has a"),
        (("motion", "--csv", "-"), "--csv -: only --json goes to standard output"),
        (("drop", "--png", "a.jpg"), "a.jpg: --png writes .png"),
        (("drop", "--rrd", "a"), "a: --rrd writes .rrd"),
        (("intervals", "--methods", "mean"), "--methods is for drop, not intervals"),
        (("drop", "--json", "/nowhere/a.json"), "/nowhere: no such folder"),
        (("drop", "--png", "."), "is a folder; give --png another file"),
        (("drop", "--json", "a", "--csv", "a"), "both --json and --csv name it"),
        (("drop", "--seeds", "0"), "not a whole number"),
        (("drop", "--rollouts", "0"), "not a whole number"),
        (("drop", "--rollouts", "101"), "--rollouts"),
        (("motion", "--rollouts", "5"), "--rollouts is for drop, not motion"),
        (("motion", "--png", "a.png"), "--png is for drop, not motion"),
        (("motion", "--methods", "mean"), "--methods is for drop"),
        (("everything",), "invalid choice"),
        ((), "required"),
    ],
)
def test_wrong_usage_is_one_line_before_any_work(
    words: tuple[str, ...],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    told = capsys.readouterr()
    assert says in told.err
    assert told.err.count("\n") == 1
    assert not told.out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("module", "words"),
    [("optuna", ("--methods", "tpe")), ("matplotlib", ("--methods", "mean", "--png", "a.png"))],
)
def test_a_library_that_is_missing_is_one_line(
    module: str,
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    assert main(("drop", *words)) == 2
    told = capsys.readouterr().err
    assert told == (f"tunenet-eval: {module} is not installed; pip install 'tunenet-logs[eval]'\n")
