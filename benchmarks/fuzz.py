"""Coverage-guided fuzzing of all that reads a log: nothing but our own errors may come out.

`python -m benchmarks.fuzz` runs for three minutes over logs of every kind that the tests can make,
within 2 GiB of memory. It needs the extra `fuzz` (atheris). A log that breaks
something is kept as `crash-...` in the working directory.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import atheris  # pyright: ignore[reportMissingImports] (an extra)

with atheris.instrument_imports(  # type: ignore[attr-defined]
    include=["tunenet_logs", "mcap", "rosbags"]
):
    from tunenet_logs.checking import check
    from tunenet_logs.errors import TuneNetError
    from tunenet_logs.recovery import recover
    from tunenet_logs.terminal import Progress

from benchmarks.logs_of_all_kinds import write_all

_SLOW_S = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=180)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir="/dev/shm") as name:
        folder = Path(name)
        corpus = folder / "corpus"
        corpus.mkdir()
        write_all(corpus)
        slowest = 0.0

        def one(data: bytes) -> None:
            nonlocal slowest
            # files are told apart by their first bytes, tables by their names too
            suffix = ".csv" if data[:1].isalpha() and b"," in data[:100] else ".mcap"
            path = folder / f"a{suffix}"
            path.write_bytes(data)
            start = time.perf_counter()
            with suppress(TuneNetError):
                check(path, Progress(quiet=True))
            with suppress(TuneNetError):
                recover(path, folder / "out.mcap", overwrite=True)
            slowest = max(slowest, time.perf_counter() - start)
            if slowest > _SLOW_S:
                raise RuntimeError(f"took {slowest:.1f} s")

        words = [sys.argv[0], str(corpus), f"-max_total_time={arguments.seconds}", "-max_len=60000"]
        words += ["-rss_limit_mb=2048", "-timeout=20", "-print_final_stats=1"]
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        atheris.Setup(words, one)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
