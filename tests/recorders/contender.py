"""A process that tries to record to a name at a moment that others have been told, too.

`python -m tests.recorders.contender` takes lines from its standard input: "LOG NUMBER OVERWRITE
MOMENT_NS" has it open LOG at that moment of the monotonic clock and write messages that hold its
NUMBER; it answers "won" or why not. "end" has it end the log; it answers "kept" or why not.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from mcap.records import Header

from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import LogError
from tunenet_logs.terminal import Progress
from tunenet_logs.writing.writer import MAGIC, EpisodeWriter, bytes_of

ROOT = Path(__file__).resolve().parents[2]
MESSAGES = 20


# The beginning of a log of ours, by which it is known.
OF_OURS = MAGIC + bytes_of(Header("ros2", "tunenet-logs 0.1.0"))


def main() -> None:
    for line in sys.stdin:
        log, number, overwrite, moment_ns = json.loads(line)
        while time.monotonic_ns() < moment_ns:
            pass
        try:
            writer = EpisodeWriter(Path(log), EpisodeInfo(), overwrite=overwrite)
        except LogError as error:
            print(error, flush=True)
            continue
        for index in range(MESSAGES):
            writer.write_pose("/ball", index, np.array([number, index, 0.0]))
        print("won", flush=True)
        sys.stdin.readline()
        try:
            writer.close()
            print("kept", flush=True)
        except LogError as error:
            print(error, flush=True)


class Contender:
    """One of these processes, with the number that its messages hold."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.recorders.contender"],
            cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def tell(self, word: str) -> None:
        """Send a line."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()

    def answer(self) -> str:
        """The next line that comes back."""
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


@contextmanager
def contenders(count: int) -> Iterator[list[Contender]]:
    """So many processes."""
    every = [Contender(number) for number in range(count)]
    with ExitStack() as stack:
        for one in every:
            stack.callback(one.close)
        yield every


def contend(
    every: list[Contender], folder: Path, rng: random.Random, *, overwrite: bool, left: str
) -> None:
    """Have all record to one name at one moment; exactly one may win, and all of it must be kept.

    Args:
        every: who tries.
        folder: empty; it is emptied again.
        rng: how far apart they begin, up to 0.5 ms.
        overwrite: what they are told.
        left: what lies there already: "", "log" or "active".

    Raises:
        AssertionError: there is not one winner, a log is damaged, or a message is lost.
    """
    log = folder / "a.mcap"
    if left:
        (folder / {"log": "a.mcap", "active": "a.mcap.active"}[left]).write_bytes(OF_OURS)
    begin_ns = time.monotonic_ns() + 1_000_000
    for one in every:
        moment_ns = begin_ns + rng.randrange(500_000)
        one.tell(json.dumps([str(log), one.number, overwrite, moment_ns]))
    said = {one: one.answer() for one in every}
    winners = [one for one, answer in said.items() if answer == "won"]
    assert len(winners) == 1, list(said.values())
    (winner,) = winners
    refused = [answer for one, answer in said.items() if one is not winner]
    assert all("a.mcap.active: is being written by another" in why for why in refused), refused
    winner.tell("end")
    assert (answer := winner.answer()) == "kept", answer
    assert [one.name for one in folder.iterdir()] == ["a.mcap"]
    health = check(log, Progress(quiet=True))
    assert not health.damage
    ball = health.episode.signals["/ball"].values
    assert np.array_equal(ball[:, 0], np.full(MESSAGES, winner.number))
    assert np.array_equal(ball[:, 1], np.arange(MESSAGES))
    log.unlink()


if __name__ == "__main__":
    main()
