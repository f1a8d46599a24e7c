"""tunenet-eval bounce-shot: a small campaign from end to end, and its files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.conftest import Command
from tunenet_logs.reader import read_episode

WORDS = ("tunenet-eval", "bounce-shot")


@pytest.mark.slow
def test_a_small_campaign(command: Command, tmp_path: Path):
    folder, told = tmp_path / "shots", tmp_path / "shots.json"
    words = ("--seeds", 1, "--targets", 2, "--sections", "campaigns", "--quiet", "--pairs", 50)
    files = ("--campaign", folder, "--json", told, "--csv", tmp_path / "s.csv")
    result = command(*WORDS, *words, *files)
    assert result.returncode == 0, result.stderr
    assert "paper's, on the table" in result.stdout
    assert "62 %" in result.stdout
    record = json.loads(told.read_text())
    assert len(record["trials"]) == 2
    assert record["shares"]["paper's, all"]["of"] == 2
    outcomes = sorted(folder.glob("outcome_*.mcap"))
    assert len(outcomes) == 2
    for trial in record["trials"]:
        logs = sorted(folder.glob(f"drop_{trial['trial']:03d}_*.mcap"))
        assert len(logs) == trial["drops"] == len(trial["verdicts"].split())
        assert read_episode(logs[0]).info.kind == "drop"
        if trial["restitution"] is not None and trial["round"]:
            assert trial["restitution"] == pytest.approx(trial["truth_at_shot"], abs=0.02)
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 3


@pytest.mark.slow
def test_drops_are_judged(command: Command):
    words = ("--seeds", 1, "--targets", 1, "--sections", "drops", "--quiet")
    result = command(*WORDS, *words)
    assert result.returncode == 0, result.stderr
    assert "off the table" in result.stdout
    assert "good" in result.stdout


def test_wrong_usage(command: Command, tmp_path: Path):
    (tmp_path / "there").write_text("")
    for words, said in (
        (("--campaign", tmp_path), "is there already"),
        (("--sections", "shots"), "no section 'shots'"),
        (("--png", tmp_path / "x.png"), "--png is for drop"),
    ):
        result = command(*WORDS, *words)
        assert result.returncode == 2
        assert said in result.stderr
