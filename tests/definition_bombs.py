"""Logs whose definitions of types a stranger made to take long."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import zstandard

from tests.hostile import HEADER, MAGIC, chunk
from tests.work_bombs import message, record, text
from tunenet_logs.messages import POSE, definition


def unclosed_texts(path: Path) -> None:
    """Thirty definitions of a text that never ends, in IDL."""
    made = [MAGIC + HEADER]
    for n in range(1, 31):
        said = struct.pack("<H", n) + text(b"a/msg/T") + text(b"ros2idl")
        made.append(record(3, said + text(b"struct position {\n" + b'"\\' * 30_000)))
        named = text(b"/%d" % n) + text(b"cdr") + text(b"")
        made.append(record(4, struct.pack("<HH", n, n) + named) + message(n, bytes(64)))
    path.write_bytes(b"".join(made))


def channels_of(path: Path, count: int, kind: bytes, encoding: bytes, schemas: list[bytes]) -> None:
    """Channels of one type, of these definitions in turns, packed."""
    form = b"protobuf" if encoding == b"protobuf" else b"ros2msg"
    made = [
        record(3, struct.pack("<H", n) + text(kind) + text(form) + text(one))
        for n, one in enumerate(schemas, 1)
    ]
    for n in range(count):
        head = struct.pack("<HH", n, 1 + n % len(schemas))
        made.append(record(4, head + text(b"/%d" % n) + text(encoding) + text(b"")))
    pack = zstandard.ZstdCompressor(3).compress
    parts = [b"".join(made[at : at + 200]) for at in range(0, len(made), 200)]
    chunks = b"".join(chunk(b"zstd", len(part), pack(part)) for part in parts)
    path.write_bytes(MAGIC + HEADER + chunks)


def protobuf_channels(path: Path) -> None:
    """9,000 channels of one definition of a megabyte in protobuf."""
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from mcap_protobuf.schema import build_file_descriptor_set

    files: FileDescriptorSet = build_file_descriptor_set(PoseInFrame)
    more = files.file.add(name="more.proto", package="more", syntax="proto3")
    for n in range(20_000):
        more.message_type.add(name=f"M{n}").field.add(name="x", number=1, type=1, label=1)
    schema = files.SerializeToString()
    channels_of(path, 9_000, b"foxglove.PoseInFrame", b"protobuf", [schema])


def long_definitions(path: Path) -> None:
    """3,000 definitions of a pose of 200 kB each, in 3,000 channels."""
    usual = definition(POSE).encode()
    schemas = [usual + b"\n# %d" % n + b"\nfloat64 x" * 20_000 for n in range(3_000)]
    channels_of(path, 3_000, POSE.encode(), b"cdr", schemas)


BOMBS: tuple[Callable[[Path], None], ...] = (unclosed_texts, protobuf_channels, long_definitions)
