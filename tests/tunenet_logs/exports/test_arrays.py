"""Arrays of NumPy, MATLAB, HDF5, Arrow, Parquet, PyTorch, Rerun, ULog; records in JSON.

They are read by their names, bounded, and nothing in them is executed.
"""

from __future__ import annotations

import json
import pickle
import re
import shutil
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest

import tunenet_logs as tn
from tests.hostile_files import npy_head
from tests.library_writers import (
    ARMS,
    ARRAYS,
    DROPS,
    RESTITUTION,
    drop,
    joints,
    write_hdf5,
    write_ulog,
)
from tests.reading import one, read, refusal, skipped, tuned
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.registry import file_bytes, is_log_folder
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import jaco

T = np.arange(100) * 0.005
Z = 1 - 4.9 * T**2
BALL = np.column_stack([0 * T, 0 * T + 1, Z])
Q = T[:, None] + np.arange(7)
Arrays = dict[str, Any]
KINDS = [name for name in ARRAYS if not name.endswith(("csv", "xlsx"))]
needs_pyarrow = pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is missing")


every_kind = pytest.mark.parametrize("name", KINDS)


@pytest.mark.parametrize("name", [name for name in KINDS if name != "a.parquet"])
def test_arrays_by_their_names(tmp_path: Path, name: str):
    signal = read(tmp_path / name, {"t": T, "ball": BALL}).signals["ball"]
    np.testing.assert_allclose(signal.values, BALL, atol=1e-12)
    assert (signal.stamps_ns[1], signal.unit, signal.is_position) == (5_000_000, "", True)
    episode = read(tmp_path / name, {"time": T, "q": Q, "tau": Q + 10, "q_des": Q + 20})
    assert set(episode.signals) == {"joints.position", "joints.effort", "commands.position"}
    np.testing.assert_allclose(episode.signals["joints.effort"].values, Q + 10)
    np.testing.assert_allclose(episode.signals["commands.position"].values, Q + 20)


@every_kind
def test_what_a_user_names(tmp_path: Path, name: str):
    path = tmp_path / name
    signal = one(path, {"a": T * 1e3, "b": BALL}, "t=a,z=b[2]", length_unit="mm")
    np.testing.assert_allclose(signal.values[:, 2], Z * 1e-3, atol=1e-12)
    assert signal.unit == "m"
    told = refusal(path, columns="t=a,z=c")
    assert "has no column 'c'; its columns are 'a', 'b" in told
    signal = one(path, {"hits": T + 1, "z": Z}, "times=hits")
    assert (signal.columns, signal.unit, set(signal.values[:, 0])) == (("impact",), "1", {1.0})
    assert signal.stamps_ns[0] == 1_000_000_000


NO_TIMES = {"ball": BALL, "fps": 200.0, "picture": np.zeros((4, 5, 3))}


def test_names_say_units_rates_and_what_is_no_place(tmp_path: Path):
    path = tmp_path / "a.npz"
    signal = one(path, {"t_ms": T * 1e3, "ball_mm": BALL * 1e3})
    assert (signal.name, signal.unit, signal.stamps_ns[1]) == ("ball", "m", 5_000_000)
    np.testing.assert_allclose(signal.values, BALL)
    assert one(path, {"ball": BALL}).counts_frames
    signal = one(path, NO_TIMES)
    assert (signal.counts_frames, signal.stamps_ns[1]) == (False, 5_000_000)
    episode = read(path, {"t": T, "position": BALL, "velocity": BALL, "forces": BALL})
    assert list(episode.signals) == ["track"]
    assert "it is no position" in set(skipped(episode).values())
    signal = one(path, {"ts": T, "x_list": Z, "zs": Z})  # lists of a script
    np.testing.assert_allclose(signal.values, np.column_stack([Z, 0 * Z, Z]))


def test_an_array_without_names_wants_numbers(tmp_path: Path):
    path = tmp_path / "a.npy"
    np.save(path, np.column_stack([T, Z]))
    assert "(100 x 2) whose columns have no names" in refusal(path)
    assert "t=1,z=2" in refusal(path)
    np.testing.assert_allclose(one(path, None, "t=1,z=2").values[:, 2], Z)


