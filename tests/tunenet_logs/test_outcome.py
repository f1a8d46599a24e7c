"""Outcomes: they come back, whatever happens to who writes them, from every kind of file."""

from __future__ import annotations

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.conftest import ROOT, files_no_larger_than, record
from tests.tunenet_logs.outcome_recorder import outcome_of
from tunenet_logs import messages
from tunenet_logs.errors import LogError
from tunenet_logs.outcomes import (
    Outcome,
    holds_outcomes,
    outcome_bytes,
    outcome_files,
    read_outcomes,
    write_outcome,
)
from tunenet_logs.writing.owned_path import write_aside, write_new

SAID = Outcome(
    task="bounce-shot",
    ball="Red gel, № 2",
    attempt=7,
    success=False,
    stamp_ns=1_795_306_665_619_892_390,
    shot_height_m=0.62,
    miss_m=-0.041,
    tuned_parameter=0.791,
    drop_log="drop_7.mcap",
    tuning="drop_7.json",
    reason="short",
    note="hit the rim; rolled off",
)
BARE = Outcome(task="bounce-shot", ball="b", attempt=1, success=True)


@pytest.mark.parametrize("outcome", [SAID, BARE])
def test_comes_back_from_its_file(tmp_path: Path, outcome: Outcome):
    path = write_outcome(tmp_path / "new" / "campaign", outcome)
    assert read_outcomes(path) == (outcome,)
    assert read_outcomes(path.parent) == (outcome,)
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
    outcomes = [outcome_of(number) for number in (3, 1, 2)]
    paths = [write_outcome(tmp_path, one) for one in outcomes]
    assert sorted(paths) == [paths[1], paths[2], paths[0]]
    before = {path: path.read_bytes() for path in paths}
    with ThreadPoolExecutor(8) as pool:
        again = list(pool.map(lambda _: write_outcome(tmp_path, SAID), range(40)))
    assert len(set(again)) == 40
    assert all(path.read_bytes() == data for path, data in before.items())
    assert read_outcomes(tmp_path).count(SAID) == 40


@pytest.mark.parametrize("write", [write_new, write_aside])
def test_a_name_that_is_taken_stays_as_it_is(tmp_path: Path, write):
    write(tmp_path / "a", b"first")
    with pytest.raises(FileExistsError):
        write(tmp_path / "a", b"second")
    assert [one.name for one in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"first"


MANY = [pytest.param(number, marks=pytest.mark.slow) for number in range(4, 60, 6)]


@pytest.mark.parametrize("acknowledged", [1, 15, 45, *MANY])
def test_killed_at_any_moment_it_leaves_whole_outcomes_and_nothing_else(
    tmp_path: Path, acknowledged: int
):
    """Amid what follows those that were acknowledged; it goes on while it is being killed."""
    words = [sys.executable, "-m", "tests.tunenet_logs.outcome_recorder", str(tmp_path)]
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
def test_a_disk_that_takes_no_more_leaves_the_earlier_ones_and_no_half_file(tmp_path: Path, write):
    write_outcome(tmp_path, outcome_of(1))
    data = outcome_bytes(outcome_of(2))
    for limit in range(1, len(data), 97):
        with files_no_larger_than(limit), pytest.raises(OSError, match="File too large"):
            write(tmp_path / "a.mcap", data)
        with files_no_larger_than(limit), pytest.raises(LogError, match="cannot be written") as no:
            write_outcome(tmp_path, outcome_of(2))
        assert "\n" not in str(no.value)
    assert read_outcomes(tmp_path) == (outcome_of(1),)
    assert len(list(tmp_path.iterdir())) == 1


def test_several_in_one_file_and_in_json(tmp_path: Path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        text = messages.definition(messages.TASK_OUTCOME).encode()
        schemas = [
            writer.register_schema(messages.TASK_OUTCOME, "ros2msg", text),
            writer.register_schema("tunenet_msgs/TaskOutcome", "jsonschema", b"{}"),
        ]
        cdr = writer.register_channel("/outcome", "cdr", schemas[0])
        plain = writer.register_channel("/outcome_too", "json", schemas[1])
        other = writer.register_channel("/other", "json", 0)
        writer.add_message(other, 0, b"{}", 0)
        for number in (2, 1):
            from tunenet_logs.outcomes import to_message

            data = messages.encode(to_message(outcome_of(number)), messages.TASK_OUTCOME)
            writer.add_message(cdr, number, data, number)
        said = {
            "header": {"stamp": {"sec": 1_900_000_000, "nanosec": 5}, "frame_id": ""},
            "task": "bounce-shot", "ball": "gel", "attempt": 4, "success": True,
            "shot_height": 0.5, "miss_distance": None, "drop_log": "", "tuning": "",
            "reason": "", "note": "",
        }  # fmt: skip
        writer.add_message(plain, 9, json.dumps(said).encode(), 9)
        writer.finish()
    first, second, third = read_outcomes(tmp_path / "a.mcap")
    assert (first, second) == (outcome_of(1), outcome_of(2))
    assert (third.ball, third.attempt, third.shot_height_m) == ("gel", 4, 0.5)
    assert third.stamp_ns == 1_900_000_000_000_000_005
    assert third.miss_m is third.tuned_parameter is None


def test_in_a_folder_other_logs_are_passed_over(tmp_path: Path):
    write_outcome(tmp_path, SAID)
    log = record(tmp_path / "drop.mcap", restitution=0.7, height_m=1.0, seconds=1.0)
    (tmp_path / "track.csv").write_text("t,x,y,z\n0,0,0,1\n")
    (tmp_path / "notes.txt").write_text("a good day\n")
    assert len(outcome_files(tmp_path)) == 1
    assert not holds_outcomes(log)
    assert read_outcomes(tmp_path) == (SAID,)
    with pytest.raises(LogError, match="holds no outcome"):
        read_outcomes(log)


def test_what_is_damaged_is_told_and_the_rest_is_read(tmp_path: Path):
    write_outcome(tmp_path, SAID)
    broken = write_outcome(tmp_path, outcome_of(1))
    whole = broken.read_bytes()
    rng = np.random.default_rng(1)
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


def test_a_damaged_recording_of_a_drop_is_none_of_their_business(tmp_path: Path):
    write_outcome(tmp_path, SAID)
    log = record(tmp_path / "drop.mcap", restitution=0.7, height_m=1.0, seconds=8.0)
    log.write_bytes(log.read_bytes()[:-500])
    assert read_outcomes(tmp_path) == (SAID,)
    with pytest.raises(LogError, match="holds no outcome"):
        read_outcomes(log)


@pytest.mark.parametrize(
    "wrong",
    [
        {"ball": " "},
        {"attempt": 0},
        {"attempt": 2**40},
        {"stamp_ns": -1},
        {"miss_m": float("nan")},
        {"note": "x" * 1001},
    ],
)
def test_what_makes_no_sense_is_no_outcome(wrong: dict):
    said = {"task": "bounce-shot", "ball": "b", "attempt": 1, "success": True}
    with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[0].replace("stamp", "time")):
        Outcome(**{**said, **wrong})
