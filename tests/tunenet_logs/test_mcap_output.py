"""Our MCAP is byte for byte what the mcap library writes of the same."""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer

from tests.conftest import files_no_larger_than
from tunenet_logs.writing.owned_path import WholeFile
from tunenet_logs.writing.writer import McapOutput

MESSAGES = [
    (index % 2, 50 + 7 * (index % 3), os.urandom(index * 37 % 9000).hex().encode())
    for index in range(99)
]


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


Opened = Callable[[Path], WholeFile]


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Opens files, empty, which are closed at the end."""
    with ExitStack() as stack:

        def one(path: Path) -> WholeFile:
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_TRUNC, 0o666)
            stack.callback(os.close, descriptor)
            return WholeFile(descriptor)

        yield one


def by_us(file: WholeFile, flushes: bool, *, ends: bool = True) -> McapOutput:
    output = McapOutput(file, "ros2", "ours")
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
def test_the_bytes_are_those_of_the_library(tmp_path: Path, opened: Opened, flushes: bool):
    output = by_us(opened(tmp_path / "a.mcap"), flushes)
    assert output.message_count == len(MESSAGES)
    assert (tmp_path / "a.mcap").read_bytes() == by_the_library(flushes)


def test_pictures_are_packed_with_little_effort(tmp_path: Path, opened: Opened):
    """A chunk that cannot be packed says that it is, as all do, and every reader reads it."""
    path = tmp_path / "a.mcap"
    pictures = [os.urandom(100_000) for _ in range(3)]
    output = McapOutput(opened(path), "ros2", "ours")
    channel = output.add_channel("/a", "cdr", output.add_schema("a", "ros2msg", "float64 x"))
    for number, data in enumerate(pictures):
        output.add_message(channel, number, number, number, data)
    output.end("last", {})
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [message.data for *_, message in reader.iter_messages()] == pictures
        summary = reader.get_summary()
        assert summary is not None
        assert {one.compression for one in summary.chunk_indexes} == {"zstd"}


def test_a_log_without_messages_is_one_too(tmp_path: Path, opened: Opened):
    output = McapOutput(opened(tmp_path / "a.mcap"), "ros2", "ours")
    output.end("last", {})
    with (tmp_path / "a.mcap").open("rb") as file:
        assert list(make_reader(file, validate_crcs=True).iter_messages()) == []


def test_what_is_given_up_of_the_end_as_room_gets_short(tmp_path: Path, opened: Opened):
    """Every log that has an end reads to its last message, however little of it fits."""
    by_us(opened(tmp_path / "whole.mcap"), flushes=True)
    whole = (tmp_path / "whole.mcap").stat().st_size
    by_us(opened(tmp_path / "open.mcap"), flushes=True, ends=False)
    endless = (tmp_path / "open.mcap").stat().st_size
    forms: list[tuple[bool, ...]] = []
    for limit in range(whole, endless - 1, -9):
        output = by_us(opened(tmp_path / "a.mcap"), flushes=True, ends=False)
        with files_no_larger_than(limit):
            is_ended = output.end_as_fits("last", {"b": "2", "é": "ü"})
        if not is_ended:
            assert (tmp_path / "a.mcap").stat().st_size == endless
            forms.append((False,))
            continue
        with (tmp_path / "a.mcap").open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert len(list(reader.iter_messages())) == len(MESSAGES)
            summary = reader.get_summary()
            names = [one.name for one in reader.iter_metadata()]
            file.seek(0)
            streamed = NonSeekingReader(file, validate_crcs=True)
            assert len(list(streamed.iter_messages(log_time_order=False))) == len(MESSAGES)
        if summary is not None:
            assert summary.statistics is not None
            assert summary.statistics.message_count == len(MESSAGES)
        has_chunks = summary is not None and bool(summary.chunk_indexes)
        forms.append((True, has_chunks, summary is not None, "last" in names))
    assert list(dict.fromkeys(forms)) == [
        (True, True, True, True),
        (True, False, True, True),
        (True, False, False, True),
        (True, False, False, False),
        (False,),
    ]


@pytest.mark.parametrize("step", [1, 50, 997])
def test_a_piece_that_does_not_fit_leaves_no_trace(tmp_path: Path, opened: Opened, step: int):
    file = opened(tmp_path / "a")
    pieces = [os.urandom(one * step % 300 + 1) for one in range(60)]
    taken = b""
    with files_no_larger_than(4000):
        for piece in pieces:
            try:
                file.append(piece)
            except OSError:
                assert len(taken) + len(piece) > 4000
            else:
                taken += piece
            assert (tmp_path / "a").read_bytes() == taken
            assert (file.size_bytes, file.crc32) == (len(taken), zlib.crc32(taken))
    file.append(b"more")
    assert (tmp_path / "a").read_bytes() == taken + b"more"
