"""What is whole of a damaged log is saved, and opens everywhere; nothing is changed in place."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from tests import strangers
from tests.conftest import BIN, Command, files_no_larger_than, record
from tests.strangers import without_chunks
from tunenet_logs.copying import import_log, recover
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.base import Loss, Record, one_by_one
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.reader import read_episode


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of several chunks."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    return record(path, restitution=0.8, height_m=1.0, seconds=8.0, rate_hz=500.0, noise_m=0.001)


def test_a_cut_log_opens_everywhere_once_it_is_recovered(long: Path, tmp_path: Path):
    cut, saved = tmp_path / "cut.mcap.active", tmp_path / "saved.mcap"
    cut.write_bytes(long.read_bytes()[: int(0.8 * long.stat().st_size)])
    before = cut.read_bytes()
    recovered = recover(cut, saved)
    assert cut.read_bytes() == before
    assert "end of the file is missing" in recovered.losses[0]
    truth = read_episode(long).signals["/ball/pose"].values
    ball = read_episode(saved).signals["/ball/pose"].values
    assert 0.5 * len(truth) < len(ball) == recovered.messages < len(truth)
    assert np.array_equal(ball, truth[: len(ball)])
    assert not read_episode(saved).warnings
    with saved.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == recovered.messages
    with AnyReader([saved]) as bag:
        assert sum(1 for _ in bag.messages()) == recovered.messages
    convert = [BIN / "rerun", "mcap", "convert", saved, "-o", tmp_path / "a.rrd"]
    subprocess.run(convert, check=True, capture_output=True, timeout=60)


def test_the_log_says_how_many_it_holds_and_that_it_was_recovered(long: Path, tmp_path: Path):
    (tmp_path / "cut.mcap").write_bytes(long.read_bytes()[: int(0.8 * long.stat().st_size)])
    recovered = recover(tmp_path / "cut.mcap", tmp_path / "saved.mcap")
    info = read_episode(tmp_path / "saved.mcap").info
    assert info.counts["written"] == recovered.messages
    assert "did not end" in info.notes["ended"]
    assert info.kind == "drop"


def test_a_broken_chunk_costs_its_own_messages_alone(long: Path, tmp_path: Path):
    data = bytearray(long.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "a.mcap").write_bytes(bytes(data))
    recovered = recover(tmp_path / "a.mcap", tmp_path / "saved.mcap")
    truth = read_episode(long).signals["/ball/pose"]
    ball = read_episode(tmp_path / "saved.mcap").signals["/ball/pose"]
    assert any("chunk" in loss for loss in recovered.losses)
    assert any("messages are missing" in loss for loss in recovered.losses)
    assert len(ball.values) > 0.4 * len(truth.values)
    kept = np.isin(truth.stamps_ns, ball.stamps_ns)
    assert np.array_equal(truth.values[kept], ball.values)


def test_what_follows_a_broken_length_is_found_again(long: Path, tmp_path: Path):
    data = bytearray(long.read_bytes())
    at = data.index(b"\x04\x00\x00\x00zstd") - 37 + 1  # the first chunk's length
    data[at + 6] ^= 0x40
    (tmp_path / "a.mcap").write_bytes(bytes(data))
    recovered = recover(tmp_path / "a.mcap", tmp_path / "saved.mcap")
    assert any("found again" in loss for loss in recovered.losses)
    assert recovered.messages > 0.4 * len(read_episode(long).signals["/ball/pose"].values)


def test_the_messages_of_a_cut_chunk_are_saved_where_it_is_not_packed(long: Path, tmp_path: Path):
    without_chunks(long, tmp_path / "plain.mcap", chunks=True)
    whole = (tmp_path / "plain.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 3])  # in the first of its chunks
    recovered = recover(tmp_path / "cut.mcap", tmp_path / "saved.mcap")
    truth = read_episode(long).signals["/ball/pose"].values
    ball = read_episode(tmp_path / "saved.mcap").signals["/ball/pose"].values
    assert len(ball) == recovered.messages > 0.2 * len(truth)
    assert np.array_equal(ball, truth[: len(ball)])
    assert read_episode(tmp_path / "cut.mcap").tainted
    zeros = whole[: len(whole) // 3] + bytes(4096)  # as a file system leaves it
    (tmp_path / "cut.mcap").write_bytes(zeros)
    with pytest.raises(LogError, match="end of the file"):
        read_episode(tmp_path / "cut.mcap")


def test_unknown_messages_and_attachments_are_copied_untouched(tmp_path: Path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("custom")
        schema = writer.register_schema("Thing", "flatbuffer", b"\x00\x01")
        channel = writer.register_channel("/thing", "flatbuffer", schema, {"qos": "best"})
        writer.add_message(channel, 5, b"payload", 4, 3)
        writer.add_attachment(1, 2, "../../etc/passwd", "text/plain", b"harmless")
        writer.add_metadata("mine", {"a": "b"})
        writer.finish()
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    with (tmp_path / "b.mcap").open("rb") as file:
        reader = make_reader(file)
        [(found, described, message)] = list(reader.iter_messages())
        assert found is not None
        assert (found.name, found.encoding, found.data) == ("Thing", "flatbuffer", b"\x00\x01")
        assert (described.topic, described.metadata) == ("/thing", {"qos": "best"})
        assert (message.data, message.publish_time, message.sequence) == (b"payload", 4, 3)
        [attachment] = list(reader.iter_attachments())
        assert (attachment.name, attachment.data) == ("../../etc/passwd", b"harmless")
        assert "mine" in {one.name for one in reader.iter_metadata()}
    assert {one.name for one in tmp_path.iterdir()} == {"a.mcap", "b.mcap"}


def test_the_log_itself_is_never_written_to(drop_log: Path, tmp_path: Path):
    before = drop_log.read_bytes()
    (tmp_path / "link.mcap").symlink_to(drop_log)
    for output in (drop_log, tmp_path / "link.mcap"):
        with pytest.raises(UsageError, match="the log itself"):
            recover(drop_log, output, overwrite=True)
    other = tmp_path / "other.mcap"
    other.write_bytes(b"mine")
    for overwrite in (False, True):
        with pytest.raises(UsageError, match="is no log that tunenet-logs wrote; move it away"):
            recover(drop_log, other, overwrite=overwrite)
    ours = tmp_path / "ours.mcap"
    recover(drop_log, ours)
    with pytest.raises(UsageError, match="--overwrite"):
        recover(drop_log, ours)
    with pytest.raises(UsageError, match=r"\.mcap"):
        recover(drop_log, tmp_path / "other.bag")
    assert other.read_bytes() == b"mine"
    assert drop_log.read_bytes() == before


def test_a_log_with_nothing_to_save_leaves_nothing(tmp_path: Path, drop_log: Path):
    (tmp_path / "cut.mcap").write_bytes(drop_log.read_bytes()[:100])
    with pytest.raises(LogError, match="no message"):
        recover(tmp_path / "cut.mcap", tmp_path / "saved.mcap")
    assert not (tmp_path / "saved.mcap").exists()
    assert not list(tmp_path.glob("*.partial"))


def test_the_command(command: Command, long: Path, tmp_path: Path):
    (tmp_path / "cut.mcap").write_bytes(long.read_bytes()[: int(0.8 * long.stat().st_size)])
    result = command("tunenet-logs", "recover", "cut.mcap", "-o", "saved.mcap", cwd=tmp_path)
    assert result.returncode == 0
    assert "messages saved from cut.mcap" in result.stdout
    assert "lost: the end of the file is missing" in result.stdout
    assert command("tunenet-logs", "check", "saved.mcap", cwd=tmp_path).returncode == 0


def test_the_messages_of_a_ros_1_bag_stay_and_that_is_said(command: Command, tmp_path: Path):
    strangers.write_poses_bag(tmp_path / "a.bag", *strangers.Stranger(0.6).samples())
    assert recover(tmp_path / "a.bag", tmp_path / "saved.mcap").holds_ros1
    result = command("tunenet-logs", "recover", "a.bag", "-o", "again.mcap", cwd=tmp_path)
    assert result.returncode == 0
    assert "still those of ROS 1" in result.stdout
    assert "tunenet-logs import" in result.stdout
    with pytest.raises(Exception, match="ros2"), AnyReader([tmp_path / "again.mcap"]):
        pass
    import_log(tmp_path / "again.mcap", tmp_path / "imported.mcap")
    with AnyReader([tmp_path / "imported.mcap"]) as bag:
        assert bag.message_count == len(strangers.Stranger(0.6).samples()[0])


def test_the_help_says_what_to_expect(command: Command):
    said = " ".join(command("tunenet-logs", "recover", "--help").stdout.split())
    assert "1 nothing could be saved" in said
    assert "Messages of ROS 1 stay what they are" in said


@pytest.mark.parametrize("limit", [10, 20_000])
def test_a_disk_that_is_full_is_told_from_one_that_cannot_be_read(
    long: Path, tmp_path: Path, limit: int
):
    with files_no_larger_than(limit), pytest.raises(LogError) as caught:
        recover(long, tmp_path / "b.mcap")
    why = "cannot be written (File too large); choose another place with -o"
    assert str(caught.value) == f"{tmp_path / 'b.mcap'}: {why}"
    assert not list(tmp_path.iterdir())


def test_a_disk_that_cannot_be_read_is_told_from_one_that_is_full(
    long: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def failing(path: Path, losses: list[Loss]) -> Iterator[Record]:
        records = one_by_one(read_mcap(path, losses))
        yield from (next(records) for _ in range(20))
        raise OSError(errno.EIO, "Input/output error", str(path))

    monkeypatch.setattr("tunenet_logs.copying.open_log", lambda _path: failing)
    with pytest.raises(LogError) as caught:
        recover(long, tmp_path / "b.mcap")
    assert str(caught.value).startswith(f"{long}: cannot be read (Input/output error); copy it")
    assert not list(tmp_path.iterdir())
