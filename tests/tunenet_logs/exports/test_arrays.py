"""Arrays of NumPy and MATLAB, records in JSON: read by their names, bounded, never executed."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

T = np.arange(100) * 0.005
Z = 1 - 4.9 * T**2
BALL = np.column_stack([0 * T, 0 * T + 1, Z])
Q = T[:, None] + np.arange(7)


def npz(path: Path, arrays: dict[str, Any]) -> None:
    np.savez(path, **arrays)


def packed_npz(path: Path, arrays: dict[str, Any]) -> None:
    np.savez_compressed(path, **arrays)


def level4(path: Path, arrays: dict[str, Any]) -> None:
    scipy.io.savemat(path, arrays, format="4")


def packed_mat(path: Path, arrays: dict[str, Any]) -> None:
    scipy.io.savemat(path, arrays, do_compression=True)


def lists(path: Path, arrays: dict[str, Any]) -> None:
    path.write_text(json.dumps({name: np.asarray(one).tolist() for name, one in arrays.items()}))


def records(path: Path, arrays: dict[str, Any]) -> None:
    rows = [{name: one[at].tolist() for name, one in arrays.items()} for at in range(len(T))]
    path.write_text(json.dumps(rows))


def lines(path: Path, arrays: dict[str, Any]) -> None:
    records(path, arrays)
    path.write_text("\n".join(map(json.dumps, json.loads(path.read_text()))) + "\n")


WRITERS = {
    "a.npz": npz, "b.npz": packed_npz, "a.mat": scipy.io.savemat, "b.mat": packed_mat,
    "c.mat": level4, "a.json": lists, "b.json": records, "a.jsonl": lines,
}  # fmt: skip
every_kind = pytest.mark.parametrize(("name", "write"), WRITERS.items(), ids=WRITERS)


def skipped(episode: Episode) -> dict[str, str]:
    return {channel.topic: channel.skipped for channel in episode.channels if channel.skipped}


@every_kind
def test_a_ball_by_the_names_of_arrays(tmp_path: Path, name: str, write: Callable[..., None]):
    write(tmp_path / name, {"t": T, "ball": BALL})
    signal = read_episode(tmp_path / name).signals["ball"]
    np.testing.assert_allclose(signal.values, BALL, atol=1e-12)
    assert signal.stamps_ns[1] == 5_000_000
    assert signal.unit == ""
    assert signal.is_position


@every_kind
def test_joints_by_the_names_of_arrays(tmp_path: Path, name: str, write: Callable[..., None]):
    write(tmp_path / name, {"time": T, "q": Q, "tau": Q + 10, "q_des": Q + 20})
    episode = read_episode(tmp_path / name)
    assert set(episode.signals) == {"joints.position", "joints.effort"}
    np.testing.assert_allclose(episode.signals["joints.effort"].values, Q + 10)
    assert skipped(episode)["q_des 0 to 6"] == "commanded, not measured"


@every_kind
def test_columns_that_a_user_names(tmp_path: Path, name: str, write: Callable[..., None]):
    write(tmp_path / name, {"a": T * 1e3, "b": BALL})
    said = ReadOptions(columns={"t": "a", "z": "b[2]"}, length_unit="mm")
    signal = read_episode(tmp_path / name, said).signals["track"]
    np.testing.assert_allclose(signal.values[:, 2], Z * 1e-3, atol=1e-12)
    assert signal.unit == "m"
    with pytest.raises(LogError, match=r"has no column 'c'; its columns are 'a', 'b"):
        read_episode(tmp_path / name, ReadOptions(columns={"t": "a", "z": "c"}))


@every_kind
def test_times_of_impacts(tmp_path: Path, name: str, write: Callable[..., None]):
    write(tmp_path / name, {"hits": T + 1, "z": Z})
    said = ReadOptions(columns={"times": "hits"})
    signal = read_episode(tmp_path / name, said).signals["impacts"]
    assert signal.columns == ("impact",)
    assert signal.unit == "1"
    assert np.all(signal.values == 1)
    assert signal.stamps_ns[0] == 1_000_000_000


def test_a_named_unit_counts(tmp_path: Path):
    np.savez(tmp_path / "a.npz", t_ms=T * 1e3, ball_mm=BALL * 1e3)
    signal = read_episode(tmp_path / "a.npz").signals["ball"]
    assert signal.unit == "m"
    assert signal.stamps_ns[1] == 5_000_000
    np.testing.assert_allclose(signal.values, BALL)


def test_rows_without_times_count_frames(tmp_path: Path):
    np.savez(tmp_path / "a.npz", ball=BALL)
    assert read_episode(tmp_path / "a.npz").signals["ball"].counts_frames
    np.savez(tmp_path / "b.npz", ball=BALL, fps=200.0, picture=np.zeros((4, 5, 3)))
    signal = read_episode(tmp_path / "b.npz").signals["ball"]
    assert not signal.counts_frames
    assert signal.stamps_ns[1] == 5_000_000


def test_a_velocity_is_no_place_and_no_joint(tmp_path: Path):
    np.savez(tmp_path / "a.npz", t=T, position=BALL, velocity=BALL, forces=BALL)
    episode = read_episode(tmp_path / "a.npz")
    assert list(episode.signals) == ["track"]
    assert "it is no position" in set(skipped(episode).values())


def test_lists_of_a_script_are_columns(tmp_path: Path):
    np.savez(tmp_path / "a.npz", ts=T, x_list=Z, zs=Z)
    signal = read_episode(tmp_path / "a.npz").signals["track"]
    np.testing.assert_allclose(signal.values, np.column_stack([Z, 0 * Z, Z]))


def test_an_array_without_names_wants_numbers(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.column_stack([T, Z]))
    with pytest.raises(LogError, match=r"\(100 x 2\) whose columns have no names.*t=1,z=2"):
        read_episode(tmp_path / "a.npy")
    said = ReadOptions(columns={"t": "1", "z": "2"})
    np.testing.assert_allclose(
        read_episode(tmp_path / "a.npy", said).signals["track"].values[:, 2], Z
    )


def test_objects_are_never_unpickled(tmp_path: Path):
    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "gone off",))

    np.savez(tmp_path / "a.npz", t=T, z=Z, b=np.array([Bomb()], object))
    assert "never unpickled" in skipped(read_episode(tmp_path / "a.npz"))["b"]
    np.save(tmp_path / "b.npy", np.array([Bomb()], object))
    with pytest.raises(LogError, match="never unpickled"):
        read_episode(tmp_path / "b.npy")
    assert not (tmp_path / "gone off").exists()


def test_claims_of_size_are_checked_first(tmp_path: Path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 2)}
    )
    (tmp_path / "a.npy").write_bytes(header.getvalue())
    with pytest.raises(LogError, match="bytes are claimed, and not there"):
        read_episode(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("t.npy", header.getvalue())
    with pytest.raises(LogError, match="bytes are claimed, and not there"):
        read_episode(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["a.npz", "a.mat"])
def test_what_unpacks_to_too_much_is_refused(tmp_path: Path, name: str):
    zeros = np.zeros(6_000_000)
    WRITERS[name.replace("a.", "b.")](tmp_path / name, {"t": zeros, "y": zeros, "z": zeros})
    assert (tmp_path / name).stat().st_size < 500_000
    with pytest.raises(LogError, match="limit"):
        read_episode(tmp_path / name)


def test_structs_are_read_by_joined_names(tmp_path: Path):
    run = {"time": T, "height_cm": Z * 100, "inner": {"note": "abc"}}
    scipy.io.savemat(tmp_path / "a.mat", {"run": run, "cells": np.array([1, "a"], object)})
    episode = read_episode(tmp_path / "a.mat")
    np.testing.assert_allclose(episode.signals["run"].values[:, 2], Z)
    assert skipped(episode) == {"run.inner.note": "text", "cells": "a cell array"}


def test_what_is_no_matlab_file_is_said(tmp_path: Path):
    (tmp_path / "a.mat").write_bytes(b"anything else")
    with pytest.raises(LogError, match=r"it is no MATLAB file, despite its name; save it with"):
        read_episode(tmp_path / "a.mat")
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(600))
    with pytest.raises(LogError, match="is a MATLAB file that is not read"):
        read_episode(tmp_path / "a.mat")


def test_a_matlab_element_that_claims_too_much_is_refused(tmp_path: Path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": T, "z": Z})
    data = bytearray((tmp_path / "a.mat").read_bytes())
    data[132:136] = struct.pack("<I", 2**31)
    (tmp_path / "a.mat").write_bytes(data)
    with pytest.raises(LogError, match="an element claims 2147483648 bytes"):
        read_episode(tmp_path / "a.mat")


def test_nested_records_are_things_of_their_own(tmp_path: Path):
    rows = [
        {"time": f"{at:.9f}", "ball": {"position": {"x": 0, "y": 1, "z": z}, "spin": [1, 2, 3]}}
        for at, z in zip(1.7e9 + T, Z, strict=True)
    ]
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, rows)))
    signal = read_episode(tmp_path / "a.jsonl").signals["ball"]
    np.testing.assert_allclose(signal.values[:, 2], Z)


def test_times_in_json_keep_their_digits(tmp_path: Path):
    text = "\n".join(f'{{"t": 1700000000.12345678{n}, "z": {n}}}' for n in range(5))
    (tmp_path / "a.jsonl").write_text(text)
    stamps = read_episode(tmp_path / "a.jsonl").signals["track"].stamps_ns
    assert stamps.tolist() == [1_700_000_000_123_456_780 + n for n in range(5)]


def test_things_in_one_list_are_never_woven_together(tmp_path: Path):
    rows = [{"t": at, "id": n, "x": n, "z": at} for at in T.tolist() for n in (3, 4)]
    (tmp_path / "a.json").write_text(json.dumps({"made_by": "us", "rows": rows}))
    signals = read_episode(tmp_path / "a.json").signals
    assert {name: set(one.values[:, 0]) for name, one in signals.items()} == {
        "track.object3": {3.0}, "track.object4": {4.0},
    }  # fmt: skip
    paths = [{"points": [{"t": at, "x": n, "y": at} for at in T.tolist()]} for n in range(3)]
    (tmp_path / "b.json").write_text(json.dumps({"paths": paths}))
    assert set(read_episode(tmp_path / "b.json").signals) == {
        "track.run1", "track.run2", "track.run3",
    }  # fmt: skip


def test_json_that_breaks_off_is_a_loss(tmp_path: Path):
    (tmp_path / "a.jsonl").write_text('{"t":0,"z":1}\n{"t":1,"z":1}\n{"t":2,"z"')
    episode = read_episode(tmp_path / "a.jsonl")
    assert len(episode.signals["track"].stamps_ns) == 2
    assert "value 3 is no JSON" in episode.losses[0]


WIDE = "{" + ",".join(f'"c{n}":1' for n in range(20_000)) + '}\n{"c1":2}'
NESTED = '{"k":[' + "[]," * 4_000_000


@pytest.mark.parametrize(
    "text",
    ["[" * 500_000, '{"a":' * 500_000, NESTED, "[1,2", "{}", '{"a":1}', WIDE],
    ids=["deep", "deep names", "long", "numbers", "empty", "one", "wide"],
)
def test_json_of_nothing_is_refused_in_one_line(tmp_path: Path, text: str):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(LogError) as refusal:
        read_episode(tmp_path / "a.json")
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 700
