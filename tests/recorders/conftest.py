"""`tunenet-record` in a folder of its own: what it says, and what it refuses."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Command

Record = Callable[..., subprocess.CompletedProcess[str]]
Refuses = Callable[..., str]


@pytest.fixture
def record(command: Command, tmp_path: Path) -> Record:
    """The command in this process, in the test's folder; it has to succeed, and leaves no trace."""

    def call(*words: object) -> subprocess.CompletedProcess[str]:
        before = signal.getsignal(signal.SIGTERM)
        done = command("tunenet-record", *words, cwd=tmp_path)
        assert done.returncode == 0, (done, words)
        assert signal.getsignal(signal.SIGTERM) is before
        return done

    return call


@pytest.fixture
def refuses(command: Command, tmp_path: Path) -> Refuses:
    """Check that words are refused in one line with what it must hold, and nothing is written."""

    def check(code: int, *words: object, says: str | tuple[str, ...] = ()) -> str:
        before = sorted(tmp_path.rglob("*"))
        done = command("tunenet-record", *words, cwd=tmp_path)
        said = done.stderr
        assert (done.returncode, done.stdout, said.count("\n")) == (code, "", 1), (done, words)
        for one in (says,) if isinstance(says, str) else says:
            assert one in said, (one, said)
        assert sorted(tmp_path.rglob("*")) == before
        return said

    return check
