"""Logs with thousands of channels, or names of hundreds of characters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.strangers import POSE, Stranger, write_poses
from tunenet_logs.describe import describe
from tunenet_logs.formats import ros
from tunenet_logs.formats.base import RawChannel, UnusableError
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.ros import idl_types
from tunenet_logs.messages import encode, pose, typestore
from tunenet_logs.reader import read_episode

DATA = encode(pose(0, "map", np.zeros(3)), POSE)
TEXT = typestore().generate_msgdef(POSE, ros_version=2)[0].encode()


def write_channels(path: Path, used: int, unused: int) -> None:
    """Channels of poses behind others that nothing uses; one message of each."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        other = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        ours = writer.register_schema(POSE, "ros2msg", TEXT)
        for number in range(unused + used):
            schema = other if number < unused else ours
            channel = writer.register_channel(f"/ch{number}", "cdr", schema)
            for stamp in (1, 2):
                writer.add_message(channel, stamp, DATA, stamp)
        writer.finish()


def described(path: Path) -> list[str]:
    return describe(path, read_episode(path)).splitlines()


def test_a_definition_is_parsed_once(monkeypatch: pytest.MonkeyPatch):
    calls: list[str] = []
    parse = ros._parsed

    def counted(text: str, name: str):
        calls.append(name)
        return parse(text, name)

    monkeypatch.setattr(ros, "_parsed", counted)
    ros.parsed.cache_clear()
    for number in range(100):
        listed_type(RawChannel(f"/ch{number}", POSE, "cdr", "ros2msg", TEXT))
    for _ in range(2):
        for text in (b"float64 x", b"\xff"):
            with pytest.raises(UnusableError):
                listed_type(RawChannel("/ch", POSE, "cdr", "ros2msg", text))
    assert calls.count(POSE) == 2


def test_a_definition_that_is_far_too_large_is_not_parsed():
    text = TEXT + b"# more\n" * 100_000
    with pytest.raises(UnusableError, match="large"):
        listed_type(RawChannel("/ch", POSE, "cdr", "ros2msg", text))


def test_of_thousands_of_channels_those_that_can_be_used_are_shown(tmp_path: Path):
    write_channels(tmp_path / "a.mcap", used=30, unused=1000)
    lines = described(tmp_path / "a.mcap")
    assert "  and 930 more channels" in lines
    rows = [line.split()[0] for line in lines if line.startswith("  /ch") and "|" not in line]
    assert rows == [f"/ch{one}" for one in (*range(1000, 1030), *range(70))]
    assert len(lines) < 300


def test_a_hundred_channels_are_shown_in_their_order(tmp_path: Path):
    write_channels(tmp_path / "a.mcap", used=50, unused=50)
    lines = described(tmp_path / "a.mcap")
    rows = [line.split()[0] for line in lines if line.startswith("  /ch") and "|" not in line]
    assert rows == [f"/ch{one}" for one in range(100)]
    assert not any("more channels" in line for line in lines)


def test_a_long_topic_does_not_widen_the_table(tmp_path: Path):
    topic = "/begin" + "/long" * 60 + "/end"
    write_poses(tmp_path / "a.mcap", *Stranger(0.7).samples(), topic=topic)
    lines = described(tmp_path / "a.mcap")
    named = [line for line in lines if line.startswith("  /begin")]
    assert len(named) == 2  # in the table and on the timeline
    assert all("…" in line and "/end " in line for line in named)
    assert max(map(len, lines[1:])) < 160


def test_a_text_that_never_ends_is_no_definition():
    with pytest.raises(Exception, match=r"."):  # as the parser of IDL says
        idl_types("struct position {\n" + '"\\' * 30_000)
