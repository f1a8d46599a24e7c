"""The ledger of many logs: one row a log, whatever is killed and whenever."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

from tests import strangers
from tests.conftest import BIN, Command
from tunenet_logs.analysis.batch.ledger import journal, ledger_file
from tunenet_logs.errors import LogError, UsageError

_START_NS = 1_700_000_000_000_000_000


def write_drop(path: Path, seed: int) -> Path:
    """A small log of a ball that drops and bounces."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(240) / 120.0 - 0.2
    heights_m = strangers.bounce_heights(rng.uniform(0.5, 0.8), rng.uniform(0.6, 1.2), seconds)
    positions_m = np.column_stack([np.zeros((len(seconds), 2)), heights_m])
    positions_m += rng.normal(0.0, 0.001, positions_m.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    stamps_ns = _START_NS + np.round(seconds * 1e9).astype(np.int64)
    strangers.write_poses(path, stamps_ns, positions_m)
    return path


@pytest.fixture(scope="module")
def made_drops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve logs in two folders, one of them damaged, and what is no log."""
    folder = tmp_path_factory.mktemp("drops")
    for seed in range(11):
        write_drop(folder / f"day{seed % 2}" / f"drop{seed:02}.mcap", seed)
    (folder / "day1" / "damaged.mcap").write_bytes(b"no log" * 50)
    (folder / "notes.md").write_text("of that day")
    (folder / "README.txt").write_text("Drops of 3 balls\nmade on day 1")
    return folder


def ledger_of(folder: Path) -> list[dict[str, Any]]:
    return pd.read_parquet(ledger_file(folder)).replace({np.nan: None}).to_dict("records")  # pyright: ignore[reportArgumentType, reportCallIssue]


def verdicts_of(rows: list[dict[str, Any]]) -> dict[str, int]:
    return dict(Counter(row["verdict"] for row in rows))


def test_a_folder_is_walked_and_every_log_has_a_row(
    made_drops: Path, tmp_path: Path, command: Command
):
    out, csv = tmp_path / "out", tmp_path / "all.csv"
    done = command("tunenet-tune", str(made_drops), "-o", str(out), "--csv", str(csv))
    assert done.returncode == 1
    assert "WARN" not in done.stderr
    rows = ledger_of(out)
    assert len(rows) == len({row["log"] for row in rows}) == 12
    assert verdicts_of(rows) == {"ok": 11, "rejected": 1}
    (bad,) = (row for row in rows if row["verdict"] == "rejected")
    assert bad["log"].endswith("damaged.mcap")
    assert "is not an MCAP log" in bad["reason"]
    record = json.loads(Path(bad["results"] + ".json").read_text())
    assert (record["verdict"], record["parameters"]) == ("rejected", None)
    assert not Path(bad["results"] + ".rrd").exists()
    for row in rows:
        if row is bad:
            continue
        assert row["restitution_low"] < row["restitution"] < row["restitution_high"]
        record = json.loads(Path(row["results"] + ".json").read_text())
        assert record["parameters"]["restitution"]["value"] == row["restitution"]
        assert record["provenance"]["log_sha256"] == row["sha256"]
    assert (out / "day0" / "drop00.rrd").exists()
    assert (out / "ledger.rrd").stat().st_size > 1000
    assert len(pd.read_csv(csv)) == 12
    assert "12 logs: 12 tuned" in done.stdout
    assert not (out / "ledger.jsonl").exists()


def test_what_is_done_and_unchanged_is_not_done_again(
    made_drops: Path, tmp_path: Path, command: Command
):
    logs = tmp_path / "logs"
    shutil.copytree(made_drops, logs)
    out = tmp_path / "out"
    words = ("tunenet-tune", str(logs), "-o", str(out), "--resume", "--no-review", "--jobs", "1")
    assert "12 logs: 12 tuned" in command(*words).stdout
    assert not list(out.rglob("drop*.rrd"))
    assert "12 logs: 0 tuned" in command(*words).stdout
    (logs / "day0" / "drop00.mcap").touch()  # the same contents
    write_drop(logs / "day1" / "drop01.mcap", 99)
    write_drop(logs / "day1" / "new.mcap", 98)
    (out / "day1" / "drop03.json").unlink()
    words = (*words, "--overwrite")
    assert "13 logs: 3 tuned" in command(*words).stdout
    assert "13 logs: 13 tuned" in command(*words, "--method", "fit").stdout
    assert len(ledger_of(out)) == 13


def test_reviews_are_written_of_one_verdict_alone(
    made_drops: Path, tmp_path: Path, command: Command
):
    out = tmp_path / "out"
    logs = [str(made_drops / "day0" / f"drop0{number}.mcap") for number in (0, 2)]
    command("tunenet-tune", *logs, "-o", str(out), "--review-only", "suspect", "--jobs", "1")
    names = "drop00.json drop02.json ledger.parquet ledger.rrd"
    assert {one.name for one in out.iterdir()} == set(names.split())


def _journal_lines(out: Path) -> list[bytes]:
    try:
        return (out / "ledger.jsonl").read_bytes().splitlines()[1:]
    except FileNotFoundError:
        return []


@pytest.mark.live
def test_no_log_is_lost_or_twice_whoever_is_stopped_or_killed(made_drops: Path, tmp_path: Path):
    """Ctrl-C, then the driver killed, then a worker: `--resume` does the rest each time."""
    logs, out = tmp_path / "logs", tmp_path / "out"
    shutil.copytree(made_drops, logs)
    for number in range(6):
        shutil.copy(logs / "day0" / "drop00.mcap", logs / f"again{number}.mcap")
    words = [str(BIN / "tunenet-tune"), str(logs), "-o", str(out)]
    words += ["--resume", "--no-review", "--jobs", "2", "--quiet"]
    for stopped in (signal.SIGINT, signal.SIGKILL, None):
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as driver:
            wanted, deadline = len(_journal_lines(out)) + 3, time.monotonic() + 120
            while len(_journal_lines(out)) < wanted:
                assert driver.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.005)
            workers = _workers(driver.pid)
            os.kill(driver.pid if stopped else workers[0], stopped or signal.SIGKILL)
            _, said = driver.communicate(timeout=120)
        assert b"Traceback" not in said
        while any(map(_lives, workers)):  # they end with their driver
            assert time.monotonic() < deadline
            time.sleep(0.02)
        code = 1 if stopped is None else 130 if stopped is signal.SIGINT else -stopped
        assert driver.returncode == code, said  # at last: for the damaged one
    rows = ledger_of(out)
    every = sorted(str(one.resolve()) for one in logs.rglob("*.mcap"))
    assert sorted(row["log"] for row in rows) == every
    assert not any(row["error"] for row in rows)
    assert verdicts_of(rows) == {"ok": 17, "rejected": 1}


def _workers(driver: int) -> list[int]:
    """The children of the driver that tune."""
    children = Path(f"/proc/{driver}/task/{driver}/children").read_text().split()
    return [
        int(child)
        for child in children
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


def _lives(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split(")")[-1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_torn_line_is_taken_away_and_the_rest_is_kept(tmp_path: Path):
    line = json.dumps({"log": "/a.mcap", "verdict": "ok", "restitution": 0.5})
    with journal(tmp_path) as kept:
        head = (tmp_path / "ledger.jsonl").read_bytes()
    (tmp_path / "ledger.jsonl").write_bytes(head + f'{line}\n{{"log": "/b.mc'.encode())
    with journal(tmp_path) as kept:
        assert len(kept.ledger) == 1
        kept.append({"log": "/b.mcap", "verdict": "rejected"})
    assert [row["log"] for row in ledger_of(tmp_path)] == ["/a.mcap", "/b.mcap"]
    with journal(tmp_path) as kept:
        kept.append({"log": "/a.mcap", "verdict": "suspect"})
    assert [row["verdict"] for row in ledger_of(tmp_path)] == ["suspect", "rejected"]
    assert not any(row["restitution"] for row in ledger_of(tmp_path))


def test_a_ledger_is_written_by_one_process_at_a_time(tmp_path: Path):
    with (
        journal(tmp_path),
        pytest.raises(UsageError, match="another tunenet-tune writes its ledger"),
        journal(tmp_path),
    ):
        pass


@pytest.mark.slow
def test_memory_does_not_grow_with_the_logs(tmp_path: Path):
    """Of one process, between its 30th log and its 90th."""
    for seed in range(6):
        write_drop(tmp_path / "logs" / f"{seed}.mcap", seed)
    code = f"""
from pathlib import Path
from tunenet_logs.analysis.batch.logs import find_logs
from tunenet_logs.analysis.batch.run import Order, Writing, run_batch
from tunenet_logs.terminal import Progress
found = find_logs([Path({str(tmp_path / "logs")!r})]).logs
def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
for turn in range(15):
    writing = Writing(overwrite=True, reviewed=frozenset())
    run_batch(Order(found, writing=writing, folder=Path({str(tmp_path)!r}) / "out",
        keeps_ledger=True, jobs=1), Progress(quiet=True))
    (Path({str(tmp_path)!r}) / "out" / "ledger.parquet").unlink()
    if turn == 4:
        before = resident()
print(resident() - before)
"""
    grown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(grown.stdout) < 60 * 0.3  # [MB] of 60 logs


def test_a_disk_that_is_full_loses_nothing(made_drops: Path, tmp_path: Path):
    """No file can grow beyond 8 kB: neither results nor the table, but the journal can."""
    words = [str(BIN / "tunenet-tune"), str(made_drops / "day0"), "-o", str(tmp_path / "out")]
    words += ["--resume", "--no-review", "--jobs", "1"]
    full = subprocess.run(
        words,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},  # it would be cut, and stay so
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8000, 8000)),
    )
    assert full.returncode == 1
    assert "ledger.parquet: cannot be written" in full.stderr
    assert "--resume" in full.stderr.splitlines()[-1]
    assert "Traceback" not in full.stderr
    assert len(_journal_lines(tmp_path / "out")) == 6
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert verdicts_of(ledger_of(tmp_path / "out")) == {"ok": 6}


HEAD = b'{"journal": "tunenet-tune"}\n'
GOOD = b'{"log": "/a.mcap", "verdict": "ok"}\n'
JOURNALS = [
    HEAD + b'{"log": "x", "verdict": "ok", "rollouts": 999999999999999999999999999999}\n',
    HEAD + b'{"log": "x", "verdict": ' + b"[" * 40_000 + b"\n",
    HEAD + b'{"log": "' + b'\\"' * 40_000 + b"\n",
    HEAD + b'{"log": "x", "verdict": "fine"}\n',
    HEAD + GOOD + b'{"log": "/b.mcap", "verdict": "ok", "restitution": {"value": 1}}\n' + GOOD,
    HEAD + GOOD + b"a note without an end",
    HEAD + b'{"log": "x' + b"a" * 200_000 + b"\n" + GOOD,
    HEAD + GOOD * 60_000,
    GOOD,
    b"",
]


def table_of(metadata: dict[bytes, bytes] | None = None, **columns: Any) -> bytes:
    table = pa.table({"log": ["x"], "verdict": ["ok"], **columns})
    sink = pa.BufferOutputStream()
    parquet.write_table(table.replace_schema_metadata(metadata), sink)
    return sink.getvalue().to_pybytes()


OURS = {b"tunenet-logs": b"ledger"}
TABLES = [
    b"",
    b"PAR1 no table",
    table_of(value=[1.0]),
    table_of(OURS, restitution=[[1, 2, 3]]),
    table_of(OURS, bytes=[{"a": 1}]),
    table_of(OURS, results=[b"bytes"]),
    table_of(OURS, verdict=["fine"]),
    table_of(OURS, reason=["A" * 5_000_000]),
]


@pytest.mark.parametrize(
    ("name", "data"),
    [
        *(("ledger.jsonl", data) for data in JOURNALS),
        *(("ledger.parquet", data) for data in TABLES),
    ],
    ids=lambda one: one if isinstance(one, str) else str(len(one)),
)
def test_a_journal_and_a_table_are_read_as_a_strangers_file(tmp_path: Path, name: str, data: bytes):
    path = tmp_path / name
    path.write_bytes(data)
    match = rf"{name}: (.*; move it away, or choose|.*is no ledger that tunenet-logs wrote)"
    with pytest.raises(LogError, match=match), journal(tmp_path):
        pass
    assert path.read_bytes() == data
    assert list(tmp_path.iterdir()) == [path]
