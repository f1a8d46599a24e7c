"""The developers' tools: what has changed is said, and every fault has its place."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from importlib import import_module
from inspect import signature
from pathlib import Path

import pytest

from tests.bench import __main__ as bench
from tests.bench.answers import Answer, FixedLog, compared, tuned
from tests.bench.faults.__main__ import misplaced
from tests.bench.faults.table import SETS
from tests.conftest import ROOT

TOOLS = sorted(Path(bench.__file__).parent.rglob("*.py"))
OURS = ("docs.", "tests", "tunenet_logs")

BALL = Answer(
    group="balls",
    sha256="",
    truth=0.7,
    verdict="ok",
    reason="",
    values={"restitution": 0.702},
    intervals={"restitution": [0.698, 0.706]},
    failed=[],
)
SUSPECT = replace(BALL, verdict="suspect", intervals={"restitution": None}, failed=["no air"])
REJECTED = replace(BALL, verdict="rejected", reason="no drop", values={}, intervals={})


def test_the_same_answers_are_no_change():
    before = {"a": BALL, "b": SUSPECT, "c": REJECTED}
    text, same = compared(before, dict(before))
    assert same
    assert "no change" in text
    assert re.search(r"\bballs +3 +0 ", text)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (BALL, replace(BALL, values={"restitution": 0.7023}), None),
        (BALL, replace(BALL, values={"restitution": 0.7025}), "restitution 0.702 is 0.7025 now"),
        (SUSPECT, replace(SUSPECT, values={"restitution": 0.7023}), None),
        (SUSPECT, replace(SUSPECT, values={"restitution": 0.7025}), "0.702 is 0.7025"),
        (BALL, replace(BALL, verdict="suspect", reason="late"), "ok is suspect now: late"),
        (BALL, REJECTED, "ok is rejected now: no drop"),
        (SUSPECT, replace(SUSPECT, failed=["spin"]), "failed ['no air'], now ['spin']"),
        (BALL, replace(BALL, values={**BALL.values, "drag": 0.1}), "now ['drag', 'restitution']"),
    ],
)
def test_what_has_changed_is_said(old: Answer, new: Answer, says: str | None):
    text, same = compared({"a": old, "b": BALL}, {"a": new, "b": BALL})
    assert same == (says is None)
    assert says in text if says else "a: " not in text


def test_errors_and_coverage_are_paired():
    missed = replace(BALL, values={"restitution": 0.71}, intervals={"restitution": [0.708, 0.712]})
    text, _ = compared({"a": BALL, "b": BALL, "c": REJECTED}, {"a": BALL, "b": missed, "c": BALL})
    for told in ("0.00200 ± 0.00000", "0.00600 ± 0.00400", "100.0 ± 0.0 %", "66.7 ± 33.3 %"):
        assert told in text


def test_an_answer_is_what_the_command_says():
    log = FixedLog("noisy", "samples", ROOT / "sample_logs" / "noisy.mcap", 0.62)
    answer = tuned(log)
    assert (answer.verdict, answer.failed) == ("ok", [])
    assert answer.error < 0.001
    assert answer.covers == 1


def test_every_fault_has_its_place_and_its_tests():
    assert not misplaced([fault for faults in SETS.values() for fault in faults])


@pytest.mark.parametrize("name", bench.SECTIONS)
def test_every_section_is_a_function_of_its_options(name: str):
    section = bench.SECTIONS[name]
    function = getattr(import_module(f"tests.bench.{section.module}"), name)
    assert set(signature(function).parameters) == section.full.keys() >= section.quick.keys()


@pytest.mark.parametrize("path", TOOLS, ids=lambda one: one.stem)
def test_all_that_a_tool_imports_of_ours_is_there(path: Path):
    """What it imports when it needs it, too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (module := node.module or "").startswith(OURS):
            for name in (alias.name for alias in node.names):
                found = import_module(module)
                assert hasattr(found, name) or import_module(f"{module}.{name}")


def test_a_section_prints_keeps_and_compares_its_figures(tmp_path, capsys):
    kept = tmp_path / "now.json"
    words = ["circle", "--quick", "--json", str(kept)]
    assert bench.main(words) == 0  # the shipped circle is the one that is made
    assert bench.main([*words, "--compare", str(kept)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[-1].split()[-2:] == ["0", "0"]
    assert told[-1].startswith("circle, bad: another")
