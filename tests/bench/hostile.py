"""Measure what small files that claim much cost every command: CPU, memory, exit.

`python -m tests.bench.hostile` makes each of them, and gives it to `tunenet-logs info`, `check` and
`recover` and to `tunenet-tune`, each in a process of its own; `--only NAME ...` makes some.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests import definition_bombs, export_bombs, hostile, work_bombs

BIN = Path(sys.executable).parent
COMMANDS = {
    "info": ("tunenet-logs", "info", "{}"),
    "check": ("tunenet-logs", "check", "{}"),
    "recover": ("tunenet-logs", "recover", "{}", "-o", "saved.mcap", "--overwrite"),
    "tune": ("tunenet-tune", "{}", "-o", "tuned", "--overwrite"),
}
SUFFIXES = {"empty_lines": ".csv"}  # of files that are known by their names


def _made(bomb: Callable[[Path], Path | None], folder: Path) -> Path:
    """Make the file by a function that is given its path, or a folder for it."""
    if bomb in export_bombs.BOMBS:
        path = bomb(folder)
        assert path is not None
        return path
    path = folder / f"bomb{SUFFIXES.get(bomb.__name__, '.mcap')}"
    bomb(path)
    return path


def main() -> None:
    every = (*hostile.BOMBS, *work_bombs.BOMBS, *definition_bombs.BOMBS, *export_bombs.BOMBS)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=[bomb.__name__ for bomb in every])
    only = parser.parse_args().only
    for bomb in every:
        if only and bomb.__name__ not in only:
            continue
        with tempfile.TemporaryDirectory() as name:
            path = _made(bomb, Path(name))
            size = path.stat().st_size if path.is_file() else 0
            for command, (program, *words) in COMMANDS.items():
                line = [str(BIN / program), *(word.format(path.name) for word in words)]
                told = hostile.spent(line, Path(name))
                print(
                    f"{bomb.__name__}, {size} bytes, {command}: {told.cpu_s:.2f} s of CPU, "
                    f"{told.peak_kib / 1024:.0f} MiB, exit code {told.code}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
