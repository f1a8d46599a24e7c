"""Bags of ROS 1 and 2: as rosbags reads them where they are whole, and on where it gives up."""

from __future__ import annotations

import bz2
import json
import shutil
import sqlite3
import struct
import tracemalloc
from contextlib import closing
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import Reader, StoragePlugin

from tests.conftest import Command, real, record
from tests.hostile import BAG as MAGIC
from tests.hostile import bag_record
from tests.message_logs import JOINT_STATE, header, in_steps, write_bag
from tests.reading import refusal
from tests.strangers import Stranger, write_poses_bag, write_poses_folder
from tests.tunenet_logs.test_containers import SAMPLES, TOPIC, count, outcome, split
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import Loss, RawMessage, one_by_one
from tunenet_logs.formats.registry import read_folder
from tunenet_logs.formats.rosbag1 import BAG, CHUNK, CONNECTION, MESSAGE, RecordFile, read_bag
from tunenet_logs.formats.rosbag2 import read_db3
from tunenet_logs.reader import read_episode

COMPRESSIONS = [None, *BagWriter.CompressionFormat]
COUNT = len(SAMPLES[0])
PAGE = 4096
each_storage = pytest.mark.parametrize("storage", list(StoragePlugin))


def bag(path: Path, compression: Any = None) -> Path:
    """A bag of many small chunks."""
    write_poses_bag(path, *SAMPLES, TOPIC, compression, chunk_bytes=4000)
    return path


def record_of(op: int, data: bytes = b"", **fields: bytes) -> bytes:
    return bag_record({b"op": bytes([op]), **{k.encode(): v for k, v in fields.items()}}, data)


def chunks(path: Path) -> list[tuple[int, int]]:
    """Where the file's chunks begin, and where their data does."""
    found = []
    with path.open("rb") as file:
        records = RecordFile(file)
        at = len(MAGIC)
        while at < records.size:
            head = records.head(at)
            if head.op == CHUNK:
                found.append((at, head.data_at))
            at = head.end
    return found


def messages(path: Path) -> tuple[list[tuple[str, int, bytes]], list[Loss]]:
    losses: list[Loss] = []
    read = read_bag if path.suffix == ".bag" else read_db3
    found = [one for one in read(path, losses) if isinstance(one, RawMessage)]
    return sorted((one.channel.topic, one.log_ns, bytes(one.data)) for one in found), losses


@pytest.mark.parametrize(
    "name",
    ["jaco2_no_effort", "jaco_names_recorded_by_rosbag", "jaco_names_recorded_by_rosbag_lz4", ""],
)
def test_every_byte_is_that_of_rosbags(tmp_path: Path, name: str):
    if name:
        path, reader = real(f"ros1/{name}.bag"), BagReader(real(f"ros1/{name}.bag"))
    else:
        path, reader = (
            write_poses_folder(tmp_path / "bag", *SAMPLES, TOPIC),
            Reader(tmp_path / "bag"),
        )
    with reader as opened:
        theirs = [(one.topic, stamp, bytes(data)) for one, stamp, data in opened.messages()]
    ours, losses = messages(path)
    assert ours == sorted(theirs)
    assert all(one.harmless for one in losses)


def test_an_arm_by_others_is_understood():
    episode = read_episode(real("ros1/jaco_names_recorded_by_rosbag.bag"))
    torques = episode.signals["/j2s7s300_driver/out/joint_torques.effort"]
    assert (torques.unit, torques.values.shape) == ("N·m", (1075, 7))
    assert len(episode.signals["/j2s7s300_driver/out/joint_state.position"].columns) == 10
    joints = read_episode(real("ros1/jaco2_no_effort.bag")).signals
    assert len(joints["/joint_states.position"].columns) == 12
    assert "/joint_states.effort" not in joints


