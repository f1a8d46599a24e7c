"""Odd folders, names and orders that a stranger may have."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pandas as pd
import pytest

from tests.analysis.batch.test_ledger import ledger_of, write_drop
from tests.conftest import BIN, Command
from tunenet_logs.analysis.batch.ledger import csv_place
from tunenet_logs.analysis.batch.logs import find_logs
from tunenet_logs.errors import UsageError


@pytest.mark.parametrize("name", ["log.mcap", "track.csv", "notes.txt"])
def test_a_text_table_never_replaces_what_is_none(tmp_path: Path, name: str, command: Command):
    log = write_drop(tmp_path / "runs" / "drop.mcap", 0)
    target = tmp_path / name
    target.write_bytes(b"t,x,y,z\n0,0,0,1\n")
    words = ("tunenet-tune", str(log), "-o", str(tmp_path / "out"), "--no-review", "--csv")
    done = command(*words, str(target))
    assert done.returncode == 2
    assert "is no ledger that tunenet-logs wrote" in done.stderr
    assert target.read_bytes() == b"t,x,y,z\n0,0,0,1\n"
    for more in ((), ("--overwrite",)):  # a log is lost by no option
        done = command(*words, str(log), *more)
        assert done.returncode == 2
        assert "is a log of this batch" in done.stderr
        assert log.read_bytes()[:5] == b"\x89MCAP"


def test_a_text_table_goes_beside_results_that_are_not_there_yet(tmp_path: Path, command: Command):
    log, out = write_drop(tmp_path / "drop.mcap", 0), tmp_path / "out"
    for _ in range(2):  # it replaces itself
        words = ("-o", str(out), "--no-review", "--csv", str(out / "all.csv"))
        done = command("tunenet-tune", str(log), *words)
        assert done.returncode == 0, done.stderr
    assert pd.read_csv(out / "all.csv").verdict.tolist() == ["ok"]


@pytest.mark.parametrize("name", ["ledger.parquet", "drop.json", "drop.RRD", "ledger.jsonl"])
def test_a_text_table_never_takes_the_name_of_other_results(tmp_path: Path, name: str):
    with pytest.raises(UsageError, match="other results"):
        csv_place(tmp_path / name, tmp_path, (), overwrite=True)


def test_links_in_circles_and_to_nowhere_are_left_out(tmp_path: Path):
    drop = write_drop(tmp_path / "runs" / "drop.mcap", 0)
    (drop.parent / "again").symlink_to(drop.parent)
    (drop.parent / "self.mcap").symlink_to(drop.parent / "self.mcap")
    (drop.parent / "gone.mcap").symlink_to(tmp_path / "gone.mcap")
    found = find_logs([drop.parent])
    assert [one.log for one in found.logs] == [drop]
    assert found.left_out == 3


def test_a_pattern_with_spaces_and_brackets_is_what_it_says(tmp_path: Path):
    drop = write_drop(tmp_path / "my runs [1]" / "a drop.mcap", 0)
    assert [one.log for one in find_logs([str(tmp_path / "my runs*" / "*.mcap")]).logs] == [drop]
    assert [one.log for one in find_logs([str(drop)]).logs] == [drop]


@pytest.mark.live
def test_ctrl_c_keeps_what_is_done_and_resume_does_the_rest(tmp_path: Path):
    folder, out = tmp_path / "runs", tmp_path / "out"
    first = write_drop(folder / "00.mcap", 0)
    for number in range(1, 40):
        shutil.copy(first, folder / f"{number:02}.mcap")
    words = [str(BIN / "tunenet-tune"), os.fspath(folder), "-o", os.fspath(out), "--no-review"]
    words += ["--jobs", "2", "--quiet"]
    journal = out / "ledger.jsonl"
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as driver:
        deadline = time.monotonic() + 60
        while not (journal.exists() and journal.read_bytes().count(b"\n") > 4):
            assert driver.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        driver.send_signal(signal.SIGINT)
        _, said = driver.communicate(timeout=60)
    assert driver.returncode == 130
    assert b"Traceback" not in said
    done = len(ledger_of(out))
    assert 3 < done < 40
    again = subprocess.run([*words, "--resume"], capture_output=True, text=True, check=True)
    assert f"{40 - done} tuned" in again.stdout
    assert len({row["log"] for row in ledger_of(out)}) == len(ledger_of(out)) == 40
