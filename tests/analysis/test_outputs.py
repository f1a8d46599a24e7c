"""A folder of results that a stranger made: whatever lies where an output goes stays as it is."""

from __future__ import annotations

import os
import random
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from mcap.records import Header

from tests.conftest import Command, record
from tunenet_logs.writing.writer import MAGIC, bytes_of

FOREIGN = {
    "empty": b"",
    "text": b"log,mine\n",
    "json": b'{\n "log": "drop.mcap", "verdict": "ok", "parameters": {}, "provenance": null}',
    "lines": b'{"path": "drop.mcap", "log": "drop.mcap", "verdict": "ok"}\n',
    "journal": b'{"log": "x", "verdict": "ok", "rollouts": 999999999999999999999999999999}\n',
    "deep": b'{"log": "x", "verdict": ' + b"[" * 40_000 + b"\n",
    "html": b"<!doctype html>\n<!-- tunenet-logs -->\n<title>tunenet-logs page of mine</title>",
    "csv": b"log,task,preset,verdict\nmine,1,2,3\n",
    "xml": b"<robot><!-- Exported by hand from the tuning of drop.mcap --></robot>",
    "png": b"\x89PNG\r\n\x1a\n" + bytes(25) + b"\0\0\0\x14tEXtSoftware\0tunenet-log",
    "pdf": b"%PDF-1.4\n<< /Creator (tunenet) >>\n%%EOF",
    "rrd": b"RRF2" + bytes(60) + b"\x12\x04mine\x1a\x1f\x0a\x1dsomebody drop 71067d30919b4c02",
    "mcap": MAGIC + bytes_of(Header("ros2", "libmcap 1.3.0")),
    "weights": b'\x20\0\0\0\0\0\0\0{"__metadata__":{"format":"pt"}}',
}


def parquet(path: Path) -> None:
    pd.DataFrame({"log": ["a.mcap"], "verdict": ["ok"]}).to_parquet(path)


