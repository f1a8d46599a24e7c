"""What small files that claim much cost: seconds and memory of a whole process, and what it says.

`python -m benchmarks.hostile` makes each of them, and gives it to `tunenet-tune` and to
`tunenet-logs check`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.hostile import BOMBS, LAUNCHER

BIN = Path(sys.executable).parent
COMMANDS = (("tunenet-tune",), ("tunenet-logs", "check"))


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "bomb.mcap"
        for bomb in BOMBS:
            bomb(log)
            for command, *rest in COMMANDS:
                start = time.perf_counter()
                words = [sys.executable, "-c", LAUNCHER, str(BIN / command), *rest, log.name]
                done = subprocess.run(
                    words, check=False, cwd=folder, capture_output=True, text=True
                )
                took = time.perf_counter() - start
                peak_mib = int(done.stderr.rpartition("peak ")[2]) / 1024
                what = f"{bomb.__name__}, {log.stat().st_size} bytes, {' '.join((command, *rest))}"
                print(f"{what}: {took:.2f} s, {peak_mib:.0f} MiB, exit code {done.returncode}")


if __name__ == "__main__":
    main()
