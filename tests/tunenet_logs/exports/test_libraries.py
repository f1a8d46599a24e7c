"""Files of arrays that libraries read in the sandbox: HDF5, Arrow, PyTorch, Rerun and ULog."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import tunenet_logs as tn
from tests.library_writers import (
    ARMS,
    DROPS,
    RESTITUTION,
    drop,
    joints,
    write_hdf5,
    write_ulog,
)
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode


def skipped(episode: Episode) -> dict[str, str]:
    return {channel.topic: channel.skipped for channel in episode.channels if channel.skipped}


def needs_library(name: str) -> None:
    if name.endswith(".pt"):
        pytest.importorskip("torch")


@pytest.mark.parametrize(("name", "write"), DROPS.items(), ids=DROPS)
def test_a_drop_is_tuned(tmp_path: Path, name: str, write: Callable[[Path], None]):
    needs_library(name)
    write(tmp_path / name)
    (signal,) = read_episode(tmp_path / name).signals.values()
    np.testing.assert_allclose(signal.values, drop()[1], atol=1e-6)
    np.testing.assert_allclose(np.diff(signal.stamps_ns), 1e9 / 240, atol=1000)
    tuning = tn.tune(tmp_path / name)
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(RESTITUTION, abs=1e-3)


@pytest.mark.parametrize(("name", "write"), ARMS.items(), ids=ARMS)
def test_joints_of_an_arm(tmp_path: Path, name: str, write: Callable[[Path], None]):
    write(tmp_path / name)
    options = ReadOptions(fps=50.0) if name.startswith("aloha") else ReadOptions()
    signals = read_episode(tmp_path / name, options).signals
    run = "demo_0." if name.startswith("robomimic") else ""
    for quantity, values in zip(("position", "velocity", "effort"), joints()[1:], strict=True):
        signal = signals[f"joints.{run}{quantity}"]
        np.testing.assert_allclose(signal.values, values)
        np.testing.assert_array_equal(signal.stamps_ns, np.arange(200) * 20_000_000)


def test_demonstrations_are_runs_in_order(tmp_path: Path):
    ARMS["robomimic.hdf5"](tmp_path / "a.hdf5")
    episode = read_episode(tmp_path / "a.hdf5")
    names = [name for name in episode.signals if name.endswith("effort")]
    assert names == [f"joints.demo_{number}.effort" for number in (0, 1, 10)]
    np.testing.assert_allclose(episode.signals["joints.demo_10.position"].values, joints(10)[1])
    assert "obs.agentview_image.demo_0" in skipped(episode)


def test_a_rate_that_nobody_says_is_asked_for(tmp_path: Path):
    ARMS["aloha.hdf5"](tmp_path / "a.hdf5")
    with pytest.raises(LogError, match="nothing says when; say --columns t=NAME or --fps RATE"):
        read_episode(tmp_path / "a.hdf5")


def test_columns_that_a_user_names(tmp_path: Path):
    times, places = drop()
    write_hdf5(tmp_path / "a.h5", {"lab/clock": times, "lab/wand": places, "note": b"red"})
    for names in (
        ("lab.clock", "lab.wand[2]"),
        ("/lab/clock", "lab/wand[2]"),
        ("clock", "wand[2]"),
    ):
        said = ReadOptions(columns=dict(zip("tz", names, strict=True)))
        signal = read_episode(tmp_path / "a.h5", said).signals["track"]
        np.testing.assert_allclose(signal.values[:, 2], places[:, 2])


def test_nothing_outside_of_the_file_is_read(tmp_path: Path):
    times, places = drop()
    write_hdf5(tmp_path / "other.h5", {"z": places[:, 2]})
    (tmp_path / "raw").write_bytes(places[:, 2].tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = times
        file["x"] = places[:, 0]
        file["external"] = h5py.ExternalLink("other.h5", "z")
        file["soft"] = h5py.SoftLink("/x")
        file["loop"] = file["/"]
        layout = h5py.VirtualLayout((len(times),), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "z", (len(times),))
        file.create_virtual_dataset("z", layout)
        file.create_dataset(
            "y", (len(times),), "f8", external=[(str(tmp_path / "raw"), 0, len(times) * 8)]
        )
    with pytest.raises(LogError) as caught:
        read_episode(tmp_path / "a.h5", ReadOptions(columns={"t": "t", "z": "z"}))
    assert "has no column 'z'; its columns are 't', 'x'" in str(caught.value)


def test_claims_of_size_are_refused(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("t", (2**33,), "f8", chunks=(2**10,), compression="gzip")
    with pytest.raises(LogError, match="over the limit of 128 MiB of numbers"):
        read_episode(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        for number in range(5001):
            file.create_dataset(f"x{number}", data=0)
    with pytest.raises(LogError):
        read_episode(tmp_path / "b.h5")


def test_objects_of_pytorch_are_never_made(tmp_path: Path):
    torch = pytest.importorskip("torch")

    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "gone off",))

    torch.save({"t": torch.zeros(9), "bomb": Bomb()}, tmp_path / "a.pt")
    with pytest.raises(LogError, match=r"objects are never unpickled; save its tensors alone"):
        read_episode(tmp_path / "a.pt")
    with zipfile.ZipFile(tmp_path / "b.pt", "w") as archive:
        archive.writestr("b/data.pkl", pickle.dumps(Bomb()))
        archive.writestr("b/version", "3")
    with pytest.raises(LogError, match="file of PyTorch"):
        read_episode(tmp_path / "b.pt")
    assert not (tmp_path / "gone off").exists()


def test_topics_of_an_autopilot_keep_their_own_times(tmp_path: Path):
    times = np.arange(100) * 10_000
    write_ulog(
        tmp_path / "a.ulg",
        {
            "vehicle_local_position": {"timestamp": times, "x": times, "y": times, "z": -times},
            "other_position": {"timestamp": times[::2], "x": times[::2], "z": times[::2]},
        },
    )
    signals = read_episode(tmp_path / "a.ulg").signals
    lengths = {name: len(signal.stamps_ns) for name, signal in signals.items()}
    assert sorted(lengths.values()) == [50, 100]
    assert {int(np.diff(one.stamps_ns)[0]) for one in signals.values()} == {10**7, 2 * 10**7}


def test_an_autopilot_may_have_hundreds_of_other_topics(tmp_path: Path):
    times = np.arange(100) * 10_000
    others = {f"sensor{number}": {"timestamp": times[:2], "x": times[:2]} for number in range(220)}
    place = {"timestamp": times, "x": times, "y": times, "z": -times}
    write_ulog(tmp_path / "a.ulg", {**others, "vehicle_local_position": place})
    episode = read_episode(tmp_path / "a.ulg")
    assert list(episode.signals) == ["track.vehicle_local_position"]
    assert sum(channel.skipped is not None for channel in episode.channels) == 220


def test_a_review_of_ours_gives_what_was_observed(tmp_path: Path):
    DROPS["plain.h5"](tmp_path / "a.h5")
    tuning = tn.tune(tmp_path / "a.h5")
    tn.review(tuning, tmp_path / "a.rrd")
    again = tn.tune(tmp_path / "a.rrd")
    assert again.estimate is not None
    assert again.estimate[0] == pytest.approx(RESTITUTION, abs=1e-3)


def test_damage_is_one_line(tmp_path: Path):
    """Cut files, of each kind."""
    for name, write in DROPS.items():
        needs_library(name)
        write(tmp_path / name)
        data = (tmp_path / name).read_bytes()
        cut = tmp_path / f"cut.{name}"
        cut.write_bytes(data[: len(data) // 2])
        if name == "drop.ulg":  # what is before the cut is read
            assert read_episode(cut).losses == ("is damaged: messages in it are missing",)
            continue
        with pytest.raises(LogError) as caught:
            read_episode(cut)
        assert "\n" not in str(caught.value)
