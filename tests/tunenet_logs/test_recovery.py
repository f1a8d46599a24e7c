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

from tests.conftest import BIN, Command, Made, files_no_larger_than, record
from tests.strangers import Stranger, without_chunks, write_poses_bag
from tunenet_logs.copying import import_log, recover
from tunenet_logs.episode import Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.base import Loss, Record, one_by_one
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.reader import read_episode

ORDER = {"restitution": 0.8, "height_m": 1.0, "seconds": 8.0, "rate_hz": 500.0, "noise_m": 0.001}


@pytest.fixture
def long(made: Made) -> Path:
    """A log of several chunks."""
    return made("long.mcap", lambda path: record(path, **ORDER))


@pytest.fixture
def cut(long: Path, tmp_path: Path) -> Path:
    path = tmp_path / "cut.mcap.active"
    path.write_bytes(long.read_bytes()[: int(0.8 * long.stat().st_size)])
    return path


def ball(path: Path) -> Signal:
    return read_episode(path).signals["/ball/pose"]


def test_a_cut_log_opens_everywhere_once_it_is_recovered(long: Path, cut: Path, tmp_path: Path):
    before, saved = cut.read_bytes(), tmp_path / "saved.mcap"
    recovered = recover(cut, saved)
    assert cut.read_bytes() == before
    assert "end of the file is missing" in recovered.losses[0]
    truth, found = ball(long).values, ball(saved).values
    assert 0.5 * len(truth) < len(found) == recovered.messages < len(truth)
    assert np.array_equal(found, truth[: len(found)])
    episode = read_episode(saved)
    assert not episode.warnings
    assert episode.info.counts["written"] == recovered.messages
    assert "did not end" in episode.info.notes["ended"]
    assert episode.info.kind == "drop"
    with saved.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == recovered.messages
    with AnyReader([saved]) as bag:
        assert sum(1 for _ in bag.messages()) == recovered.messages
    convert = [BIN / "rerun", "mcap", "convert", saved, "-o", tmp_path / "a.rrd"]
    subprocess.run(convert, check=True, capture_output=True, timeout=60)


@pytest.mark.parametrize("place", ["chunk", "length"])
def test_a_broken_chunk_costs_its_own_messages_alone(long: Path, tmp_path: Path, place: str):
    data, path = bytearray(long.read_bytes()), tmp_path / "a.mcap"
    if place == "chunk":
        data[len(data) // 2] ^= 4
    else:  # of the first chunk
        data[data.index(b"\x04\x00\x00\x00zstd") - 37 + 1 + 6] ^= 0x40
    path.write_bytes(bytes(data))
    recovered = recover(path, tmp_path / "saved.mcap")
    truth, found = ball(long), ball(tmp_path / "saved.mcap")
    says = ("chunk", "messages are missing") if place == "chunk" else ("found again",)
    assert all(any(one in loss for loss in recovered.losses) for one in says)
    assert len(found.values) > 0.4 * len(truth.values)
    assert np.array_equal(truth.values[np.isin(truth.stamps_ns, found.stamps_ns)], found.values)


def test_the_messages_of_a_cut_chunk_are_saved_where_it_is_not_packed(long: Path, tmp_path: Path):
    plain, path = tmp_path / "plain.mcap", tmp_path / "cut.mcap"
    without_chunks(long, plain, chunks=True)
    whole = plain.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])  # in the first of its chunks
    recovered = recover(path, tmp_path / "saved.mcap")
    truth, found = ball(long).values, ball(tmp_path / "saved.mcap").values
    assert len(found) == recovered.messages > 0.2 * len(truth)
    assert np.array_equal(found, truth[: len(found)])
    assert read_episode(path).tainted
    path.write_bytes(whole[: len(whole) // 3] + bytes(4096))  # as a file system leaves it
    with pytest.raises(LogError, match="end of the file"):
        read_episode(path)


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


def test_nothing_that_is_there_is_written_to(drop_log: Path, tmp_path: Path):
    before, other, ours = drop_log.read_bytes(), tmp_path / "other.mcap", tmp_path / "ours.mcap"
    (tmp_path / "link.mcap").symlink_to(drop_log)
    other.write_bytes(b"mine")
    recover(drop_log, ours)
    for output, overwrite, says in (
        (drop_log, True, "the log itself"),
        (tmp_path / "link.mcap", True, "the log itself"),
        (other, False, "is no log that tunenet-logs wrote; move it away"),
        (other, True, "is no log that tunenet-logs wrote; move it away"),
        (ours, False, "--overwrite"),
        (tmp_path / "other.bag", False, r"\.mcap"),
    ):
        with pytest.raises(UsageError, match=says):
            recover(drop_log, output, overwrite=overwrite)
    assert other.read_bytes() == b"mine"
    assert drop_log.read_bytes() == before
    (tmp_path / "cut.mcap").write_bytes(before[:100])  # nothing to save
    with pytest.raises(LogError, match="no message"):
        recover(tmp_path / "cut.mcap", tmp_path / "saved.mcap")
    assert not (tmp_path / "saved.mcap").exists()
    assert not list(tmp_path.glob("*.partial"))


def test_the_command(command: Command, cut: Path):
    words = ("recover", cut.name, "-o", "saved.mcap")
    result = command("tunenet-logs", *words, cwd=cut.parent)
    assert result.returncode == 0
    assert f"messages saved from {cut.name}" in result.stdout
    assert "lost: the end of the file is missing" in result.stdout
    assert command("tunenet-logs", "check", "saved.mcap", cwd=cut.parent).returncode == 0
    said = " ".join(command("tunenet-logs", "recover", "--help").stdout.split())
    assert "1 nothing could be saved" in said
    assert "Messages of ROS 1 stay what they are" in said


def test_the_messages_of_a_ros_1_bag_stay_and_that_is_said(command: Command, tmp_path: Path):
    samples = Stranger(0.6).samples()
    write_poses_bag(tmp_path / "a.bag", *samples)
    assert recover(tmp_path / "a.bag", tmp_path / "saved.mcap").holds_ros1
    result = command("tunenet-logs", "recover", "a.bag", "-o", "again.mcap", cwd=tmp_path)
    assert result.returncode == 0
    assert "still those of ROS 1" in result.stdout
    assert "tunenet-logs import" in result.stdout
    with pytest.raises(Exception, match="ros2"), AnyReader([tmp_path / "again.mcap"]):
        pass
    import_log(tmp_path / "again.mcap", tmp_path / "imported.mcap")
    with AnyReader([tmp_path / "imported.mcap"]) as bag:
        assert bag.message_count == len(samples[0])


@pytest.mark.parametrize("limit", [10, 20_000, None])
def test_a_disk_that_is_full_is_told_from_one_that_cannot_be_read(
    long: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int | None
):
    def failing(path: Path, losses: list[Loss]) -> Iterator[Record]:
        records = one_by_one(read_mcap(path, losses))
        yield from (next(records) for _ in range(20))
        raise OSError(errno.EIO, "Input/output error", str(path))

    says = f"{tmp_path / 'b.mcap'}: cannot be written (File too large); choose another place with"
    if limit is None:
        monkeypatch.setattr("tunenet_logs.copying.open_log", lambda _path: failing)
        says = f"{long}: cannot be read (Input/output error); copy it"
    with files_no_larger_than(limit or 10**9), pytest.raises(LogError) as caught:
        recover(long, tmp_path / "b.mcap")
    assert str(caught.value).startswith(says)
    assert not list(tmp_path.iterdir())
