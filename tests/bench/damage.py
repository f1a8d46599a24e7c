"""Damage logs on the way through tuning and checking: is anything ever wrong silently?

`python -m tests.bench.damage` flips 5,000 single bits in logs of positions, joints and pictures, in
chunks and without; and cuts a log of 2 kB at every byte. It prints how often what was read differed
and nothing was said, which must be never.
"""

from __future__ import annotations

import argparse
import random
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.strangers import without_chunks
from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress
from tunenet_logs.writing.writer import EpisodeWriter

Contents = tuple[tuple[Any, ...], ...]


def write_log(path: Path, *, samples: int, pictures: int) -> None:
    """Write a log by our writer."""
    rng = np.random.default_rng(0)
    with EpisodeWriter(
        path, EpisodeInfo(kind="drop", truth={"restitution": 0.5}), live=False
    ) as out:
        for index in range(samples):
            out.write_pose("/ball/pose", index * 10_000_000, rng.normal(size=3))
            if samples > 20:
                names = [f"joint{number}" for number in range(7)]
                out.write_joints("/joint_states", index * 10_000_000, names, rng.normal(size=7))
        for index in range(pictures):
            pixels = rng.integers(0, 255, (24, 32, 3), np.uint8)
            data = cv2.imencode(".jpg", pixels)[1].tobytes()
            out.write_frame("/camera/image_raw/compressed", Frame(index * 10**7, "jpeg", data))


def contents(path: Path) -> tuple[Contents, bool]:
    """Return all that a tuning would see of a log, and whether anything was said about it."""
    episode = read_episode(path)
    seen: list[tuple[Any, ...]] = [
        (name, one.stamps_ns.tobytes(), one.values.tobytes(), one.columns)
        for name, one in sorted(episode.signals.items())
    ]
    for topic in episode.picture_topics:
        seen += [(topic, one.stamp_ns, one.data) for one in episode.frames(topic)]
    said = bool(episode.warnings) and bool(check(path, Progress(quiet=True)).damage)
    return tuple(seen), said


def flipped(whole: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Yield the file with one bit flipped, again and again."""
    rng = random.Random(seed)
    for _ in range(count):
        data = bytearray(whole)
        data[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        yield bytes(data)


def outcome(path: Path, data: bytes, truth: Contents) -> str:
    """Classify the result for a damaged log in a word or two."""
    path.write_bytes(data)
    try:
        seen, said = contents(path)
    except TuneNetError:
        return "refused"
    if seen == truth:
        return "the same, damage said" if said else "the same"
    return "differs, damage said" if said else "DIFFERS SILENTLY"


def is_prefix(seen: Contents, truth: Contents) -> bool:
    """Check whether all that was read of a cut log is in the whole one."""
    whole = {entry[0]: entry for entry in truth}
    return all(
        bytes(whole[name][1]).startswith(stamps) and bytes(whole[name][2]).startswith(values)
        for name, stamps, values, _ in seen
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flips", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_log(folder / "chunks.mcap", samples=60, pictures=4)
        without_chunks(folder / "chunks.mcap", folder / "plain.mcap")
        for kind in ("chunks", "plain"):
            log = folder / f"{kind}.mcap"
            truth, _ = contents(log)
            counts = Counter(
                outcome(folder / "damaged.mcap", data, truth)
                for data in flipped(log.read_bytes(), arguments.flips // 2, arguments.seed)
            )
            print(
                f"{kind}, {log.stat().st_size} bytes, {arguments.flips // 2} flips: {dict(counts)}"
            )
        write_log(folder / "small.mcap", samples=16, pictures=0)
        whole = (folder / "small.mcap").read_bytes()
        truth, _ = contents(folder / "small.mcap")
        counts = Counter()
        for end in range(len(whole)):
            (folder / "cut.mcap").write_bytes(whole[:end])
            try:
                seen, said = contents(folder / "cut.mcap")
            except TuneNetError:
                counts["refused"] += 1
                continue
            good = said and is_prefix(seen, truth)
            counts["shorter, damage said" if good else "WRONG"] += 1
        print(f"cut at each of {len(whole)} bytes: {dict(counts)}")


if __name__ == "__main__":
    main()
