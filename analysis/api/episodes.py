"""Read, build, simulate and save episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike

from analysis.tune_options import AnyPath
from recorders.filmed_drop import FilmOrder
from recorders.simulated_drop import DropOrder
from recorders.simulated_payload import PayloadOrder
from recorders.simulated_shot import ShotOrder
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.read_options import ReadingOptions, reading_of

_LATEST_S = 9e9  # after any clock's time in ns that 64 bits hold


def read_episode(path: AnyPath, **reading: Unpack[ReadingOptions]) -> Episode:
    """Read any log or video into memory; images are decoded when `Episode.frames` is called.

    Args:
        path: Log, video, table, ROS bag or a bag's folder.
        **reading: What the file does not state itself; see `ReadingOptions`.

    Raises:
        LogError: There is no such file, or nothing in it can be read.
        UsageError: An option is invalid.
    """
    from tunenet_logs.reader import read_episode as read

    return read(Path(path), reading_of(reading))


def episode_of_positions(
    seconds: ArrayLike,
    positions: ArrayLike,
    *,
    unit: Literal["m", "px", ""] = "m",
    topic: str = "/ball/pose",
) -> Episode:
    """Build the episode of a drop from arrays, for `tune` and `save_episode`.

    Args:
        seconds: Stamp of each position [s], increasing; shape (T,).
        positions: x, y, z with z up, shape (T, 3); or heights alone, shape (T,).
        unit: Unit of the positions; "" if unknown: gravity then gives the scale.
        topic: Name of the signal.

    Raises:
        UsageError: Shapes disagree, a number is not finite, or the stamps do not increase.
    """
    placed = np.array(positions, float)
    if placed.ndim == 1:
        placed = np.column_stack([np.zeros((len(placed), 2)), placed])
    signal = _signal(topic, seconds, placed, ("x", "y", "z"), unit)
    return Episode(EpisodeInfo(kind="drop", source="Python"), {topic: signal})


def episode_of_joints(
    seconds: ArrayLike,
    names: Sequence[str],
    position_rad: ArrayLike,
    effort_nm: ArrayLike,
    velocity_rad_s: ArrayLike | None = None,
    *,
    topic: str = "/joint_states",
) -> Episode:
    """Build the episode of an arm's run from arrays, for `tune` and `save_episode`.

    Args:
        seconds: Stamp of each joint state [s], increasing; shape (T,).
        names: Names of the J joints, as in the arm's URDF.
        position_rad: Joint positions, shape (T, J).
        effort_nm: Joint torques, shape (T, J).
        velocity_rad_s: Joint velocities, shape (T, J); None if not measured.
        topic: Name of the signals.

    Raises:
        UsageError: Shapes disagree, a number is not finite, or the stamps do not increase.
    """
    parts = [("position", position_rad, "rad"), ("effort", effort_nm, "N·m")]
    if velocity_rad_s is not None:
        parts.append(("velocity", velocity_rad_s, "rad/s"))
    signals = {
        f"{topic}.{part}": _signal(
            f"{topic}.{part}", seconds, np.array(values, float), tuple(names), unit
        )
        for part, values, unit in parts
    }
    return Episode(EpisodeInfo(kind="payload", source="Python"), signals)


def _signal(
    name: str, seconds: ArrayLike, values: Array, columns: tuple[str, ...], unit: str
) -> Signal:
    stamps_s = np.array(seconds, float)
    if not (np.isfinite(stamps_s).all() and np.isfinite(values).all()):
        raise UsageError(f"{name}: a number is missing or not finite; leave such samples out")
    if not (np.abs(stamps_s) < _LATEST_S).all():
        raise UsageError(f"{name}: times are in seconds, below {_LATEST_S:g}")
    try:
        return Signal(name, np.round(stamps_s * 1e9).astype(np.int64), values, columns, unit)
    except ValueError as error:
        raise UsageError(str(error)) from error


def simulate(
    order: DropOrder | PayloadOrder | ShotOrder,
    *,
    film: FilmOrder | None = None,
    engine: str | None = None,
) -> Episode:
    """Simulate an episode, as `tunenet-record --simulate` does. Equal orders give equal bits.

    Args:
        order: A drop, an arm's run with a payload, or a bounce shot.
        film: How a camera films a drop; the episode then has images instead of positions.
        engine: See `tune`.

    Raises:
        UsageError: A value is out of range, or something else than a drop is to be filmed.
    """
    from recorders.filmed_drop import film_drop
    from recorders.simulated_drop import simulate_drop
    from recorders.simulated_payload import simulate_payload
    from recorders.simulated_shot import simulate_shot
    from recorders.simulators.engines import simulated_by

    with simulated_by(engine):
        if isinstance(order, DropOrder):
            return simulate_drop(order) if film is None else film_drop(order, film)
        if film is not None:
            raise UsageError("only a drop can be filmed; leave film out")
        if isinstance(order, PayloadOrder):
            return simulate_payload(order)
        return simulate_shot(order)


def save_episode(episode: Episode, path: AnyPath, *, overwrite: bool = False) -> Path:
    """Write an episode as an MCAP log that `tune` and other MCAP tools read.

    Args:
        episode: Positions, joint states and images.
        path: The log, `NAME.mcap`.
        overwrite: Whether an existing file may be replaced.

    Raises:
        LogError: The file exists, or cannot be written.
    """
    from recorders.session import record_episode
    from tunenet_logs.terminal import Progress

    record_episode(episode, Path(path), overwrite=overwrite, progress=Progress(quiet=True))
    return Path(path)
