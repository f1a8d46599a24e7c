"""What people and programs do to a file that is being recorded, and where its messages are then."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from tests.recorders.live_recorder import JOINTS, Progress, found_in, started
from tunenet_logs.copying import check
from tunenet_logs.terminal import Progress as Bars

STRANGER = b"not a log, and not yours"
_KEPT = re.compile(r"; (\d+) of \d+ messages are kept in (.+?); ")


def remove(active: Path) -> None:
    active.unlink()


def remove_folder(active: Path) -> None:
    # The recorder's own files may come in between; a person would try again, too.
    while active.parent.exists():
        shutil.rmtree(active.parent, ignore_errors=True)


def replace(active: Path) -> None:
    other = active.with_name("other")
    other.write_bytes(STRANGER)
    other.replace(active)


def link_to_nothing(active: Path) -> None:
    active.unlink()
    active.symlink_to(active.with_name("nothing"))


def put_pipe(active: Path) -> None:
    active.unlink()
    os.mkfifo(active)


def move(active: Path) -> None:
    active.rename(active.with_name("moved.mcap"))


def rename_folder(active: Path) -> None:
    active.parent.rename(active.parent.with_name("renamed"))


def copy_over(active: Path) -> None:
    copy = active.with_name("copy")
    shutil.copyfile(active, copy)
    copy.replace(active)


ATTACKS: dict[str, Callable[[Path], None]] = {
    "removed": remove,
    "folder removed": remove_folder,
    "replaced": replace,
    "replaced by a link to nothing": link_to_nothing,
    "replaced by a pipe": put_pipe,
    "moved": move,
    "folder renamed": rename_folder,
    "replaced by its copy": copy_over,
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
    row = Progress(folder / "progress").row(JOINTS)
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
    assert not check(log, Bars(quiet=True)).damage
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
