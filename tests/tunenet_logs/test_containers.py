"""Laws of every container of messages: the same episode, cut, damaged, hostile or packed."""

from __future__ import annotations

import bz2
import gzip
import struct
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from tests.conftest import Command, Made, real, record
from tests.hostile import HEADER, MAGIC, chunk, described, message
from tests.message_logs import Schema, write_raw
from tests.reading import refusal
from tests.strangers import POSE, Stranger, write_poses, write_poses_bag, write_poses_folder
from tunenet_logs.copying import recover
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.formats import base as budget
from tunenet_logs.reader import read_episode

TOPIC = "/vrpn/thing/pose"
SAMPLES = Stranger(0.6, seconds=1.0, hold_s=0.2).samples()
COUNT = len(SAMPLES[0])
ZSTD = zstandard.ZstdCompressor().compress


class Container(NamedTuple):
    """What writes a log, the step at which it is cut, and how many of its messages may be lost."""

    write: Callable[[Path], Any]
    step: int
    is_packed: bool = False


def bag(compression: Any) -> Callable[[Path], Any]:
    """Of many small chunks."""
    return lambda path: write_poses_bag(path, *SAMPLES, TOPIC, compression, chunk_bytes=4000)


def db3(mode: CompressionMode = CompressionMode.NONE) -> Callable[[Path], Any]:
    def write(path: Path) -> None:
        made = write_poses_folder(path.with_name(f"{path.name}.folder"), *SAMPLES, TOPIC, mode=mode)
        made.rename(path)

    return write


def folder(storage: StoragePlugin, numbers: tuple[int, ...]) -> Callable[[Path], Any]:
    return lambda path: split(path, storage, numbers)


def split(
    path: Path,
    storage: StoragePlugin,
    numbers: tuple[int, ...] = (9, 10, 11),
    samples: Any = SAMPLES,
) -> Path:
    """A bag of ROS 2 in several files, the last written first."""
    path.mkdir()
    parts = np.array_split(np.arange(len(samples[0])), len(numbers))
    for number, part in reversed(list(zip(numbers, parts, strict=True))):
        whole = path.with_name(f"{path.name}_part{number}")
        file = write_poses_folder(whole, samples[0][part], samples[1][part], TOPIC, storage)
        file.rename(path / f"lab_drop_{number}{file.suffix}")
    (path / "metadata.yaml").write_text("not: [believed")
    return path


FILES: dict[str, Container] = {
    **{f"{one.name}.mcap": Container(
        lambda path, one=one: write_poses(path, *SAMPLES, TOPIC, one, chunk_bytes=4000), 211)
       for one in CompressionType},
    "plain.bag": Container(bag(None), 211),
    **{f"{one.name}.bag": Container(bag(one), 211) for one in BagWriter.CompressionFormat},
    "a.db3": Container(db3(), 2048),
    "messages.db3": Container(db3(CompressionMode.MESSAGE), 2048),
}  # fmt: skip
FOLDERS: dict[str, Callable[[Path], Any]] = {
    **{f"{one.name} folder of {len(numbers)}": folder(one, numbers)
       for one in StoragePlugin for numbers in ((0,), (9, 10, 11))},
    "packed folder": lambda path: write_poses_folder(path, *SAMPLES, TOPIC,
                                                     mode=CompressionMode.FILE),
}  # fmt: skip
PACK: dict[str, Callable[[bytes], bytes]] = {
    ".zst": zstandard.compress, ".zstd": zstandard.compress, ".gz": gzip.compress,
    ".bz2": bz2.compress, ".lz4": lz4.frame.compress,
}  # fmt: skip


def outcome(path: Path) -> tuple[int, tuple[str, ...]]:
    """How many samples there are, and what is lost; of a log of which nothing can be read too."""
    try:
        episode = read_episode(path)
    except LogError as error:
        return 0, tuple(str(error).splitlines())
    return count(episode), episode.losses


def count(episode: Episode) -> int:
    signal = episode.signals.get(TOPIC)
    return 0 if signal is None else len(signal.values)


@pytest.mark.parametrize("name", [*FILES, *FOLDERS])
def test_every_container_gives_the_same_episode(tmp_path: Path, name: str):
    (FILES[name].write if name in FILES else FOLDERS[name])(tmp_path / name)
    episode = read_episode(tmp_path / name)
    assert list(episode.signals) == [TOPIC]
    assert np.array_equal(episode.signals[TOPIC].values, SAMPLES[1])
    assert np.array_equal(episode.signals[TOPIC].stamps_ns, SAMPLES[0])
    assert len(episode.channels) == 1
    assert not episode.losses
    assert [one for one in episode.warnings if "vouched" not in one] == []
    assert episode.warnings or not name.endswith(".mcap")


