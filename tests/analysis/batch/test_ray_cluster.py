"""A real Ray cluster of two workers on this machine."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path

import pytest

from tests.analysis.batch.test_ledger import ledger_of, verdicts_of, write_drop
from tests.conftest import BIN, Command

pytest.importorskip("ray")
pytestmark = pytest.mark.live

_COUNT = 24

_OURS = "TUNENET_TEST_RAY"  # a variable that marks what the command starts


def is_loopback(text: str) -> bool:
    """Whether an address is of this machine alone."""
    address = ip_address(text)
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for seed in range(_COUNT - 1):
        write_drop(folder / f"drop{seed:02}.mcap", seed)
    (folder / "bad.mcap").write_bytes(b"none" * 100)
    return folder


def test_logs_of_a_worker_that_dies_are_done_again(logs: Path, tmp_path: Path):
    out = tmp_path / "out"
    words = [str(BIN / "tunenet-tune"), str(logs), "-o", str(out), "--no-review"]
    killed = None
    addresses: set[str] = set()
    with subprocess.Popen(
        [*words, "--jobs", "2", "--ray"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, _OURS: str(out)},
    ) as driver:
        deadline = time.monotonic() + 180
        while driver.poll() is None and killed is None and time.monotonic() < deadline:
            journal = out / "ledger.jsonl"
            if journal.exists() and journal.read_bytes().count(b"\n") >= 2:
                killed = _an_actor(driver.pid)
                addresses |= _listening(_processes(out))
                if killed is not None:
                    os.kill(killed, signal.SIGKILL)
            time.sleep(0.01)
        printed, said = driver.communicate(timeout=180)
    assert killed is not None, said
    assert driver.returncode == 1, said
    rows = ledger_of(out)
    assert len({row["log"] for row in rows}) == len(rows) == _COUNT
    assert verdicts_of(rows) == {"ok": _COUNT - 1, "rejected": 1}
    assert f"{_COUNT} logs: {_COUNT} tuned" in printed
    assert addresses
    assert all(map(is_loopback, addresses)), addresses
    deadline = time.monotonic() + 60
    while _processes(out) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _processes(out)


def _processes(out: Path) -> list[Path]:
    """Those that the command started, and itself."""
    found: list[Path] = []
    for folder in Path("/proc").iterdir():
        with suppress(OSError):
            if folder.name.isdecimal() and os.fsencode(f"{_OURS}={out}") in (
                folder / "environ"
            ).read_bytes().split(b"\0"):
                found.append(folder)
    return found


def _listening(processes: list[Path]) -> set[str]:
    """The addresses at which processes listen."""
    sockets: set[str] = set()
    for process in processes:
        with suppress(OSError):
            for one in (process / "fd").iterdir():
                with suppress(OSError):
                    sockets.add(str(one.readlink()))
    found: set[str] = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and f"socket:[{words[9]}]" in sockets:
                data = bytes.fromhex(words[1].partition(":")[0])
                parts = [data[at : at + 4][::-1] for at in range(0, len(data), 4)]
                found.add(str(ip_address(b"".join(parts))))
    return found


def _an_actor(driver: int) -> int | None:
    """A process of this driver's session that tunes."""
    for folder in Path("/proc").iterdir():
        if not folder.name.isdecimal():
            continue
        try:
            words = (folder / "cmdline").read_bytes()
            state = (folder / "stat").read_text().rsplit(")", 1)[1].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if b"ray::MapWorker" in words and (int(state[3]) == driver or _is_below(folder, driver)):
            return int(folder.name)
    return None


def _is_below(folder: Path, ancestor: int) -> bool:
    """Whether a process descends from another."""
    while True:
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            return False
        if parent == ancestor:
            return True
        if parent <= 1:
            return False
        folder = folder.parent / str(parent)


@pytest.mark.parametrize("words", [("--ray", "127.0.0.1:1"), ("--ray", "drop.mcap")])
def test_an_address_without_a_cluster_is_one_line(
    logs: Path, tmp_path: Path, command: Command, words: tuple[str, ...]
):
    done = command("tunenet-tune", str(logs), "-o", str(tmp_path / "out"), *words)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