def test_thirteen_joints_are_thirteen_columns(tmp_path: Path):
    names, values = [f"arm_joint_{number}" for number in range(13)], np.arange(13.0)
    sent = [
        {"header": header(second * 10**9), "name": names, "position": values + second,
         "effort": -values - second}
        for second in range(1, 6)
    ]  # fmt: skip
    signals = read_episode(
        write_bag(tmp_path / "a.bag", in_steps("/js", JOINT_STATE, sent))
    ).signals
    assert set(signals) == {"/js.position", "/js.effort"}
    assert signals["/js.effort"].columns == tuple(names)
    assert np.array_equal(signals["/js.position"].values[4], values + 5)


def test_a_damaged_chunk_costs_that_chunk_even_where_it_described_all(tmp_path: Path):
    path = bag(tmp_path / "a.bag", BagWriter.CompressionFormat.BZ2)
    whole = bytearray(path.read_bytes())
    (_, first), (_, second), *_ = chunks(path)
    whole[first + 20 : first + 40] = bytes(20)
    path.write_bytes(bytes(whole))
    found, losses = outcome(path)
    assert 0 < COUNT - found < 60
    assert f"{COUNT - found} of {COUNT} messages are missing" in " ".join(losses)
    place = next(one for one in messages(path)[1] if one.at_byte is not None)
    assert place.at_byte is not None
    assert place.at_byte < first < place.at_byte + place.size < second


def test_a_damaged_size_does_not_cost_the_rest(tmp_path: Path):
    path = bag(tmp_path / "a.bag", BagWriter.CompressionFormat.LZ4)
    whole = bytearray(path.read_bytes())
    _, (_, second), *_ = chunks(path)
    for size in (0, 17, 2**31, 2**32 - 1):
        whole[second - 4 : second] = struct.pack("<I", size)
        path.write_bytes(bytes(whole))
        assert outcome(path)[0] >= COUNT - 60


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_what_a_killed_recorder_left_is_read(tmp_path: Path, compression: Any):
    """The last chunk's sizes are written when it is closed, the index after it."""
    path = bag(tmp_path / "a.bag.active", compression)
    (first, _), *_, (at, data_at) = chunks(path)
    with path.open("rb") as file:
        head = RecordFile(file).head(at)
    whole = path.read_bytes()
    opened = record_of(CHUNK, compression=head.fields[b"compression"], size=bytes(4))
    numbers = {"index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}
    start = MAGIC + record_of(BAG, b" " * 4000, **numbers)
    path.write_bytes(start + whole[first:at] + opened + whole[data_at : head.end])
    found, losses = outcome(path)
    assert found == COUNT
    assert any("index" in one for one in losses)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_bomb_stays_small_whatever_it_states(tmp_path: Path, compression: str):
    packed = {"bz2": bz2.compress, "lz4": lz4.frame.compress}[compression](bytes(2**28))
    for stated in (1000, 2**31, 2**32 - 1):
        fields = {"compression": compression.encode(), "size": struct.pack("<I", stated)}
        (tmp_path / "a.bag").write_bytes(MAGIC + record_of(CHUNK, packed, **fields))
        tracemalloc.start()
        _, lost = outcome(tmp_path / "a.bag")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 64 * 2**20, stated
        assert any("chunk" in one for one in lost), stated


def connection(kind: str) -> bytes:
    fields = [f"type={kind}", "md5sum=*", "message_definition=float64 x"]
    data = b"".join(struct.pack("<I", len(one)) + one.encode() for one in fields)
    return record_of(CONNECTION, data, conn=bytes(4), topic=b"/a")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"#ROSBAG V1.2\n", "rosbag filter"),
        (MAGIC + record_of(BAG, encryptor=b"rosbag/AesCbcEncryptor"), "rosbag decrypt"),
        (MAGIC + connection("a/B") + connection("a/C"), "two ways"),
        (MAGIC + record_of(MESSAGE, b"x", conn=struct.pack("<I", 3), time=bytes(8)) * 4,
         "4 messages belong"),
        (MAGIC + b"\x04\x00\x00\x00op=" * 2**20, ""),  # false beginnings: not for hours
    ],
)  # fmt: skip
def test_what_is_odd_in_a_bag_is_said(tmp_path: Path, content: bytes, says: str):
    (tmp_path / "a.bag").write_bytes(content)
    _, losses = outcome(tmp_path / "a.bag")
    assert losses
    assert any(says in one for one in losses)


