"""One process in which every command meets every file that a stranger made to hurt.

`python -m tests.tunenet_logs.hostile_reader FILE ...` says as a line of JSON after each command:
the file, the command, its exit code, what it printed, and the most memory that this process has
ever had.
"""

from __future__ import annotations

import io
import json
import resource
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from tunenet_logs.analysis.cli.tune import main as tunenet_tune
from tunenet_logs.cli import main as tunenet_logs


def main() -> None:
    """Try all files."""
    for path in map(Path, sys.argv[1:]):
        for name, body, *words in (
            ("tunenet-logs check", tunenet_logs, "check", path),
            ("tunenet-tune", tunenet_tune, path, "-o", path.parent),
        ):
            printed = io.StringIO()
            with redirect_stdout(printed), redirect_stderr(printed):
                code = body([str(word) for word in words])
            peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            told = {"file": path.stem, "command": name, "code": code, "peak": peak}
            print(json.dumps({**told, "said": printed.getvalue()}), flush=True)


if __name__ == "__main__":
    main()
