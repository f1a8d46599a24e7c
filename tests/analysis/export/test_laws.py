"""What holds for the file of every engine: provenance, comments that hold, refusals."""

from __future__ import annotations

import ast
import json
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from tests.analysis.export.tunings import HOSTILE, ball_tuning, payload_tuning
from tests.conftest import Command
from tunenet_logs.analysis.export.registry import FORMATS, export_format

MAKERS = {"ball": ball_tuning, "payload": payload_tuning}


@pytest.fixture(scope="module")
def export(command: Command) -> Command:
    return partial(command, "tunenet-export")


@pytest.fixture(autouse=True)
def _no_engine_runs(monkeypatch: pytest.MonkeyPatch):
    """What engines make of the files is tested beside each: here it would only take time."""
    for name in FORMATS:
        monkeypatch.setattr(export_format(name), "LIBRARY", None)


def parsed(path: Path) -> object:
    """The file, read by its language's own parser."""
    text = path.read_text("utf-8")
    match path.suffix:
        case ".py":
            return ast.parse(text)
        case ".json":
            return json.loads(text)
        case ".yaml":
            return YAML(typ="safe").load(text)
        case ".usda":
            assert text.startswith("#usda 1.0\n")
            return text
        case _:
            return ET.fromstring(text)  # an XML


def code(path: Path) -> str:
    """What the file says, its comments aside."""
    text = path.read_text("utf-8")
    match path.suffix:
        case ".py":
            return ast.dump(ast.parse(text))
        case ".yaml" | ".json":
            card = parsed(path)
            assert isinstance(card, dict)
            for name in ("provenance", "notes", "reason", "verdict"):
                card.pop(name, None)
            return repr(card)
        case ".usda":
            return "\n".join(
                line for line in text.split("\n") if not line.lstrip().startswith("# ")
            )
        case _:
            return ET.tostring(ET.fromstring(text), encoding="unicode")


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("engine", FORMATS)
def test_a_file_says_whose_numbers_it_holds(
    export: Command, tmp_path: Path, engine: str, kind: str
):
    tuning = MAKERS[kind](tmp_path / "a.json")
    result = export(tuning, "--to", engine)
    assert result.returncode == 0, result.stderr
    assert not result.stderr
    for path in set(tmp_path.iterdir()) - {tuning}:
        assert path.name.startswith("a.card." if engine in ("json", "yaml") else f"a.{engine}")
        assert str(path) in result.stdout
        parsed(path)
        text = path.read_text()
        for words in (json.loads(tuning.read_text())["log"], "0.1.0", "Verdict: ok", "95 %"):
            assert words in text, words


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("engine", FORMATS)
def test_no_word_of_a_log_leaves_its_comment(
    export: Command, tmp_path: Path, engine: str, kind: str
):
    """The file says the same, comments aside, whatever the log is called."""
    known = MAKERS[kind](tmp_path / "a.json")
    strange = MAKERS[kind](
        tmp_path / "b.json", log=HOSTILE, verdict="suspect", reason=2 * HOSTILE, ball=HOSTILE
    )
    for tuning in (known, strange):
        result = export(tuning, "--to", engine)
        assert result.returncode == 0, result.stderr
    for path in sorted(set(tmp_path.glob("a.*")) - {known}):
        other = path.with_name(path.name.replace("a.", "b.", 1))
        parsed(other)
        assert code(path) == code(other)
        assert "suspect" in other.read_text()
        if path.suffix != ".json":
            assert other.read_text().isprintable() is False  # line ends alone
            assert all(line.isprintable() for line in other.read_text().split("\n"))


@pytest.mark.parametrize("engine", FORMATS)
def test_a_rejected_tuning_is_refused(export: Command, tmp_path: Path, engine: str):
    tuning = ball_tuning(
        tmp_path / "a.json", verdict="rejected", reason="no fall", parameters=None, bounces=[]
    )
    result = export(tuning, "--to", engine)
    assert (result.returncode, result.stdout) == (1, "")
    assert "rejected (no fall)" in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == [tuning]


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("engine", FORMATS)
def test_a_suspect_tuning_is_exported_with_a_warning(
    export: Command, tmp_path: Path, engine: str, kind: str
):
    tuning = MAKERS[kind](tmp_path / "a.json", verdict="suspect", reason="it rolls away")
    result = export(tuning, "--to", engine)
    assert result.returncode == 0
    assert result.stderr == "tunenet-export: the tuning is suspect: it rolls away\n"
    for path in set(tmp_path.iterdir()) - {tuning}:
        assert "WARNING: this tuning is suspect: it rolls away" in path.read_text()


def test_every_engine_is_found_under_its_name():
    for name in FORMATS:
        engine = export_format(name)
        assert name == engine.NAME
        assert engine.SUFFIX.startswith(".")
        assert engine.__doc__
