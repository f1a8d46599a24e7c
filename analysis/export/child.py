"""Run an engine in a child process, which contains its output, libraries and crashes.

Started as `python -P -m analysis.export.child ENGINE FILE HEIGHT_M SECONDS`; the last line of its
output is a JSON with what `CanDrop.dropped` returns.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import cast

from analysis.export.registry import CanDrop, export_format


def main() -> None:
    """Drop the ball of an exported file."""
    name, path, height_m, seconds = sys.argv[1:]
    engine = cast("CanDrop", export_format(name))
    times_s, heights_m = engine.dropped(Path(path), float(height_m), float(seconds))
    fall = {"seconds": times_s.tolist(), "heights_m": heights_m.tolist()}
    print(f"\n{json.dumps(fall)}", flush=True)


if __name__ == "__main__":
    main()
