"""Measure writing speed: EpisodeWriter beside the bare mcap library, in one run.

`python -m tests.bench.writing` writes joint states and JPEG frames with both: the same options, the
same serialisation by rosbags, nobody waiting for the disk. The queue of a live recording is
measured apart.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from tests.recorders.live_recorder import JOINTS, NAMES, PICTURES
from tests.recorders.mjpeg_camera import picture
from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.recorders.session import TopicQueue
from tunenet_logs.writing.writer import EpisodeWriter


def seconds(work: Callable[[], None]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def ours(log: Path, put: Callable[[EpisodeWriter, int], None], count: int, *, live: bool) -> None:
    with EpisodeWriter(log, EpisodeInfo(), overwrite=True, live=live) as writer:
        for number in range(count):
            put(writer, number)


def bare(log: Path, type_name: str, make: Callable[[int], bytes], count: int) -> None:
    with log.open("wb") as file:
        writer = Writer(
            file, chunk_size=64 * 1024, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        writer.start(profile="ros2")
        text = messages.definition(type_name).encode()
        schema = writer.register_schema(type_name, "ros2msg", text)
        channel = writer.register_channel("/topic", "cdr", schema)
        for number in range(count):
            data = make(number)
            writer.add_message(channel, number + 1, data, number + 1, number)
        writer.finish()


@dataclass(frozen=True)
class Stream:
    """Messages to write: the same with both, number by number."""

    name: str
    count: int
    type_name: str
    put: Callable[[EpisodeWriter, int], None]
    make: Callable[[int], bytes]


def compare(stream: Stream, log: Path, repeats: int) -> None:
    """Write in turns with each, and print the best of each beside the bare library's."""
    put, count = stream.put, stream.count
    works: dict[str, Callable[[], None]] = {
        "EpisodeWriter, live": lambda: ours(log, put, count, live=True),
        "EpisodeWriter, from a file": lambda: ours(log, put, count, live=False),
        "bare mcap.Writer": lambda: bare(log, stream.type_name, stream.make, count),
    }
    rounds = [[seconds(work) for work in works.values()] for _ in range(repeats)]
    best = [min(column) for column in zip(*rounds, strict=True)]
    for who, took in zip(works, best, strict=True):
        speed = f"{count / took:9.0f} a second   {best[-1] / took:5.2f}"
        print(f"{stream.name:13} {who:26} {speed}", flush=True)


def through_a_queue(payloads: Sequence[bytes]) -> None:
    queue: TopicQueue[bytes] = TopicQueue(2**40, drops=True)
    for number, data in enumerate(payloads):
        queue.put(JOINTS, number, data, len(data))
    while queue.take() is not None:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=50_000)
    parser.add_argument("--frames", type=int, default=3_000)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    os.fdatasync = lambda _file: None  # the disk is not what is measured
    states = np.random.default_rng(0).normal(size=(arguments.states, 3, 7))
    jpegs = [picture(number, (640, 480)) for number in range(32)]

    def put_state(writer: EpisodeWriter, number: int) -> None:
        writer.write_joints(JOINTS, number + 1, NAMES, *states[number])

    def put_frame(writer: EpisodeWriter, number: int) -> None:
        writer.write_frame(PICTURES, Frame(number + 1, "jpeg", jpegs[number % len(jpegs)]))

    def make_state(number: int) -> bytes:
        state = messages.joint_state(number + 1, NAMES, *states[number])
        return messages.encode(state, messages.JOINT_STATE)

    def make_frame(number: int) -> bytes:
        return messages.frame(Frame(number + 1, "jpeg", jpegs[number % len(jpegs)]))[1]

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        state = messages.JOINT_STATE, put_state, make_state
        image = messages.COMPRESSED_IMAGE, put_frame, make_frame
        compare(Stream("joint states", arguments.states, *state), log, arguments.repeats)
        compare(Stream("JPEG frames", arguments.frames, *image), log, arguments.repeats)
    data = make_state(0)
    took = min(seconds(lambda: through_a_queue([data] * 50_000)) for _ in range(5))
    print(f"{'queue':13} {'put and take':26} {50_000 / took:9.0f} a second")


if __name__ == "__main__":
    main()