def test_objects_are_never_unpickled(tmp_path: Path):
    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "gone off",))

    bomb = np.array([Bomb()], object)
    assert "never unpickled" in skipped(read(tmp_path / "a.npz", {"t": T, "z": Z, "b": bomb}))["b"]
    np.save(tmp_path / "b.npy", bomb)
    assert "never unpickled" in refusal(tmp_path / "b.npy")
    with zipfile.ZipFile(tmp_path / "b.pt", "w") as archive:
        archive.writestr("b/data.pkl", pickle.dumps(Bomb()))
        archive.writestr("b/version", "3")
    if find_spec("torch"):
        import torch

        torch.save({"t": torch.zeros(9), "bomb": Bomb()}, tmp_path / "a.pt")
        assert "objects are never unpickled; save its tensors alone" in refusal(tmp_path / "a.pt")
        assert "file of PyTorch" in refusal(tmp_path / "b.pt")
    assert not (tmp_path / "gone off").exists()


def packed_zeros(name: str) -> Callable[[Path], object]:
    zeros = np.zeros(6_000_000)
    return lambda path: ARRAYS[name](path, {"t": zeros, "y": zeros, "z": zeros})


def claimed_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("t", (2**33,), "f8", chunks=(2**10,), compression="gzip")


def wide_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for number in range(5001):
            file.create_dataset(f"x{number}", data=0)


