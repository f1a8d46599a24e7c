"""Compare effective with wanted restitution in the installed engines: docs/engines.md's table.

`python -m tests.bench.engines [ENGINE...]` records simulated balls of several restitutions, tunes
them, exports them as `tunenet-export` does, lets each file drop its ball from 0.3 to 3 m, and
prints the worst deviation of the effective restitution: the root of the first rebound's height over
the drop height. Each file is meant for a drop of 1 m; where an engine's restitution depends on
speed, a second row has a file for each height. Last: wall time for a second of the engine's.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import cast

import numpy as np

from tunenet_logs.analysis.evaluation.studies.engines import rebound_restitution
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions, exported
from tunenet_logs.analysis.export.registry import (
    FORMATS,
    CanDrop,
    ExportFormat,
    export_format,
    texts,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

WANTED = (0.2, 0.3, 0.5, 0.7, 0.9)
HEIGHTS_M = np.geomspace(0.3, 3.0, 9)
COARSE_S = 1 / 240


@cache
def tuned(restitution: float) -> Record:
    """Tune a ball that fell 1 m in a simulation, recorded for 3 s at 240 Hz."""
    order = DropOrder(restitution=restitution, height_m=1.0, rate_hz=240.0, seconds=3.0)
    return record_of(tune_episode(simulate_drop(order), TuneOptions(task="drop")))


def ball(engine: ExportFormat, record: Record, options: ExportOptions) -> ExportedBall:
    """Export the ball as `tunenet-export` gives it to an engine's file."""
    item = exported(record, options)
    assert isinstance(item, ExportedBall)
    return item.in_air() if hasattr(engine, "HAS_AIR") else item


def rebound(
    engine: ExportFormat, item: ExportedBall, height_m: float, how: Mapping[str, float]
) -> tuple[float, float]:
    """Return the effective restitution of the file's ball, and ms a simulated second."""
    seconds = math.sqrt(2 * height_m / GRAVITY_M_S2) * (1.2 + 2 * item.restitution)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"ball{engine.SUFFIX}"
        for suffix, text in texts(engine, item).items():
            path.with_suffix(suffix).write_text(text)
        begin_s = time.perf_counter()
        _, heights_m = cast("CanDrop", engine).dropped(path, height_m, seconds, **how)
        took_s = time.perf_counter() - begin_s
    return rebound_restitution(heights_m), 1e3 * took_s / seconds


@dataclass(frozen=True)
class Row:
    """Way to use an engine's file."""

    label: str  # in the table
    step: str  # in words
    step_s: float | None = None  # given to the file; None for its own
    for_each: bool = False  # whether each height has a file for its own impact's speed
    how: Mapping[str, float] = field(default_factory=dict)  # passed on to `dropped`

    def options(self, height_m: float) -> ExportOptions:
        """Return what the user says for a drop from a height."""
        speed_m_s = math.sqrt(2 * GRAVITY_M_S2 * height_m) if self.for_each else None
        return ExportOptions(speed_m_s=speed_m_s, step_s=self.step_s)

    def line(self, engine: ExportFormat) -> str:
        """Measure and format the line of the table."""
        worst, costs_ms = [], []
        for wanted in WANTED:
            off = []
            for height_m in map(float, HEIGHTS_M):
                item = ball(engine, tuned(wanted), self.options(height_m))
                found, cost_ms = rebound(engine, item, height_m, self.how)
                off.append(abs(found - wanted))
                costs_ms.append(cost_ms)
            worst.append(max(off))
        cells = "".join(f"{value:9.4f}" for value in worst)
        return f"{self.label:30}{self.step:12}{cells}{min(costs_ms):10.1f}"


def rows(engine: ExportFormat) -> list[Row]:
    """List the rows of an engine: its file as it comes, and what goes wrong with it."""
    if engine.NAME == "drake":  # by its model, restitution depends on speed
        return [
            Row("drake, a file for 1 m", "continuous"),
            Row("drake, a file for each height", "continuous", for_each=True),
            Row("drake, discrete", "1/1000 s", for_each=True, how={"step_s": 1e-3}),
        ]
    step_s = engine.STEP_S
    assert step_s is not None
    return [
        Row(engine.NAME, f"1/{1 / step_s:.0f} s"),
        Row(f"{engine.NAME}, coarse", f"1/{1 / COARSE_S:.0f} s", step_s=COARSE_S),
    ]


def main() -> None:
    """Print the table, a row as soon as it is measured."""
    head = "".join(f"{f'e = {one:g}':>9}" for one in WANTED)
    print("worst |effective - wanted|, 9 heights from .3 to 3 m")
    print(f"{'engine':30}{'step':12}{head}{'ms per s':>10}")
    for name in sys.argv[1:] or FORMATS:
        engine = export_format(name)
        if engine.LIBRARY is None or find_spec(engine.LIBRARY) is None:
            print(f"{name:30}not run")
            continue
        for row in rows(engine):
            print(row.line(engine), flush=True)


if __name__ == "__main__":
    main()
