"""Logs that a stranger made to take long: many records, channels or pixels in few bytes."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import zstandard

from tests.hostile import HEADER, MAGIC, chunk, write_pictures
from tunenet_logs.messages import POSE, definition, encode, pose

_CHUNK_BYTES = 4 * 2**20


def record(opcode: int, body: bytes = b"") -> bytes:
    """A record of an MCAP file."""
    return struct.pack("<BQ", opcode, len(body)) + body


def text(words: bytes) -> bytes:
    """A text in an MCAP record."""
    return struct.pack("<I", len(words)) + words


def described(count: int, topic: bytes = b"/ch%d") -> bytes:
    """Schema and channels of poses, numbered from 0."""
    body = struct.pack("<H", 1) + text(POSE.encode()) + text(b"ros2msg")
    schema = record(3, body + text(definition(POSE).encode()))
    return schema + b"".join(
        record(
            4,
            struct.pack("<HH", n, 1)
            + text(topic.replace(b"%d", b"%d" % n))
            + text(b"cdr")
            + text(b""),
        )
        for n in range(count)
    )


def message(channel: int = 0, data: bytes = b"", stamp_ns: int = 1) -> bytes:
    """A message record."""
    return record(5, struct.pack("<HIQQ", channel, 0, stamp_ns, stamp_ns) + data)


def packed_chunks(content: bytes, count: int) -> bytes:
    """Chunks of 4 MiB of the same records."""
    plain = content * (_CHUNK_BYTES // len(content))
    return count * chunk(b"zstd", len(plain), zstandard.ZstdCompressor(19).compress(plain))


def zeros_in_chunks(path: Path) -> None:
    """A gigabyte of zeros in chunks."""
    path.write_bytes(MAGIC + HEADER + described(1) + packed_chunks(b"\0", 256) + bytes(1_000_000))


def tiny_records_in_chunks(path: Path) -> None:
    """A hundred million private records without content, in chunks."""
    path.write_bytes(MAGIC + HEADER + described(1) + packed_chunks(record(0x80), 256))


def tiny_messages_in_chunks(path: Path) -> None:
    """Thirty million messages without content, in chunks."""
    path.write_bytes(MAGIC + HEADER + described(1) + packed_chunks(message(), 256))


def poses_in_chunks(path: Path) -> None:
    """Ten million whole messages, all the same."""
    data = encode(pose(0, "map", np.zeros(3)), POSE)
    path.write_bytes(MAGIC + HEADER + described(1) + packed_chunks(message(0, data), 256))


def unknown_messages_in_chunks(path: Path) -> None:
    """Thirty million messages of a channel that nothing describes."""
    path.write_bytes(MAGIC + HEADER + packed_chunks(message(7), 256))


def channels_in_chunks(path: Path) -> None:
    """A channel, described again and again."""
    path.write_bytes(MAGIC + HEADER + packed_chunks(described(1), 256))


def zeros_behind_the_magic(path: Path) -> None:
    """What a power cut leaves."""
    path.write_bytes(MAGIC + bytes(30_000_000))


def zeros_between(path: Path) -> None:
    """Zeros, and private records between them."""
    path.write_bytes(MAGIC + HEADER + (bytes(10) + record(0x80)) * 2_000_000)


def private_records(path: Path) -> None:
    """Four million records of no known kind, and without content."""
    path.write_bytes(MAGIC + HEADER + record(0x80) * 4_600_000)


def damaged_records(path: Path) -> None:
    """Three million schemas without content."""
    path.write_bytes(MAGIC + HEADER + record(3) * 3_300_000)


def empty_metadata(path: Path) -> None:
    """Two and a half million metadata records that say nothing."""
    path.write_bytes(MAGIC + HEADER + record(12, bytes(8)) * 2_500_000)


def long_metadata(path: Path) -> None:
    """A metadata record of five million empty words."""
    body = text(b"a") + text(bytes(40_000_000))
    path.write_bytes(MAGIC + HEADER + record(12, body))


def long_statistics(path: Path) -> None:
    """Statistics that count the messages of four million channels."""
    body = struct.pack("<QHIIIIQQ", 0, 0, 0, 0, 0, 0, 0, 0) + text(bytes(40_000_000))
    end = record(15, bytes(4)) + record(11, body) + record(2, bytes(20)) + MAGIC
    path.write_bytes(MAGIC + HEADER + end)


def many_channels(path: Path) -> None:
    """65,000 channels of poses."""
    path.write_bytes(
        MAGIC + HEADER + described(65_000) + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC
    )


def many_heard_channels(path: Path) -> None:
    """9,900 channels of poses, and some messages of each."""
    data = encode(pose(0, "map", np.zeros(3)), POSE)
    said = b"".join(message(n, data, 1 + k) for k in range(3) for n in range(9_900))
    path.write_bytes(MAGIC + HEADER + described(9_900) + said)


def many_types(path: Path) -> None:
    """65,000 channels, each of its own type that is defined in the log."""
    made = [MAGIC + HEADER]
    for n in range(1, 65_000):
        said = struct.pack("<H", n) + text(b"a/msg/T%d" % n) + text(b"ros2msg")
        made.append(record(3, said + text(b"float64[3] position\n")))
        made.append(
            record(4, struct.pack("<HH", n, n) + text(b"/%d" % n) + text(b"cdr") + text(b""))
        )
    path.write_bytes(b"".join(made))


def many_chunks_of_channels(path: Path) -> None:
    """9,900 channels, and 100,000 chunks of nothing."""
    path.write_bytes(MAGIC + HEADER + described(9_900) + chunk(b"", 9, record(0x80)) * 100_000)


def false_chunks(path: Path) -> None:
    """What looks like the beginning of a chunk, 100,000 times."""
    begin = struct.pack("<BQQQQII", 6, 40, 0, 1, 0, 0, 4) + b"zstd"
    path.write_bytes(MAGIC + HEADER + (begin + b"\xff" * 40) * 100_000)


def impossible_chunks(path: Path) -> None:
    """Likewise, too long for the file."""
    begin = struct.pack("<BQQQQII", 6, 2**60, 0, 1, 0, 0, 4) + b"zstd"
    path.write_bytes(MAGIC + HEADER + begin * 300_000)


def picture_topics(path: Path) -> None:
    """2,000 channels of pictures among many messages."""
    write_pictures(path, _blank(64), count=2000, topics=2000, others=300_000)


def small_blank_log(path: Path) -> None:
    """28 kB of a log with blank pictures."""
    write_pictures(path, _blank(4000), count=40)


def many_scans(path: Path) -> None:
    """A JPEG of 3,000 scans."""
    write_pictures(path, jpeg_of_scans(3000), count=3)


def packed_words_png(path: Path) -> None:
    """A PNG with a thousand packed words of 8 MB."""
    write_pictures(path, png_of_words(900), count=10)


def _blank(side_px: int) -> bytes:
    return cv2.imencode(".png", np.zeros((side_px, side_px), np.uint8))[1].tobytes()


def jpeg_of_scans(count: int, side_px: int = 4000) -> bytes:
    """A grey progressive JPEG whose scans are many and empty."""
    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    data = cv2.imencode(".jpg", np.zeros((side_px, side_px), np.uint8), flags)[1].tobytes()
    at = data.rindex(b"\xff\xda")
    return data[:at] + data[at:-2] * count + b"\xff\xd9"


def png_of_words(count: int) -> bytes:
    """A PNG with parts of words that unpack to 7 MB each."""
    import zlib

    data = _blank(1000)
    words = b"zTXt" + b"a\0\0" + zlib.compress(bytes(7_000_000), 9)
    part = struct.pack(">I", len(words) - 4) + words + struct.pack(">I", zlib.crc32(words))
    return data[:33] + part * count + data[33:]


def bag_record(fields: dict[bytes, bytes], data: bytes = b"") -> bytes:
    """A record of a ROS 1 bag."""
    head = b"".join(text(name + b"=" + value) for name, value in fields.items())
    return text(head) + text(data)


def bag_connection(number: int) -> bytes:
    """A connection of poses."""
    more = text(b"type=geometry_msgs/PoseStamped") + text(b"md5sum=" + b"0" * 32)
    more += text(b"message_definition=float64 x")
    return bag_record(
        {b"op": b"\7", b"conn": struct.pack("<I", number), b"topic": b"/a%d" % number}, more
    )


BAG = b"#ROSBAG V2.0\n"


def still_film(path: Path) -> None:
    """150 pictures of 16 megapixels, all the same, in a film of 53 kB."""
    import av

    with av.open(str(path), "w", format="mp4") as film:
        stream: Any = film.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 4000, 4000, "yuv420p"
        stream.options = {"preset": "ultrafast", "crf": "40"}
        stream.gop_size = 1000
        picture = av.VideoFrame.from_ndarray(np.zeros((4000, 4000, 3), np.uint8), format="rgb24")
        for picture.pts in range(150):
            film.mux(stream.encode(picture))
        film.mux(stream.encode())


def empty_lines(path: Path) -> None:
    """A table of two rows and 20 million empty lines."""
    path.write_bytes(b"t,z\n0,1\n" + b"\n" * 20_000_000 + b"1,1\n")


def bag_of_tiny_messages(path: Path) -> None:
    """Thirty million messages without content in chunks of a bag."""
    one = bag_record({b"op": b"\2", b"conn": bytes(4), b"time": bytes(8)})
    plain = one * (_CHUNK_BYTES // len(one))
    head = {b"op": b"\5", b"compression": b"lz4", b"size": struct.pack("<I", len(plain))}
    made = bag_record(head, lz4.frame.compress(plain, compression_level=9))
    path.write_bytes(BAG + bag_connection(0) + made * 256)


def bag_of_connections(path: Path) -> None:
    """200,000 connections."""
    path.write_bytes(BAG + b"".join(map(bag_connection, range(200_000))))


def bag_of_zeros(path: Path) -> None:
    """Zeros behind the version."""
    path.write_bytes(BAG + bytes(30_000_000))


def bag_of_marks(path: Path) -> None:
    """What looks like the field of a record's kind, two million times."""
    path.write_bytes(BAG + b"\x04\0\0\0op=" * 2_000_000)