# Databases of ROS 2.
@pytest.fixture
def db3(tmp_path: Path) -> Path:
    return write_poses_folder(tmp_path / "bag", *SAMPLES, TOPIC)


def change(path: Path, script: str) -> Path:
    with closing(sqlite3.connect(path)) as database:
        database.executescript(script)
    return path


def around(path: Path) -> Any:
    return [
        (one.name, one.read_bytes(), one.stat().st_mtime_ns)
        for one in sorted(path.parent.iterdir())
    ]


def test_reading_leaves_no_trace_and_a_strange_name_is_a_name(db3: Path):
    path = db3.rename(db3.with_name("a?mode=rwc#b %20 'ü'.db3"))
    before = around(path)
    assert count(read_episode(path)) == COUNT
    assert around(path) == before


def test_what_a_killed_recorder_left_beside_a_database_is_read(db3: Path):
    """Everything since the last checkpoint is in a -wal."""
    change(db3, "PRAGMA journal_mode = WAL")
    path = db3.with_name("killed.db3")
    with closing(sqlite3.connect(db3)) as database:
        database.execute("PRAGMA wal_autocheckpoint = 0")
        later = "id + 10000, topic_id, timestamp + 9000000000, data"
        database.execute(f"INSERT INTO messages SELECT {later} FROM messages")
        database.commit()
        shutil.copyfile(db3, path)
        shutil.copyfile(f"{db3}-wal", f"{path}-wal")
    before = around(path)
    episode = read_episode(path)
    assert episode.channels[0].messages == 2 * COUNT
    assert any("-wal" in one for one in episode.warnings)
    assert around(path) == before
    Path(f"{path}-wal").unlink()
    assert read_episode(path).channels[0].messages == COUNT


def test_a_strangers_journal_is_not_rolled_back(db3: Path):
    beside = Path(f"{db3}-journal")
    beside.write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + bytes(600))
    episode = read_episode(db3)
    assert count(episode) == COUNT
    assert any("transaction" in one for one in episode.losses)
    assert beside.exists()


COPY = "ALTER TABLE messages RENAME TO kept;"
ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)"


@pytest.mark.parametrize(
    ("script", "says"),
    [
        (f"{COPY} CREATE VIEW messages AS SELECT * FROM kept", "no plain table"),
        (f"{COPY} CREATE VIEW messages AS {ENDLESS} SELECT x AS id, 1 AS topic_id, x AS timestamp, "
         "zeroblob(9) AS data FROM n", "no plain table"),
        (f"{COPY} CREATE VIRTUAL TABLE messages USING fts4(topic_id, timestamp, data)", "no plain"),
        (f"{COPY} CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, "
         "data AS (zeroblob(1000000000)))", "no plain column 'data'"),
        (f"{COPY} CREATE TABLE messages(_rowid_, topic_id, timestamp, data)", "hides"),
        (COPY, "no table 'messages'"),
        ("DROP TABLE topics", "no table 'topics'"),
        ("ALTER TABLE messages DROP COLUMN topic_id", "no plain column 'topic_id'"),
    ],
    ids=["view", "recursive view", "virtual", "computed", "rowid", "none", "topics", "column"],
)  # fmt: skip
def test_a_hostile_schema_is_refused(db3: Path, script: str, says: str):
    change(db3, script)
    assert says in refusal(db3)


