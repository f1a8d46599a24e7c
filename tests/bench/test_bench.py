"""The developers' tools: what has changed is said, and every fault has its place."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.bench import __main__ as bench
from tests.bench.answers import Answer, FixedLog, compared, tuned
from tests.bench.faults.__main__ import misplaced
from tests.bench.faults.table import SETS
from tests.conftest import ROOT

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
    assert text.splitlines()[1].split()[:3] == ["balls", "3", "0"]


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
    line = text.splitlines()[1]
    for told in ("0.00200 ± 0.00000", "0.00600 ± 0.00400", "100.0 ± 0.0 %", "66.7 ± 33.3 %"):
        assert told in line


def test_an_answer_is_what_the_command_says():
    log = FixedLog("noisy", "samples", ROOT / "sample_logs" / "noisy.mcap", 0.62)
    answer = tuned(log)
    assert (answer.verdict, answer.failed) == ("ok", [])
    assert answer.error < 0.001
    assert answer.covers == 1


def test_every_fault_has_its_place_and_its_tests():
    assert not misplaced([fault for faults in SETS.values() for fault in faults])


def test_a_section_prints_keeps_and_compares_its_figures(tmp_path, capsys):
    kept = tmp_path / "now.json"
    words = ["circle", "--quick", "--json", str(kept)]
    assert bench.main(words) == 0  # the shipped circle is the one that is made
    assert bench.main([*words, "--compare", str(kept)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[-1].split()[-2:] == ["0", "0"]
    assert told[-1].startswith("circle, bad: another")
