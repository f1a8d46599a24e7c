"""Outcomes: they come back, whatever happens to who writes them, from every kind of file."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.conftest import ROOT, files_no_larger_than, record
from tests.message_logs import Schema, write_raw
from tunenet_logs import messages
from tunenet_logs.errors import LogError
from tunenet_logs.outcomes import (
    Outcome,
    holds_outcomes,
    outcome_bytes,
    outcome_files,
    read_outcomes,
    to_message,
    write_outcome,
)
from tunenet_logs.writing.owned_path import write_aside, write_new

NOTE = "what was seen of it, at some length, " * 20
SAID = Outcome(
    task="bounce-shot", ball="Red gel, № 2", attempt=7, success=False,
    stamp_ns=1_795_306_665_619_892_390, shot_height_m=0.62, miss_m=-0.041, tuned_parameter=0.791,
    drop_log="drop_7.mcap", tuning="drop_7.json", reason="short", note="hit the rim; rolled off",
)  # fmt: skip
BARE = Outcome(task="bounce-shot", ball="b", attempt=1, success=True)


def outcome_of(number: int) -> Outcome:
    """The number-th outcome."""
    return Outcome(
        task="bounce-shot", ball="red gel", attempt=number, success=number % 3 == 0,
        stamp_ns=1_800_000_000_000_000_000 + number * 1_000_003,
        shot_height_m=0.5 + number / 1000, miss_m=number / 1e4, note=NOTE[:number],
    )  # fmt: skip


@pytest.mark.parametrize("outcome", [SAID, BARE])
def test_comes_back_from_its_file(tmp_path: Path, outcome: Outcome):
    path = write_outcome(tmp_path / "new" / "campaign", outcome)
    assert read_outcomes(path) == read_outcomes(path.parent) == (outcome,)
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    assert path.read_bytes() == outcome_bytes(outcome)


def test_the_libraries_of_ros_2_and_mcap_read_it(tmp_path: Path):
    path = write_outcome(tmp_path, SAID)
    assert path.name == "outcome_20261122T001745.619Z_red-gel-2_007.mcap"
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        ((_, channel, message, decoded),) = reader.iter_decoded_messages()
    assert channel.topic == "/task/outcome"
    assert message.log_time == message.publish_time == SAID.stamp_ns
    assert (decoded.ball, decoded.attempt, decoded.success) == (SAID.ball, 7, False)
    assert decoded.miss_distance == -0.041
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(messages.OUTCOME_FIELDS, messages.TASK_OUTCOME))
    with AnyReader([path]) as bag:
        ((connection, _, data),) = bag.messages()
        read: Any = store.deserialize_cdr(bytes(data), connection.msgtype)
        assert read.reason == "short"


def test_names_sort_by_time_and_none_is_written_over(tmp_path: Path):
    paths = [write_outcome(tmp_path, outcome_of(number)) for number in (3, 1, 2)]
    assert sorted(paths) == [paths[1], paths[2], paths[0]]
    before = {path: path.read_bytes() for path in paths}
    with ThreadPoolExecutor(8) as pool:
        again = list(pool.map(lambda _: write_outcome(tmp_path, SAID), range(40)))
    assert len(set(again)) == 40
    assert all(path.read_bytes() == data for path, data in before.items())
    assert read_outcomes(tmp_path).count(SAID) == 40


# An outcome after the other, until it is killed; their numbers on stdout.
RECORDER = """
import sys
from itertools import count
from pathlib import Path
from tests.tunenet_logs.test_outcome import outcome_of, write_outcome
for number in count(1):
    write_outcome(Path(sys.argv[1]), outcome_of(number))
    print(number, flush=True)