def bag_of_damage(path: Path) -> None:
    """Records of no kind, with some bytes of nothing between."""
    path.write_bytes(BAG + (bag_record({b"op": b"\x09"}) + b"\xff" * 4) * 500_000)


def db3_of(path: Path, topics: int, messages: int, data: bytes = b"") -> None:
    """A ROS 2 bag of sqlite3."""
    with closing(sqlite3.connect(path)) as base, base:
        base.execute(
            "CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)"
        )
        base.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        rows = ((n, f"/{n}", "geometry_msgs/msg/PoseStamped", "cdr") for n in range(topics))
        base.executemany("INSERT INTO topics VALUES (?, ?, ?, ?)", rows)
        said = ((n, n % topics, n, data) for n in range(messages))
        base.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", said)


def db3_of_topics(path: Path) -> None:
    """A million topics."""
    db3_of(path, 1_000_000, 1)


def db3_of_empty_messages(path: Path) -> None:
    """Two million messages without content."""
    db3_of(path, 1, 2_000_000)


BOMBS: tuple[Callable[[Path], None], ...] = (
    zeros_in_chunks, tiny_records_in_chunks, tiny_messages_in_chunks, poses_in_chunks,
    unknown_messages_in_chunks, channels_in_chunks, zeros_behind_the_magic, zeros_between,
    private_records, damaged_records, empty_metadata, long_metadata, long_statistics,
    many_channels, many_heard_channels, many_types, many_chunks_of_channels, false_chunks,
    impossible_chunks, picture_topics, small_blank_log, many_scans, packed_words_png,
    bag_of_tiny_messages, bag_of_connections, bag_of_zeros, bag_of_marks, bag_of_damage,
    db3_of_topics, db3_of_empty_messages, still_film, empty_lines,
)  # fmt: skip