@pytest.mark.parametrize("name", FILES)
def test_cut_anywhere_it_is_a_shorter_episode(tmp_path: Path, name: str):
    path = tmp_path / name
    FILES[name].write(path)
    whole, lengths = path.read_bytes(), []
    for cut in [*range(100, len(whole), FILES[name].step), len(whole) - 1]:
        path.write_bytes(whole[:cut])
        found, losses = outcome(path)
        assert losses, cut
        lengths.append(found)
    assert lengths == sorted(lengths)
    assert lengths[-1] > COUNT - 30
    assert lengths[-1] == COUNT or name.endswith("db3")
    assert len(set(lengths)) > 4


def test_our_own_log_cut_anywhere_is_a_shorter_episode(small: Path, tmp_path: Path):
    whole, truth = small.read_bytes(), read_episode(small).signals["/ball/pose"].values
    lengths = []
    for cut in range(8, len(whole), 7):
        (tmp_path / "cut.mcap").write_bytes(whole[:cut])
        try:
            episode = read_episode(tmp_path / "cut.mcap")
        except LogError:
            continue
        assert episode.losses, cut
        ball = episode.signals.get("/ball/pose")
        lengths.append(0 if ball is None else len(ball.values))
        if ball is not None:
            assert np.array_equal(ball.values, truth[: lengths[-1]])
    assert lengths == sorted(lengths)
    assert lengths[-1] == len(truth)


