"""What ARCHITECTURE.md says to edit, edited: a toy of each kind joins by one entry of one table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tunenet_logs as tn
from tests.recorders.films import film
from tunenet_logs.analysis import registry
from tunenet_logs.analysis.checks import Check
from tunenet_logs.analysis.drop.experiments import DropFromPositions
from tunenet_logs.analysis.estimators.base import Estimator, FitResult, Problem, Step, Trace
from tunenet_logs.analysis.experiment import Claim
from tunenet_logs.formats import registry as formats
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.recorders.camera import sources
from tunenet_logs.recorders.camera.base import CapturedFrame, Source
from tunenet_logs.recorders.camera.device import VideoFile
from tunenet_logs.recorders.camera.sources import SourceOptions

RESTITUTION, GRAVITY_M_S2 = 0.8, 9.81


def drop(topic: str = "/ball/pose", *, sign: float = 1.0) -> tn.Episode:
    """An ideal ball let go from 1 m, 240 samples a second."""
    fall_s = math.sqrt(2 / GRAVITY_M_S2)
    begins_s, speeds_m_s = [-fall_s], [GRAVITY_M_S2 * fall_s]  # as if thrown to where it is let go
    while len(begins_s) < 30:
        begins_s.append(begins_s[-1] + 2 * speeds_m_s[-1] / GRAVITY_M_S2)
        speeds_m_s.append(RESTITUTION * speeds_m_s[-1])
    seconds = np.arange(480) / 240
    flight = np.searchsorted(begins_s, seconds, side="right") - 1
    since_s = seconds - np.array(begins_s)[flight]
    heights_m = np.array(speeds_m_s)[flight] * since_s - GRAVITY_M_S2 / 2 * since_s**2
    return tn.episode_of_positions(seconds, sign * heights_m, topic=topic)


def restitution(tuning: tn.Tuning) -> float:
    found = tuning.record.estimate("restitution")
    assert found is not None
    return float(np.ravel(found.value)[0])


def is_toy(start: Start) -> bool:
    return start.data.startswith(b"TOY1")


def read_toy(path: Path, _options: ReadOptions) -> tn.Episode:
    seconds, heights = np.frombuffer(path.read_bytes()[4:], "<f8").reshape(-1, 2).T
    return tn.episode_of_positions(seconds, heights)


def test_a_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A recogniser of the first bytes and a reader: one row of `formats.registry.EXPORTS`."""
    (signal,) = drop().signals.values()
    rows = np.column_stack((signal.seconds, signal.values[:, 2]))
    (tmp_path / "drop.toy").write_bytes(b"TOY1" + rows.tobytes())
    with pytest.raises(tn.LogError, match="is not an MCAP log"):
        tn.read_episode(tmp_path / "drop.toy")
    monkeypatch.setattr(formats, "EXPORTS", ((is_toy, read_toy), *formats.EXPORTS))
    tuning = tn.tune(tmp_path / "drop.toy")
    assert restitution(tuning) == pytest.approx(RESTITUTION, abs=0.002)


class Guess(Estimator):
    """The first guess, unchanged."""

    name = "guess"
    takes_steps = False

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        return Trace((Step(problem.initial, problem.rollouts),))


def test_an_estimator(monkeypatch: pytest.MonkeyPatch):
    """A subclass of `Estimator`: one row of `analysis.registry.METHODS`."""
    monkeypatch.setitem(registry.METHODS, "guess", f"{__name__}:Guess")
    tuning = tn.tune(drop(), method="guess")
    assert tuning.verdict != "ok"
    with pytest.raises(tn.UsageError, match="guess"):
        tn.tune(drop(), method="no such method")


class DropFromDepths(DropFromPositions):
    """A drop seen from above: depths below a sensor, which grow as the ball falls."""

    def claim(self, episode: tn.Episode, topic: str | None) -> Claim:
        return Claim.CERTAIN if "/depth" in episode.signals else Claim.NONE

    def detect(self, episode, selection, preset):
        depth = episode.signals["/depth"]
        upright = replace(depth, values=-depth.values)
        return super().detect(replace(episode, signals={"/depth": upright}), selection, preset)


def test_an_experiment(monkeypatch: pytest.MonkeyPatch):
    """Another way to observe a drop: one row of `analysis.registry.EXPERIMENTS`."""
    monkeypatch.setitem(registry.EXPERIMENTS, "drop-depth", f"{__name__}:DropFromDepths")
    tuning = tn.tune(drop("/depth", sign=-1.0))
    assert restitution(tuning) == pytest.approx(RESTITUTION, abs=0.002)


class CheckedDrop(DropFromPositions):
    """Drops with a check more."""

    def checks(self, detection, last: Step, fit: FitResult | None) -> tuple[Check, ...]:
        wanted = Check("it is Friday", False, "it is Saturday", advice="wait six days")
        return (*super().checks(detection, last, fit), wanted)


def test_a_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One `Check` more of an experiment: verdict, table, JSON and page follow."""
    assert tn.tune(drop()).verdict == "ok"
    monkeypatch.setitem(registry.EXPERIMENTS, "drop", f"{__name__}:CheckedDrop")
    tuning = tn.tune(drop())
    assert tuning.verdict == "suspect"
    assert tuning.reason
    assert "it is Friday" in tuning.reason
    tn.save_tuning(tuning, tmp_path / "drop.json")
    checks = json.loads((tmp_path / "drop.json").read_text())["checks"]
    assert {"name": "it is Friday", "passed": False} in [
        {"name": one["name"], "passed": one["passed"]} for one in checks
    ]


class Looped(VideoFile):
    """A camera that shows a video's first frames."""

    def frames(self) -> Iterator[CapturedFrame]:
        yield from list(super().frames())[:5]


def open_loop(text: str, wishes: SourceOptions) -> Source:
    return Looped(Path(text.removeprefix("loop:/")), wishes.filmed_hz)


def test_a_cameras_scheme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that opens a `Source`: one row of `recorders.camera.sources.OPENERS`."""
    (tmp_path / "a.mp4").write_bytes(film("mp4"))
    monkeypatch.setattr(sources, "OPENERS", {**sources.OPENERS, "loop": open_loop})
    source = sources.open_source(f"loop:/{tmp_path / 'a.mp4'}")
    assert len(list(source.frames())) == 5
