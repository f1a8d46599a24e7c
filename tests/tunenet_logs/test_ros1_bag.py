"""ROS 1 bags: as rosbags reads them where they are whole, and on where it gives up."""

from __future__ import annotations

import bz2
import struct
import tracemalloc
from contextlib import suppress
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from tests.conftest import real
from tests.strangers import Stranger, write_poses, write_poses_bag
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.formats.base import Loss, RawMessage
from tunenet_logs.formats.rosbag1 import BAG, CHUNK, CONNECTION, MESSAGE, RecordFile, read_bag
from tunenet_logs.reader import read_episode

TOPIC = "/vrpn/thing/pose"
MAGIC = b"#ROSBAG V2.0\n"
COMPRESSIONS = [None, *Writer.CompressionFormat]
SAMPLES = Stranger(0.6, seconds=1.0, hold_s=0.2).samples()


def bag(path: Path, compression: Writer.CompressionFormat | None = None) -> Path:
    """A bag of many small chunks."""
    write_poses_bag(path, *SAMPLES, TOPIC, compression, chunk_bytes=4000)
    return path


def record(op: int, data: bytes, **fields: bytes) -> bytes:
    head = b""
    for name, value in {"op": bytes([op]), **fields}.items():
        field = name.encode() + b"=" + value
        head += struct.pack("<I", len(field)) + field
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def heads(path: Path, op: int) -> list[tuple[int, int]]:
    """Where the file's records of a kind begin, and where their data does."""
    found = []
    with path.open("rb") as file:
        records = RecordFile(file)
        at = len(MAGIC)
        while at < records.size:
            head = records.head(at)
            if head.op == op:
                found.append((at, head.data_at))
            at = head.end
    return found


def messages(path: Path) -> tuple[list[tuple[str, int, bytes]], list[Loss]]:
    losses: list[Loss] = []
    found = [one for one in read_bag(path, losses) if isinstance(one, RawMessage)]
    return sorted((one.channel.topic, one.log_ns, bytes(one.data)) for one in found), losses


def count(episode: Episode) -> int:
    signal = episode.signals.get(TOPIC)
    return 0 if signal is None else len(signal.values)


def losses(path: Path) -> tuple[str, ...]:
    """What is lost, in words; of a log of which nothing can be read too."""
    try:
        return read_episode(path).losses
    except LogError as error:
        return (str(error),)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_it_gives_the_episode_that_the_mcap_gives(tmp_path: Path, compression):
    write_poses(tmp_path / "a.mcap", *SAMPLES, TOPIC)
    truth = read_episode(tmp_path / "a.mcap").signals[TOPIC]
    episode = read_episode(bag(tmp_path / "a.bag", compression))
    assert np.array_equal(episode.signals[TOPIC].values, truth.values)
    assert np.array_equal(episode.signals[TOPIC].stamps_ns, truth.stamps_ns)
    assert not episode.losses
    assert [one for one in episode.warnings if "vouched" not in one] == []


@pytest.mark.parametrize(
    "name",
    ["jaco2_no_effort", "jaco_names_recorded_by_rosbag", "jaco_names_recorded_by_rosbag_lz4"],
)
def test_every_byte_is_that_of_rosbags(name: str):
    path = real(f"ros1/{name}.bag")
    with Reader(path) as reader:
        theirs = [(one.topic, stamp, bytes(data)) for one, stamp, data in reader.messages()]
    ours, losses = messages(path)
    assert ours == sorted(theirs)
    assert all(one.harmless for one in losses)


def test_an_arm_by_others_is_understood():
    episode = read_episode(real("ros1/jaco_names_recorded_by_rosbag.bag"))
    torques = episode.signals["/j2s7s300_driver/out/joint_torques.effort"]
    assert torques.unit == "N·m"
    assert torques.values.shape == (1075, 7)
    joints = read_episode(real("ros1/jaco2_no_effort.bag"))
    assert "/joint_states.position" in joints.signals
    assert "/joint_states.effort" not in joints.signals
    assert len(joints.signals["/joint_states.position"].columns) == 12
    assert len(episode.signals["/j2s7s300_driver/out/joint_state.position"].columns) == 10


def test_thirteen_joints_are_thirteen_columns(tmp_path: Path):
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "sensor_msgs/msg/JointState"
    names = [f"arm_joint_{number}" for number in range(13)]
    with Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for second in range(1, 6):
            stamp = store.types["builtin_interfaces/msg/Time"](sec=second, nanosec=0)
            header = store.types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="")
            values = np.arange(13.0) + second
            message = store.types[kind](header, names, values, np.array([]), -values)
            data = bytes(store.serialize_ros1(message, kind))
            writer.write(connection, second * 10**9, data)
    signals = read_episode(tmp_path / "a.bag").signals
    assert set(signals) == {"/joint_states.position", "/joint_states.effort"}
    assert signals["/joint_states.effort"].columns == tuple(names)
    assert np.array_equal(signals["/joint_states.position"].values[4], np.arange(13.0) + 5)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_cut_anywhere_it_is_a_shorter_episode(tmp_path: Path, compression):
    whole = bag(tmp_path / "a.bag", compression).read_bytes()
    path = tmp_path / "cut.bag"
    lengths = []
    for cut in [*range(len(MAGIC), len(whole), 211), len(whole) - 1]:
        path.write_bytes(whole[:cut])
        assert losses(path), cut
        with suppress(LogError):
            lengths.append(count(read_episode(path)))
    assert lengths == sorted(lengths)
    assert lengths[-1] == len(SAMPLES[0])
    assert len(set(lengths)) > 4


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    compression=st.sampled_from(COMPRESSIONS),
    changes=st.lists(st.tuples(st.integers(13, 2**31), st.integers(1, 255)), min_size=1),
)
def test_changed_bytes_give_only_our_errors(tmp_path: Path, compression, changes):
    path = tmp_path / f"{compression}.bag"
    if not path.exists():
        bag(path, compression)
    whole = bytearray(path.read_bytes())
    for place, bits in changes:
        whole[13 + place % (len(whole) - 13)] ^= bits
    (tmp_path / "changed.bag").write_bytes(bytes(whole))
    with suppress(TuneNetError):
        read_episode(tmp_path / "changed.bag")


