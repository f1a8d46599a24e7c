"""What all commands do about signals and numbers, in real processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import wave
from pathlib import Path

import pytest

from tests.conftest import BIN, ROOT, record
from tunenet_logs.console import Parser, run
from tunenet_logs.reader import read_episode

WAITER = """
import os, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tunenet_logs.console import Parser, run

def body(_):
    try:
        print("ready", flush=True)
        work()
    finally:
        print("cleaning up", flush=True)
        sys.stdin.read()  # what is cleaned up is not broken off by a second signal
        Path("cleaned").touch()

def work():
    time.sleep(100)

def pooled():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        list(pool.map(worker, range(6)))

def worker(number):
    os.write(1, b"at work\\n")
    time.sleep(100)

if __name__ == "__mp_main__":
    os.write(1, b"starting\\n")  # in one piece, whatever another writes

if __name__ == "__main__":
    if "pool" in sys.argv:
        work = pooled
    sys.exit(run(Parser("it", "", ""), body, []))
"""


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log that takes a moment to copy."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    return record(path, restitution=0.8, height_m=1.0, seconds=10.0, rate_hz=2000.0)


def start(folder: Path, *words: str) -> subprocess.Popen[str]:
    (folder / "it.py").write_text(WAITER)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "it.py", *words], cwd=folder, text=True, env=environment,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    wait_for(process, "ready")
    return process


def wait_for(process: subprocess.Popen[str], *words: str) -> None:
    """Wait until it has said all this, in whatever order."""
    assert process.stdout is not None
    missing = [f"{word}\n" for word in words]
    while missing:
        line = process.stdout.readline()
        assert line, missing
        if line in missing:
            missing.remove(line)


def send(process: subprocess.Popen[str], number: int) -> None:
    """Send a signal once it sleeps; Python sleeps through one that comes right before."""
    while Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "S":
        time.sleep(0.001)
    process.send_signal(number)


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")],
)
def test_a_signal_unwinds_and_is_one_line(tmp_path: Path, number: int, code: int, word: str):
    process = start(tmp_path)
    send(process, number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (code, f"it: {word}\n")
    assert (tmp_path / "cleaned").exists()


def test_a_second_sigterm_does_not_break_off_what_is_cleaned_up(tmp_path: Path):
    process = start(tmp_path)
    send(process, signal.SIGTERM)
    wait_for(process, "cleaning up")
    process.terminate()
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (143, "it: terminated\n")
    assert (tmp_path / "cleaned").exists()


@pytest.mark.parametrize("are_at_work", [False, True])
def test_processes_that_work_for_it_end_too(tmp_path: Path, are_at_work: bool):
    process = start(tmp_path, "pool")
    wait_for(process, *(2 * ["at work" if are_at_work else "starting"]))
    send(process, signal.SIGTERM)
    _, err = process.communicate(timeout=60)  # the workers hold these pipes as well
    if not are_at_work:  # one that was half started when its parent ended says so itself
        err = err.partition("Traceback")[0]
    assert (process.returncode, err) == (143, "it: terminated\n")


@pytest.mark.parametrize("verb", ["import", "recover"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_copy_that_is_stopped_leaves_nothing(tmp_path: Path, long: Path, verb: str, number: int):
    process, folder = held_while_it_writes(tmp_path, [BIN / "tunenet-logs", verb, long])
    process.send_signal(number)
    process.send_signal(signal.SIGCONT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (143 if number == signal.SIGTERM else 130)
    assert err.count("\n") == 1
    assert not list(folder.iterdir())


def held_while_it_writes(
    tmp_path: Path, words: list[str | Path]
) -> tuple[subprocess.Popen[str], Path]:
    """A command that is amid its file, stopped where it is."""
    for trial in range(20):  # a machine that is busy may look too late
        folder = tmp_path / str(trial)
        folder.mkdir()
        order = [*words, "-o", folder / "b.mcap"]
        process = subprocess.Popen(order, stderr=subprocess.PIPE, text=True)
        while not has_begun(folder):
            assert process.poll() is None
            time.sleep(0.001)
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
        if not (folder / "b.mcap").exists():
            return process, folder
        process.send_signal(signal.SIGCONT)
        process.communicate(timeout=60)
    raise AssertionError("it was always quicker")


def has_begun(folder: Path) -> bool:
    """Whether the first chunks are there."""
    try:
        return any(one.stat().st_size > 20_000 for one in folder.iterdir())
    except FileNotFoundError:  # it got its last name meanwhile
        return True


def test_a_recording_still_ends_whole(tmp_path: Path):
    order = ["--simulate", "drop", "--rate", "5000", "--seconds", "10"]
    process, folder = held_while_it_writes(tmp_path, [BIN / "tunenet-record", *order])
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGCONT)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    episode = read_episode(folder / "b.mcap")
    assert episode.info.notes["ended"] == "stopped by a signal"
    assert 0 < episode.info.counts["written"] < 50_000
    assert not episode.warnings


def test_a_handler_of_someone_else_stays():
    seen: list[int] = []

    def mine(number: int, _frame: object) -> None:
        seen.append(number)

    def body(_arguments: object) -> int:
        os.kill(os.getpid(), signal.SIGTERM)
        return 0

    before = signal.signal(signal.SIGTERM, mine)
    try:
        assert run(Parser("it", "", ""), body, []) == 0
        assert signal.getsignal(signal.SIGTERM) is mine
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIGTERM]


def test_afterwards_sigterm_is_what_it_was(capsys: pytest.CaptureFixture[str]):
    def body(_arguments: object) -> int:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10)
        return 0

    before = signal.getsignal(signal.SIGTERM)
    assert before is signal.SIG_DFL
    assert run(Parser("it", "", ""), body, []) == 143
    assert signal.getsignal(signal.SIGTERM) is before
    assert capsys.readouterr().err == "it: terminated\n"


STOPPED_INSIDE = """
import os, signal, sys
from tunenet_logs.media import Mp4Claims

check, sent = Mp4Claims.check, []

def stopped(self, data):
    if not sent:
        sent.append(os.kill(os.getpid(), signal.SIGTERM))
    return check(self, data)

Mp4Claims.check = stopped
from tunenet_logs.commands import logs
sys.exit(logs())
"""


def test_a_signal_inside_ffmpeg_is_one_line(tmp_path: Path):
    """FFmpeg calls Python to read; what is raised there it would print, and go on."""
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((1, 2, 48_000, 0, "NONE", ""))
        file.writeframes(bytes(2 * 48_000))
    words = [sys.executable, "-c", STOPPED_INSIDE, "import", "a.wav"]
    done = subprocess.run(
        words,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (143, "tunenet-logs: terminated\n")
    assert [one.name for one in tmp_path.iterdir()] == ["a.wav"]
