"""Tables and words: what a terminal of any width and a review show of a tuning."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import struct
import subprocess
import termios
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tests.conftest import BIN, Command, record
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import (
    TextTable,
    interval_words,
    laid_out,
    result_words,
    row_of,
    said_names,
    table,
)
from tunenet_logs.analysis.record import Equivalent, Equivalents, Motion
from tunenet_logs.analysis.tuning import tune_log


def shown(*tunings: Tuning) -> str:
    return table([row_of(one, record_of(one)) for one in tunings])


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.61981, 0.62032, "0.6198 to 0.6203"),
        (0.7000012, 0.7000391, "0.70000 to 0.70004"),
        (0.3500001, 0.3500034, "0.350000 to 0.350003"),
        (0.34999996, 0.35000003, "0.349999 to 0.350001"),
        (0.0, 0.00002, "0.00000 to 0.00002"),
    ],
)
def test_no_interval_reads_as_certainty(low: float, high: float, words: str):
    assert interval_words((low, high)) == words


def test_the_table_shows_the_truth_only_where_a_log_states_one(drop_log: Path, tmp_path: Path):
    (tmp_path / "b.mcap").write_text("no log")
    known, unknown = (tune_log(path, TuneOptions()) for path in (drop_log, tmp_path / "b.mcap"))
    assert "truth" in shown(known, unknown).splitlines()[0]
    assert "truth" not in shown(unknown).splitlines()[0]
    assert "is not an MCAP log" in shown(unknown)


def test_what_an_airless_simulator_needs_and_what_the_log_leaves_open_is_said(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    assert "without air" not in shown(tuning)  # the same there
    made = record_of(tuning)
    without = Equivalents(Equivalent(0.486, 1.05, (6.7,)), Equivalent(0.49, 1.0, (6.7,)))
    motion = Motion(equivalents=without, unidentifiable=("drag and slope: no",))
    words = table([replace(row_of(tuning, made), record=replace(made, motion=motion))])
    assert "without air: 0.486 for the first rebound (1.1 % rms), 0.490 for all (1.0 %)" in words
    assert "drag and slope: no" in words


def test_an_interval_is_given_unless_a_check_doubts_the_value_itself(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    for name, has in (
        ("no samples missing", True),
        ("first flight seen", True),
        ("simulation fits", False),
        ("gravity", False),
    ):
        assert name in {check.name for check in tuning.checks}
        checks = tuple(replace(check, passed=check.name != name) for check in tuning.checks)
        doubted = replace(tuning, checks=checks, verdict="suspect", reason=name)
        assert (doubted.interval95 is not None) == has, name
        assert (" (suspect)" in shown(doubted)) == has
        words = result_words(record_of(doubted), tuning.preset, "drop")
        assert "95 % interval (suspect)" in words or not has
        assert words.index(name) < words.index("| restitution")


def test_a_reviews_names_stay_apart():
    names = {
        "restitution_slope": "restitution slope",
        "joint/shoulder_pan.damping": "shoulder_pan.damping",
        "body/ns/left_arm.ipos[0]": "ns/left_arm.ipos[0]",
        "joint/belt.damping": "joint/belt.damping",
        "tendon/belt.damping": "tendon/belt.damping",
    }
    assert said_names(names) == names


def seen(columns: int, *words: object) -> list[str]:
    """The lines that tunenet-tune shows in a pseudo-terminal of so many columns."""
    ours, its = pty.openpty()
    try:
        fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        environment = {name: text for name, text in os.environ.items() if name != "COLUMNS"}
        process = subprocess.Popen(
            [str(BIN / "tunenet-tune"), *map(str, words), "--no-review"],
            stdout=its,
            stderr=its if "--json" in words else subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
            env=environment,
        )
    finally:
        os.close(its)
    text = b""
    with os.fdopen(ours, "rb", buffering=0) as terminal:
        try:
            while part := terminal.read(4096):
                text += part
        except OSError:  # the other end is closed
            pass
    assert process.wait(timeout=60) == 0
    return text.decode().splitlines()


def test_a_table_fits_the_terminal_and_a_pipe_has_it_whole(
    drop_log: Path, command: Command, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(drop_log.parent)
    lines = seen(80, drop_log.name)
    upright = lines[: lines.index("")]
    cells = {name: cell.strip() for name, cell in (line.split("  ", 1) for line in upright)}
    assert max(map(len, upright)) <= 80
    assert cells["verdict"] == "ok"
    assert float(cells["restitution"]) == pytest.approx(0.7, abs=1e-3)
    whole = {"95 % interval", "drag [1/m]", "rollouts", "truth"}
    assert whole <= set(cells)
    piped = command("tunenet-tune", drop_log.name, "--no-review").stdout.splitlines()[0]
    assert seen(250, drop_log.name)[0].split() == piped.split()
    assert all(name in piped for name in (*whole, "slope", "fits", "cross-check", "time"))
    [line] = seen(80, drop_log.name, "--json", "-")  # no bars, though it is the same terminal
    assert json.loads(line)["verdict"] == "ok"
    record(drop_log.with_name("other.mcap"), restitution=0.5)
    lines = seen(80, "other.mcap", drop_log.name, "-o", "out", "--jobs", 1)
    several = lines[: lines.index("")]
    assert max(map(len, several)) <= 80
    assert {"verdict", "restitution"} <= set(several[0].split())
    assert "rollouts" not in several[0]
    said = " ".join(several[3:])
    assert said.startswith("(left out, too wide for this terminal: ")
    assert "rollouts" in said


COLUMNS = {
    "log": ["a" * 30 + ".mcap", "b.mcap"],
    "verdict": ["ok", "rejected"],
    "restitution": ["0.7000", "-"],
    "95 % interval": ["0.6990 to 0.7010", "-"],
    "fits": ["0.01 %", "-"],
    "rollouts": ["7", "0"],
    "time": ["1.00 s", "0.10 s"],
}


LONG = {"joint/shoulder_pan_joint.frictionloss [N·m]": ["0.0123", "-"]}


def laid(columns: Mapping[str, Sequence[str]], most: int | None) -> list[str]:
    rows = list(zip(*columns.values(), strict=True))
    below = [[], ["rejected: the ball is not seen to bounce, and so on for many more words"]]
    return laid_out(TextTable(tuple(columns), rows, below), most).splitlines()


@pytest.mark.parametrize("most", [1, 30, 50, 60, 80, 200, None])
def test_no_line_is_wider_and_what_matters_least_leaves_first(most: int | None):
    lines = laid(COLUMNS, most)
    least = len("a" * 10 + "  verdict  restitution")
    assert max(map(len, lines)) <= max(most or 999, least + 1)
    assert "0.7000" in lines[1]
    assert lines[2].split()[:2] == ["b.mcap", "rejected"]
    heads = lines[0].split()
    kept = len([name for name in COLUMNS if name.split()[-1] in heads])
    assert [name.split()[-1] in heads for name in COLUMNS] == [k < kept for k in range(7)]
    assert all(name in " ".join(lines) for name in COLUMNS)  # those that left are named
    assert most is not None or (kept, lines[-1].strip()[:8]) == (7, "rejected")
    assert max(map(len, laid(COLUMNS | LONG, 80))) <= 80
