"""Measure batches of many logs: processes against one, Ray, memory, kills.

`python -m tests.bench.batches` makes small logs of a ball's positions (those of
`tests.bench.state_logs`), 5 % of them damaged, and tunes them to JSON and ledger without reviews.
Rates count from the first results on, so that starting processes is left out. `--kills 30` kills
the driver and its workers in turn, at random moments, begins again with `--resume`, and counts the
ledger's rows.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tests.bench.state_logs import write_log
from tunenet_logs.analysis.batch.ledger import ledger_file
from tunenet_logs.analysis.batch.logs import find_logs
from tunenet_logs.analysis.batch.run import Order, Result, Work, Writing, run_batch
from tunenet_logs.analysis.parallel import streamed
from tunenet_logs.terminal import Progress

_DIFFERENT, _DAMAGED_EVERY, _STARTING = 100, 20, 64
_SLEEP_S, _MAX_S = 0.01, 600.0


def make_logs(folder: Path, count: int) -> None:
    """Write logs of which one in twenty is cut in its middle or no log at all."""
    folder.mkdir()
    for index in range(count):
        path = folder / f"{index:06}.mcap"
        if index < _DIFFERENT:
            write_log(path, index)
        else:
            shutil.copyfile(folder / f"{index % _DIFFERENT:06}.mcap", path)
    for index in range(_DAMAGED_EVERY - 1, count, _DAMAGED_EVERY):
        path = folder / f"{index:06}.mcap"
        path.write_bytes(b"no log" * 100 if index % 40 > 20 else path.read_bytes()[:300])


class Timed:
    """Stream of results that notes when they come, and what its workers hold in memory."""

    def __init__(self, stream: Callable[..., Iterator[tuple[int, Result]]]) -> None:
        self._stream = stream
        self.moments_s: list[float] = []
        self.resident_mb = 0.0

    def __call__(
        self,
        work: Callable[[Work], Result],
        items: Sequence[Work],
        lost: Callable[[Work], Result],
    ) -> Iterator[tuple[int, Result]]:
        """See `Streamed`."""
        for one in self._stream(work=work, items=items, lost=lost):
            self.moments_s.append(time.monotonic())
            if len(self.moments_s) == len(items):
                self.resident_mb = max(map(_resident_mb, _descendants(os.getpid())), default=0.0)
            yield one

    @property
    def rate(self) -> float:
        """Return the results a second, after the first ones."""
        moments = self.moments_s[_STARTING:]
        return (len(moments) - 1) / (moments[-1] - moments[0])


def rates(folder: Path, out: Path) -> dict[str, Any]:
    """Measure logs a second by one process, by two, by two of Ray's."""
    logs = find_logs([folder]).logs
    ways: dict[str, Timed] = {
        "one process": Timed(partial(streamed, jobs=1)),
        "two processes": Timed(partial(streamed, jobs=2)),
    }
    if find_spec("ray"):
        from tunenet_logs.analysis.parallel import HERE, Cluster, on_cluster

        ways["two workers of Ray"] = Timed(partial(on_cluster, Cluster(HERE, 2)))
    writing = Writing(reviewed=frozenset())
    found: dict[str, Any] = {}
    for name, way in ways.items():
        place = out / name.replace(" ", "_")
        order = Order(logs, writing=writing, folder=place, keeps_ledger=True)
        batch = run_batch(order, Progress(quiet=True), way)
        found[name] = {
            "logs_a_second": round(way.rate, 1),
            "largest_worker_mb": round(way.resident_mb),
            "verdicts": dict(batch.verdicts),
        }
        print(f"{name:20} {way.rate:6.1f} logs a second, largest worker {way.resident_mb:.0f} MB")
    one, two = (found[name]["logs_a_second"] for name in ("one process", "two processes"))
    found["two_against_one"] = round(two / one, 2)
    print(f"two processes against one: {two / one:.2f}")
    if "two workers of Ray" in found:
        ratio = found["two workers of Ray"]["logs_a_second"] / two
        found["ray_against_processes"] = round(ratio, 2)
        print(f"Ray against processes: {ratio:.2f}")
    return found


def figures(count: int = 2000) -> dict[str, Any]:
    """Measure `rates` of so many logs."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "logs"
        make_logs(folder, count)
        return rates(folder, Path(made))


def killed(folder: Path, out: Path, kills: int) -> dict[str, Any]:
    """Measure a batch whose driver and workers are killed so often, by its ledger."""
    words = [
        sys.executable,
        "-m",
        "tunenet_logs.analysis.cli.tune",
        str(folder),
        "-o",
        str(out),
        "--resume",
    ]
    words += ["--no-review", "--quiet", "--jobs", "2"]
    rng, left, starts = random.Random(5), kills, 0
    began_s = time.monotonic()
    while time.monotonic() - began_s < _MAX_S:
        starts += 1
        with subprocess.Popen(words, stdout=subprocess.DEVNULL) as driver:
            at_s = time.monotonic() + rng.uniform(1.5, 5.0)
            while driver.poll() is None:
                time.sleep(_SLEEP_S)
                if left and time.monotonic() > at_s:
                    workers = _descendants(driver.pid)
                    victim = driver.pid if left % 2 or not workers else rng.choice(workers)
                    os.kill(victim, signal.SIGKILL)
                    left -= 1
                    at_s = time.monotonic() + rng.uniform(0.5, 4.0)
        if driver.returncode in (0, 1):
            break
    rows = _rows(out)
    names = Counter(row["log"] for row in rows)
    wanted = {str(path.resolve()) for path in folder.iterdir()}
    found = {
        "kills": kills - left,
        "starts": starts,
        "logs": len(wanted),
        "lost": len(wanted - set(names)),
        "twice": sum(count > 1 for count in names.values()),
        "not_done": sum(row["error"] is not None for row in rows),
        "verdicts": dict(Counter(row["verdict"] for row in rows)),
    }
    print(", ".join(f"{name} {value}" for name, value in found.items()))
    return found


def _rows(out: Path) -> list[dict[str, Any]]:
    from pyarrow import parquet

    return parquet.read_table(ledger_file(out)).to_pylist()


def _descendants(process: int) -> list[int]:
    """List processes below one that tune: of the pool, or of Ray."""
    found: list[int] = []
    try:
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    except OSError:
        return found
    for child in map(int, children):
        try:
            words = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:
            continue
        if b"spawn_main" in words or b"ray::MapWorker" in words:
            found.append(child)
        found += _descendants(child)
    return found


def _resident_mb(process: int) -> float:
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096 / 1e6
    except OSError:
        return 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    if arguments.kills:
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "logs"
            make_logs(folder, arguments.count)
            found = killed(folder, Path(made) / "out", arguments.kills)
    else:
        found = figures(arguments.count)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
