"""A signal ends a command with one line and nothing half written, from its first lines on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import tomllib
import wave
from pathlib import Path

import pytest

from tests.conftest import BIN, ROOT, record
from tunenet_logs.console import Parser, run
from tunenet_logs.reader import read_episode

SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
WORDS: dict[int, str] = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "hung up",
}

# Of all that is run here, `start` runs `main` of command.py as the command "it".
AS_IT = "import sys; from tunenet_logs.process import start; sys.exit(start('it', 'command'))"
RUN = """
from tunenet_logs.console import Parser, run
def main():
    return run(Parser("it", "", ""), body, [])
"""
SLOW_IMPORT = """
import os, sys
os.write(1, b"importing\\n")
sys.stdin.read()
def main():
    return 0
"""
SLOW_LIBRARY = """
import os, time
try:
    os.write(1, b"importing\\n")
    end = time.monotonic() + 1
    while time.monotonic() < end:
        time.sleep(0.01)
except KeyboardInterrupt:
    raise ImportError("as C code takes it")
"""
WITH_LIBRARY = f"""
{RUN}
def body(_):
    import slow_library, time
    time.sleep(60)
"""
DESTRUCTOR = f"""
import os, time
{RUN}
class Slow:
    def __del__(self):
        os.kill(os.getpid(), 15)
        time.sleep(0.1)
def body(_):
    Slow()
    time.sleep(90)
"""
# As Cython adds its own place to a traceback.
LOST_TRACEBACK = f"""
import os, time
{RUN}
def body(_):
    code = compile("os.kill(os.getpid(), 15)", "av/error.py", "exec")
    try:
        exec(code.replace(co_name="av.error.err_check"))
    except BaseException:
        pass
    time.sleep(5)
    return 0
"""
NOISY_LIBRARIES = """
import sys, cv2, numpy as np
def main():
    picture = bytearray(cv2.imencode(".png", np.ones((9, 9), np.uint8))[1].tobytes())
    picture[-20] ^= 1
    cv2.imdecode(np.frombuffer(bytes(picture), np.uint8), 1)
    np.float64(1e308) * np.float64(10)
    print("it: ours", file=sys.stderr)
    return 0
"""
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
DISTURBED = """
import os, sys
def stop(event, details):
    if event == "import" and details[0] == "argparse" and not done:
        done.append(1)
        os.kill(os.getpid(), {number})
done = []
sys.addaudithook(stop)
sys.argv = ["x", "--help"]
from {module} import {function}
sys.exit({function}())
"""
STOPPED_INSIDE = """
import os, signal, sys
from tunenet_logs.media import Mp4Claims

check, sent = Mp4Claims.check, []

def stopped(self, data):
    if not sent:
        sent.append(os.kill(os.getpid(), signal.SIGTERM))
    return check(self, data)

Mp4Claims.check = stopped
sys.argv = ["tunenet-logs", "import", "a.wav"]
from tunenet_logs.commands import logs
sys.exit(logs())
"""


def start(folder: Path, *words: str | Path, before: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*before, sys.executable, *words], cwd=folder, text=True,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and standard error of what ends by itself."""
    _, err = process.communicate(timeout=60)
    return process.returncode, err


def waiter(folder: Path, *words: str) -> subprocess.Popen[str]:
    (folder / "it.py").write_text(WAITER)
    process = start(folder, "it.py", *words)
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


# ---- From the first lines on


@pytest.mark.parametrize("number", WORDS)
@pytest.mark.parametrize("name", sorted(SCRIPTS.keys() - {"tunenet"}))  # that begins another
def test_each_command_ends_with_one_line(tmp_path: Path, name: str, number: int):
    module, function = SCRIPTS[name].split(":")
    code = DISTURBED.format(number=int(number), module=module, function=function)
    assert ended(start(tmp_path, "-c", code)) == (128 + number, f"{name}: {WORDS[number]}\n")


@pytest.mark.parametrize("number", WORDS)
def test_amid_the_import_of_a_library_it_is_no_error_of_the_library(tmp_path: Path, number: int):
    (tmp_path / "slow_library.py").write_text(SLOW_LIBRARY)
    (tmp_path / "command.py").write_text(WITH_LIBRARY)
    process = start(tmp_path, "-c", AS_IT)
    wait_for(process, "importing")
    process.send_signal(number)
    assert ended(process) == (128 + number, f"it: {WORDS[number]}\n")


@pytest.mark.parametrize("command", [DESTRUCTOR, LOST_TRACEBACK], ids=["destructor", "traceback"])
def test_one_that_would_be_swallowed_still_ends_the_command(tmp_path: Path, command: str):
    (tmp_path / "command.py").write_text(command)
    assert ended(start(tmp_path, "-c", AS_IT)) == (143, "it: terminated\n")


