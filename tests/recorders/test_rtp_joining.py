"""Fragments of pictures are put together, and nothing else is changed or hidden."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from tunenet_logs.recorders.camera.rtsp import FragmentJoiner

FIRST, LAST = 0x80, 0x40
HEADS = {"H264": b"\x7c", "H265": b"\x62\x01"}  # of a NAL unit that comes in fragments


class Packet(NamedTuple):
    channel: int
    number: int
    ticks: int
    is_marked: bool
    payload: bytes


def wire(packets: list[Packet]) -> memoryview:
    out = bytearray()
    for channel, number, ticks, is_marked, payload in packets:
        rtp = struct.pack(">BBHII", 0x80, 96 | 0x80 * is_marked, number & 0xFFFF, ticks, 7)
        out += struct.pack(">cBH", b"$", channel, len(rtp + payload)) + rtp + payload
    return memoryview(out)


def read(data: bytearray | memoryview) -> Iterator[Packet]:
    at = 0
    while at < len(data):
        dollar, channel, size = struct.unpack_from(">cBH", data, at)
        assert dollar == b"$"
        _, kind, number, ticks, _ = struct.unpack_from(">BBHII", data, at + 4)
        payload = bytes(data[at + 16 : at + 4 + size])
        yield Packet(channel, number, ticks, bool(kind & 0x80), payload)
        at += 4 + size


def picture(coding: str, data: bytes, number: int, ticks: int) -> list[Packet]:
    """One unit in fragments of a thousand bytes."""
    pieces = [data[at : at + 1000] for at in range(0, len(data), 1000)]
    packets: list[Packet] = []
    for index, piece in enumerate(pieces):
        is_last = index == len(pieces) - 1
        kind = 5 | FIRST * (not index) | LAST * is_last
        payload = HEADS[coding] + bytes((kind,)) + piece
        packets.append(Packet(0, number + index, ticks, is_last, payload))
    return packets


@pytest.mark.parametrize("coding", ["H264", "H265"])
@pytest.mark.parametrize("begins", [0, 65_530])
def test_a_picture_in_pieces_is_one_packet(coding: str, begins: int):
    data = bytes(range(256)) * 100
    pieces = [one for at in range(3) for one in picture(coding, data, begins + 26 * at, at)]
    joiner = FragmentJoiner(coding, 0)
    whole = [one for part in (pieces[:52], pieces[52:]) for one in read(joiner.joined(wire(part)))]
    payload = HEADS[coding] + bytes((5 | FIRST,)) + data  # and LAST would be an error
    assert [one.payload for one in whole] == [payload] * 3
    assert [one.number for one in whole] == [begins + at & 0xFFFF for at in range(3)]
    assert [one.ticks for one in whole] == [0, 1, 2]
    assert all(one.is_marked for one in whole)


def test_no_packet_is_too_large():
    pieces = picture("H264", bytes(200_000), 0, 0)
    joined = list(read(FragmentJoiner("H264", 0).joined(wire(pieces))))
    assert len(joined) == 4
    assert max(len(one.payload) for one in joined) < 60_000
    assert b"".join(one.payload[2:] for one in joined) == bytes(200_000)
    assert [bool(one.payload[1] & FIRST) for one in joined] == [True, False, False, False]
    assert [bool(one.payload[1] & LAST) for one in joined] == [False, False, False, True]


def test_what_is_lost_stays_missing():
    pieces = picture("H264", bytes(5000), 0, 0) + picture("H264", bytes(5000), 5, 1)
    del pieces[2]
    joined = list(read(FragmentJoiner("H264", 0).joined(wire(pieces))))
    assert [one.number for one in joined] == [0, 2, 3]  # after two and two
    assert [len(one.payload) for one in joined] == [2002, 2002, 5002]


@pytest.mark.parametrize(
    "between",
    [
        Packet(1, 2, 0, False, bytes(20)),  # a report
        Packet(0, 2, 0, False, b"\x7c"),  # cut off
        Packet(0, 2, 0, False, b"\x09\xf0"),  # a whole unit
    ],
)
def test_what_is_no_fragment_stays_where_it_is(between: Packet):
    pieces = picture("H264", bytes(4000), 0, 0)
    joined = list(read(FragmentJoiner("H264", 0).joined(wire([*pieces[:2], between, *pieces[2:]]))))
    assert [one.payload for one in joined][1] == between.payload
    assert [len(one.payload) for one in joined[::2]] == [2002, 2002]


def test_a_picture_whose_end_did_not_come_is_open():
    pieces = picture("H264", bytes(5000), 9, 1000) + picture("H264", bytes(5000), 14, 4000)
    joiner = FragmentJoiner("H264", 0)
    joiner.joined(wire(pieces[:-1]))
    assert [joiner.is_open(ticks) for ticks in (None, 0, 3000)] == [False, False, True]
    joiner.joined(wire(pieces[-1:]))
    assert not joiner.is_open(3000)


def test_another_codec_is_passed_on_as_it_came():
    data = wire(picture("H264", bytes(4000), 0, 0))
    assert FragmentJoiner("JPEG", 0).joined(data) is data
