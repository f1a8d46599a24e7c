"""What holds for the file of every engine: provenance, comments that hold, refusals."""

from __future__ import annotations

import ast
import json
import re
import tokenize
import xml.etree.ElementTree as ET
from functools import partial
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from tests.analysis.records import HOSTILE, ball_tuning, payload_tuning
from tests.conftest import Command
from tunenet_logs.analysis.export.exported import hash_comment, xml_comment
from tunenet_logs.analysis.export.registry import FORMATS, export_format

MAKERS = {"ball": ball_tuning, "payload": payload_tuning}


each_file = pytest.mark.parametrize(
    ("engine", "kind"), [(engine, kind) for engine in FORMATS for kind in MAKERS]
)


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
    found = parsed(path)
    match found:
        case ast.Module():
            return ast.dump(found)
        case dict():
            told = {"provenance", "notes", "reason", "verdict"}
            return repr({name: value for name, value in found.items() if name not in told})
        case str():
            return re.sub("^ *# .*\n", "", found, flags=re.MULTILINE)
        case _:
            return ET.tostring(found, encoding="unicode")  # type: ignore[arg-type]


@each_file
def test_a_file_says_whose_numbers_it_holds_and_doubts(
    export: Command, tmp_path: Path, engine: str, kind: str
):
    tuning = MAKERS[kind](tmp_path / "a.json")
    log = json.loads(tuning.read_text())["log"]
    for words, warning in (("ok", ""), ("suspect", "the tuning is suspect: it rolls away")):
        MAKERS[kind](tuning, verdict=words, reason=warning and "it rolls away")
        result = export(tuning, "--to", engine)
        assert result.returncode == 0, result.stderr
        assert result.stderr == (warning and f"tunenet-export: {warning}\n")
        for path in set(tmp_path.iterdir()) - {tuning}:
            assert path.name.startswith("a.card." if engine in ("json", "yaml") else f"a.{engine}")
            assert str(path) in result.stdout
            parsed(path)
            text = path.read_text()
            assert all(one in text for one in (log, "0.1.0", f"Verdict: {words}", "95 %"))
            assert ("WARNING: this tuning is suspect: it rolls away" in text) == bool(warning)


@each_file
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
        assert code(path) == code(other)
        assert "suspect" in other.read_text()
        if path.suffix != ".json":
            assert all(line.isprintable() for line in other.read_text().split("\n"))


WORDS = st.lists(st.text(st.characters() | st.sampled_from("-><!#\n\r\x85\u2028\"'")), max_size=4)


@given(WORDS)
def test_comments_end_where_they_should(lines: list[str]):
    text = f"<a>{xml_comment(lines)}<b/></a>"
    root = ET.fromstring(text.encode())
    assert [child.tag for child in root] == ["b"]
    assert not "".join(root.itertext())
    assert text.count("\n") == len(lines) + 1
    text = hash_comment(lines)
    kinds = {token.type for token in tokenize.generate_tokens(StringIO(text + "\n").readline)}
    assert kinds <= {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.ENDMARKER}
    assert len(text.splitlines()) == len(lines)


@pytest.mark.parametrize("existing", ["a.pybullet.py", "a.pybullet.urdf"])
def test_what_is_another_logs_is_replaced_only_when_asked(
    export: Command, tmp_path: Path, existing: str
):
    """Both files are looked at before either is written."""
    tuning, place = payload_tuning(tmp_path / "a.json"), tmp_path / existing
    words = (tuning, "--to", "pybullet")
    for _ in range(2):
        assert export(*words).returncode == 0
    place.write_text(re.sub("(tuning of )[^,.]+", r"\1other", place.read_text(), count=1))
    place.write_text(re.sub("(SHA-256 of the log: )..", r"\1zz", place.read_text(), count=1))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    result = export(*words)
    assert result.returncode == 2
    assert "is the export of other" in result.stderr
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert export(*words, "--overwrite").returncode == 0
    assert "0.8" in place.read_text()