def half_a_gigabyte(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    ends = np.array([0, 2**29, 2**29, 2**29], np.int32)
    long = pa.StringArray.from_buffers(3, pa.py_buffer(ends), pa.py_buffer(b"x" * 2**29))
    table = pa.table({"t": [0.0, 1.0, 2.0], "z": [1.0, 2.0, 3.0], "name": long})
    pq.write_table(table, path, compression="zstd", use_dictionary=False, write_statistics=False)
    assert path.stat().st_size < 1_000_000


@pytest.mark.parametrize(
    ("name", "make", "says"),
    [
        ("a.npy", lambda _: npy_head(10**12, 2), "bytes are claimed, and not there"),
        ("a.npz", packed_zeros("b.npz"), "limit"),
        ("a.mat", packed_zeros("b.mat"), "limit"),
        ("a.mat", lambda _: b"anything else", "it is no MATLAB file, despite its name; save it wi"),
        ("a.mat", lambda _: b"MATLAB 7.3 MAT-file".ljust(600), "is a MATLAB file that is not read"),
        ("a.h5", claimed_hdf5, "over the limit of 128 MiB of numbers"),
        ("a.h5", wide_hdf5, ""),
        ("a.parquet", half_a_gigabyte, "memory"),
        ("a.parquet",
         lambda path: pd.DataFrame(np.ones((1, 5001))).add_prefix("c").to_parquet(path),
         "has 5001 columns, over the limit of 5000"),
        ("a.parquet", lambda path: pd.DataFrame({"t": np.zeros(2_000_001)}).to_parquet(path),
         "claims 2000001 rows"),
        *(("a.json", lambda _, text=text: text.encode(), "") for text in (
            '{"k":[' + "[]," * 4_000_000, "[1,2", "{}", '{"a":1}',
            "{" + ",".join(f'"c{n}":1' for n in range(20_000)) + '}\n{"c1":2}')),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_refusals(tmp_path: Path, name: str, make: Callable[[Path], object], says: str):
    if name == "a.parquet":
        pytest.importorskip("pyarrow")
    made = make(tmp_path / name)
    if isinstance(made, bytes):
        (tmp_path / name).write_bytes(made)
    assert says in refusal(tmp_path / name)


def test_structs_are_read_by_joined_names(tmp_path: Path):
    run = {"time": T, "height_cm": Z * 100, "inner": {"note": "abc"}}
    episode = read(tmp_path / "a.mat", {"run": run, "cells": np.array([1, "a"], object)})
    np.testing.assert_allclose(episode.signals["run"].values[:, 2], Z)
    assert skipped(episode) == {"run.inner.note": "text", "cells": "a cell array"}


def test_records_are_things_of_their_own_and_times_keep_their_digits(tmp_path: Path):
    rows = [
        {"time": f"{at:.9f}", "ball": {"position": {"x": 0, "y": 1, "z": z}, "spin": [1, 2, 3]}}
        for at, z in zip(1.7e9 + T, Z, strict=True)
    ]
    signal = read(tmp_path / "a.jsonl", "\n".join(map(json.dumps, rows))).signals["ball"]
    np.testing.assert_allclose(signal.values[:, 2], Z)
    text = "\n".join(f'{{"t": 1700000000.12345678{n}, "z": {n}}}' for n in range(5))
    exact = [1_700_000_000_123_456_780 + n for n in range(5)]
    assert one(tmp_path / "b.jsonl", text).stamps_ns.tolist() == exact
    text = '{"t":0,"z":1}\n{"t":1,"z":1}\n{"t":2,"z"'  # breaks off
    episode = read(tmp_path / "c.jsonl", text)
    assert len(episode.signals["track"].stamps_ns) == 2
    assert "value 3 is no JSON" in episode.losses[0]


def test_things_in_one_list_are_never_woven_together(tmp_path: Path):
    rows = [{"t": at, "id": n, "x": n, "z": at} for at in T.tolist() for n in (3, 4)]
    signals = read(tmp_path / "c.json", json.dumps({"made_by": "us", "rows": rows})).signals
    things = {name: set(one.values[:, 0]) for name, one in signals.items()}
    assert things == {"track.object3": {3.0}, "track.object4": {4.0}}
    paths = [{"points": [{"t": at, "x": n, "y": at} for at in T.tolist()]} for n in range(3)]
    runs = read(tmp_path / "d.json", json.dumps({"paths": paths})).signals
    assert set(runs) == {"track.run1", "track.run2", "track.run3"}


@pytest.mark.parametrize("name", DROPS)
def test_a_drop_is_tuned_and_a_cut_file_is_one_line(tmp_path: Path, name: str):
    if name.endswith(".pt"):
        pytest.importorskip("torch")
    path = tmp_path / name
    DROPS[name](path)
    (signal,) = read_episode(path).signals.values()
    np.testing.assert_allclose(signal.values, drop()[1], atol=1e-6)
    np.testing.assert_allclose(np.diff(signal.stamps_ns), 1e9 / 240, atol=1000)
    assert tuned(path) == pytest.approx(RESTITUTION, abs=1e-3)
    if name == "plain.h5":  # a review gives what was observed
        tn.review(tn.tune(path), tmp_path / "a.rrd")
        again = tn.tune(tmp_path / "a.rrd").estimate
        assert again is not None
        assert again[0] == pytest.approx(RESTITUTION, abs=1e-3)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    if name == "drop.ulg":  # what is before the cut is read
        assert read_episode(path).losses == ("is damaged: messages in it are missing",)
    else:
        refusal(path)


@pytest.mark.parametrize("name", ARMS)
def test_joints_of_an_arm(tmp_path: Path, name: str):
    path = tmp_path / name
    ARMS[name](path)
    if name.startswith("aloha"):
        assert "nothing says when; say --columns t=NAME or --fps RATE" in refusal(path)
    episode = read(path, fps=50.0 if name.startswith("aloha") else None)
    run = "demo_0." if name.startswith("robomimic") else ""
    for quantity, values in zip(("position", "velocity", "effort"), joints()[1:], strict=True):
        signal = episode.signals[f"joints.{run}{quantity}"]
        np.testing.assert_allclose(signal.values, values)
        np.testing.assert_array_equal(signal.stamps_ns, np.arange(200) * 20_000_000)
    if run:  # demonstrations are runs in order
        names = [name for name in episode.signals if name.endswith("effort")]
        assert names == [f"joints.demo_{number}.effort" for number in (0, 1, 10)]
        last = episode.signals["joints.demo_10.position"].values
        np.testing.assert_allclose(last, joints(10)[1])
        assert "obs.agentview_image.demo_0" in skipped(episode)


@pytest.mark.parametrize("name", ["a.npz", "a.json"])
def test_a_list_of_names_is_of_the_joints_beside_it(tmp_path: Path, name: str):
    """Two or three columns of positions would be a place otherwise."""
    places = np.sin(np.add.outer(4 * T, [0.0, 1.0]))
    arrays = {"time": T, "positions": places, "commands": places + 0.01}
    signals = read(tmp_path / name, {"joint_names": ["hip", "knee"], **arrays}).signals
    assert set(signals) == {"joints.position", "commands.position"}
    assert {one.columns for one in signals.values()} == {("hip", "knee")}
    np.testing.assert_allclose(signals["joints.position"].values, places)


def test_data_sets_in_groups_are_named_by_their_paths(tmp_path: Path):
    times, places = drop()
    write_hdf5(tmp_path / "a.h5", {"lab/clock": times, "lab/wand": places, "note": b"red"})
    dotted, slashed, short = (
        ("lab.clock", "lab.wand"),
        ("/lab/clock", "lab/wand"),
        ("clock", "wand"),
    )
    for clock, wand in (dotted, slashed, short):
        signal = one(tmp_path / "a.h5", None, f"t={clock},z={wand}[2]")
        np.testing.assert_allclose(signal.values[:, 2], places[:, 2])


def test_nothing_outside_of_an_hdf5_file_is_read(tmp_path: Path):
    times, places = drop()
    write_hdf5(tmp_path / "other.h5", {"z": places[:, 2]})
    (tmp_path / "raw").write_bytes(places[:, 2].tobytes())
    size = (len(times),)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = times
        file["x"] = places[:, 0]
        file["external"] = h5py.ExternalLink("other.h5", "z")
        file["soft"] = h5py.SoftLink("/x")
        file["loop"] = file["/"]
        layout = h5py.VirtualLayout(size, "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "z", size)
        file.create_virtual_dataset("z", layout)
        raw = [(str(tmp_path / "raw"), 0, len(times) * 8)]
        file.create_dataset("y", size, "f8", external=raw)
    told = refusal(tmp_path / "a.h5", columns="t=t,z=z")
    assert "has no column 'z'; its columns are 't', 'x'" in told


def test_topics_of_an_autopilot_keep_their_own_times(tmp_path: Path):
    times = np.arange(100) * 10_000
    place = {"timestamp": times, "x": times, "y": times, "z": -times}
    other = {"timestamp": times[::2], "x": times[::2], "z": times[::2]}
    path = tmp_path / "a.ulg"
    write_ulog(path, {"vehicle_local_position": place, "other_position": other})
    signals = read_episode(path).signals.values()
    assert sorted(len(one.stamps_ns) for one in signals) == [50, 100]
    assert {int(np.diff(one.stamps_ns)[0]) for one in signals} == {10**7, 2 * 10**7}
    others = {f"sensor{number}": {"timestamp": times[:2], "x": times[:2]} for number in range(220)}
    write_ulog(path, {**others, "vehicle_local_position": place})
    episode = read_episode(path)
    assert list(episode.signals) == ["track.vehicle_local_position"]
    assert len(skipped(episode)) == 220


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
    (folder / "meta").mkdir()
    info = {"fps": 30, "robot_type": "so101", "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return log


@needs_pyarrow
@pytest.mark.parametrize("version", [2, 3])
def test_episodes_of_a_lerobot_data_set(tmp_path: Path, version: int):
    log = lerobot(tmp_path, version=version)
    episode = read_episode(log)
    assert set(episode.signals) == {
        f"{topic}.episode{number}{quantity}"
        for number in (0, 1)
        for topic, quantity in (
            *(("observation.state", ".position"), ("observation.state.gripper", ".position")),
            ("action", ""),
        )
    }
    signal = episode.signals["observation.state.episode1.position"]
    assert (signal.columns, signal.unit, signal.drives) == (("pan", "lift"), "", False)
    assert signal.stamps_ns[29] == round(29e9 / 30)
    np.testing.assert_allclose(signal.values[0], [30, 40])
    gripper = episode.signals["observation.state.gripper.episode1.position"]
    assert (gripper.columns, gripper.unit) == (("gripper",), "%")
    np.testing.assert_allclose(gripper.values[0], 0.0)  # 50 of 0 to 100: the middle
    assert episode.signals["action.episode0"].drives
    assert any("say --angle-unit" in words for words in episode.warnings)
    with pytest.raises(NotFoundError, match="no joint torques"):
        read_arm_log(episode, jaco())
    said = read_episode(log, ReadOptions(angle_unit="deg"))
    signal = said.signals["observation.state.episode1.position"]
    assert signal.unit == "rad"
    np.testing.assert_allclose(signal.values[0], np.radians([30, 40]))
    whole = read_episode(tmp_path)
    assert whole.signals.keys() == episode.signals.keys()
    assert is_log_folder(tmp_path)
    assert file_bytes(tmp_path) > log.stat().st_size


@needs_pyarrow
def test_a_data_set_of_several_files_is_one_log(tmp_path: Path):
    """Of version 2 each episode has its own file, of version 3 many share some."""
    log = lerobot(tmp_path, version=2)
    whole = read_episode(tmp_path)
    rows = pd.read_parquet(log)
    for number in (0, 1):
        file = log.with_name(f"episode_00000{number}.parquet")
        rows[rows.episode_index == number].to_parquet(file)
    again = read_episode(tmp_path)
    for name, signal in whole.signals.items():
        np.testing.assert_array_equal(again.signals[name].values, signal.values)
        np.testing.assert_array_equal(again.signals[name].stamps_ns, signal.stamps_ns)
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(LogError, match=re.escape(f"{file}: Parquet file that is not read")):
        read_episode(tmp_path)
    rows.drop(columns="action").to_parquet(file)
    with pytest.raises(LogError, match=r"other columns from episode_000001\.parquet on"):
        read_episode(tmp_path)
    file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(LogError, match=r"000001\.parquet: is a pointer of Git LFS.*git lfs pull"):
        read_episode(tmp_path)
    shutil.rmtree(tmp_path / "data")
    (tmp_path / "meta" / "episodes.jsonl").touch()
    with pytest.raises(LogError, match=r"without data/chunk-\*/\*\.parquet; copy its data, too"):
        read_episode(tmp_path)


@needs_pyarrow
def test_a_data_sets_description_may_be_damaged_and_lies_within_it(tmp_path: Path):
    log = lerobot(tmp_path / "set")
    info = tmp_path / "set" / "meta" / "info.json"
    for text in ("", "{", "[" * 100_000, '{"fps": "x", "features": {}}'):
        info.write_text(text)
        episode = read_episode(log)
        assert "meta/info.json is damaged: joints go by their numbers" in episode.warnings
        assert episode.signals["observation.state.episode0"].columns == (
            *("joint1", "joint2", "joint3"),
        )
    info.rename(tmp_path / "info.json")
    info.symlink_to(tmp_path / "info.json")
    assert any("no meta/info.json" in warning for warning in read_episode(log).warnings)


@needs_pyarrow
def test_tables_in_parquet(tmp_path: Path):
    path = tmp_path / "a.parquet"
    signal = one(path, {"time": T, "height_cm": Z * 100, "n": 1 + 0 * T})
    np.testing.assert_allclose(signal.values[:, 2], Z)
    assert (signal.name, signal.unit) == ("track", "m")
    index = pd.date_range("2026-01-01", periods=100, freq="5ms")  # dates of an index are times
    pd.DataFrame({"z": Z}, index=index).to_parquet(path)
    stamps = read_episode(path).signals["track"].stamps_ns
    assert stamps[1] - stamps[0] == 5_000_000
    assert stamps[0] == np.datetime64("2026-01-01", "ns").astype(int)
    poses = [{"position": {"x": 0.0, "y": 1.0, "z": z}} for z in Z]
    pd.DataFrame({"t": T, "ball": BALL.tolist(), "hand": poses}).to_parquet(path)
    signals = read_episode(path).signals
    np.testing.assert_allclose(signals["ball"].values, signals["hand"].values)
    stems = ("actual_q", "target_q", "target_moment")
    robot = {f"{stem}_{joint}": T + joint for stem in stems for joint in range(6)}
    assert set(read(path, {"timestamp": T} | robot).signals) == {
        *("joints.position", "commands.position")
    }
    whole = path.read_bytes()
    for cut in (4, 100, -1, -100):
        path.write_bytes(whole[:cut])
        assert "Parquet file that is not read: it is damaged" in refusal(path)
