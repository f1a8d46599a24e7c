"""Parquet: tables by name, LeRobot's episodes, and files that claim too much."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import real
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers import parquet as parquet_columns
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import jaco

pytestmark = pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is not installed")

T = np.arange(60) * 0.005
Z = 1 - 4.9 * T**2


def lerobot(folder: Path, *, version: int = 3) -> Path:
    """A data set of two episodes of three joints at 30 Hz."""
    name = "file-000.parquet" if version == 3 else "episode_000000.parquet"
    log = folder / "data" / "chunk-000" / name
    log.parent.mkdir(parents=True)
    frame = np.tile(np.arange(30), 2)
    table = {
        "observation.state": [np.array([n, 10 + n, 20 + n], np.float32) for n in range(60)],
        "action": [np.zeros(3, np.float32)] * 60,
        "timestamp": (frame / 30).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.repeat([0, 1], 30),
    }
    pd.DataFrame(table).to_parquet(log)
    names = ["pan.pos", "lift.pos", "gripper.pos"]
    features = {"observation.state": {"names": names if version == 3 else {"motors": names}}}
    info = {"fps": 30, "robot_type": "so101", "features": features}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return log


@pytest.mark.parametrize("version", [2, 3])
def test_episodes_of_a_lerobot_data_set(tmp_path: Path, version: int):
    episode = read_episode(lerobot(tmp_path, version=version))
    assert set(episode.signals) == {"observation.state.episode0", "observation.state.episode1"}
    signal = episode.signals["observation.state.episode1"]
    assert signal.columns == ("pan.pos", "lift.pos", "gripper.pos")
    assert signal.unit == ""
    assert signal.stamps_ns[29] == round(29e9 / 30)
    np.testing.assert_allclose(signal.values[0], [30, 40, 50])
    reasons = {channel.topic: channel.skipped for channel in episode.channels}
    assert "holds no torques as a rule" in (reasons["action"] or "")
    with pytest.raises(NotFoundError, match="holds no torques as a rule"):
        read_arm_log(episode, jaco())


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"fps": "x", "features": {}}'])
def test_a_damaged_description_of_a_data_set_is_said(tmp_path: Path, text: str):
    log = lerobot(tmp_path)
    (tmp_path / "meta" / "info.json").write_text(text)
    episode = read_episode(log)
    assert "meta/info.json is damaged: joints go by their numbers" in episode.warnings
    assert next(iter(episode.signals.values())).columns == ("joint1", "joint2", "joint3")


def test_nothing_outside_of_a_data_set_is_opened(tmp_path: Path):
    log = lerobot(tmp_path / "set")
    info = tmp_path / "set" / "meta" / "info.json"
    info.rename(tmp_path / "info.json")
    info.symlink_to(tmp_path / "info.json")
    assert any("no meta/info.json" in warning for warning in read_episode(log).warnings)


def test_a_data_set_names_a_file_to_read(tmp_path: Path):
    log = lerobot(tmp_path)
    with pytest.raises(LogError, match=f"is a LeRobot data set; name {log}"):
        read_episode(tmp_path)


def test_a_real_lerobot_episode():
    signals = read_episode(real("labs/lerobot_episode.parquet")).signals
    assert signals["observation.state"].values.shape == (479, 26)


def test_a_table_in_parquet(tmp_path: Path):
    pd.DataFrame({"time": T, "height_cm": Z * 100, "n": 1}).to_parquet(tmp_path / "a.parquet")
    signal = read_episode(tmp_path / "a.parquet").signals["track"]
    np.testing.assert_allclose(signal.values[:, 2], Z)
    assert signal.unit == "m"


def test_dates_of_an_index_are_times(tmp_path: Path):
    index = pd.date_range("2026-01-01", periods=60, freq="5ms")
    pd.DataFrame({"z": Z}, index=index).to_parquet(tmp_path / "a.parquet")
    stamps = read_episode(tmp_path / "a.parquet").signals["track"].stamps_ns
    assert stamps[1] - stamps[0] == 5_000_000
    assert stamps[0] == np.datetime64("2026-01-01", "ns").astype(int)


def test_lists_and_columns_within_columns(tmp_path: Path):
    poses = [{"position": {"x": 0.0, "y": 1.0, "z": z}} for z in Z]
    balls = [[0.0, 1.0, z] for z in Z]
    pd.DataFrame({"t": T, "ball": balls, "hand": poses}).to_parquet(tmp_path / "a.parquet")
    signals = read_episode(tmp_path / "a.parquet").signals
    np.testing.assert_allclose(signals["ball"].values, signals["hand"].values)
    said = ReadOptions(columns={"t": "t", "z": "ball[2]"})
    np.testing.assert_allclose(
        read_episode(tmp_path / "a.parquet", said).signals["track"].values[:, 2], Z
    )


def test_a_robots_columns_in_parquet(tmp_path: Path):
    table = {"timestamp": T} | {
        f"{stem}_{joint}": T + joint
        for stem in ("actual_q", "target_q", "target_moment")
        for joint in range(6)
    }
    pd.DataFrame(table).to_parquet(tmp_path / "a.parquet")
    episode = read_episode(tmp_path / "a.parquet")
    assert set(episode.signals) == {"joints.position"}


def test_a_page_that_unpacks_to_half_a_gigabyte_is_refused(tmp_path: Path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    ends = np.array([0, 2**29, 2**29, 2**29], np.int32)
    long = pa.StringArray.from_buffers(3, pa.py_buffer(ends), pa.py_buffer(b"x" * 2**29))
    table = pa.table({"t": [0.0, 1.0, 2.0], "z": [1.0, 2.0, 3.0], "name": long})
    log = tmp_path / "a.parquet"
    pq.write_table(table, log, compression="zstd", use_dictionary=False, write_statistics=False)
    assert log.stat().st_size < 1_000_000
    with pytest.raises(LogError, match="memory"):
        read_episode(log)


def test_more_rows_or_columns_than_any_log_has_are_refused(tmp_path: Path):
    pd.DataFrame({f"c{at}": [1] for at in range(5001)}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(LogError, match="has 5001 columns, over the limit of 5000"):
        read_episode(tmp_path / "a.parquet")
    pd.DataFrame({"t": np.zeros(2_000_001)}).to_parquet(tmp_path / "b.parquet")
    with pytest.raises(LogError, match="claims 2000001 rows"):
        read_episode(tmp_path / "b.parquet")


@pytest.mark.parametrize("cut", [4, 100, -1, -100])
def test_a_damaged_file_is_refused_in_one_line(tmp_path: Path, cut: int):
    pd.DataFrame({"time": T, "z": Z}).to_parquet(tmp_path / "a.parquet")
    (tmp_path / "a.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:cut])
    with pytest.raises(LogError, match="Parquet file that is not read: it is damaged") as refusal:
        read_episode(tmp_path / "a.parquet")
    assert "\n" not in str(refusal.value)


def test_without_pyarrow_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pd.DataFrame({"time": T, "z": Z}).to_parquet(tmp_path / "a.parquet")
    monkeypatch.setattr(parquet_columns, "find_spec", lambda _: None)
    with pytest.raises(LogError, match=r"pip install 'tunenet-logs\[tables\]'"):
        read_episode(tmp_path / "a.parquet")
