"""A recording that is stopped by a signal ends whole."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Bar, Progress


class StopsAfter(Progress):
    """Sends a real signal to this process after so many samples."""

    def __init__(self, samples: int) -> None:
        super().__init__(quiet=True)
        self.left = samples

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
        yield self

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
        pass

    def update(self, done: int, /) -> None:
        self.left -= done
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGTERM)


def test_a_signal_ends_the_recording_cleanly(tmp_path: Path):
    episode = simulate_drop(DropOrder(seed=1))
    before = signal.getsignal(signal.SIGTERM)
    summary = record_episode(
        episode, tmp_path / "a.mcap", overwrite=False, progress=StopsAfter(100)
    )
    assert summary.ended
    assert summary.captured == summary.written == 100
    back = read_episode(tmp_path / "a.mcap")
    assert len(back.signals["/ball/pose"].values) == 100
    assert back.info.counts["written"] == 100
    assert "signal" in back.info.notes["ended"]
    assert not back.warnings
    assert signal.getsignal(signal.SIGTERM) is before
