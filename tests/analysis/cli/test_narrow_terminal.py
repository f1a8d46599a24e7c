"""The table of tunenet-tune in a pseudo-terminal of some width, and in a pipe."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import struct
import subprocess
import termios
from pathlib import Path

import pytest

from tests.conftest import BIN, Command, record
from tunenet_logs.analysis.presentation import TextTable, laid_out

COLUMNS = {
    "log": ["a" * 30 + ".mcap", "b.mcap"],
    "verdict": ["ok", "rejected"],
    "restitution": ["0.7000", "-"],
    "95 % interval": ["0.6990 to 0.7010", "-"],
    "fits": ["0.01 %", "-"],
    "rollouts": ["7", "0"],
    "time": ["1.00 s", "0.10 s"],
}
BELOW = [[], ["rejected: the ball is not seen to bounce, and so on for many more words than fit"]]


def shown(columns: dict[str, list[str]], below: list[list[str]]) -> TextTable:
    """The table of some columns, with lines below each row."""
    return TextTable(tuple(columns), list(zip(*columns.values(), strict=True)), below)


def seen(columns: int, *words: object) -> list[str]:
    """The lines that a command shows in a terminal of so many columns."""
    ours, its = pty.openpty()
    try:
        fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        environment = {name: text for name, text in os.environ.items() if name != "COLUMNS"}
        process = subprocess.Popen(
            [str(BIN / "tunenet-tune"), *map(str, words)],
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


def table_of(lines: list[str]) -> list[str]:
    """What stands above the empty line."""
    return lines[: lines.index("")]


def test_one_log_stands_upright_in_a_narrow_terminal(drop_log: Path, monkeypatch):
    monkeypatch.chdir(drop_log.parent)
    table = table_of(seen(80, drop_log.name, "--no-review"))
    cells = dict(line.split("  ", 1) for line in table)
    assert {name: cell.strip() for name, cell in cells.items()}["verdict"] == "ok"
    assert float(cells["restitution"]) == pytest.approx(0.7, abs=1e-3)
    assert {"95 % interval", "drag [1/m]", "rollouts", "truth"} <= set(cells)
    assert max(map(len, table)) <= 80


def test_several_logs_leave_out_what_matters_least(drop_log: Path, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "other.mcap", restitution=0.5)
    words = ["other.mcap", drop_log, "-o", "out", "--no-review", "--jobs", 1]
    table = table_of(seen(80, *words))
    assert max(map(len, table)) <= 80
    assert {"verdict", "restitution"} <= set(table[0].split())
    said = " ".join(table[3:])
    assert said.startswith("(left out, too wide for this terminal: ")
    assert "rollouts" in said
    assert "rollouts" not in table[0]


def test_a_wide_terminal_and_a_pipe_have_the_whole_table(
    drop_log: Path, process: Command, monkeypatch
):
    monkeypatch.chdir(drop_log.parent)
    wide = seen(250, drop_log.name, "--no-review")[0].split()
    piped = process("tunenet-tune", drop_log.name, "--no-review").stdout.splitlines()[0].split()
    assert wide == piped
    assert {"slope", "drag", "cross-check", "rollouts", "time", "truth"} <= set(piped)


def test_json_is_not_mixed_with_bars(drop_log: Path, monkeypatch):
    """Standard error is the same terminal."""
    monkeypatch.chdir(drop_log.parent)
    [line] = seen(80, drop_log.name, "--no-review", "--json", "-")
    assert json.loads(line)["verdict"] == "ok"


@pytest.mark.parametrize("most", [1, 30, 50, 60, 80, 200])
def test_no_line_is_wider_than_the_terminal(most: int):
    lines = laid_out(shown(COLUMNS, BELOW), most).splitlines()
    least = len("a" * 10 + "  verdict  restitution")
    assert max(map(len, lines)) <= max(most, least + 1)
    assert "0.7000" in lines[1]
    assert lines[2].split()[:2] == ["b.mcap", "rejected"]


def test_columns_leave_from_the_right_and_are_named():
    text = laid_out(shown(COLUMNS, BELOW), 80)
    assert text.splitlines()[0].split("  ")[-1].strip() == "fits"
    assert "left out, too wide for this terminal: rollouts, time;" in text.replace("\n", " ")


ADDRESSES = {
    "joint/shoulder_pan_joint.frictionloss [N·m]": ["0.0123", "-"],
    "95 % interval": ["0.0120 to 0.0126", "-"],
    "body/left_gripper_finger_link.inertia[2] [kg·m²]": ["0.0100 ± 0.0001", "-"],
}


def test_long_names_take_several_lines_before_a_column_leaves():
    columns = {name: COLUMNS[name] for name in ("log", "verdict")} | ADDRESSES
    lines = laid_out(shown(columns, BELOW), 100).splitlines()
    assert max(map(len, lines)) <= 100
    joint, body = (lines[0].index(word) for word in ("joint/", "body/"))
    assert [line[joint : joint + 19].rstrip() for line in lines[:3]] == [
        "joint/",
        "shoulder_pan_joint",
        ".frictionloss [N·m]",
    ]
    assert "".join(line[body:].strip() for line in lines[:3]).replace(" ", "") == (
        "body/left_gripper_finger_link.inertia[2][kg·m²]"
    )
    assert lines[2].startswith("log")
    assert "0.0123" in lines[3]
    assert "left out" not in "".join(lines)


def test_at_80_columns_the_interval_stays_beside_a_long_name():
    columns = {name: COLUMNS[name] for name in ("log", "verdict")} | ADDRESSES
    lines = laid_out(shown(columns, BELOW), 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert "0.0120 to 0.0126" in lines[3]
    assert "left out, too wide for this terminal: body/left_gripper" in " ".join(lines)


@pytest.mark.parametrize("letters", [10, 30, 100])
def test_one_log_with_a_long_name_stays_within_80_columns(letters: int):
    name = f"joint/{'x' * letters}.frictionloss [N·m]"
    columns = {"log": ["a.mcap"], "verdict": ["ok"], name: ["0.0123 ± 0.0001"]}
    lines = laid_out(shown({**columns, "y" * 50: ["0.1"]}, [[]]), 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert ("…" in "".join(lines)) == (letters == 100)
    assert all(cells[0] in "".join(lines) for cells in columns.values())


def test_without_a_width_nothing_is_left_out_or_wrapped():
    lines = laid_out(shown(COLUMNS, BELOW), None).splitlines()
    assert lines[0].split()[-1] == "time"
    assert lines[-1] == f"  {BELOW[1][0]}"
