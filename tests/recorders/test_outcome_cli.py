"""tunenet-record --outcome as a user runs it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, Command, record
from tunenet_logs.outcomes import read_outcomes


def test_each_outcome_is_the_next_of_its_ball(command: Command, tmp_path: Path):
    for ball, word in (("red gel", "success"), ("racquetball", "failure"), ("red gel", "failure")):
        result = command(
            "tunenet-record", "--outcome", word, "--ball", ball, "--shot-height", 0.62,
            "--miss=-0.03", "--reason", "rim", "--note", "left side", "-o", "campaign",
            cwd=tmp_path,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
    assert f"{word} of red gel, attempt 2" in result.stdout
    first, second, third = read_outcomes(tmp_path / "campaign")
    assert [one.attempt for one in (first, second, third)] == [1, 1, 2]
    assert [one.success for one in (first, second, third)] == [True, False, False]
    assert (first.task, first.shot_height_m, first.miss_m) == ("bounce-shot", 0.62, -0.03)
    assert (first.reason, first.note) == ("rim", "left side")
    assert 0 < first.stamp_ns < second.stamp_ns < third.stamp_ns


def test_a_tuning_says_restitution_and_log(command: Command, tmp_path: Path):
    (tmp_path / "campaign").mkdir()
    record(tmp_path / "campaign" / "drop_1.mcap", restitution=0.7, height_m=1.0, seconds=2.0)
    tuned = command("tunenet-tune", "campaign/drop_1.mcap", cwd=tmp_path)
    assert tuned.returncode == 0, tuned.stderr
    words = ("--ball", "gel", "--tuning", "campaign/drop_1.json", "--at", "2026-11-22T14:30Z")
    result = command(
        "tunenet-record", "--outcome", "success", *words, "-o", "campaign", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
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
    words = ["--outcome", "success", "--ball", "b", "-o", str(tmp_path)]
    subprocess.run([sys.executable, "-c", SIX_AT_ONCE, *words], cwd=ROOT, check=True, timeout=60)
    assert [one.attempt for one in read_outcomes(tmp_path)] == [1, 2, 3, 4, 5, 6, 7]
    assert len(list(tmp_path.iterdir())) == 7


def test_a_correction_says_which_counts(command: Command, tmp_path: Path):
    def recorded(*words: object) -> str:
        told = ("--outcome", "failure", "--ball", "gel", *words)
        result = command("tunenet-record", *told, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        return result.stdout

    assert ";" not in recorded("--at", "2026-11-02T10:00Z")
    later = recorded("--attempt", 1, "--at", "2026-11-02T11:00Z")
    assert "gel, attempt 1; it had an outcome, and the later one counts" in later
    earlier = recorded("--attempt", 1, "--at", "2026-11-02T09:00Z")
    assert "attempt 1; it has an outcome of a later time, and that counts" in earlier
    assert "gel, attempt 1\n" in recorded("--task", "grasp")
    (tmp_path / "paper.csv").write_text("ball,success\ngel,yes\ngel,yes\n")
    (tmp_path / "notes.txt").write_text("x" * 2**21)
    assert "gel, attempt 4\n" in recorded()


def test_no_attempt_comes_after_the_last(command: Command, tmp_path: Path):
    words = ("tunenet-record", "--outcome", "success", "--ball", "gel")
    assert command(*words, "--attempt", 1_000_000, cwd=tmp_path).returncode == 0
    result = command(*words, cwd=tmp_path)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "has an attempt 1000000" in result.stderr


@pytest.mark.parametrize(
    "parameters",
    [
        '{"restitution": {"value": NaN}}',
        '{"restitution": {"value": 7}}',
        '{"restitution": {"value": "0.7"}}',
        '{"restitution": {"value": true}}',
        '{"restitution": [1]}',
        f'{{"restitution": {{"value": 1{"0" * 400}}}}}',
        "[1]",
        '""',
    ],
)
def test_what_is_no_tuning_tells_nothing(command: Command, tmp_path: Path, parameters: str):
    (tmp_path / "a.json").write_text(f'{{"log": "a.mcap", "parameters": {parameters}}}')
    words = ("--ball", "gel", "--tuning", "a.json", "-o", "campaign")
    result = command("tunenet-record", "--outcome", "success", *words, cwd=tmp_path)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "a.json: is no tuning" in result.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["a.json"]


def test_a_path_that_no_outcome_holds_is_refused(command: Command, tmp_path: Path):
    deep = tmp_path.joinpath(*["d" * 200] * 6)
    deep.mkdir(parents=True)
    (deep / "a.mcap").write_text("")
    for path, told in ((deep / "a.mcap", "over 1000 letters"), ("x" * 300, "no such file")):
        words = ("--ball", "gel", "--drop-log", path, "-o", "campaign")
        result = command("tunenet-record", "--outcome", "success", *words, cwd=tmp_path)
        assert (result.returncode, result.stderr.count("\n")) == (2, 1)
        assert told in result.stderr
        assert not (tmp_path / "campaign").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "--ball"),
        (("--ball", "b", "--rate", "60"), "--rate"),
        (("--ball", "b", "--overwrite"), "--overwrite"),
        (("--ball", "b", "--height", "1"), "--height"),
        (("--ball", "b", "--miss", "far"), "--miss"),
        (("--ball", "b", "--at", "noon"), "--at"),
        (("--ball", "b", "--at", "2050-01-01 10:00"), "beyond 2038"),
        (("--ball", "b", "--at", "9999-12-31T23:59-05:00"), "--at"),
        (("--ball", " "), "--ball"),
        (("--ball", "b", "-o", "x.mcap"), "x.mcap"),
        (("--ball", "b", "--drop-log", "x.mcap"), "x.mcap"),
        (("--ball", "b", "--tuning", "x.json"), "x.json"),
        (("--ball", "b", "--tuning", "bad.json"), "bad.json"),
    ],
)
def test_wrong_words_are_one_line(command: Command, tmp_path: Path, words: tuple, told: str):
    (tmp_path / "bad.json").write_text(json.dumps([1]))
    result = command("tunenet-record", "--outcome", "success", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert told in result.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["bad.json"]


@pytest.mark.parametrize("option", [("--ball", "b"), ("--reason", "rim")])
def test_they_go_with_no_simulation(command: Command, tmp_path: Path, option: tuple[str, str]):
    result = command("tunenet-record", "--simulate", "drop", *option, cwd=tmp_path)
    assert result.returncode == 2
    assert f"{option[0]} does not go with --simulate drop" in result.stderr
    assert not list(tmp_path.iterdir())
