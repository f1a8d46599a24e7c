"""From a command's first lines on, a signal ends it with one line, and libraries say nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import ROOT

ENTRY = "import sys; from {0} import {1}; sys.exit({1}())"
SLOW_IMPORT = """
import os, time
os.write(1, b"importing\\n")
time.sleep({0})
def main():
    import slow_library
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
# Runs `main` of command.py as the command "it".
AS_IT = "import sys; from tunenet_logs.process import start; sys.exit(start('it', 'command'))"

WORDS: dict[int, str] = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "hung up",
}


def start(folder: Path, code: str, *, ignored: int = 0) -> subprocess.Popen[str]:
    def prepare() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if ignored:
            signal.signal(ignored, signal.SIG_IGN)

    return subprocess.Popen(
        [sys.executable, "-c", code], cwd=folder, text=True, preexec_fn=prepare,  # noqa: PLW1509
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def ended(folder: Path, command: str, code: str = AS_IT) -> tuple[int, str]:
    """Exit code and standard error of a command that ends by itself."""
    (folder / "command.py").write_text(command)
    process = start(folder, code)
    _, err = process.communicate(timeout=60)
    return process.returncode, err


def wait_for(process: subprocess.Popen[str], line: str) -> None:
    assert process.stdout is not None
    assert process.stdout.readline() == f"{line}\n"


@pytest.mark.parametrize("number", WORDS)
def test_a_signal_while_a_command_is_imported_is_one_line(tmp_path: Path, number: int):
    (tmp_path / "slow_command.py").write_text(SLOW_IMPORT.format(60))
    code = "from tunenet_logs.process import start; start('it', 'slow_command')"
    process = start(tmp_path, code)
    wait_for(process, "importing")
    time.sleep(0.05)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + number, f"it: {WORDS[number]}\n")


@pytest.mark.parametrize("number", WORDS)
def test_a_signal_amid_a_library_s_import_is_no_error_of_the_library(tmp_path: Path, number: int):
    (tmp_path / "slow_library.py").write_text(SLOW_LIBRARY)
    (tmp_path / "command.py").write_text(
        "from tunenet_logs.console import Parser, run\n"
        "def body(_):\n    import slow_library, time\n    time.sleep(60)\n    return 0\n"
        "def main():\n    return run(Parser('it', '', ''), body, [])\n"
    )
    process = start(tmp_path, AS_IT)
    wait_for(process, "importing")
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + number, f"it: {WORDS[number]}\n")


def test_a_signal_that_a_destructor_would_swallow_still_ends_the_command(tmp_path: Path):
    command = (
        "import os, time\n"
        "from tunenet_logs.console import Parser, run\n"
        "class Slow:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), 15)\n        time.sleep(0.1)\n"
        "def body(_):\n    Slow()\n    time.sleep(90)\n    return 0\n"
        "def main():\n    return run(Parser('it', '', ''), body, [])\n"
    )
    assert ended(tmp_path, command) == (143, "it: terminated\n")


def test_nohup_is_heeded(tmp_path: Path):
    (tmp_path / "slow_command.py").write_text(SLOW_IMPORT.format(1) + "    return 0\n")
    (tmp_path / "slow_library.py").write_text("")
    code = (
        "import sys; from tunenet_logs.process import start; sys.exit(start('it', 'slow_command'))"
    )
    process = start(tmp_path, code, ignored=signal.SIGHUP)
    wait_for(process, "importing")
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")


@pytest.mark.parametrize("number", WORDS)
def test_a_signal_while_a_pool_starts_is_one_line(tmp_path: Path, number: int):
    logs = [str(ROOT / "sample_logs" / f"{name}.mcap") for name in ("bouncy", "dull", "noisy")]
    code = f"import sys; sys.argv[1:] = {[*logs, '--jobs', '2', '-o', 'out']!r}; "
    code += ENTRY.format("tunenet_logs.commands", "tune")
    process = start(tmp_path, code)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not children.read_text().split():  # the first is half started
        assert process.poll() is None
        time.sleep(0.001)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + number, f"tunenet-tune: {WORDS[number]}\n")


def test_what_libraries_print_past_python_is_not_heard(tmp_path: Path):
    command = (
        "import os, sys\nimport cv2, numpy as np\n"
        "def main():\n"
        "    picture = bytearray(cv2.imencode('.png', np.ones((9, 9), np.uint8))[1].tobytes())\n"
        "    picture[-20] ^= 1\n"
        "    cv2.imdecode(np.frombuffer(bytes(picture), np.uint8), 1)\n"
        "    np.float64(1e308) * np.float64(10)\n"
        "    print('it: ours', file=sys.stderr)\n    return 0\n"
    )
    assert ended(tmp_path, command) == (0, "it: ours\n")
    assert (
        "libpng" in ended(tmp_path, command, f"import sys; sys.argv.append('--debug'); {AS_IT}")[1]
    )