@pytest.fixture
def small(made: Made) -> Path:
    return made("small.mcap", lambda path: record(path, restitution=0.5, height_m=0.5, seconds=0.5))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_flipped_bit_is_never_silent(small: Path, tmp_path: Path, data: st.DataObject):
    whole = bytearray(small.read_bytes())
    whole[data.draw(st.integers(8, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    (tmp_path / "flipped.mcap").write_bytes(bytes(whole))
    truth = read_episode(small)
    try:
        episode = read_episode(tmp_path / "flipped.mcap")
    except TuneNetError:
        return
    same = set(episode.signals) == set(truth.signals) and all(
        np.array_equal(signal.values, truth.signals[name].values)
        and np.array_equal(signal.stamps_ns, truth.signals[name].stamps_ns)
        for name, signal in episode.signals.items()
    )
    assert same or episode.losses


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.mcap", b"\x89MCAP0\r", "not an MCAP"),
        ("a.mcap", MAGIC + struct.pack("<BQ", 5, 2**62) + b"x" * 50, "end of the file"),
        ("a.gz", gzip.compress(b"", mtime=0), "nothing"),
        ("a.gz", gzip.compress(b"%PDF-1.4 hello", mtime=0), "PDF"),
        ("a.gz", gzip.compress(bytes(257) + b"ustar\0" * 99, mtime=0), "tar archive"),
    ],
)  # fmt: skip
def test_what_is_no_log_is_refused(tmp_path: Path, name: str, content: bytes, says: str):
    told = refusal(tmp_path / name, content)
    assert says in told
    assert "unpacking" not in told


def test_log_times_stand_in_for_stamps_that_are_not_set_or_beyond_all_time(tmp_path: Path):
    path = tmp_path / "a.mcap"
    write_poses(path, *SAMPLES, set_header=False)
    assert np.array_equal(read_episode(path).signals[TOPIC].stamps_ns, SAMPLES[0])
    far = [int(stamp) for stamp in SAMPLES[0]]
    far[5] = 2**63 + 7
    write_poses(path, far, SAMPLES[1], set_header=False)
    assert len(read_episode(path).signals[TOPIC].values) == COUNT - 1
    assert any("1 damaged" in warning for warning in read_episode(path).warnings)


def test_channels_that_cannot_be_used_say_why(tmp_path: Path):
    told = [
        ("/cbor", Schema("Pose", "jsonschema", b"{}", "cbor")),
        ("/not the usual", Schema(POSE, text=b"float64 x")),
        ("/damaged", Schema(POSE, text=b"\xff\xfe not a definition ][ ")),
        ("/protobuf", Schema(POSE, "protobuf")),
    ]
    sent = [(topic, schema, 1, b"\x00\x01\x00\x00") for topic, schema in told]
    episode = read_episode(write_raw(tmp_path / "a.mcap", sent))
    assert not episode.signals
    assert len(episode.channels) == len(told)
    assert all(one.topic[1:] in (one.skipped or "") for one in episode.channels)


def test_a_chunk_damaged_behind_its_channel_does_not_hide_the_next(tmp_path: Path):
    """Found by fuzzing: the channel was taken for known though nobody had been told of it."""
    said = described(1) + message(0, b"x")
    damaged = said + struct.pack("<BQ", 5, 2**40)
    chunks = (chunk(b"", len(one), one) for one in (damaged, said))
    (tmp_path / "a.mcap").write_bytes(MAGIC + HEADER + b"".join(chunks))
    episode = read_episode(tmp_path / "a.mcap")
    assert any("damaged chunk" in one for one in episode.losses)
    assert [(one.topic, one.messages) for one in episode.channels] == [("/ch0", 1)]


@pytest.mark.parametrize("folder", ["mcap_rosbag2", "mcap_conformance"])
def test_the_counts_of_others_files_are_those_of_the_library(folder: str):
    for path in sorted(real(folder).glob("*.mcap")):
        with path.open("rb") as file:
            found = NonSeekingReader(file).iter_messages(log_time_order=False)
            theirs = Counter(channel.topic for _, channel, _ in found)
        episode, ours = read_episode(path), Counter[str]()
        for channel in episode.channels:
            ours[channel.topic] += channel.messages
            assert channel.skipped or channel.topic in episode.signals or not channel.messages
        assert +ours == theirs, path.name


# Files that were packed as a whole.
@pytest.fixture
def folder_for_unpacking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Nothing that was unpacked stays, whatever happens."""
    folder = tmp_path / "unpacking"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield
    assert not list(folder.iterdir())


@pytest.mark.usefixtures("folder_for_unpacking")
@pytest.mark.parametrize("suffix", PACK)
def test_a_packed_file_is_the_file(small: Path, tmp_path: Path, suffix: str, command: Command):
    data, plain = small.read_bytes(), read_episode(small)
    packed = tmp_path / f"a.mcap{suffix}"
    for parts in ((data,), (data[:5000], data[5000:])):  # in one stream, and in several
        packed.write_bytes(b"".join(map(PACK[suffix], parts)))
        episode = read_episode(packed)
        assert list(episode.signals) == list(plain.signals)
        for name, signal in plain.signals.items():
            assert np.array_equal(episode.signals[name].values, signal.values)
        assert episode.info == plain.info
        assert not episode.losses
    rows = "".join(f"{at / 100},{1.5 - at / 1000}\n" for at in range(50))
    table = tmp_path / f"drop.csv{suffix}"
    table.write_bytes(PACK[suffix](f"t,height_m\n{rows}".encode()))
    assert len(next(iter(read_episode(table).signals.values())).values) == 50
    for words in (("info",), ("check",), ("import", "-o", tmp_path / "c.mcap", "--overwrite")):
        assert command("tunenet-logs", *words, packed).returncode == 0


@pytest.mark.usefixtures("folder_for_unpacking")
def test_what_precedes_the_end_of_a_packed_file_is_read_and_recovered(tmp_path: Path, small: Path):
    log = record(tmp_path / "long.mcap", seed=1, seconds=10.0)
    data = gzip.compress(log.read_bytes())
    packed = tmp_path / "a.mcap.gz"
    packed.write_bytes(data[: 2 * len(data) // 3])
    episode = read_episode(packed)
    (signal,) = episode.signals.values()
    assert 100 < len(signal.stamps_ns) < len(next(iter(read_episode(log).signals.values())).values)
    assert "gzip data is cut" in episode.losses[0]
    assert recover(packed, tmp_path / "saved.mcap").messages == len(signal.stamps_ns)
    damaged = bytearray(bz2.compress(small.read_bytes() * 60, 1))
    damaged[-len(damaged) // 3] ^= 0xFF
    (tmp_path / "a.mcap.bz2").write_bytes(damaged)
    assert any("damaged" in loss for loss in read_episode(tmp_path / "a.mcap.bz2").losses)


@pytest.mark.usefixtures("folder_for_unpacking")
def test_a_packed_bomb_is_refused_and_shares_its_budget(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    data, packed = small.read_bytes(), tmp_path / "bomb.mcap.zst"
    monkeypatch.setattr(budget, "_FREE_BYTES", 10_000_000)
    packer = zstandard.ZstdCompressor().compressobj()
    zeros = [packer.compress(bytes(1_000_000)) for _ in range(30)]
    packed.write_bytes(b"".join([packer.compress(data), *zeros, packer.flush()]))
    with pytest.raises(LogError, match="256 times its size"):
        read_episode(packed)
    packed.write_bytes(zstandard.compress(data))
    monkeypatch.setattr(budget, "_FREE_BYTES", len(data) + 500)
    monkeypatch.setattr(budget, "_MAX_RATIO", 0)
    assert read_episode(packed).losses  # the file itself fits, its chunks do not


# Logs with thousands of channels, or names of hundreds of characters.