@pytest.mark.parametrize(
    ("script", "lost", "says"),
    [
        # as older distributions wrote them, which go by the type's name
        ("DROP TABLE message_definitions; DROP TABLE schema; DROP TABLE metadata; "
         "ALTER TABLE topics DROP COLUMN offered_qos_profiles", 0, ()),
        *((f"DELETE FROM messages WHERE id BETWEEN 10 AND {9 + count}", count,
           (f"{count} of its messages",)) for count in (1, 5)),
        ("""UPDATE messages SET timestamp = 'soon' WHERE id = 3;
            UPDATE messages SET data = 'text' WHERE id = 4;
            UPDATE messages SET topic_id = 1.5 WHERE id = 5;
            UPDATE messages SET topic_id = 77 WHERE id = 6;
            UPDATE messages SET timestamp = -1 WHERE id = 7;
            INSERT INTO topics VALUES (2, x'00', 'a/B', 'cdr', '', '');""", 5,
         ("2 messages are damaged (the first: message 3", "topic 2 is damaged",
          "2 messages belong to topics that nothing describes", "1 damaged messages")),
    ],
    ids=["older", "one missing", "five missing", "other types"],
)  # fmt: skip
def test_what_is_not_as_usual_in_a_database(
    db3: Path, script: str, lost: int, says: tuple[str, ...]
):
    found, losses = outcome(change(db3, script))
    assert found == COUNT - lost
    assert all(any(one in loss for loss in losses) for one in says)
    assert bool(losses) == bool(says)


def test_a_damaged_page_costs_that_page(tmp_path: Path):
    samples = Stranger(0.6, seconds=3.0).samples()
    db3 = write_poses_folder(tmp_path / "bag", *samples, TOPIC)
    whole = bytearray(db3.read_bytes())
    middle = len(whole) // PAGE // 2 * PAGE
    whole[middle : middle + PAGE] = bytes(PAGE)
    db3.write_bytes(bytes(whole))
    found, losses = outcome(db3)
    assert len(samples[0]) - 60 < found < len(samples[0])
    assert any("table messages: rows" in one for one in losses)


def test_pages_that_form_a_circle_do_not_take_hours(tmp_path: Path):
    """The last pages of a tree's inner page name its first again."""
    db3 = write_poses_folder(tmp_path / "bag", *Stranger(0.6, seconds=3.0).samples(), TOPIC)
    whole = bytearray(db3.read_bytes())
    with closing(sqlite3.connect(db3)) as database:
        query = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ((root,),) = database.execute(query)
    at = (root - 1) * PAGE
    assert whole[at] == 5  # an inner page; behind its head, where its cells are
    for cell in range(int.from_bytes(whole[at + 3 : at + 5], "big")):
        place = at + 12 + 2 * cell
        child = at + int.from_bytes(whole[place : place + 2], "big")
        whole[child : child + 4] = root.to_bytes(4, "big")
    db3.write_bytes(bytes(whole))
    assert read_episode(db3).losses


