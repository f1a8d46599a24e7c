"""Fuzz all that reads a log: nothing but our own errors may come out, and soon.

`python -m tests.bench.fuzz` runs for three minutes over logs of every kind that the tests can make.
It needs the extra `fuzz` (atheris), whose coverage guides it, but makes all slower; `--plain` does
without, and goes on from the slowest logs. One that breaks something is kept as `crash-...` in the
working directory, as is one that takes more CPU than it may. The figures of all of them are printed
now and then, and at the end.
"""

from __future__ import annotations

import argparse
import random
import resource
import statistics
import struct
import sys
import tempfile
import time
import zlib
from contextlib import suppress
from pathlib import Path

_SMALL_BYTES = 64 * 1024  # what is smaller is measured as a whole, what is larger by the byte
_MAX_SMALL_S = 2.0  # CPU that a small log may take, to be checked and recovered
_MAX_RATIO = 10.0  # how much more a byte of a large log may cost than one of a whole log
_FROM_SLOW, _MAX_SLOW = 0.5, 40  # without coverage: share of logs made of slow ones, of so many
_MAX_BYTES, _REPORT_EVERY = 200_000, 2_000
_EDGES = (0, 1, 8, 22, 255, 65_535, 2**31 - 1, 2**32 - 1)  # what lengths and counts are set to


def mutant(data: bytes, most: int, seed: int) -> bytes:
    """Mutate a log of at most `most` bytes: double, cut or move blocks, and change lengths."""
    chance = random.Random(seed)
    made = bytearray(data)
    for _ in range(chance.randint(1, 3)):
        begin = chance.randrange(len(made) + 1)
        end = min(len(made), begin + int(2 ** chance.uniform(0, 12)))
        match chance.randrange(4):
            case 0:
                room = max(0, most - len(made)) // max(1, end - begin)
                many = min(room, int(2 ** chance.uniform(0, 16)))
                made[begin:begin] = made[begin:end] * many
            case 1:
                at = chance.randrange(len(made) + 1)
                made[at:at] = made[begin:end]
            case 2:
                del made[begin:end]
            case _:
                form = chance.choice(("<H", "<I", "<Q", ">H", ">I"))
                width = struct.calcsize(form)
                number = min(chance.choice((*_EDGES, len(made) - begin)), 256**width - 1)
                made[begin : begin + width] = struct.pack(form, number)
    return bytes(made[:most])


class Bench:
    """Bench that checks and recovers logs, and measures what that costs."""

    def __init__(self, folder: Path) -> None:
        from tests.bench.robustness import write_all

        self._folder, self.corpus = folder, folder / "corpus"
        self.corpus.mkdir()
        write_all(self.corpus)
        self.whole = [file.read_bytes() for file in sorted(self.corpus.iterdir())]
        for data in self.whole:  # what is imported late is not counted
            self._cost_s(data)
        # CPU for a byte of a whole log
        self._usual_s = statistics.median(self._cost_s(data) / len(data) for data in self.whole)
        self._logs, self._slowest, self._ratios = 0, (0.0, 0), [0.0]

    def _cost_s(self, data: bytes) -> float:
        """Return the CPU time of a log [s]."""
        from tunenet_logs.copying import check, recover
        from tunenet_logs.errors import TuneNetError
        from tunenet_logs.terminal import Progress

        # files are told apart by their first bytes, tables by their names too
        suffix = ".csv" if data[:1].isalpha() and b"," in data[:100] else ".mcap"
        path = self._folder / f"a{suffix}"
        path.write_bytes(data)
        start = time.process_time()
        with suppress(TuneNetError):
            check(path, Progress(quiet=True))
        with suppress(TuneNetError):
            recover(path, self._folder / "out.mcap", overwrite=True)
        return time.process_time() - start

    def one(self, data: bytes) -> float:
        """Count a log, and return its CPU time [s]; RuntimeError where it took more than it may."""
        size, usual_s = len(data), self._usual_s * len(data)
        most_s = _MAX_SMALL_S if size <= _SMALL_BYTES else _MAX_RATIO * usual_s
        cpu_s = self._cost_s(data)
        if cpu_s > most_s:  # a busy machine makes caches cold
            cpu_s = min(cpu_s, self._cost_s(data), self._cost_s(data))
        self._logs += 1
        if self._logs % _REPORT_EVERY == 0:
            print(self.told(), file=sys.stderr, flush=True)
        if size <= _SMALL_BYTES:
            self._slowest = max(self._slowest, (cpu_s, size))
        else:
            self._ratios.append(cpu_s / usual_s)
        if cpu_s > most_s:
            raise RuntimeError(f"{size} bytes took {cpu_s:.2f} s, usual are {usual_s:.2f} s")
        return cpu_s

    def told(self) -> str:
        """Format the figures as a line."""
        cpu_s, size = self._slowest
        return (
            f"{self._logs} logs; slowest small one {cpu_s:.2f} s for {size} bytes; "
            f"{len(self._ratios) - 1} large ones, the worst {max(self._ratios):.2f} times as slow "
            f"as usual ({self._usual_s * 1e6:.2f} s/MB)"
        )


def _guided(folder: Path, seconds: int) -> None:
    """Fuzz by coverage."""
    import atheris  # pyright: ignore[reportMissingImports] (an extra)

    with atheris.instrument_imports(  # type: ignore[attr-defined]
        include=["tunenet_logs", "mcap", "rosbags"]
    ):
        bench = Bench(folder)

    def changed(data: bytes, most: int, seed: int) -> bytes:
        return mutant(data, most, seed) if seed % 2 else atheris.Mutate(data, most)

    words = [sys.argv[0], str(bench.corpus), f"-max_total_time={seconds}"]
    words += [f"-max_len={_MAX_BYTES}", "-len_control=0"]  # which keeps what a mutator gives it
    words += ["-rss_limit_mb=8192", "-timeout=60", "-print_final_stats=1"]

    def one(data: bytes) -> None:
        bench.one(data)

    atheris.Setup(words, one, custom_mutator=changed)
    atheris.Fuzz()


def _plain(folder: Path, seconds: int) -> None:
    """Fuzz from the logs that took longest, by the byte, and from the whole ones."""
    bench = Bench(folder)
    slow: list[tuple[float, bytes]] = []
    end_s = time.monotonic() + seconds
    chance = random.Random(seconds)
    while time.monotonic() < end_s:
        known = [data for _, data in slow] if chance.random() < _FROM_SLOW else []
        data = mutant(chance.choice(known or bench.whole), _MAX_BYTES, chance.getrandbits(32))
        try:
            spent_s = bench.one(data)
        except Exception as error:  # noqa: BLE001 (whatever comes out is what is looked for)
            kept = Path(f"crash-{zlib.crc32(data):08x}")
            kept.write_bytes(data)
            print(f"{kept}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            continue
        slow.append((spent_s / max(len(data), _SMALL_BYTES // 8), data))
        slow.sort(key=lambda one: -one[0])
        del slow[_MAX_SLOW:]
    print(bench.told())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=180)
    parser.add_argument("--plain", action="store_true", help="without atheris, and its slowness")
    arguments = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory(dir="/dev/shm") as name:
        (_plain if arguments.plain else _guided)(Path(name), arguments.seconds)


if __name__ == "__main__":
    main()
