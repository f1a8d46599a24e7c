"""Shared fixtures: the commands as a user runs them, and one simulated log."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from recorders.filmed_drop import FilmOrder, film_drop
from recorders.session import record_episode
from recorders.simulated_drop import DropOrder, simulate_drop
from tunenet_logs.progress import Progress

ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def command() -> Command:
    """Run a console script in a process of its own."""

    def run(name: str, *arguments: object, cwd: Path | None = None):
        words = [str(BIN / name), *(str(one) for one in arguments)]
        return subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=300)

    return run


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
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="session")
def filmed_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A filmed drop of ours: restitution 0.7 from 1 m, 60 Hz, 3 s."""
    path = tmp_path_factory.mktemp("film") / "filmed.mcap"
    return film(path, restitution=0.7, height_m=1.0, seconds=3.0, hold_s=0.3, seed=5)


@pytest.fixture
def drop_log(tmp_path: Path) -> Path:
    """A log of ours: restitution 0.7 from 1 m."""
    return record(tmp_path / "drop.mcap", restitution=0.7, height_m=1.0)