def test_a_message_that_is_a_bomb_stays_small(db3: Path):
    bomb = zstandard.ZstdCompressor().compress(bytes(512 * 2**20))
    with closing(sqlite3.connect(db3)) as database:
        database.execute("UPDATE messages SET data = ? WHERE id = 5", (bomb,))
        database.commit()
    tracemalloc.start()
    found, losses = outcome(db3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 * 2**20
    assert found == COUNT - 1
    assert any("1 messages are damaged" in one for one in losses)


# Folders: one recording in the order of its files, or a refusal that says why.
@each_storage
def test_files_come_in_the_order_of_their_numbers(tmp_path: Path, storage: StoragePlugin):
    records = one_by_one(read_folder(split(tmp_path / "bag", storage), []))
    stamps = [one.log_ns for one in records if isinstance(one, RawMessage)]
    assert stamps == list(SAMPLES[0])


@each_storage
def test_a_damaged_file_is_named_and_the_others_read(tmp_path: Path, storage: StoragePlugin):
    folder = split(tmp_path / "bag", storage, (0, 1, 2, 3))
    files = sorted(one for one in folder.iterdir() if one.suffix != ".yaml")
    files[1].write_bytes(files[1].read_bytes()[:-3000])
    files[2].write_bytes(b"something else")
    files[3].write_bytes(b"")  # what a killed recorder left of a file that it had just begun
    losses: list[Loss] = []
    found = [one for one in one_by_one(read_folder(folder, losses)) if isinstance(one, RawMessage)]
    assert len(found) >= COUNT // 4
    assert {one.file for one in losses if not one.harmless} == {one.name for one in files[1:]}
    assert any(str(one).startswith(f"{files[3].name}: is empty") for one in losses)
    assert sum(one.harmless for one in losses) == 1


def test_without_metadata_or_a_part_it_says_what_it_took_for_one(tmp_path: Path):
    folder = split(tmp_path / "bag", StoragePlugin.MCAP)
    (folder / "metadata.yaml").unlink()
    episode = read_episode(folder)
    assert not episode.losses
    assert any("lab_drop_9.mcap to lab_drop_11.mcap" in one for one in episode.warnings)
    [loss] = read_episode(split(tmp_path / "parts", StoragePlugin.MCAP, (0, 1, 3, 10))).losses
    assert "number 2, 4, 5, 6, 7 are missing" in loss


SEVERAL = r"several recordings \(.*name one of them"
NO_BAG = r"is a directory without .*\.db3, \.mcap.*name a log file"


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"a_0.mcap": b"x", "b_1.mcap": b"x"}, SEVERAL),
        ({"a_0.mcap": b"x", "a_0.db3": b"x"}, SEVERAL),
        ({"red1.mcap": b"x", "red2.mcap": b"x"}, SEVERAL),
        ({"a.mcap": b"x", "a_1.mcap": b"x"}, SEVERAL),
        ({"drop_0.mcap": None, "drop_1.mcap": None}, "several recordings"),  # of our own
        ({"a_0.mcap": b"x", "a_1.mcap": b""}, "no file in it can be read: a_0.mcap is no .mcap fi"),
        ({}, NO_BAG),
        ({"a.txt": b"x", "._x_0.db3": b"x", "b.bag": b"x"}, NO_BAG),
    ],
)
def test_folders_that_are_no_recording(tmp_path: Path, files: dict[str, bytes | None], says: str):
    for name, data in files.items():
        if data is None:
            record(tmp_path / name, restitution=0.5, height_m=0.5, seconds=0.5)
        else:
            (tmp_path / name).write_bytes(data)
    if says == NO_BAG:
        (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(LogError, match=says):
        read_episode(tmp_path)


def test_splits_by_others_read_as_one(tmp_path: Path):
    """Files of rosbag2's own tests, as its writer left them."""
    counts = []
    for number in range(5):
        name = f"py_wbag_wbag_{number}.mcap"
        path = real(f"mcap_rosbag2/{name}")
        (tmp_path / name).write_bytes(path.read_bytes())
        counts.append(sum(one.messages for one in read_episode(path).channels))
    episode = read_episode(tmp_path)
    assert sum(one.messages for one in episode.channels) == sum(counts) > 0


@each_storage
def test_the_commands_take_a_folder(command: Command, tmp_path: Path, storage: StoragePlugin):
    folder = split(tmp_path / "lab.drop", storage, samples=Stranger(0.6).samples())
    before = sorted(folder.iterdir())
    result = command("tunenet-logs", "info", f"{folder}/")
    assert result.returncode == 0, result.stderr
    size = sum(one.stat().st_size for one in folder.iterdir())
    assert result.stdout.startswith(f"{folder}: {size} bytes, ")
    result = command("tunenet-tune", ".", cwd=folder)
    assert result.returncode == 0, result.stderr
    assert json.loads((tmp_path / "lab.drop.json").read_text())["verdict"] == "ok"
    assert (tmp_path / "lab.drop.rrd").exists()
    assert before == sorted(folder.iterdir())
