"""Campaigns that tests make: drops of ours with their tunings, and outcomes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from tests.conftest import record
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Signal
from tunenet_logs.outcomes import Outcome, write_outcome
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress

START_NS = 1_800_000_000_000_000_000
MINUTE_NS = 60_000_000_000


def drop(path: Path, restitution: float = 0.7, *, is_bad: bool = False) -> Path:
    """A log of a drop, with its tuning beside it; a bad one ends in the fall."""
    record(path, restitution=restitution, height_m=0.8, seconds=0.35 if is_bad else 2.0)
    tune(path)
    return path


def drop_at(path: Path, stamp_ns: int) -> Path:
    """The same, recorded at a time of the wall clock."""
    episode = simulate_drop(DropOrder(restitution=0.7, height_m=0.8, seconds=2.0))
    moved = {
        name: Signal(name, one.stamps_ns + stamp_ns, one.values, one.columns, one.unit)
        for name, one in episode.signals.items()
    }
    quiet = Progress(quiet=True)
    record_episode(replace(episode, signals=moved), path, overwrite=False, progress=quiet)
    tune(path)
    return path


def tune(path: Path) -> None:
    """Write a log's tuning beside it."""
    path.with_suffix(".json").write_text(to_json(record_of(tune_log(path, TuneOptions()))))


def told(path: Path, **changes: object) -> None:
    """Change what a tuning says."""
    before = json.loads(path.read_text())
    path.write_text(json.dumps({**before, **changes}))


def outcome(folder: Path, number: int, ball: str = "gel", **said: object) -> Path:
    """Write an outcome, a minute after the one before."""
    values = {
        "task": "bounce-shot",
        "ball": ball,
        "attempt": number,
        "success": True,
        "stamp_ns": START_NS + number * MINUTE_NS,
        **said,
    }
    return write_outcome(folder, Outcome(**values))  # type: ignore[arg-type]