def linked(to: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(path.parent / "theirs" / to)


OBSTACLES: dict[str, Callable[[Path], object]] = {
    "folder": Path.mkdir,
    "pipe": os.mkfifo,
    "socket": lambda path: os.mknod(path, 0o140644),
    "link to a file": linked("file"),
    "link to a folder": linked("folder"),
    "link to a pipe": linked("pipe"),
    "dangling link": linked("none"),
    "circle of links": lambda path: path.symlink_to(path.name),
    "parquet": parquet,
    **{
        name: lambda path, data=data: Path(path).write_bytes(data) for name, data in FOREIGN.items()
    },
}

OUTPUTS = [
    ("tunenet-tune {log} -o {out}", "drop.json"),
    ("tunenet-tune {log} -o {out}", "drop.rrd"),
    ("tunenet-tune {log} -o {out} --overwrite", "drop.json"),
    ("tunenet-tune {log} -o {out} --resume", "ledger.jsonl"),
    ("tunenet-tune {log} -o {out} --resume --overwrite", "ledger.parquet"),
    ("tunenet-tune {log} -o {out} --resume", "ledger.rrd"),
    ("tunenet-tune {log} -o {out} --csv {out}/all.csv --overwrite", "all.csv"),
    ("tunenet-tune {log} -o {out} --json {out}/all.jsonl --overwrite", "all.jsonl"),
    ("tunenet-tune {log} -o {out} --save-arm-card {out}/arm.json --overwrite", "arm.json"),
    ("tunenet-report {json} -o {out}/a.html --overwrite", "a.html"),
    ("tunenet-report {json} --png {out}/a.png --overwrite", "a.png"),
    ("tunenet-report {json} --pdf {out}/a.pdf --overwrite", "a.pdf"),
    ("tunenet-compare {json} {json} --csv {out}/a.csv --overwrite", "a.csv"),
    ("tunenet-compare {json} {json} --csv {out}/a.csv --overwrite", "a_pairs.csv"),
    ("tunenet-compare {json} {json} --html {out}/a.html --overwrite", "a.html"),
    ("tunenet-compare {json} {json} --png {out}/a.png", "a.png"),
    ("tunenet-export {json} --to sdf -o {out}/a.sdf", "a.sdf"),
    ("tunenet-export {json} --to json -o {out}/a.json --overwrite", "a.json"),
    ("tunenet-export {json} --to pybullet -o {out}/a.py --overwrite", "a.urdf"),
    ("tunenet-plan {json} --json {out}/a.json --overwrite", "a.json"),
    ("tunenet-plan {json} --rrd {out}/a.rrd --overwrite", "a.rrd"),
    ("tunenet-plan --save-rig {out}/rig.yaml", "rig.yaml"),
    ("tunenet-review {log} -o {out}/a.rrd --overwrite --quiet", "a.rrd"),
    ("tunenet-train drop -o {out}/a.safetensors --overwrite --quiet", "a.safetensors"),
    ("tunenet-eval intervals --json {out}/a.json --overwrite", "a.json"),
    ("tunenet-eval intervals --csv {out}/a.csv --overwrite", "a.csv"),
    ("tunenet-eval drop --png {out}/a.png --overwrite", "a.png"),
    ("tunenet-eval drop --rrd {out}/a.rrd --overwrite", "a.rrd"),
    ("tunenet-record --simulate drop -o {out}/a.mcap --overwrite --quiet", "a.mcap"),
    ("tunenet-record --simulate drop -o {out}/a.mcap --overwrite --quiet", "a.mcap.active"),
    ("tunenet-record --simulate payload --save-path {out}/a.csv --overwrite", "a.csv"),
    ("tunenet-logs import {log} -o {out}/a.mcap --overwrite --quiet", "a.mcap"),
    ("tunenet-logs recover {log} -o {out}/a.mcap --overwrite --quiet", "a.mcap"),
]


@pytest.fixture(scope="module")
def tuned(command: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with its results."""
    log = record(tmp_path_factory.mktemp("tuned") / "drop.mcap", restitution=0.74)
    assert command("tunenet-tune", log).returncode == 0
    return log


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A stranger's folder, with what links lead to."""
    folder = tmp_path / "out"
    (folder / "theirs" / "folder").mkdir(parents=True)
    (folder / "theirs" / "file").write_text("theirs")
    os.mkfifo(folder / "theirs" / "pipe")
    return folder


def seen(folder: Path) -> dict[Path, object]:
    """All that tells whether anything in it was touched."""
    return {path: state_of(path) for path in [folder, *folder.rglob("*")]}


def state_of(path: Path) -> object:
    state = path.lstat()
    link = str(path.readlink()) if path.is_symlink() else ""
    changed = 0 if path.name == "out" else state.st_mtime_ns  # scratch files come and go in it
    data = path.read_bytes() if stat.S_ISREG(state.st_mode) else b""
    return state.st_ino, state.st_mode, changed, link, data


def run(command: Command, words: str, log: Path, out: Path):
    name, *rest = words.format(log=log, json=log.with_suffix(".json"), out=out).split()
    return command(name, *rest)


@pytest.mark.parametrize(("words", "name"), OUTPUTS)
def test_what_is_not_ours_is_never_touched(
    command: Command, tuned: Path, out: Path, words: str, name: str
):
    for obstacle, make in OBSTACLES.items():
        if obstacle == "folder" and words.startswith("tunenet-report {json} --p"):
            continue  # which takes the figures
        make(out / name)
        before = seen(out)
        done = run(command, words, tuned, out)
        said = f"{obstacle}: {done.stdout}{done.stderr}"
        assert done.returncode in (1, 2), said
        assert f"{out / name}: " in done.stderr, said
        assert done.stderr.count("\n") == 1, said
        assert seen(out) == before, said
        (out / name).rmdir() if obstacle == "folder" else (out / name).unlink()


OF_OURS = [
    ("tunenet-tune {log} -o {out}", ("drop.json", "drop.rrd")),
    ("tunenet-tune {log} -o {out} --resume", ("ledger.parquet", "ledger.rrd")),
    ("tunenet-tune {log} -o {out} --csv {out}/a.csv --no-review", ("a.csv",)),
    ("tunenet-tune {log} -o {out} --json {out}/a.jsonl --no-review", ("a.jsonl",)),
    ("tunenet-compare {json} {json} --csv {out}/a.csv", ("a.csv", "a_pairs.csv")),
    ("tunenet-compare {json} {json} --html {out}/a.html", ("a.html",)),
    ("tunenet-export {json} --to yaml -o {out}/a.yaml", ("a.yaml",)),
    ("tunenet-plan {json} --json {out}/a.json --rrd {out}/a.rrd", ("a.json", "a.rrd")),
    ("tunenet-review {json} -o {out}/a.rrd --quiet", ("a.rrd",)),
]


@pytest.mark.parametrize(("words", "names"), OF_OURS)
def test_what_is_ours_and_of_the_same_log_is_replaced_but_through_no_link(
    command: Command, tuned: Path, out: Path, words: str, names: tuple[str, ...]
):
    assert run(command, words, tuned, out).returncode == 0
    before = {name: (out / name).stat().st_ino for name in names}
    backups = {name: out / f"{name}.backup" for name in names}
    for name, backup in backups.items():
        backup.hardlink_to(out / name)
    done = run(command, words, tuned, out)
    assert done.returncode == 0, done.stderr
    for name, backup in backups.items():
        assert (out / name).stat().st_ino != before[name] == backup.stat().st_ino
        (out / name).chmod(0o444)
        state = seen(out)
        done = run(command, words, tuned, out)
        assert f"{out / name}: is read-only; make it writable" in done.stderr
        assert seen(out) == state
        (out / name).unlink()
        (out / name).symlink_to(backup)
        state = seen(out)
        done = run(command, words, tuned, out)
        assert f"{out / name}: is a link" in done.stderr
        assert seen(out) == state
        (out / name).unlink()
        shutil.copy(backup, out / name)


def test_a_folder_within_that_is_a_link_is_not_written_through(
    command: Command, tuned: Path, out: Path, tmp_path: Path
):
    logs = tmp_path / "logs" / "day"
    logs.mkdir(parents=True)
    shutil.copy(tuned, logs / "drop.mcap")
    (out / "day").symlink_to(out / "theirs")
    before = seen(out)
    done = command("tunenet-tune", tmp_path / "logs", "-o", out)
    assert done.returncode == 1
    assert f"{out / 'day'}: is a link" in done.stderr
    assert seen(out) == before


def test_a_verdict_that_got_worse_is_said_and_an_unwanted_review_stays(
    command: Command, tuned: Path, out: Path
):
    (out / "drop.rrd").write_bytes(FOREIGN["rrd"])
    words = "tunenet-tune {log} -o {out} --no-review"
    assert run(command, words, tuned, out).returncode == 0
    done = run(command, f"{words} --end 0.6", tuned, out)
    assert f"{out / 'drop.json'}: was ok, 0.74000; is " in done.stderr
    assert "was " not in run(command, words, tuned, out).stderr
    assert (out / "drop.rrd").read_bytes() == FOREIGN["rrd"]


LOOP = """
import sys
from pathlib import Path
from tunenet_logs.writing.owned_path import OutputPlace, begins_with
place = OutputPlace(Path(sys.argv[1]), "text", begins_with(b"ours"))
print(flush=True)
while True:
    for letter in b"ab":
        with place.replacing() as partial, partial.open("wb") as file:
            file.write(b"ours")
            for _ in range(64):
                file.write(bytes([letter]) * 4096)
                file.flush()
"""


def test_a_kill_leaves_the_old_file_or_the_new_one(tmp_path: Path):
    path, rng = tmp_path / "a", random.Random(0)
    for _ in range(10):
        words = [sys.executable, "-c", LOOP, str(path)]
        with subprocess.Popen(words, stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.03))
            writer.send_signal(signal.SIGKILL)
        if path.exists():
            assert path.read_bytes() in (b"ours" + letter * 4096 * 64 for letter in (b"a", b"b"))
    assert path.exists()
