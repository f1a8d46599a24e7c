"""Build signals and episodes from a file's arrays: the part that all export readers share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunenet_logs.episode import FRAME_NS, UNSTATED, Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.meaning import LENGTHS
from tunenet_logs.sample_order import sorted_stamps

_MAX_S = 2.0**62 * 1e-9  # of a time: what int64 holds in ns, so that differences fit as well


def time_stamps(seconds: ArrayLike) -> NDArray[np.int64]:
    """Convert times [s] to stamps [ns], shape (T,).

    Raises:
        ValueError: one is not finite, or out of range.
    """
    values = np.asarray(seconds, np.float64)
    if not np.all(np.abs(values) < _MAX_S):  # NaN is not
        raise ValueError("a time is none")
    return np.round(values * 1e9).astype(np.int64)


def frame_stamps(
    frames: ArrayLike, rate_hz: float | None, options: ReadOptions
) -> tuple[NDArray[np.int64], bool]:
    """Convert frame numbers to stamps [ns], shape (T,), and say whether their rate is unknown.

    Args:
        frames: numbers, shape (T,).
        rate_hz: stated by the file; None where it is unstated. `--fps` takes precedence.
        options: the user's.

    Raises:
        ValueError: a number is not finite, or out of range.
    """
    rate = options.rate_hz or rate_hz
    period_s = FRAME_NS * 1e-9 if not rate else 1 / rate
    return time_stamps(np.asarray(frames, np.float64) * period_s), not rate


def position_signal(
    name: str,
    stamps_ns: NDArray[np.int64],
    values: ArrayLike,
    unit: str,
    options: ReadOptions,
    *,
    counts_frames: bool = False,
) -> tuple[Signal, list[str]]:
    """Build an object's position signal from the rows in which it was seen, and note repairs.

    Args:
        name: of the signal.
        stamps_ns: shape (T,).
        values: x, y, z in `unit`, z up where the file states the vertical; NaN where unseen,
            shape (T, 3).
        unit: one of `LENGTHS`, "px" or `UNSTATED`; `--length-unit` overrides the last two.
        options: the user's.
        counts_frames: see `Signal`.
    """
    rows = np.asarray(values, np.float64)
    seen = np.isfinite(rows).all(axis=1)
    keep, ordered, notes, left_out = sorted_stamps(stamps_ns[seen], (rows[seen],))
    unit = unit if unit in LENGTHS else options.length_unit or unit
    scale, unit = (LENGTHS[unit], "m") if unit in LENGTHS else (1.0, unit or UNSTATED)
    signal = Signal(
        name,
        ordered,
        rows[seen][keep] * scale,
        ("x", "y", "z"),
        unit,
        counts_frames=counts_frames,
        left_out=left_out,
    )
    return signal, [f"{name}: {note}" for note in notes]


def export_episode(
    path: Path,
    what: str,
    signals: Sequence[Signal],
    *,
    unused: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    losses: Sequence[str] = (),
    notes: Mapping[str, str] | None = None,
) -> Episode:
    """Build the episode of an export.

    Args:
        path: of the file.
        what: kind of file: "OptiTrack Motive export", ...
        signals: that a task may use; each name once.
        unused: what else it holds, by name: why that is not used.
        warnings: what was repaired or is doubtful, in words.
        losses: warnings that mean damage.
        notes: of the episode's info.
    """
    channels = [
        Channel(one.name, f"{_listed(one.columns)} [{one.unit or '?'}]", "export", one.stamps_ns)
        for one in signals
    ]
    none: NDArray[np.int64] = np.empty(0, np.int64)
    channels += [
        Channel(name[:200], "", "export", none, skipped=why) for name, why in (unused or {}).items()
    ]
    info = EpisodeInfo(source=f"{what} {path.name}", notes=notes or {})
    by_name = {one.name: one for one in signals if len(one.stamps_ns)}
    return Episode(info, by_name, tuple(channels), (*losses, *warnings), tuple(losses))


def _listed(columns: Sequence[str]) -> str:
    return ", ".join(columns) if len(columns) <= 8 else f"{len(columns)} columns"
