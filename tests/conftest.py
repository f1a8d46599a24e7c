"""Shared fixtures: the commands as a user runs them, and one simulated log."""

from __future__ import annotations

import fcntl
import io
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from tests.wheel import install_wheel
from tunenet_logs import commands
from tunenet_logs.analysis.batch.logs import find_logs
from tunenet_logs.analysis.batch.run import Order, Result, Writing, run_batch
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop, simulate_drop
from tunenet_logs.recorders.simulators.known import ENGINES, simulated_by
from tunenet_logs.terminal import Progress

ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent

Command = Callable[..., subprocess.CompletedProcess[str]]
Made = Callable[[str, Callable[[Path], object]], Path]

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell's `&` has it for all it starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # and `nohup`, which what is started inherits
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def tune_all(
    logs: Sequence[Path],
    options: TuneOptions,
    folder: Path | None,
    jobs: int,
    progress: Progress,
    *,
    overwrite: bool = False,
    also: Callable[[Tuning], None] | None = None,
) -> list[Result]:
    """A few logs tuned without a ledger; the results in their order."""
    writing = Writing(overwrite=overwrite, also=also)
    found = find_logs(logs).logs
    return run_batch(Order(found, options, writing, folder, jobs=jobs), progress).results


settings.register_profile("suite", max_examples=50, deadline=None, derandomize=True)
settings.register_profile("thorough", max_examples=500, deadline=None)
settings.load_profile("suite")

# By a command's name, the module of its `main`.
MODULES = {f"tunenet-{verb}": module for verb, (module, _) in commands.VERBS.items()}
del MODULES["tunenet-docs"]  # a word after `tunenet` alone
COMMANDS = tuple(MODULES)


@pytest.fixture(scope="session")
def command() -> Command:
    """Call a command's `main` in this process: same words, exit code and output, no start-up."""

    def call(name: str, *arguments: object, cwd: Path | None = None):
        words = [str(one) for one in arguments]
        out, err = io.StringIO(), io.StringIO()
        with chdir(cwd or Path.cwd()), redirect_stdout(out), redirect_stderr(err):
            try:
                code = import_module(MODULES[name]).main(words)
            except SystemExit as stop:  # --help and --version
                code = int(stop.code or 0)
        return subprocess.CompletedProcess([name, *words], code, out.getvalue(), err.getvalue())

    return call


@pytest.fixture(scope="session")
def process() -> Command:
    """Run a console script as a user does, in a process of its own."""

    def run(name: str, *arguments: object, cwd: Path | None = None):
        words = [str(BIN / name), *(str(one) for one in arguments)]
        return subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=300)

    return run


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Make a file that is dear once, for all tests of all workers; nobody may change it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    folder = folder / "made"

    def make(name: str, write: Callable[[Path], object]) -> Path:
        folder.mkdir(exist_ok=True)
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            path = folder / name
            if not path.exists():
                (folder / "unfinished").mkdir(exist_ok=True)
                write(folder / "unfinished" / name)
                (folder / "unfinished" / name).rename(path)
        return path

    return make


def record(path: Path, **order: object) -> Path:
    """Simulate a drop and record it."""
    episode = simulate_drop(DropOrder(**order))  # type: ignore[arg-type]
    record_episode(episode, path, overwrite=False, progress=Progress(quiet=True))
    return path


def film(path: Path, picture: FilmOrder | None = None, **order: object) -> Path:
    """Simulate a drop, film it and record the pictures."""
    episode = film_drop(DropOrder(**order), picture or FilmOrder())  # type: ignore[arg-type]
    record_episode(episode, path, overwrite=False, progress=Progress(quiet=True))
    return path


def real(name: str) -> Path:
    """A recording that others made, of a real ball or camera; without it, the test is skipped."""
    path = ROOT.parent / "shared" / "real" / name
    if not path.exists():
        pytest.skip(
            f"needs the recording {name}, which others made and which is not part of the project"
        )
    return path


@contextmanager
def files_no_larger_than(limit: int) -> Iterator[None]:
    """Let no file of this process grow over so many bytes."""
    before, writes = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True  # what is imported meanwhile would be cut, and stay so
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        sys.dont_write_bytecode = writes
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="session")
def filmed_log(made: Made) -> Path:
    """A filmed drop of ours: restitution 0.7 from 1 m, 60 Hz, 3 s. Not to be changed."""
    order = {"restitution": 0.7, "height_m": 1.0, "seconds": 3.0, "hold_s": 0.3, "seed": 5}
    return made("filmed.mcap", lambda path: film(path, **order))


@pytest.fixture
def drop_log(tmp_path: Path) -> Path:
    """A log of ours: restitution 0.7 from 1 m."""
    return record(tmp_path / "drop.mcap", restitution=0.7, height_m=1.0)


@pytest.fixture(params=ENGINES)
def each_engine(request: pytest.FixtureRequest) -> Iterator[str]:
    """Every engine, one after another: what a test simulates without a choice is done by it."""
    name = request.param
    if find_spec(name) is None:
        pytest.skip(f"{name} is not installed: it has no wheels for this Python or platform")
    with simulated_by(name):
        yield name


@pytest.fixture(scope="session")
def installed(made: Made) -> Path:
    """The built wheel in a folder of its own, with the commands in `bin`. Not to be changed."""
    return made("site", install_wheel)