def test_a_damaged_chunk_costs_that_chunk_even_where_it_described_all(tmp_path: Path):
    path = bag(tmp_path / "a.bag", Writer.CompressionFormat.BZ2)
    whole = bytearray(path.read_bytes())
    (_, first), (_, second), *_ = heads(path, CHUNK)
    whole[first + 20 : first + 40] = bytes(20)
    path.write_bytes(bytes(whole))
    episode = read_episode(path)
    lost = len(SAMPLES[0]) - count(episode)
    assert 0 < lost < 60
    assert f"{lost} of {len(SAMPLES[0])} messages are missing" in " ".join(episode.losses)
    place = next(one for one in messages(path)[1] if one.at_byte is not None)
    assert place.at_byte is not None
    assert place.at_byte < first < place.at_byte + place.size < second


def test_a_damaged_size_does_not_cost_the_rest(tmp_path: Path):
    path = bag(tmp_path / "a.bag", Writer.CompressionFormat.LZ4)
    whole = bytearray(path.read_bytes())
    _, (_, second), *_ = heads(path, CHUNK)
    for size in (0, 17, 2**31, 2**32 - 1):
        whole[second - 4 : second] = struct.pack("<I", size)
        path.write_bytes(bytes(whole))
        assert count(read_episode(path)) >= len(SAMPLES[0]) - 60


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_what_a_killed_recorder_left_is_read(tmp_path: Path, compression):
    """The last chunk's sizes are written when it is closed, the index after it."""
    path = bag(tmp_path / "a.bag.active", compression)
    *_, (at, data_at) = heads(path, CHUNK)
    with path.open("rb") as file:
        head = RecordFile(file).head(at)
    whole = path.read_bytes()
    opened = record(CHUNK, b"", compression=head.fields[b"compression"], size=bytes(4))
    numbers = {"index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}
    start = MAGIC + record(BAG, b" " * 4000, **numbers)
    (first, _), *_ = heads(path, CHUNK)
    path.write_bytes(start + whole[first:at] + opened + whole[data_at : head.end])
    episode = read_episode(path)
    assert count(episode) == len(SAMPLES[0])
    assert any("index" in one for one in episode.losses)


@pytest.mark.parametrize("length", [2**31 - 1, 2**31, 2**32 - 1])
@pytest.mark.parametrize("place", ["head", "field", "data"])
def test_huge_lengths_are_not_believed(tmp_path: Path, length: int, place: str):
    whole = bytearray(record(MESSAGE, b"x", conn=bytes(4), time=bytes(8)))
    at = {"head": 0, "field": 4, "data": len(whole) - 5}[place]
    whole[at : at + 4] = struct.pack("<I", length)
    far = {"index_pos": struct.pack("<Q", 2**62), "chunk_count": bytes(4)}
    start = MAGIC + record(BAG, b"", **far)
    (tmp_path / "a.bag").write_bytes(start + bytes(whole))
    assert losses(tmp_path / "a.bag")


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_bomb_stays_small_whatever_it_states(tmp_path: Path, compression: str):
    packed = {"bz2": bz2.compress, "lz4": lz4.frame.compress}[compression](bytes(2**28))
    for stated in (1000, 2**31, 2**32 - 1):
        fields = {"compression": compression.encode(), "size": struct.pack("<I", stated)}
        (tmp_path / "a.bag").write_bytes(MAGIC + record(CHUNK, packed, **fields))
        tracemalloc.start()
        lost = losses(tmp_path / "a.bag")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 64 * 2**20, stated
        assert any("chunk" in one for one in lost), stated


def test_a_file_of_false_beginnings_does_not_take_hours(tmp_path: Path):
    (tmp_path / "a.bag").write_bytes(MAGIC + b"\x04\x00\x00\x00op=" * 2**20)
    assert losses(tmp_path / "a.bag")


def test_connections_that_contradict_are_told(tmp_path: Path):
    def connection(kind: str) -> bytes:
        fields = [f"type={kind}", "md5sum=*", "message_definition=float64 x"]
        data = b"".join(struct.pack("<I", len(one)) + one.encode() for one in fields)
        return record(CONNECTION, data, conn=bytes(4), topic=b"/a")

    (tmp_path / "a.bag").write_bytes(MAGIC + connection("a/B") + connection("a/C"))
    assert any("two ways" in one for one in losses(tmp_path / "a.bag"))


def test_messages_that_nothing_describes_are_counted(tmp_path: Path):
    lost = record(MESSAGE, b"x", conn=struct.pack("<I", 3), time=bytes(8))
    (tmp_path / "a.bag").write_bytes(MAGIC + lost * 4)
    assert any("4 messages belong" in one for one in losses(tmp_path / "a.bag"))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"#ROSBAG V1.2\n", "rosbag filter"),
        (MAGIC + record(BAG, b"", encryptor=b"rosbag/AesCbcEncryptor"), "rosbag decrypt"),
    ],
)
def test_what_is_not_read_says_what_to_do(tmp_path: Path, content: bytes, says: str):
    (tmp_path / "a.bag").write_bytes(content)
    with pytest.raises(LogError, match=says):
        read_episode(tmp_path / "a.bag")
