"""tunenet-record as a user runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop


def test_records_what_was_asked_for(process: Command, tmp_path: Path):
    result = process(
        "tunenet-record", "--simulate", "drop", "--restitution", 0.55, "--height", 1.4,
        "--radius", 0.02, "--rate", 120, "--seconds", 2, "--hold", 0.5, "-o", "a.mcap",
        cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "300 samples captured, 300 written, 0 dropped" in result.stdout
    episode = read_episode(tmp_path / "a.mcap")
    heights = episode.signals["/ball/pose"].values[:, 2]
    assert episode.signals["/ball/pose"].rate_hz == pytest.approx(120)
    assert np.all(heights[:60] == 1.42)
    assert heights[75] < 1.4
    assert episode.info.truth == {"restitution": 0.55, "restitution_slope": 0.0, "drag": 0.0}
    assert episode.info.rig == {"ball_diameter_m": 0.04, "drop_height_m": 1.4}
    assert episode.info.counts == {"captured": 300, "dropped": 0, "written": 300}


def test_refuses_to_overwrite(command: Command, drop_log: Path):
    before = drop_log.read_bytes()
    result = command("tunenet-record", "--simulate", "drop", "-o", drop_log)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "--overwrite" in result.stderr
    assert drop_log.read_bytes() == before


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--restitution", "-0.1"),
        ("--restitution", "1.01"),
        ("--restitution", "nan"),
        ("--height", "0"),
        ("--height", "inf"),
        ("--rate", "x"),
        ("--seed", "-1"),
    ],
)
def test_a_bad_value_is_one_line_that_names_it(
    command: Command, tmp_path: Path, option: str, value: str
):
    result = command("tunenet-record", "--simulate", "drop", f"{option}={value}", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert option in result.stderr
    assert value in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("source", [("--simulate", "drop"), ("--camera", "clip.mp4")])
@pytest.mark.parametrize("name", ["x.mp4", "x", "x.mcap.active", "x.MCAP"])
def test_a_log_is_not_named_like_something_else(
    command: Command, tmp_path: Path, source: tuple[str, str], name: str
):
    result = command("tunenet-record", *source, "-o", name, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert name in result.stderr
    assert f"name it {Path(name).with_suffix('.mcap')}" in result.stderr
    assert not list(tmp_path.iterdir())


def test_the_seed_draws_what_was_not_asked_for():
    first, second, other = (simulate_drop(DropOrder(seed=seed)) for seed in (4, 4, 5))
    assert first.info == second.info
    assert first.info.truth != other.info.truth
    assert 0.1 <= first.info.truth["restitution"] <= 0.95
    assert 0.3 <= first.info.rig["drop_height_m"] <= 5


def test_noise_is_what_was_asked_for():
    clean = simulate_drop(DropOrder(restitution=0.5, height_m=1.0))
    noisy = simulate_drop(DropOrder(restitution=0.5, height_m=1.0, noise_m=0.003))
    off = noisy.signals["/ball/pose"].values - clean.signals["/ball/pose"].values
    assert np.std(off) == pytest.approx(0.003, rel=0.1)


@needs_pybullet
def test_the_papers_preset_is_60_hz():
    assert simulate_drop(DropOrder(preset="paper")).signals["/ball/pose"].rate_hz == pytest.approx(
        60
    )
    with pytest.raises(UsageError, match="60 Hz"):
        simulate_drop(DropOrder(preset="paper", rate_hz=240))
