"""What a log costs is bounded by its size, in records, channels, places of damage and pixels."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests import definition_bombs, work_bombs
from tests.conftest import BIN
from tests.hostile import HEADER, MAGIC, chunk, spent, write_pictures
from tests.strangers import (
    Stranger,
    without_chunks,
    write_poses,
    write_poses_bag,
    write_poses_folder,
)
from tests.work_bombs import db3_of, described, jpeg_of_scans, message, png_of_words, record
from tunenet_logs import reader, video
from tunenet_logs.cli import main
from tunenet_logs.copying import check
from tunenet_logs.errors import LogError
from tunenet_logs.formats import base as budget
from tunenet_logs.formats import decoders
from tunenet_logs.formats import registry as ros2_folder
from tunenet_logs.formats.base import Loss, RawChannel, RawMessage, Record, one_by_one
from tunenet_logs.formats.columns import cells as lines
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.formats.registry import read_folder
from tunenet_logs.formats.rosbag1 import read_bag
from tunenet_logs.formats.rosbag2 import read_db3
from tunenet_logs.images import image_size, image_work_px
from tunenet_logs.messages import POSE, encode, pose
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress

MAX_CPU_S, MAX_KIB = 30.0, 500_000  # of one command; three times the CPU that the slowest takes
SAMPLES = Stranger(0.7).samples()
DATA = encode(pose(0, "map", np.zeros(3)), POSE)
COMMANDS = {
    "info": ("tunenet-logs", "info", "{}"),
    "check": ("tunenet-logs", "check", "{}"),
    "recover": ("tunenet-logs", "recover", "{}", "-o", "saved.mcap"),
    "tune": ("tunenet-tune", "{}", "-o", "tuned"),
}
# Those that are made and met in a moment, and took the longest.
QUICK = (
    "zeros_in_chunks", "tiny_records_in_chunks", "zeros_behind_the_magic", "damaged_records",
    "many_types", "false_chunks", "many_scans", "packed_words_png", "unclosed_texts",
    "protobuf_channels",
)  # fmt: skip


BOMBS = (*work_bombs.BOMBS, *definition_bombs.BOMBS)


def met(bomb: Callable[[Path], None], folder: Path, command: str) -> None:
    path = folder / ("bomb.csv" if bomb.__name__ == "empty_lines" else "bomb.mcap")
    bomb(path)
    program, *words = COMMANDS[command]
    told = spent([str(BIN / program), *(word.format(path) for word in words)], folder)
    assert "Traceback" not in told.said
    assert told.code in (0, 1), told.said
    assert told.cpu_s < MAX_CPU_S
    assert told.peak_kib < MAX_KIB
    assert told.said.count("\n") < 250


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("bomb", BOMBS, ids=lambda one: one.__name__)
def test_a_bomb_takes_little(tmp_path: Path, bomb: Callable[[Path], None], command: str):
    met(bomb, tmp_path, command)


@pytest.mark.parametrize("bomb", [one for one in BOMBS if one.__name__ in QUICK],
                         ids=lambda one: one.__name__)  # fmt: skip
def test_a_small_bomb_takes_little(tmp_path: Path, bomb: Callable[[Path], None]):
    met(bomb, tmp_path, "check")


def read(container: Callable, path: Path, **more: object) -> tuple[list[Record], list[Loss]]:
    losses: list[Loss] = []
    return list(container(path, losses, **more)), losses


def messages(records: list[Record]) -> int:
    return sum(isinstance(one, RawMessage) for one in one_by_one(records))


def test_zeros_are_said_once_and_what_follows_is_read(tmp_path: Path):
    path, said = tmp_path / "a.mcap", described(1) + message(0, DATA)
    path.write_bytes(MAGIC + HEADER + said + bytes(4096) + said + bytes(100_000))
    begin = len(MAGIC + HEADER + said)
    records, losses = read(read_mcap, path)
    assert messages(records) == 2
    zeros = [one for one in losses if "zeros" in one.what]
    assert [(one.at_byte, one.size) for one in zeros] == [
        (begin, 4096),
        (begin + 4096 + len(said), 100_000),
    ]


def test_zeros_in_a_chunk_are_said_once_and_what_follows_is_read(tmp_path: Path):
    path = tmp_path / "a.mcap"
    inside = message(0, DATA) + bytes(5000) + message(0, DATA)
    path.write_bytes(MAGIC + HEADER + described(1) + chunk(b"", len(inside), inside))
    records, losses = read(read_mcap, path)
    assert messages(records) == 2
    (zeros,) = [one.what for one in losses if "zeros" in one.what]
    assert zeros == "5000 bytes of a chunk are zeros"


def write_db3(path: Path) -> None:
    db3_of(path, 1, 5000, DATA)


def write_bag(path: Path) -> None:
    write_poses_bag(path, *SAMPLES)


def write_mcap(path: Path) -> None:
    write_poses(path.with_name("packed"), *SAMPLES)
    without_chunks(path.with_name("packed"), path)


KINDS = {
    "mcap": (read_mcap, write_mcap),
    "bag": (read_bag, write_bag),
    "db3": (read_db3, write_db3),
}


@pytest.mark.parametrize("kind", KINDS)
def test_reading_stops_where_a_log_has_far_more_records_than_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
):
    container, write = KINDS[kind]
    write(tmp_path / "a")
    every, losses = read(container, tmp_path / "a")
    assert not any("stopped" in one.what for one in losses)
    monkeypatch.setattr(budget, "_FREE_RECORDS", 450)
    monkeypatch.setattr(budget, "_BYTES_A_RECORD", 10**9)
    some, losses = read(container, tmp_path / "a")
    assert 0 < messages(some) < messages(every)
    (why,) = [one.what for one in losses if "stopped" in one.what]
    assert "far more records" in why
    assert "left out" in why


@pytest.mark.parametrize("kind", KINDS)
def test_an_honest_log_uses_a_small_part_of_its_budget(tmp_path: Path, kind: str):
    container, write = KINDS[kind]
    write(tmp_path / "a")
    whole = budget.Budget((tmp_path / "a").stat().st_size)
    read(container, tmp_path / "a", budget=whole)
    assert 0 < whole.spent_records < whole.file_bytes / 15  # and a fourth of it is free


def write_channels(path: Path, count: int) -> None:
    path.write_bytes(MAGIC + HEADER + described(count))


def write_connections(path: Path, count: int) -> None:
    path.write_bytes(work_bombs.BAG + b"".join(map(work_bombs.bag_connection, range(count))))


@pytest.mark.parametrize(
    ("container", "write"),
    [
        (read_mcap, write_channels),
        (read_bag, write_connections),
        (read_db3, partial(db3_of, messages=1)),
    ],
)
def test_channels_beyond_any_log_are_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, container: Callable, write: Callable
):
    monkeypatch.setattr(budget, "MAX_CHANNELS", 20)
    write(tmp_path / "a", 20)
    records, losses = read(container, tmp_path / "a")
    assert sum(isinstance(one, RawChannel) for one in records) == 20
    assert not any("stopped" in one.what for one in losses)
    write(tmp_path / "b", 21)
    records, losses = read(container, tmp_path / "b")
    assert sum(isinstance(one, RawChannel) for one in records) <= 20
    assert any("over 20 channels" in one.what for one in losses)


def test_damaged_places_are_kept_within_the_budget(tmp_path: Path):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + HEADER + record(3) * 200_000)
    _, losses = read(read_mcap, path)
    most = (250_000 + path.stat().st_size / 4) / budget.DAMAGE_RECORDS
    assert 1000 < len(losses) <= most + 2


def test_a_chunk_that_is_found_again_and_again_is_looked_for_from_near(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from tunenet_logs.formats import mcap

    looked: list[int] = []
    blocks = mcap._McapReading._blocks

    def counted(self: mcap._McapReading):
        for block in blocks(self):
            looked.append(len(block))
            yield block

    monkeypatch.setattr(mcap._McapReading, "_blocks", counted)
    path = tmp_path / "a.mcap"
    begin = struct.pack("<BQQQQII", 6, 40, 0, 1, 0, 0, 4) + b"zstd" + b"\xff" * 40
    path.write_bytes(MAGIC + HEADER + begin * 2000 + bytes(1_000_000))
    read(read_mcap, path)
    assert sum(looked) < 20_000_000  # a megabyte each time would be two gigabytes


def test_metadata_of_too_many_words_is_damaged(tmp_path: Path):
    path = tmp_path / "a.mcap"
    work_bombs.long_metadata(path)
    _, losses = read(read_mcap, path)
    assert any("over 20000 parts" in one.what for one in losses)


def test_files_of_a_folder_share_one_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "bag"
    write_poses_folder(folder, *SAMPLES)
    (first,) = folder.glob("*.db3")
    first.rename(folder / "bag_0.db3")
    (folder / "bag_1.db3").write_bytes((folder / "bag_0.db3").read_bytes())
    every, _ = read(read_folder, folder)
    monkeypatch.setattr(budget, "_FREE_RECORDS", messages(every) * 3 // 4)
    monkeypatch.setattr(budget, "_BYTES_A_RECORD", 10**9)
    some, losses = read(read_folder, folder)
    assert messages(every) / 2 < messages(some) < messages(every)
    assert [one.file for one in losses if "stopped" in one.what] == ["bag_1.db3"]
    monkeypatch.setattr(ros2_folder, "_MAX_PARTS", 1)
    with pytest.raises(LogError, match="over 1 files"):
        read(read_folder, folder)


def test_scans_of_a_jpeg_are_counted():
    usual, many = jpeg_of_scans(1, side_px=200), jpeg_of_scans(30, side_px=200)
    assert image_work_px(usual) == 40_000
    assert 100_000 < image_work_px(many) < 200_000
    with pytest.raises(LogError, match="over 50 scans"):
        image_size(jpeg_of_scans(60, side_px=200))


def test_packed_words_of_a_png_are_counted():
    assert image_size(png_of_words(10)) == (1000, 1000)
    with pytest.raises(LogError, match="packed words"):
        image_size(png_of_words(20))


def test_pictures_are_paid_for_by_the_bytes_of_their_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "a.mcap"
    write_pictures(path, jpeg_of_scans(1, side_px=200), count=20)
    assert len(list(read_episode(path).frames())) == 20
    monkeypatch.setattr(reader, "_FREE_PIXELS", 400_000)
    monkeypatch.setattr(reader, "_PIXELS_A_BYTE", 0)
    frames = read_episode(path).frames()
    assert [next(frames).size_px() for _ in range(10)] == [(200, 200)] * 10
    with pytest.raises(LogError, match="far more pixels"):
        next(frames)


def test_cameras_share_the_pixels_of_their_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.mcap"
    write_pictures(path, jpeg_of_scans(1, side_px=200), count=20, topics=2)
    monkeypatch.setattr(reader, "_FREE_PIXELS", 400_000)
    monkeypatch.setattr(reader, "_PIXELS_A_BYTE", 0)
    health = check(path, Progress(quiet=True))
    assert [line for line in health.damage if "reading ends after 5 of 10" in line] == [
        line for line in health.damage if "/eye" in line
    ]


def test_cameras_of_many_messages_are_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.mcap"
    write_pictures(path, jpeg_of_scans(1, side_px=64), count=40, topics=20, others=100)
    assert len(read_episode(path).picture_topics) == 20
    monkeypatch.setattr(reader, "_FREE_MESSAGES", 1000)
    episode = read_episode(path)
    assert len(episode.picture_topics) == 8
    assert any("12 channels were left out" in line for line in episode.warnings)


def test_a_film_of_far_more_pixels_than_its_bytes_pay_for_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "a.gif"
    head = b"GIF89a" + struct.pack("<HHBBB", 100, 100, 0x80, 0, 0) + bytes(6)
    frame = b"\x21\xf9\x04\0\4\0\0\0\x2c" + struct.pack("<HHHHB", 0, 0, 1, 1, 0)
    path.write_bytes(head + (frame + b"\2\2\x44\1\0") * 50 + b"\x3b")
    assert len(list(read_episode(path).frames())) == 50
    monkeypatch.setattr(video, "FREE_VIDEO_PIXELS", 10_000)
    monkeypatch.setattr(video, "VIDEO_PIXELS_A_BYTE", 1)
    with pytest.raises(LogError, match="far more pixels than a film of its size"):
        read_episode(path)


@pytest.mark.parametrize("count", [1, 100])
def test_a_definition_of_many_channels_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
):
    made: list[str] = []
    usual = decoders.listed_type

    def counted(channel: RawChannel):
        made.append(channel.topic)
        return usual(channel)

    monkeypatch.setattr(decoders, "listed_type", counted)
    write_channels(tmp_path / "a.mcap", count)
    assert len(read_episode(tmp_path / "a.mcap").channels) == count
    assert made == ["/ch0"]


def test_definitions_beyond_any_log_are_not_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(budget, "_MAX_DEFINITION_BYTES", 10_000)
    schemas = [b"float64 x\n" * 100] * 20
    definition_bombs.channels_of(tmp_path / "a", 20, b"a/msg/T", b"cdr", schemas)
    _, losses = read(read_mcap, tmp_path / "a")
    assert any("10000 bytes of definitions" in one.what for one in losses)


def test_empty_lines_are_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.csv"
    path.write_text("t,z\n" + "\n" * 2000 + "1,2\n")
    monkeypatch.setattr(lines, "_MAX_LINES", 1000)
    with pytest.raises(LogError, match="over 1000 lines"):
        read_episode(path)


def test_of_very_much_damage_the_first_is_said(tmp_path: Path, capsys: pytest.CaptureFixture):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + HEADER + described(1) + message(0, DATA) + record(3) * 500)
    assert main(["check", str(path)]) == 1
    said = capsys.readouterr().out
    assert said.count("  damage: ") == 101
    assert "  damage: and 401 more\n" in said
