"""tunenet-record --outcome as a user runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, Command
from tests.conftest import record as record_drop
from tests.recorders.conftest import Record, Refuses
from tunenet_logs.outcomes import read_outcomes

SUCCESS = ("--outcome", "success", "--ball", "gel")


def test_each_outcome_is_the_next_of_its_ball(record: Record, tmp_path: Path):
    said = ""
    for ball, word in (("red gel", "success"), ("racquetball", "failure"), ("red gel", "failure")):
        said = record(
            "--outcome", word, "--ball", ball, "--shot-height", 0.62, "--miss=-0.03",
            "--reason", "rim", "--note", "left side", "-o", "campaign",
        ).stdout  # fmt: skip
    assert "failure of red gel, attempt 2" in said
    first, second, third = read_outcomes(tmp_path / "campaign")
    assert [one.attempt for one in (first, second, third)] == [1, 1, 2]
    assert [one.success for one in (first, second, third)] == [True, False, False]
    assert (first.task, first.shot_height_m, first.miss_m) == ("bounce-shot", 0.62, -0.03)
    assert (first.reason, first.note) == ("rim", "left side")
    assert 0 < first.stamp_ns < second.stamp_ns < third.stamp_ns


def test_a_tuning_says_restitution_and_log(record: Record, command: Command, tmp_path: Path):
    (tmp_path / "campaign").mkdir()
    record_drop(tmp_path / "campaign" / "drop_1.mcap", restitution=0.7, height_m=1.0, seconds=2.0)
    tuned = command("tunenet-tune", "campaign/drop_1.mcap", cwd=tmp_path)
    assert tuned.returncode == 0, tuned.stderr
    words = ("--tuning", "campaign/drop_1.json", "--at", "2026-11-22T14:30Z", "-o", "campaign")
    record(*SUCCESS, *words)
    (outcome,) = read_outcomes(tmp_path / "campaign")
    assert (outcome.drop_log, outcome.tuning) == ("drop_1.mcap", "drop_1.json")
    assert outcome.tuned_parameter == pytest.approx(0.7, abs=0.002)
    assert outcome.stamp_ns == 1_795_357_800_000_000_000


SIX_AT_ONCE = """
import multiprocessing, sys
from tunenet_logs.recorders.cli import main

def record(begin):
    begin.wait()
    sys.exit(main(sys.argv[1:]))

assert main(sys.argv[1:]) == 0
fork = multiprocessing.get_context("fork")
begin = fork.Barrier(6)
running = [fork.Process(target=record, args=[begin]) for _ in range(6)]
for one in running:
    one.start()
for one in running:
    one.join()
sys.exit(any(one.exitcode for one in running))
"""


def test_several_at_once_all_stay_and_none_has_anothers_number(tmp_path: Path):
    """Six processes that begin at the same moment, after a first outcome."""
    words = [sys.executable, "-c", SIX_AT_ONCE, *SUCCESS, "-o", str(tmp_path)]
    subprocess.run(words, cwd=ROOT, check=True, timeout=60)
    assert [one.attempt for one in read_outcomes(tmp_path)] == [1, 2, 3, 4, 5, 6, 7]
    assert len(list(tmp_path.iterdir())) == 7


def test_a_correction_says_which_counts(record: Record, refuses: Refuses, tmp_path: Path):
    def recorded(*words: object) -> str:
        return record("--outcome", "failure", "--ball", "gel", *words).stdout

    assert ";" not in recorded("--at", "2026-11-02T10:00Z")
    later = recorded("--attempt", 1, "--at", "2026-11-02T11:00Z")
    assert "gel, attempt 1; it had an outcome, and the later one counts" in later
    earlier = recorded("--attempt", 1, "--at", "2026-11-02T09:00Z")
    assert "attempt 1; it has an outcome of a later time, and that counts" in earlier
    assert "gel, attempt 1\n" in recorded("--task", "grasp")
    (tmp_path / "paper.csv").write_text("ball,success\ngel,yes\ngel,yes\n")
    (tmp_path / "notes.txt").write_text("x" * 2**21)
    assert "gel, attempt 4\n" in recorded()
    recorded("--attempt", 1_000_000, "-o", "last")  # that there can be
    refuses(2, *SUCCESS, "-o", "last", says="has an attempt 1000000")


@pytest.mark.parametrize("value", ["NaN", "7", '"0.7"', "true", f"1{'0' * 400}"])
def test_what_is_no_tuning_tells_nothing(refuses: Refuses, tmp_path: Path, value: str):
    parameters = f'{{"restitution": {{"value": {value}}}}}'
    (tmp_path / "a.json").write_text(f'{{"log": "a.mcap", "parameters": {parameters}}}')
    refuses(2, *SUCCESS, "--tuning", "a.json", "-o", "campaign", says="a.json: is no tuning")


def test_a_path_that_no_outcome_holds_is_refused(refuses: Refuses, tmp_path: Path):
    deep = tmp_path.joinpath(*["d" * 200] * 6)
    deep.mkdir(parents=True)
    (deep / "a.mcap").touch()
    words = ("--drop-log", deep / "a.mcap", "-o", "campaign")
    refuses(2, *SUCCESS, *words, says="over 1000 letters")