"""
MANY = [pytest.param(number, marks=pytest.mark.slow) for number in range(4, 60, 6)]


@pytest.mark.parametrize("acknowledged", [1, 15, 45, *MANY])
def test_killed_at_any_moment_it_leaves_whole_outcomes_and_nothing_else(
    tmp_path: Path, acknowledged: int
):
    """Amid what follows those that were acknowledged; it goes on while it is being killed."""
    words = [sys.executable, "-c", RECORDER, str(tmp_path)]
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout is not None
    told = [process.stdout.readline() for _ in range(acknowledged)]
    process.kill()
    told += process.stdout.read().split()
    process.wait()
    found = read_outcomes(tmp_path)
    assert found == tuple(outcome_of(number) for number in range(1, len(found) + 1))
    assert len(told) == int(told[-1]) >= acknowledged
    assert len(told) <= len(found) <= len(told) + 1
    assert len(list(tmp_path.iterdir())) == len(found)


@pytest.mark.parametrize("write", [write_new, write_aside])
def test_a_name_that_is_taken_stays_and_a_full_disk_leaves_no_half_file(tmp_path: Path, write):
    write(tmp_path / "a", b"first")
    with pytest.raises(FileExistsError):
        write(tmp_path / "a", b"second")
    assert (tmp_path / "a").read_bytes() == b"first"
    folder = tmp_path / "campaign"
    write_outcome(folder, outcome_of(1))
    data = outcome_bytes(outcome_of(2))
    for limit in range(1, len(data), 97):
        with files_no_larger_than(limit), pytest.raises(OSError, match="File too large"):
            write(folder / "a.mcap", data)
        with files_no_larger_than(limit), pytest.raises(LogError, match="cannot be written") as no:
            write_outcome(folder, outcome_of(2))
        assert "\n" not in str(no.value)
    assert read_outcomes(folder) == (outcome_of(1),)
    assert len(list(folder.iterdir())) == 1
    assert {one.name for one in tmp_path.iterdir()} == {"a", "campaign"}


def test_several_in_one_file_and_in_json(tmp_path: Path):
    said = {
        "header": {"stamp": {"sec": 1_900_000_000, "nanosec": 5}, "frame_id": ""},
        "task": "bounce-shot", "ball": "gel", "attempt": 4, "success": True, "shot_height": 0.5,
        "miss_distance": None, "drop_log": "", "tuning": "", "reason": "", "note": "",
    }  # fmt: skip
    text = messages.definition(messages.TASK_OUTCOME).encode()
    ours = Schema(messages.TASK_OUTCOME, text=text)
    theirs = Schema("tunenet_msgs/TaskOutcome", "jsonschema", b"{}", "json")
    numbered = [
        messages.encode(to_message(outcome_of(number)), messages.TASK_OUTCOME) for number in (2, 1)
    ]
    write_raw(tmp_path / "a.mcap", [
        ("/other", Schema("other", "jsonschema", b"{}", "json"), 0, b"{}"),
        *(("/outcome", ours, number, data) for number, data in enumerate(numbered)),
        ("/outcome_too", theirs, 9, json.dumps(said).encode()),
    ])  # fmt: skip
    first, second, third = read_outcomes(tmp_path / "a.mcap")
    assert (first, second) == (outcome_of(1), outcome_of(2))
    assert (third.ball, third.attempt, third.shot_height_m) == ("gel", 4, 0.5)
    assert third.stamp_ns == 1_900_000_000_000_000_005
    assert third.miss_m is third.tuned_parameter is None


def test_in_a_folder_other_logs_are_passed_over_damaged_ones_too(tmp_path: Path):
    write_outcome(tmp_path, SAID)
    log = record(tmp_path / "drop.mcap", restitution=0.7, height_m=1.0, seconds=8.0)
    (tmp_path / "track.csv").write_text("t,x,y,z\n0,0,0,1\n")
    (tmp_path / "notes.txt").write_text("a good day\n")
    assert len(outcome_files(tmp_path)) == 1
    assert not holds_outcomes(log)
    for data in (log.read_bytes(), log.read_bytes()[:-500]):
        log.write_bytes(data)
        assert read_outcomes(tmp_path) == (SAID,)
        with pytest.raises(LogError, match="holds no outcome"):
            read_outcomes(log)


def test_what_is_damaged_is_told_and_the_rest_is_read(tmp_path: Path):
    write_outcome(tmp_path, SAID)
    broken = write_outcome(tmp_path, outcome_of(1))
    whole, rng = broken.read_bytes(), np.random.default_rng(1)
    for _ in range(60):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        broken.write_bytes(data[: rng.integers(len(data) // 2, len(data) + 1)])
        told: list[str] = []
        found = read_outcomes(tmp_path, told.append)
        assert SAID in found
        assert set(found) <= {SAID, outcome_of(1)}
        assert outcome_of(1) in found or told
        assert all(str(broken) in one for one in told)


@pytest.mark.parametrize(
    "wrong",
    [
        {"ball": " "}, {"attempt": 0}, {"attempt": 2**40}, {"stamp_ns": -1},
        {"miss_m": float("nan")}, {"note": "x" * 1001},
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_no_outcome(wrong: dict[str, Any]):
    said = {"task": "bounce-shot", "ball": "b", "attempt": 1, "success": True}
    with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[0].replace("stamp", "time")):
        Outcome(**{**said, **wrong})


# Outcomes written down in a table.
GOOD = """\
ball,success,attempt,time,shot_height_m,miss_m,reason,weather
red gel,success,1,2026-11-22 14:30Z,0.62,0.004,,sunny
red gel,failure,2,2026-11-22 14:35Z,0.62,,"short, rim",sunny
"""


def of_table(table: Path, text: str) -> tuple[Outcome, ...]:
    table.write_text(text)
    return read_outcomes(table)


def test_columns_go_by_their_names(tmp_path: Path):
    first, second = of_table(tmp_path / "outcomes.csv", GOOD)
    assert first == Outcome(
        task="bounce-shot", ball="red gel", attempt=1, success=True,
        stamp_ns=1_795_357_800_000_000_000, shot_height_m=0.62, miss_m=0.004,
    )  # fmt: skip
    assert (second.success, second.miss_m, second.reason) == (False, None, "short, rim")
    assert read_outcomes(tmp_path) == (first, second)
    text = "Ball;Result;Miss\ngel;yes;0,012\nracquetball;no;0,08\ngel;no;\n"  # of another country
    found = {(one.ball, one.attempt): one for one in of_table(tmp_path / "outcomes.csv", text)}
    assert found["gel", 1].miss_m == 0.012
    assert not found["gel", 2].success
    assert not found["racquetball", 1].success
    text = "# a windy day\nball,success\n#1 red,yes\n#2 red,no\n"  # a row begins with a hash
    assert [one.ball for one in of_table(tmp_path / "outcomes.csv", text)] == ["#1 red", "#2 red"]


def test_what_was_not_numbered_is_numbered_over_all_tables(tmp_path: Path):
    (tmp_path / "a.csv").write_text("ball,success,attempt\ngel,yes,2\ngel,no,\nfoam,no,\n")
    (tmp_path / "b.tsv").write_text("ball\tsuccess\ngel\tyes\n")
    found = sorted((one.ball, one.attempt) for one in read_outcomes(tmp_path))
    assert found == [("foam", 1), ("gel", 2), ("gel", 3), ("gel", 4)]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty"),
        ("ball,attempt\na,1\n", "no column 'success' (there are: ball, attempt)"),
        ("ball,success\na,perhaps\n", "line 2, column 'success': 'perhaps' cannot be read; write"),
        ("ball,success\na,1\nb,\n", "line 3, column 'success': ''"),
        ("ball,success,miss\na,1,far\n", "line 2, column 'miss': 'far' is no number; write a num"),
        ("ball,success,attempt\na,1,1.5\n", "line 2, column 'attempt': '1.5'"),
        ("ball,success,time\na,1,noon\n", "line 2, column 'time': 'noon' cannot be read; write"),
        ("ball,success,time\na,1,9999-12-31 23:59\n",
         "line 2, column 'time': '9999-12-31 23:59' cannot be read"),
        ("ball,success\n,1\n", "line 2: ball is empty; correct that line"),
        ("ball,success\na,1,2\n", "line 2 has 3 cells under 2 names"),
        ("ball,success\n", "holds no outcome"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, told: str
):
    monkeypatch.setenv("TZ", "America/New_York")  # where the last time is beyond all clocks
    time.tzset()
    table = tmp_path / "outcomes.csv"
    with pytest.raises(LogError, match=re.escape(told)) as caught:
        of_table(table, text)
    assert str(caught.value).startswith(str(table))
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    time.tzset()
