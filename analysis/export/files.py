"""Write a tuning as an engine's files, and check one: its engine drops the ball again.

The engine runs in the sandbox, which contains its output, libraries and crashes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ExportOptions,
    exported,
)
from tunenet_logs.analysis.export.registry import (
    FORMATS,
    MODEL_FORMATS,
    CanDrop,
    ExportFormat,
    export_format,
    texts,
)
from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.sandbox import Sandbox, SandboxError
from tunenet_logs.recorders.simulators.ball import lands_after_s
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    from tunenet_logs.analysis.record import Record


# ---- Check: drop the ball in its engine, and measure its bounces.

LIMIT_S = 300.0  # wall time that an engine may take: some compile themselves first
_MAX_SECONDS, _MAX_BOUNCES = 10.0, 6  # that are simulated, and that are listed
# Of the drop height: the first rebound and later ones, below which an engine only settles.
_LOWEST_FIRST, _LOWEST_REBOUND = 0.002, 0.02


@dataclass(frozen=True)
class DropCheck:
    """How an engine moved the ball of an exported file."""

    effective: tuple[float, ...]  # restitution of each bounce
    # From the recording, up to the last impact seen [% of the drop height]; None without metres
    rms_percent: float | None


def checked(engine: ExportFormat, path: Path, ball: ExportedBall) -> DropCheck | str:
    """Drop the ball in the engine, in a child process; return in words why it cannot be done."""
    if engine.LIBRARY is None or not hasattr(engine, "dropped"):
        return f"nothing here runs a file for {engine.NAME}"
    if find_spec(engine.LIBRARY) is None:
        return f"{engine.NAME} is not installed"
    # The time to simulate: the recording's, and that of the listed bounces.
    fall_s = math.sqrt(2 * ball.drop_height_m.value / GRAVITY_M_S2)
    bounces = sum(2 * ball.restitution**k for k in range(1, _MAX_BOUNCES + 1))
    recorded_s = 0.0
    if ball.observed is not None:
        recorded_s = ball.observed.last_s - ball.observed.impact_s
    height_m = ball.drop_height_m.value
    seconds = min(max(fall_s * (1.1 + bounces), fall_s + recorded_s), _MAX_SECONDS)
    box = Sandbox(memory_bytes=None, cpu_s=None, wall_s=LIMIT_S, environment={})
    try:
        with box:
            _, fall = box.ask(dropped, engine.NAME, str(path.absolute()), height_m, seconds)
    except SandboxError as error:
        if error.kind == "time":
            return f"{engine.NAME} took longer than {LIMIT_S:.0f} s"
        last = f"{error.raised}: {error.said}" if error.raised else f"code {error.code}"
        # What the engine said last, at most 200 characters.
        return f"{engine.NAME} ended with: {short_name(last, 200)}"
    times_s, heights_m = fall["seconds"], fall["heights_m"]
    has_air = hasattr(engine, "HAS_AIR")
    by_bounce = restitutions_at_impacts if has_air else effective_restitutions
    seen, rms_percent = ball.observed, None
    if seen is not None:
        drag_1_m = ball.drag_1_m if has_air else 0.0
        fall_s = lands_after_s(float(heights_m[0]), 0.0, GRAVITY_M_S2, drag_1_m)
        # The RMS difference from the recording, whose clock reads `release_s` at release.
        release_s = seen.impact_s - fall_s
        since_s = seen.curves.seconds - release_s
        until_s = min(float(times_s[-1]), seen.last_s - release_s)
        compared = (since_s >= 0) & (since_s <= until_s) & np.isfinite(seen.curves.observed_m)
        if np.any(compared):
            simulated_m = np.interp(since_s[compared], times_s, heights_m)
            off_m = simulated_m - seen.curves.observed_m[compared]
            rms_percent = 100 * float(np.sqrt(np.mean(off_m**2))) / float(heights_m[0])
    return DropCheck(by_bounce(heights_m, float(times_s[1])), rms_percent)


def dropped(
    name: str, path: str, height_m: float, seconds: float
) -> Iterator[tuple[None, dict[str, Array]]]:
    """Drop the ball of an exported file, in the sandbox."""
    engine = cast("CanDrop", export_format(name))
    times_s, heights_m = engine.dropped(Path(path), height_m, seconds)
    yield None, {"seconds": np.asarray(times_s, float), "heights_m": np.asarray(heights_m, float)}


def effective_restitutions(heights_m: Array, _period_s: float = 0.0) -> tuple[float, ...]:
    """Measure the restitution of each bounce without air, from the apexes of heights (T,)."""
    middle = heights_m[1:-1]
    turns = 1 + np.flatnonzero((middle > heights_m[:-2]) & (middle >= heights_m[2:]))
    height_m = float(heights_m[0])
    tops_m = [_top(heights_m[turn - 1 : turn + 2]) for turn in turns]
    if not tops_m or tops_m[0] < _LOWEST_FIRST * height_m:
        return ()
    seen_m = [height_m, tops_m[0], *(top for top in tops_m[1:] if top > _LOWEST_REBOUND * height_m)]
    return tuple(math.sqrt(top_m / before_m) for before_m, top_m in pairwise(seen_m))[:_MAX_BOUNCES]


def restitutions_at_impacts(heights_m: Array, period_s: float) -> tuple[float, ...]:
    """Measure each bounce's restitution in air, from the energies a step before and after it.

    Contacts take one step, in which the drag is negligible. `heights_m` (T,).
    """
    middle = heights_m[1:-1]
    turns = 1 + np.flatnonzero((middle < heights_m[:-2]) & (middle <= heights_m[2:]))
    speeds_m_s = np.diff(heights_m) / period_s
    before = speeds_m_s[turns - 1] ** 2 / 2 + GRAVITY_M_S2 * heights_m[turns]
    after = speeds_m_s[turns] ** 2 / 2 + GRAVITY_M_S2 * heights_m[turns + 1]
    least = _LOWEST_REBOUND * GRAVITY_M_S2 * float(heights_m[0])
    strong = (before > least) & (after > 0)
    return tuple(np.sqrt(after[strong] / before[strong])[:_MAX_BOUNCES].tolist())


def _top(around_m: Array) -> float:
    """Return the vertex of the parabola through three samples about an apex."""
    before, middle, after = around_m.tolist()
    bend = before - 2 * middle + after
    return middle - (after - before) ** 2 / (8 * bend) if bend else middle


# ---- Files: the texts of a tuning in an engine's format.


def exported_for(
    engine: ExportFormat, record: Record, said: ExportOptions
) -> ExportedBall | ExportedPayload:
    """Convert a record to what an engine's file expresses."""
    if said.step_s is not None and engine.STEP_S is None:
        raise UsageError(f"a file for {engine.NAME} holds no time step: leave --step out")
    item = exported(record, said)
    if isinstance(item, ExportedBall) and hasattr(engine, "HAS_AIR"):
        return item.in_air()
    return item


def export_texts(
    engine: ExportFormat, item: ExportedBall | ExportedPayload, path: Path
) -> dict[Path, str]:
    """Return the texts of the files to write by their paths; the engine's own comes first."""
    if path.suffix != engine.SUFFIX:
        raise UsageError(f"{path}: is for {engine.NAME}; give -o a name that ends {engine.SUFFIX}")
    return {path.with_suffix(suffix): text for suffix, text in texts(engine, item).items()}


def engine_format(name: str) -> ExportFormat:
    """Return the format of that name, for a ball or a payload."""
    if name in MODEL_FORMATS and name not in FORMATS:
        raise UsageError(f"{name} is the own file of a tuned model: choose another of --to")
    if name not in FORMATS:
        raise UsageError(f"nothing is exported to {name!r}; choose one of: {', '.join(FORMATS)}")
    return export_format(name)
