"""ROS 2 sqlite3 bags: read without a trace, past damage, and never doing what a schema says."""

from __future__ import annotations

import shutil
import sqlite3
import tracemalloc
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionMode, Reader

from tests.strangers import Stranger, write_poses, write_poses_folder
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.formats.base import RawMessage
from tunenet_logs.formats.rosbag2 import read_db3
from tunenet_logs.reader import read_episode

TOPIC = "/vrpn/thing/pose"
SAMPLES = Stranger(0.6, seconds=3.0, hold_s=0.5).samples()
COUNT = len(SAMPLES[0])
PAGE = 4096


@pytest.fixture
def db3(tmp_path: Path) -> Path:
    return write_poses_folder(tmp_path / "bag", *SAMPLES, TOPIC)


def change(path: Path, script: str) -> Path:
    with closing(sqlite3.connect(path)) as database:
        database.executescript(script)
    return path


def count(episode: Episode) -> int:
    signal = episode.signals.get(TOPIC)
    return 0 if signal is None else len(signal.values)


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_it_gives_the_episode_that_the_mcap_gives(tmp_path: Path, mode: CompressionMode):
    write_poses(tmp_path / "a.mcap", *SAMPLES, TOPIC)
    truth = read_episode(tmp_path / "a.mcap").signals[TOPIC]
    episode = read_episode(write_poses_folder(tmp_path / "bag", *SAMPLES, TOPIC, mode=mode))
    assert np.array_equal(episode.signals[TOPIC].values, truth.values)
    assert np.array_equal(episode.signals[TOPIC].stamps_ns, truth.stamps_ns)
    assert not episode.losses
    assert [one for one in episode.warnings if "vouched" not in one] == []


def test_every_byte_is_that_of_rosbags(db3: Path):
    with Reader(db3.parent) as reader:
        theirs = [(one.topic, stamp, bytes(data)) for one, stamp, data in reader.messages()]
    records = list(read_db3(db3, []))
    ours = [one for one in records if isinstance(one, RawMessage)]
    assert [(one.channel.topic, one.log_ns, bytes(one.data)) for one in ours] == theirs
    assert all(one.channel.schema_encoding == "ros2msg" for one in ours)


def test_only_the_topics_asked_for_are_given(db3: Path):
    script = """
        INSERT INTO topics SELECT 9, '/other', type, serialization_format, '', '' FROM topics;
        INSERT INTO messages SELECT id + 10000, 9, timestamp, data FROM messages;
    """
    change(db3, script)
    found = [one for one in read_db3(db3, [], ("/other",)) if isinstance(one, RawMessage)]
    assert len(found) == COUNT
    assert {one.channel.topic for one in found} == {"/other"}


def test_bags_of_older_distributions_go_by_the_types_name(db3: Path):
    change(db3, "DROP TABLE message_definitions; DROP TABLE schema; DROP TABLE metadata; "
           "ALTER TABLE topics DROP COLUMN offered_qos_profiles")  # fmt: skip
    assert count(read_episode(db3)) == COUNT


def test_reading_leaves_no_trace(db3: Path):
    before = (db3.read_bytes(), db3.stat().st_mtime_ns, sorted(db3.parent.iterdir()))
    read_episode(db3)
    assert before == (db3.read_bytes(), db3.stat().st_mtime_ns, sorted(db3.parent.iterdir()))


def test_a_strange_name_is_a_name(db3: Path):
    path = db3.with_name("a?mode=rwc#b %20 'ü'.db3")
    db3.rename(path)
    assert count(read_episode(path)) == COUNT


def killed(db3: Path) -> Path:
    """What a recorder leaves that was killed: everything since the last checkpoint in a -wal."""
    change(db3, "PRAGMA journal_mode = WAL")
    path = db3.with_name("killed.db3")
    with closing(sqlite3.connect(db3)) as database:
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.execute(
            "INSERT INTO messages SELECT id + 10000, topic_id, timestamp + 9000000000, data "
            "FROM messages"
        )
        database.commit()
        shutil.copyfile(db3, path)
        shutil.copyfile(f"{db3}-wal", f"{path}-wal")
    return path


