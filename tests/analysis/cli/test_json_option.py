"""`--json FILE` and `--json -`: results for scripts, and nothing else on standard output."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import Command
from tests.tunenet_logs.test_json_output import strict


def kept(log: Path) -> dict[str, Any]:
    """What NAME.json beside a log holds, but the curves."""
    fields = json.loads(log.with_suffix(".json").read_text())
    del fields["curves"]
    return fields


def test_one_log_gives_what_its_json_holds(process: Command, drop_log: Path):
    """In a process of its own: libraries that print would show here."""
    result = process("tunenet-tune", drop_log, "--json", "-")
    assert result.returncode == 0
    assert result.stderr == ""
    [found] = strict(result.stdout)
    own = {key: found.pop(key) for key in ("path", "json", "rrd", "error")}
    assert own == {
        "path": str(drop_log),
        "json": str(drop_log.with_suffix(".json")),
        "rrd": str(drop_log.with_suffix(".rrd")),
        "error": None,
    }
    assert found == kept(drop_log)
    assert found["parameters"]["restitution"]["value"] == pytest.approx(0.7, abs=1e-3)
    assert drop_log.with_suffix(".rrd").stat().st_size > 0


def test_each_log_has_its_line_be_it_readable_or_not(
    command: Command, drop_log: Path, tmp_path: Path
):
    hostile = tmp_path / os.fsdecode(b"\xff\x1b[31m\n.mcap")
    hostile.write_text("no log")
    logs = [drop_log, hostile, tmp_path / "none.mcap"]
    words = ["-o", tmp_path / "out", "--no-review", "--jobs", 1, "--json", "-"]
    result = command("tunenet-tune", *logs, *words)
    assert result.returncode == 1
    assert result.stdout.isascii()
    found = strict(result.stdout)
    assert [os.fsencode(one["path"]) for one in found] == [os.fsencode(log) for log in logs]
    assert [one["verdict"] for one in found] == ["ok", "rejected", "rejected"]
    assert [set(one) for one in found] == [set(found[0])] * 3
    assert found[0]["rrd"] is None
    assert found[2]["json"] is None
    assert all(one["json"] is None or Path(one["json"]).is_file() for one in found)


def test_a_file_takes_the_lines_and_the_table_stays(
    command: Command, drop_log: Path, tmp_path: Path
):
    file = tmp_path / "all.json"
    for _ in range(2):  # it replaces its own
        result = command("tunenet-tune", drop_log, "--no-review", "--json", file)
        assert result.returncode == 0
        assert "restitution" in result.stdout
    [found] = strict(file.read_text())
    assert found["verdict"] == "ok"


@pytest.mark.parametrize(
    ("file", "says"),
    [
        ("{log}", "is a log of this batch"),
        ("{stem}.json", "is where a log's own results go"),
        ("notes.txt", "is no file of --json that tunenet-logs wrote"),
        ("nowhere/all.json", "no such folder"),
    ],
)
def test_nothing_else_is_replaced(
    command: Command, drop_log: Path, tmp_path: Path, file: str, says: str
):
    (tmp_path / "notes.txt").write_text("mine")
    place = drop_log.parent / file.format(log=drop_log.name, stem=drop_log.stem)
    before = drop_log.read_bytes()
    result = command("tunenet-tune", drop_log, "--json", place)
    assert result.returncode == 2
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert drop_log.read_bytes() == before
    assert not drop_log.with_suffix(".rrd").exists()


def test_a_pipe_is_refused_rather_than_waited_for(command: Command, drop_log: Path, tmp_path: Path):
    os.mkfifo(tmp_path / "all.jsonl")
    result = command("tunenet-tune", drop_log, "--json", tmp_path / "all.jsonl")
    assert result.returncode in (1, 2)
    assert result.stderr.count("\n") == 1
    assert (tmp_path / "all.jsonl").is_fifo()


def test_a_plan_goes_to_standard_output(command: Command, tmp_path: Path):
    words = ["--restitution", 0.7, "--shots", 20]
    result = command("tunenet-plan", *words, "--json", "-")
    command("tunenet-plan", *words, "--json", tmp_path / "plan.json")
    [found] = strict(result.stdout)
    in_file = json.loads((tmp_path / "plan.json").read_text())
    del found["seconds"], in_file["seconds"]
    assert found == in_file


def test_an_experiment_goes_to_standard_output(command: Command):
    words = ["--seeds", 1, "--targets", 2, "--jobs", 1, "--quiet"]
    result = command("tunenet-eval", "intervals", *words, "--json", "-")
    [found] = strict(result.stdout)
    assert found
    refused = command("tunenet-eval", "intervals", "--csv", "-")
    assert refused.returncode == 2
