"""Bad files are one clear error; damaged ones are read as far as they are whole."""

from __future__ import annotations

import struct
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.writer import CompressionType, Writer

from tests.conftest import real, record
from tests.hostile import HEADER, MAGIC, chunk
from tests.strangers import Stranger, write_poses
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.reader import read_episode


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "small.mcap"
    return record(path, restitution=0.5, height_m=0.5, seconds=0.5)


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "is empty"), (b"hello, world", "is not an MCAP log"), (b"\x89MCAP0\r", "not an MCAP")],
)
def test_what_is_no_log_is_refused(tmp_path: Path, content: bytes, says: str):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=says) as caught:
        read_episode(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_a_directory_are_refused(tmp_path: Path):
    with pytest.raises(LogError, match="no such file"):
        read_episode(tmp_path / "a.mcap")
    with pytest.raises(LogError, match="is a directory"):
        read_episode(tmp_path)


def test_cut_anywhere_it_is_a_shorter_episode(small: Path, tmp_path: Path):
    whole = small.read_bytes()
    truth = read_episode(small).signals["/ball/pose"]
    lengths = []
    for cut in range(8, len(whole), 7):
        path = tmp_path / "cut.mcap"
        path.write_bytes(whole[:cut])
        try:
            episode = read_episode(path)
        except LogError:
            lengths.append(0)
            continue
        assert episode.losses, cut
        ball = episode.signals.get("/ball/pose")
        count = 0 if ball is None else len(ball.values)
        if ball is not None:
            assert np.array_equal(ball.values, truth.values[:count])
        lengths.append(count)
    assert lengths == sorted(lengths)
    assert lengths[-1] == len(truth.values)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_flipped_bit_is_never_silent(small: Path, tmp_path: Path, data: st.DataObject):
    whole = bytearray(small.read_bytes())
    at = data.draw(st.integers(8, len(whole) - 1))
    whole[at] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path / "flipped.mcap"
    path.write_bytes(bytes(whole))
    truth = read_episode(small)
    try:
        episode = read_episode(path)
    except TuneNetError:
        return
    same = set(episode.signals) == set(truth.signals) and all(
        np.array_equal(signal.values, truth.signals[name].values)
        and np.array_equal(signal.stamps_ns, truth.signals[name].stamps_ns)
        for name, signal in episode.signals.items()
    )
    assert same or episode.losses


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=400))
def test_any_bytes_give_only_our_errors(tmp_path: Path, tail: bytes):
    path = tmp_path / "fuzz.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + tail)
    with suppress(TuneNetError):
        read_episode(path)


@pytest.mark.parametrize("stated", [1000, 4 * 2**30, 2**62])
def test_a_decompression_bomb_stays_small(tmp_path: Path, stated: int):
    bomb = zstandard.ZstdCompressor(level=3).compress(bytes(512 * 2**20))
    path = tmp_path / "bomb.mcap"
    header = struct.pack("<BQII", 1, 8, 0, 0)
    path.write_bytes(b"\x89MCAP0\r\n" + header + chunk(b"zstd", stated, bomb))
    tracemalloc.start()
    with pytest.raises(LogError, match="chunk"):
        read_episode(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 * 2**20


def test_a_huge_length_is_not_believed(tmp_path: Path):
    path = tmp_path / "huge.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 5, 2**62) + b"x" * 50)
    with pytest.raises(LogError, match="end of the file"):
        read_episode(path)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_strangers_log_reads_whatever_its_compression(
    tmp_path: Path, compression: CompressionType
):
    stamps, positions = Stranger(0.6).samples()
    write_poses(tmp_path / "a.mcap", stamps, positions, "/any/topic", compression)
    episode = read_episode(tmp_path / "a.mcap")
    assert np.array_equal(episode.signals["/any/topic"].values, positions)
    assert np.array_equal(episode.signals["/any/topic"].stamps_ns, stamps)
    assert any("vouched" in warning for warning in episode.warnings)


def test_log_times_stand_in_for_headers_that_were_not_set(tmp_path: Path):
    stamps, positions = Stranger(0.6).samples()
    write_poses(tmp_path / "a.mcap", stamps, positions, set_header=False)
    assert np.array_equal(
        read_episode(tmp_path / "a.mcap").signals["/vrpn/thing/pose"].stamps_ns, stamps
    )


def test_channels_that_cannot_be_used_say_why(tmp_path: Path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        pose = "geometry_msgs/msg/PoseStamped"
        for topic, encoding, kind, schema_encoding, text in [
            ("/cbor", "cbor", "Pose", "jsonschema", b"{}"),
            ("/other", "cdr", pose, "ros2msg", b"float64 x"),
            ("/broken", "cdr", pose, "ros2msg", b"\xff\xfe not a definition ][ "),
            ("/proto", "cdr", pose, "protobuf", b""),
        ]:
            schema = writer.register_schema(kind, schema_encoding, text)
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 1, b"\x00\x01\x00\x00", 1)
        writer.finish()
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.signals
    reasons = {one.topic: one.skipped or "" for one in episode.channels}
    assert "cbor" in reasons["/cbor"]
    assert "not the usual" in reasons["/other"]
    assert "damaged" in reasons["/broken"]
    assert "protobuf" in reasons["/proto"]


@pytest.mark.parametrize("folder", ["mcap_rosbag2", "mcap_conformance"])
def test_files_by_other_writers_open(folder: str):
    for path in sorted(real(folder).glob("*.mcap")):
        episode = read_episode(path)
        for channel in episode.channels:
            assert channel.skipped or channel.topic in episode.signals or not channel.messages


def test_stamps_beyond_int64_are_left_out_and_counted(tmp_path: Path):
    stamps, positions = Stranger(0.6).samples()
    far = [int(stamp) for stamp in stamps]
    far[5] = 2**63 + 7
    write_poses(tmp_path / "a.mcap", far, positions, set_header=False)
    episode = read_episode(tmp_path / "a.mcap")
    assert len(episode.signals["/vrpn/thing/pose"].values) == len(positions) - 1
    assert any("1 damaged" in warning for warning in episode.warnings)


def test_a_chunk_damaged_behind_its_channel_does_not_hide_the_next(tmp_path: Path):
    """Found by fuzzing: the channel was taken for known though nobody had been told of it."""

    def packed(*records: McapRecord, tail: bytes = b"") -> bytes:
        builder = RecordBuilder()
        for one in records:
            one.write(builder)
        data = builder.end() + tail
        return chunk(b"", len(data), data)

    schema = Schema(id=1, name="Thing", encoding="", data=b"")
    channel = Channel(id=1, topic="/thing", message_encoding="", metadata={}, schema_id=1)
    message = Message(channel_id=1, log_time=5, data=b"x", publish_time=5, sequence=0)
    damaged = packed(schema, channel, message, tail=struct.pack("<BQ", 5, 2**40))
    (tmp_path / "a.mcap").write_bytes(MAGIC + HEADER + damaged + packed(schema, channel, message))
    episode = read_episode(tmp_path / "a.mcap")
    assert any("damaged chunk" in one for one in episode.losses)
    assert [(one.topic, one.messages) for one in episode.channels] == [("/thing", 1)]