def test_what_a_killed_recorder_left_beside_it_is_read(db3: Path):
    path = killed(db3)
    before = sorted((one.name, one.stat().st_size) for one in path.parent.iterdir())
    episode = read_episode(path)
    assert episode.channels[0].messages == 2 * COUNT
    assert any("-wal" in one for one in episode.warnings)
    assert before == sorted((one.name, one.stat().st_size) for one in path.parent.iterdir())
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
        (
            f"{COPY} CREATE VIEW messages AS {ENDLESS} "
            "SELECT x AS id, 1 AS topic_id, x AS timestamp, zeroblob(9) AS data FROM n",
            "no plain table",
        ),
        (f"{COPY} CREATE VIRTUAL TABLE messages USING fts4(topic_id, timestamp, data)", "no plain"),
        (
            f"{COPY} CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, "
            "data AS (zeroblob(1000000000)))",
            "no plain column 'data'",
        ),
        (f"{COPY} CREATE TABLE messages(_rowid_, topic_id, timestamp, data)", "hides"),
        (COPY, "no table 'messages'"),
        ("DROP TABLE topics", "no table 'topics'"),
        ("ALTER TABLE messages DROP COLUMN topic_id", "no plain column 'topic_id'"),
    ],
    ids=["view", "recursive view", "virtual", "computed", "rowid", "none", "topics", "column"],
)
def test_a_hostile_schema_is_refused(db3: Path, script: str, says: str):
    change(db3, script)
    with pytest.raises(LogError, match=says) as caught:
        read_episode(db3)
    assert str(db3) in str(caught.value)


def test_values_of_another_type_are_counted(db3: Path):
    change(db3, """
        UPDATE messages SET timestamp = 'soon' WHERE id = 3;
        UPDATE messages SET data = 'text' WHERE id = 4;
        UPDATE messages SET topic_id = 1.5 WHERE id = 5;
        UPDATE messages SET topic_id = 77 WHERE id = 6;
        UPDATE messages SET timestamp = -1 WHERE id = 7;
        INSERT INTO topics VALUES (2, x'00', 'a/B', 'cdr', '', '');
    """)  # fmt: skip
    episode = read_episode(db3)
    assert count(episode) == COUNT - 5
    said = " ".join(episode.losses)
    assert "2 messages are damaged (the first: message 3" in said
    assert "2 messages belong to topics that nothing describes" in said
    assert "topic 2 is damaged" in said
    assert "1 damaged messages" in said


@pytest.mark.parametrize("count", [1, 5])
def test_missing_numbers_are_told(db3: Path, count: int):
    change(db3, f"DELETE FROM messages WHERE id BETWEEN 10 AND {9 + count}")
    assert any(one.startswith(f"{count} of its messages") for one in read_episode(db3).losses)


def test_cut_anywhere_it_is_a_shorter_episode(db3: Path):
    whole = db3.read_bytes()
    lengths = []
    for cut in [*range(100, len(whole), PAGE // 2), len(whole) - 1]:
        db3.write_bytes(whole[:cut])
        try:
            episode = read_episode(db3)
        except LogError:
            lengths.append(0)
            continue
        assert any("cut" in one for one in episode.losses)
        lengths.append(count(episode))
    assert lengths == sorted(lengths)
    assert lengths[-1] > COUNT - 30
    assert len(set(lengths)) > 5


def test_a_damaged_page_costs_that_page(db3: Path):
    whole = bytearray(db3.read_bytes())
    middle = len(whole) // PAGE // 2 * PAGE
    whole[middle : middle + PAGE] = bytes(PAGE)
    db3.write_bytes(bytes(whole))
    episode = read_episode(db3)
    assert COUNT - 60 < count(episode) < COUNT
    assert any("table messages: rows" in one for one in episode.losses)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    changes=st.lists(st.tuples(st.integers(0, 2**31), st.integers(1, 255)), min_size=1),
    in_schema=st.booleans(),
)
def test_changed_bytes_give_only_our_errors(db3: Path, tmp_path: Path, changes, in_schema: bool):
    whole = bytearray(db3.read_bytes())
    for place, bits in changes:
        whole[place % (5 * PAGE if in_schema else len(whole))] ^= bits
    (tmp_path / "changed.db3").write_bytes(bytes(whole))
    with suppress(TuneNetError):
        read_episode(tmp_path / "changed.db3")
    assert not list(tmp_path.glob("changed.db3-*"))


def test_pages_that_form_a_circle_do_not_take_hours(db3: Path):
    """The last pages of a tree's inner page name its first again."""
    whole = bytearray(db3.read_bytes())
    with closing(sqlite3.connect(db3)) as database:
        query = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ((root,),) = database.execute(query)
    at = (root - 1) * PAGE
    assert whole[at] == 5  # an inner page; behind its head, where its cells are
    cells = int.from_bytes(whole[at + 3 : at + 5], "big")
    for cell in range(cells):
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
    episode = read_episode(db3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 * 2**20
    assert count(episode) == COUNT - 1
    assert any("1 messages are damaged" in one for one in episode.losses)


def test_a_file_that_is_compressed_as_a_whole_is_read(tmp_path: Path):
    path = write_poses_folder(tmp_path / "bag", *SAMPLES, TOPIC, mode=CompressionMode.FILE)
    for log in (path, path.parent):
        assert np.array_equal(read_episode(log).signals[TOPIC].values, SAMPLES[1])


def test_a_database_of_something_else_is_refused(tmp_path: Path):
    change(tmp_path / "a.db3", "CREATE TABLE t(x)")
    with pytest.raises(LogError, match="no table 'topics'"):
        read_episode(tmp_path / "a.db3")