def test_nohup_is_heeded(tmp_path: Path):
    (tmp_path / "command.py").write_text(SLOW_IMPORT)
    process = start(tmp_path, "-c", AS_IT, before=("nohup",))
    wait_for(process, "importing")
    send(process, signal.SIGHUP)
    assert ended(process) == (0, "")


@pytest.mark.parametrize("number", WORDS)
def test_while_a_pool_starts(tmp_path: Path, number: int):
    logs = [ROOT / "sample_logs" / f"{name}.mcap" for name in ("bouncy", "dull", "noisy")]
    process = start(tmp_path, BIN / "tunenet-tune", *logs, "--jobs", "2", "-o", "out")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not children.read_text().split():  # the first is half started
        assert process.poll() is None
        time.sleep(0.001)
    process.send_signal(number)
    assert ended(process) == (128 + number, f"tunenet-tune: {WORDS[number]}\n")


def test_what_libraries_print_past_python_is_not_heard(tmp_path: Path):
    (tmp_path / "command.py").write_text(NOISY_LIBRARIES)
    assert ended(start(tmp_path, "-c", AS_IT)) == (0, "it: ours\n")
    assert "libpng" in ended(start(tmp_path, "-c", AS_IT, "--debug"))[1]


# ---- At work


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_second_one_does_not_break_off_what_is_cleaned_up(tmp_path: Path, number: int):
    process = waiter(tmp_path)
    send(process, number)
    wait_for(process, "cleaning up")
    process.terminate()
    process.terminate()
    assert ended(process) == (128 + number, f"it: {WORDS[number]}\n")
    assert (tmp_path / "cleaned").exists()


@pytest.mark.parametrize("are_at_work", [False, True])
def test_processes_that_work_for_it_end_too(tmp_path: Path, are_at_work: bool):
    process = waiter(tmp_path, "pool")
    wait_for(process, *(2 * ["at work" if are_at_work else "starting"]))
    send(process, signal.SIGTERM)
    code, err = ended(process)  # the workers hold these pipes as well
    if not are_at_work:  # one that was half started when its parent ended says so itself
        err = err.partition("Traceback")[0]
    assert (code, err) == (143, "it: terminated\n")


def test_inside_ffmpeg(tmp_path: Path):
    """FFmpeg calls Python to read; what is raised there it would print, and go on."""
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((1, 2, 48_000, 0, "NONE", ""))
        file.writeframes(bytes(2 * 48_000))
    process = start(tmp_path, "-c", STOPPED_INSIDE)
    assert ended(process) == (143, "tunenet-logs: terminated\n")
    assert [one.name for one in tmp_path.iterdir()] == ["a.wav"]


# ---- Amid a file


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    return record(path, restitution=0.8, height_m=1.0, seconds=10.0, rate_hz=2000.0)


def held_while_it_writes(tmp_path: Path, *words: str | Path) -> tuple[subprocess.Popen[str], Path]:
    for trial in range(20):  # a machine that is busy may look too late
        folder = tmp_path / str(trial)
        folder.mkdir()
        process = start(tmp_path, BIN / words[0], *words[1:], "-o", folder / "b.mcap")
        while not any(size_of(one) > 20_000 for one in folder.iterdir()):  # the first chunks
            assert process.poll() is None
            time.sleep(0.001)
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
        if not (folder / "b.mcap").exists():
            return process, folder
        process.send_signal(signal.SIGCONT)
        process.communicate(timeout=60)
    raise AssertionError("it was always quicker")


def size_of(path: Path) -> float:
    """Its bytes; without bound if it got its last name meanwhile."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return float("inf")


@pytest.mark.parametrize(
    ("verb", "number"), [("import", signal.SIGTERM), ("recover", signal.SIGINT)]
)
def test_a_copy_that_is_stopped_leaves_nothing(tmp_path: Path, long: Path, verb: str, number: int):
    process, folder = held_while_it_writes(tmp_path, "tunenet-logs", verb, long)
    process.send_signal(number)
    process.send_signal(signal.SIGCONT)
    assert ended(process) == (128 + number, f"tunenet-logs: {WORDS[number]}\n")
    assert not list(folder.iterdir())


def test_a_recording_that_is_stopped_ends_whole(tmp_path: Path):
    order = ["--simulate", "drop", "--rate", "5000", "--seconds", "10"]
    process, folder = held_while_it_writes(tmp_path, "tunenet-record", *order)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGCONT)
    assert ended(process) == (0, "")
    episode = read_episode(folder / "b.mcap")
    assert episode.info.notes["ended"] == "stopped by a signal"
    assert 0 < episode.info.counts["written"] < 50_000
    assert not episode.warnings


# ---- In a program that calls a command


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
