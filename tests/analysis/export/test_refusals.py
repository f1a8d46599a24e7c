"""What tunenet-export refuses, in one line, with nothing written."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path

import pytest

from tests.analysis.export.tunings import ball_tuning, payload_tuning
from tests.conftest import Command


@pytest.fixture(scope="module")
def export(command: Command) -> Command:
    return partial(command, "tunenet-export")


@pytest.mark.parametrize(
    ("make", "words", "code", "says"),
    [
        (ball_tuning, ("--to", "unreal"), 2, "invalid choice: 'unreal'"),
        (ball_tuning, (), 2, "required: --to"),
        (ball_tuning, ("--to", "json", "--step", 0.001), 2, "leave --step out"),
        (ball_tuning, ("--to", "json", "--speed", 0), 2, "--speed"),
        (ball_tuning, ("--to", "json", "--mass", "nan"), 2, "--mass"),
        (ball_tuning, ("--to", "json", "-o", "ball.xml"), 2, "ends .json"),
        (ball_tuning, ("--to", "json", "-o", "no/ball.json"), 2, "no such folder"),
        (ball_tuning, ("--to", "json", "-o", "a.json"), 2, "is the tuning itself"),
        (ball_tuning, ("--to", "json", "-o", "a.json", "--overwrite"), 2, "is the tuning itself"),
        (payload_tuning, ("--to", "urdf", "--radius", 0.1), 2, "--radius is for a ball"),
        (payload_tuning, ("--to", "urdf", "--speed", 3), 2, "--speed is for a ball"),
        (partial(payload_tuning, mass_kg=0.0), ("--to", "urdf"), 1, "weighs nothing"),
        (partial(payload_tuning, mass_kg=-0.1), ("--to", "urdf"), 1, "payload mass -0.1"),
        (partial(payload_tuning, com_m=(0, 0, 99.0)), ("--to", "urdf"), 1, "within 10 m"),
        (partial(payload_tuning, task="drop"), ("--to", "urdf"), 1, "holds neither"),
        (partial(ball_tuning, restitution=1.4), ("--to", "urdf"), 1, "1.4 is not from 0 to 1"),
        (partial(ball_tuning, first=1.4), ("--to", "urdf"), 1, "1.4 is not from 0 to 1"),
        (partial(ball_tuning, slope=3.0), ("--to", "urdf"), 1, "3 is not from -1 to 1"),
        (partial(ball_tuning, parameters=None), ("--to", "urdf"), 1, "holds neither"),
        (partial(ball_tuning, physical=False), ("--to", "urdf"), 1, "--preset default"),
        (partial(ball_tuning, bounces=[]), ("--to", "urdf", "--speed", 3), 2, "no impact speed"),
    ],
)
def test_is_one_line_and_writes_nothing(
    export: Command, tmp_path: Path, make, words: tuple[object, ...], code: int, says: str
):
    tuning = make(tmp_path / "a.json")
    before = tuning.read_bytes()
    result = export("a.json", *words, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (code, "")
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == [tuning]
    assert tuning.read_bytes() == before


@pytest.mark.parametrize("text", ["", "[1]", "{}", "\0", '{"verdict": "ok", "parameters": {'])
def test_a_file_that_is_no_tuning_is_refused(export: Command, tmp_path: Path, text: str):
    path = tmp_path / "a.json"
    path.write_text(text)
    result = export(path, "--to", "urdf")
    assert (result.returncode, result.stdout) == (1, "")
    assert str(path) in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_tuning_that_is_not_there_is_refused(export: Command, tmp_path: Path):
    result = export(tmp_path / "a.json", "--to", "urdf")
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("existing", ["a.pybullet.py", "a.pybullet.urdf"])
def test_what_is_another_logs_is_replaced_only_when_asked(
    export: Command, tmp_path: Path, existing: str
):
    """Both files are looked at before either is written."""
    tuning = payload_tuning(tmp_path / "a.json")
    (tmp_path / existing).write_text("mine")
    result = export(tuning, "--to", "pybullet")
    assert result.returncode == 2
    assert f"{existing}: exists" in result.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", existing}
    assert (tmp_path / existing).read_text() == "mine"
    assert export(tuning, "--to", "pybullet", "--overwrite").returncode == 2
    (tmp_path / existing).unlink()
    assert export(tuning, "--to", "pybullet").returncode == 0
    assert export(tuning, "--to", "pybullet").returncode == 0
    place = tmp_path / existing
    place.write_text(re.sub("(tuning of )[^,.]+", r"\1other", place.read_text(), count=1))
    place.write_text(re.sub("(SHA-256 of the log: )..", r"\1zz", place.read_text(), count=1))
    others = place.read_text()
    result = export(tuning, "--to", "pybullet")
    assert result.returncode == 2
    assert "is the export of other" in result.stderr
    assert place.read_text() == others
    assert export(tuning, "--to", "pybullet", "--overwrite").returncode == 0
    assert "0.8" in place.read_text()


def test_a_card_is_no_tuning(export: Command, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json")
    assert export(tuning, "--to", "json").returncode == 0
    card = tmp_path / "a.card.json"
    assert json.loads(card.read_text())["kind"] == "ball"
    assert export(card, "--to", "urdf").returncode == 1
