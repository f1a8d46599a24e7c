"""`tunenet-logs info`, `check`, `recover`: what is in a log, whether it is whole, what is saved."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

import tunenet_logs as tn
from tests.conftest import BIN, ROOT, Command, Made, files_no_larger_than, real, record
from tests.strangers import Stranger, without_chunks, write_poses, write_poses_bag
from tunenet_logs.copying import check, import_log, recover
from tunenet_logs.describe import describe
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import csv_line, json_line, text_of
from tunenet_logs.formats.base import Loss, Record, one_by_one
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress
from tunenet_logs.writing.writer import EpisodeWriter

# A topic that ends lines, clears terminals, turns text around and closes JSON's quotes.
HOSTILE = '/a"b\\\n\x1b[2J\u202e\u2028{}'


def test_info_tells_what_is_in_a_log(process: Command, drop_log: Path):
    result = process("tunenet-logs", "info", drop_log)
    assert result.returncode == 0
    for fact in ("kind: drop", "/ball/pose", "PoseStamped", "400", "60.0 Hz", "restitution 0.7"):
        assert fact in result.stdout


def test_a_gap_is_seen_in_figures_and_on_the_timeline(tmp_path: Path):
    stamps, positions = Stranger(0.6, rate_hz=100, seconds=5.0).samples()
    keep = (np.arange(len(stamps)) < 200) | (np.arange(len(stamps)) >= 300)
    write_poses(tmp_path / "a.mcap", stamps[keep], positions[keep], "/ball")
    text = describe(tmp_path / "a.mcap", read_episode(tmp_path / "a.mcap"))
    assert "1 to 1.01 s" in text
    [line] = [one for one in text.splitlines() if one.startswith("  /ball |")]
    assert 8 <= line.split("|")[1].count(" ") <= 10
    assert "from 2023-11-14 22:13:20 UTC" in text
    for count in (0, 1):  # one message or none
        path = tmp_path / f"{count}.mcap"
        write_poses(path, stamps[:count], positions[:count])
        assert f"{count}" in describe(path, read_episode(path))


def test_channels_that_differ_by_a_number_are_one_row(drop_log: Path):
    stamps = np.arange(5) * 10**7
    topics = [f"{name}.episode{number}" for number in range(60) for name in ("action", "state")]
    topics += ["joint1", "joint2"]
    channels = tuple(Channel(one, "joints", "table", stamps) for one in topics)
    rows = describe(drop_log, Episode(EpisodeInfo(), {}, channels=channels)).splitlines()[2:6]
    assert [row.split()[0] for row in rows] == ["action.episode0", "state.episode0", *topics[-2:]]
    assert [row.endswith("yes, and 59 more like it") for row in rows] == [True, True, False, False]


# Whether a log is whole, and where it is not.
def test_whole_logs_pass(command: Command, drop_log: Path, filmed_log: Path, tmp_path: Path):
    result = command("tunenet-logs", "check", drop_log, filmed_log)
    assert result.returncode == 0, result.stdout
    assert result.stdout.count(": whole, ") == 2
    assert result.stderr == ""
    write_poses(tmp_path / "a.mcap", *Stranger(0.6).samples())  # without a checksum of all data
    result = command("tunenet-logs", "check", tmp_path / "a.mcap")
    assert result.returncode == 0
    assert "cannot be vouched for" in result.stdout


def test_damage_is_named_with_its_place(command: Command, drop_log: Path):
    data = bytearray(drop_log.read_bytes())
    at = data.index(b"zstd") + 2000
    data[at] ^= 1
    drop_log.write_bytes(bytes(data))
    result = command("tunenet-logs", "check", drop_log)
    assert result.returncode == 1
    [line] = [one for one in result.stdout.splitlines() if "chunk" in one]
    start, end = (int(word.strip("()")) for word in line.split() if word.strip("()").isdecimal())
    assert start < at < end


@pytest.mark.parametrize(
    ("change", "says"),
    [
        *((lambda data, share=share: data[: max(9, int(share * len(data)))], "")
          for share in (0.0, 0.3, 0.6, 0.999)),
        (lambda data: data + b"garbage", "bytes follow"),
        (lambda data: data + data, "another log follows"),
    ],
)  # fmt: skip
def test_what_is_cut_or_goes_on_behind_its_end_never_passes(
    drop_log: Path, command: Command, change: Callable[[bytes], bytes], says: str
):
    drop_log.write_bytes(change(drop_log.read_bytes()))
    result = command("tunenet-logs", "check", drop_log)
    assert result.returncode == 1
    assert says in result.stdout + result.stderr


def test_damaged_pictures_are_counted_and_one_bad_file_hides_no_other(
    command: Command, drop_log: Path, tmp_path: Path, filmed_log: Path
):
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo()) as writer:
        for number, frame in enumerate(read_episode(filmed_log).frames()):
            data = frame.data[:1000] if number in (3, 7) else frame.data
            writer.write_frame("/camera", Frame(frame.stamp_ns, "jpeg", data))
    [line] = check(tmp_path / "a.mcap", Progress(quiet=True)).damage
    assert "2 of" in line
    (tmp_path / "bad.mcap").write_bytes(b"nothing")
    result = command("tunenet-logs", "check", tmp_path / "bad.mcap", drop_log)
    assert result.returncode == 1
    assert f"{drop_log}: whole" in result.stdout
    assert result.stderr.count("\n") == 1


# As strict JSON, with the promised keys, of any log.
def strict(text: str) -> list[dict[str, Any]]:
    """Objects, one a line, of JSON as its standard has it."""

    def refuse(word: str) -> NoReturn:
        raise ValueError(word)

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def promised_keys(verb: str) -> set[str]:
    """The keys that docs/logs.md has in its list of a verb."""
    text = (ROOT / "docs" / "logs.md").read_text()
    section = text.split(f"`{verb} --json`:", 1)[1].split("\n\n", 2)[1]
    rows = [row.split(": ")[0] for row in section.splitlines() if row.startswith("- ")]
    return {key for row in rows for key in re.findall(r"`(\w+)`", row)}


def test_info_tells_a_script_what_it_tells_a_person(
    command: Command, drop_log: Path, tmp_path: Path
):
    [found] = strict(command("tunenet-logs", "info", drop_log, "--json").stdout)
    assert (found["log"], found["error"]) == (str(drop_log), None)
    assert found["bytes"] == drop_log.stat().st_size
    assert (found["kind"], found["truth"]["restitution"]) == ("drop", 0.7)
    [channel] = found["channels"]
    assert (channel["topic"], channel["messages"], channel["used"]) == ("/ball/pose", 400, True)
    assert channel["rate_hz"] == pytest.approx(60)
    assert found["duration_s"] == pytest.approx(399 / 60)
    stamps_ns = np.arange(100) * 10_000_000
    stamps_ns[50:] += 2 * 10**9
    write_poses(tmp_path / "gap.mcap", stamps_ns, np.zeros((100, 3)))
    [found] = strict(command("tunenet-logs", "info", tmp_path / "gap.mcap", "--json").stdout)
    [channel] = found["channels"]
    assert (channel["gaps"], channel["longest_gap_s"]) == (1, pytest.approx(2.01))


def test_check_tells_damage_with_the_exit_code(command: Command, drop_log: Path, tmp_path: Path):
    (tmp_path / "cut.mcap").write_bytes(drop_log.read_bytes()[:-500])
    result = command("tunenet-logs", "check", drop_log, tmp_path / "cut.mcap", "--json")
    whole, cut = strict(result.stdout)
    assert result.returncode == 1
    assert (whole["whole"], whole["damage"], whole["messages"]) == (True, [], 400)
    assert cut["whole"] is False
    assert cut["damage"]


@pytest.mark.parametrize("verb", ["info", "check"])
def test_the_keys_are_those_of_the_document(
    command: Command, drop_log: Path, tmp_path: Path, verb: str
):
    """Those of a log that cannot be read, too: a script needs no second way."""
    (tmp_path / "no.mcap").write_text("no log")
    result = command("tunenet-logs", verb, drop_log, tmp_path / "no.mcap", "--json")
    read, unread = strict(result.stdout)
    assert result.returncode == 1
    assert set(read) == set(unread) == promised_keys(verb)
    assert unread["error"] in result.stderr
    assert {key for key, value in unread.items() if value is not None} <= {"log", "error", "whole"}


@pytest.mark.parametrize(
    "name",
    [
        *("ros1/jaco2_6dof_bsd3.bag", "ros1/jaco2_no_effort.bag", "labs/markers_analogs.c3d"),
        *("labs/tracker_multi_data.txt", "mcap_rosbag2/cdr_test_cdr_test_0.mcap"),
        *("mcap_conformance/NoData.mcap", "labs/lerobot_episode.parquet"),
    ],
)
def test_files_of_strangers_give_the_promised_keys(command: Command, name: str):
    for verb in ("info", "check"):
        [found] = strict(command("tunenet-logs", verb, real(name), "--json").stdout)
        assert set(found) == promised_keys(verb)


def test_names_that_attack_are_data_and_no_number_is_nan(command: Command, tmp_path: Path):
    path = tmp_path / os.fsdecode(b"\xff\x1b[31m\n.mcap")
    write_poses(path, np.arange(10) * 10**7, np.zeros((10, 3)), topic=HOSTILE)
    for verb in ("info", "check"):
        text = command("tunenet-logs", verb, path, "--json").stdout
        assert text.isascii()
        assert text.removesuffix("\n").isprintable()
        [found] = strict(text)
        assert os.fsencode(found["log"]) == os.fsencode(path)
        assert verb == "check" or found["channels"][0]["topic"] == HOSTILE
    line = json_line({"a": float("nan"), "b": [np.float64("inf"), np.int64(3)], "c": {"d": -0.5}})
    assert strict(line) == [{"a": None, "b": [None, 3], "c": {"d": -0.5}}]


# No cell of a table of ours is a formula, and each is read back as it was.
TEXTS = [
    '=HYPERLINK("http://example.org/?"&A1,"click")', "=1+1", "+1+1", "-1+1", "-", "@SUM(A1)",
    "\t=1", "\r=1", "\n=1", " =1", "'=1", "''=1", "\ufeff=1", "\uff1d1", "\0=1",
    "it's", "'quoted'", "a,b", "a;=1", 'say "x"', "two\nlines", "", "drop.mcap", "/ball", "1/2",
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_inert_and_comes_back(text: str):
    (cell,) = csv.reader(csv_line([text]).splitlines(keepends=True)) if text else ([""],)
    assert cell[0].lstrip(" \t\r\n\0\ufeff")[:1] not in (*"=+-@", "\uff1d")
    assert cell[0][:1] not in ("\t", "\r", "\n")
    assert text_of(cell[0]) == text


def test_numbers_stay_numbers_and_the_name_of_a_log_is_no_formula(tmp_path: Path, command: Command):
    line = csv_line([-1, -0.5, np.float64(-2e-7), "-1.5", "+3", "1e-5", None, float("nan"), True])
    assert line == "-1,-0.5,-2e-07,-1.5,+3,1e-5,,,True\n"
    record(tmp_path / "=1+1.mcap", restitution=0.7, height_m=1.0)
    tune = ("tunenet-tune", ".", "-o", "out", "--csv", "all.csv", "--no-review")
    for words in (tune, ("tunenet-compare", "out", "--csv", "compared.csv")):
        done = command(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    for name in ("all.csv", "compared.csv"):
        with (tmp_path / name).open(newline="") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert not any(cell.startswith("=") for cell in cells)
    assert "=1+1.mcap" in map(text_of, cells)


# How far work is: told where it is done, heard by whoever listens.
def test_a_film_tells_its_stages_to_a_function():
    heard: list[tuple[str, float]] = []
    film = ROOT / "sample_logs" / "filmed.mcap"
    tn.tune(film, progress=lambda what, fraction: heard.append((what, fraction)))
    assert list(dict.fromkeys(what for what, _ in heard))[:4] == [
        "reading", "decoding the pictures", "finding what moves", "following the ball",
    ]  # fmt: skip
    assert all(0 <= fraction <= 1 for _, fraction in heard)


# What is whole of a damaged log is saved, and opens everywhere; nothing is changed in place.
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
    assert summary.statistics.message_count > recovered.messages  # with those that draw it
    with AnyReader([saved]) as bag:
        poses = [one for one in bag.connections if one.topic == "/ball/pose"]
        assert sum(1 for _ in bag.messages(poses)) == recovered.messages
    convert = [BIN / "rerun", "mcap", "convert", saved, "-o", tmp_path / "a.rrd"]
    subprocess.run(convert, check=True, capture_output=True, timeout=60)


@pytest.mark.parametrize("place", ["chunk", "length"])
def test_a_broken_chunk_costs_its_own_messages_alone(long: Path, tmp_path: Path, place: str):
    data, path = bytearray(long.read_bytes()), tmp_path / "a.mcap"
    if place == "chunk":
        data[data.index(b"zstd", len(data) // 2) + 100] ^= 4
    else:  # of the first chunk
        data[data.index(b"\x04\x00\x00\x00zstd") - 37 + 1 + 6] ^= 0x40
    path.write_bytes(bytes(data))
    recovered = recover(path, tmp_path / "saved.mcap")
    truth, found = ball(long), ball(tmp_path / "saved.mcap")
    says = ("chunk", "messages are missing") if place == "chunk" else ("found again",)
    assert all(any(one in loss for loss in recovered.losses) for one in says), recovered.losses
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
