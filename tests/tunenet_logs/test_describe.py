"""`tunenet-logs info`: rates, gaps and the timeline in text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.strangers import Stranger, write_poses
from tunenet_logs.describe import describe, gaps_s
from tunenet_logs.reader import read_episode


def test_a_gap_is_seen_in_figures_and_on_the_timeline(tmp_path: Path):
    stamps, positions = Stranger(0.6, rate_hz=100, seconds=5.0).samples()
    keep = (np.arange(len(stamps)) < 200) | (np.arange(len(stamps)) >= 300)
    write_poses(tmp_path / "a.mcap", stamps[keep], positions[keep], "/ball")
    text = describe(tmp_path / "a.mcap", read_episode(tmp_path / "a.mcap"))
    assert "1 to 1.01 s" in text
    [line] = [one for one in text.splitlines() if one.startswith("  /ball |")]
    marks = line.split("|")[1]
    assert len(marks) == 60
    assert 8 <= marks.count(" ") <= 10
    assert marks.strip()[0] == marks.strip()[-1] == "#"
    assert "from 2023-11-14 22:13:20 UTC" in text


def test_a_log_with_one_message_or_none_is_described(tmp_path: Path):
    stamps, positions = Stranger(0.6).samples()
    for count in (0, 1):
        path = tmp_path / f"{count}.mcap"
        write_poses(path, stamps[:count], positions[:count])
        assert f"{count}" in describe(path, read_episode(path))


def test_even_samples_have_no_gap():
    assert not len(gaps_s(np.arange(100) * 10_000_000))
    assert not len(gaps_s(np.array([5])))
