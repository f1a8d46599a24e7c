"""Files that were compressed as a whole, whole and broken."""

from __future__ import annotations

import bz2
import gzip
import tempfile
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from tests.conftest import Command, real, record
from tunenet_logs.copying import recover
from tunenet_logs.errors import LogError
from tunenet_logs.formats import base as budget
from tunenet_logs.reader import read_episode

PACK: dict[str, Callable[[bytes], bytes]] = {
    ".zst": zstandard.compress,
    ".zstd": zstandard.compress,
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".lz4": lz4.frame.compress,
}


@pytest.fixture(autouse=True)
def folder_for_unpacking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Nothing that was unpacked stays, whatever happens."""
    folder = tmp_path / "unpacking"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield
    assert not list(folder.iterdir())


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return record(tmp_path / "a.mcap", seed=1)


@pytest.mark.parametrize("suffix", list(PACK))
def test_a_packed_log_is_the_log(log: Path, suffix: str):
    packed = log.with_name(f"a.mcap{suffix}")
    packed.write_bytes(PACK[suffix](log.read_bytes()))
    plain, episode = read_episode(log), read_episode(packed)
    assert list(episode.signals) == list(plain.signals)
    for name, signal in plain.signals.items():
        assert np.array_equal(episode.signals[name].values, signal.values)
    assert episode.info == plain.info
    assert not episode.losses


@pytest.mark.parametrize("suffix", list(PACK))
def test_several_streams_are_one_file(log: Path, suffix: str):
    data = log.read_bytes()
    packed = log.with_name(f"a.mcap{suffix}")
    packed.write_bytes(PACK[suffix](data[:5000]) + PACK[suffix](data[5000:]))
    assert not read_episode(packed).losses


def test_what_precedes_the_end_of_a_cut_file_is_read_and_recovered(tmp_path: Path):
    log = record(tmp_path / "long.mcap", seed=1, seconds=10.0)
    packed = log.with_name("a.mcap.gz")
    data = gzip.compress(log.read_bytes())
    packed.write_bytes(data[: 2 * len(data) // 3])
    episode = read_episode(packed)
    (signal,) = episode.signals.values()
    assert 100 < len(signal.stamps_ns) < len(next(iter(read_episode(log).signals.values())).values)
    assert "gzip data is cut" in episode.losses[0]
    recovered = recover(packed, tmp_path / "saved.mcap")
    assert recovered.messages == len(signal.stamps_ns)


def test_damage_in_the_middle_is_said(log: Path):
    data = bytearray(bz2.compress(log.read_bytes() * 60, 1))
    data[-len(data) // 3] ^= 0xFF
    packed = log.with_name("a.mcap.bz2")
    packed.write_bytes(data)
    assert any("damaged" in loss for loss in read_episode(packed).losses)


def test_a_bomb_is_refused(log: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(budget, "_FREE_BYTES", 10_000_000)
    packer = zstandard.ZstdCompressor().compressobj()
    packed = log.with_name("bomb.mcap.zst")
    with packed.open("wb") as file:
        file.write(packer.compress(log.read_bytes()))
        for _ in range(30):
            file.write(packer.compress(bytes(1_000_000)))
        file.write(packer.flush())
    with pytest.raises(LogError, match="256 times its size"):
        read_episode(packed)


def test_what_lies_inside_shares_the_budget_of_the_file(log: Path, monkeypatch: pytest.MonkeyPatch):
    data = log.read_bytes()
    packed = log.with_name("a.mcap.zst")
    packed.write_bytes(zstandard.compress(data))
    monkeypatch.setattr(budget, "_FREE_BYTES", len(data) + 10_000)
    monkeypatch.setattr(budget, "_MAX_RATIO", 0)
    assert read_episode(packed).losses  # the file itself fits, its chunks do not


@pytest.mark.parametrize("suffix", list(PACK))
def test_a_packed_table_is_the_table(tmp_path: Path, suffix: str):
    rows = "".join(f"{at / 100},{1.5 - at / 1000}\n" for at in range(50))
    packed = tmp_path / f"drop.csv{suffix}"
    packed.write_bytes(PACK[suffix](f"t,height_m\n{rows}".encode()))
    episode = read_episode(packed)
    assert len(next(iter(episode.signals.values())).values) == 50


@pytest.mark.parametrize(
    ("inside", "said"),
    [(b"", "nothing"), (b"%PDF-1.4 hello", "PDF"), (bytes(257) + b"ustar\0" * 99, "tar archive")],
)
def test_something_else_inside_is_called_what_it_is(tmp_path: Path, inside: bytes, said: str):
    packed = tmp_path / "a.gz"
    packed.write_bytes(gzip.compress(inside))
    with pytest.raises(LogError, match=said) as caught:
        read_episode(packed)
    assert "unpacking" not in str(caught.value)


def test_a_folder_of_packed_files_is_one_recording():
    episode = read_episode(real("labs/rosbag2_zstd/file_compression"))
    assert sum(channel.messages for channel in episode.channels) == 775
    assert not episode.losses


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (b"\x89HDF\r\n\x1a\n", "is an HDF5 file that is not read"),
        (b"\x7fELF", "is a program"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a file of an office program"),
        (b"ULog\x01\x12\x35", "ulog2csv"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (bytes(100), "nothing but zeros"),
    ],
)
def test_other_files_are_called_what_they_are(tmp_path: Path, start: bytes, said: str):
    path = tmp_path / "a.dat"
    path.write_bytes(start + bytes(1000))
    with pytest.raises(LogError, match=said) as caught:
        read_episode(path)
    assert "video" not in str(caught.value)


def test_the_commands_take_packed_files(log: Path, tmp_path: Path, command: Command):
    packed = log.with_name("b.mcap.zst")
    packed.write_bytes(zstandard.compress(log.read_bytes()))
    for words in (
        ("info", packed),
        ("check", packed),
        ("import", packed, "-o", tmp_path / "c.mcap"),
    ):
        assert command("tunenet-logs", *words).returncode == 0
