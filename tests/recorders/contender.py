"""What others do to a file that is being recorded: record to its name, or take it away.

`python -m tests.recorders.contender` takes lines from its standard input: "LOG NUMBER OVERWRITE
MOMENT_NS" has it open LOG at that moment of the monotonic clock and write messages that hold its
NUMBER; it answers "won" or why not. "end" has it end the log; it answers "kept" or why not.
"""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from mcap.records import Header

from tests.recorders.live_recorder import JOINTS, found_in, started
from tests.recorders.live_recorder import Progress as Put
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


# ---- A file that is taken away

STRANGER = b"not a log, and not yours"
_KEPT = re.compile(r"; (\d+) of \d+ messages are kept in (.+?); ")


def _remove_folder(active: Path) -> None:
    # The recorder's own files may come in between; a person would try again, too.
    while active.parent.exists():
        shutil.rmtree(active.parent, ignore_errors=True)


def _replace(active: Path, copies: bool = False) -> None:
    other = active.with_name("other")
    other.write_bytes(active.read_bytes() if copies else STRANGER)
    other.replace(active)


def _link_to_nothing(active: Path) -> None:
    active.unlink()
    active.symlink_to(active.with_name("nothing"))


def _put_pipe(active: Path) -> None:
    active.unlink()
    os.mkfifo(active)


ATTACKS: dict[str, Callable[[Path], object]] = {
    "removed": Path.unlink,
    "folder removed": _remove_folder,
    "replaced": _replace,
    "replaced by a link to nothing": _link_to_nothing,
    "replaced by a pipe": _put_pipe,
    "moved": lambda active: active.rename(active.with_name("moved.mcap")),
    "folder renamed": lambda active: active.parent.rename(active.parent.with_name("renamed")),
    "replaced by its copy": lambda active: _replace(active, copies=True),
}


def attack(
    folder: Path, how: str, seconds: float, *, ends: bool = False, acknowledged: int = 0
) -> str:
    """Record, take the file away after so long, and look for every acknowledged message.

    Args:
        folder: empty; its folder "logs" is recorded to, its folder "tmp" is the temporary one.
        how: one of `ATTACKS`.
        seconds: from the moment on when it records.
        ends: whether a signal ends the recording right after the attack.
        acknowledged: messages that are waited for before the attack.

    Returns:
        The last line of the recorder.

    Raises:
        AssertionError: it does not say where every message is, or a stranger's file is gone.
    """
    logs, temporary = folder / "logs", folder / "tmp"
    logs.mkdir()
    temporary.mkdir()
    process = started(folder, [JOINTS], logs / "a.mcap", {"TMPDIR": str(temporary)})
    row = Put(folder / "progress").row(JOINTS)
    time.sleep(seconds)
    while row[2] < acknowledged and process.poll() is None:
        time.sleep(0.01)
    ATTACKS[how](logs / "a.mcap.active")
    if ends:
        process.send_signal(signal.SIGTERM)
    said = _ended(process)
    assert process.returncode == 1, (process.returncode, said)
    kept = _KEPT.search(said)
    assert kept, said
    log = logs / kept[2]
    assert not check(log, Progress(quiet=True)).damage
    found = found_in(log)[JOINTS]
    assert found.wrong == 0
    assert found.messages == int(kept[1]) >= int(row[2])
    if how == "replaced":
        assert (logs / "a.mcap.active").read_bytes() == STRANGER
    assert not (logs / "a.mcap").exists()
    return said


def _ended(process: subprocess.Popen[str]) -> str:
    said, _ = process.communicate(timeout=60)
    (line,) = said.splitlines()
    return line


if __name__ == "__main__":
    main()
