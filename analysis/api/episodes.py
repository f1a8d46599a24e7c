"""Episodes from Python: read, simulated, written as logs."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from analysis.tune_options import AnyPath
from recorders.filmed_drop import FilmOrder
from recorders.simulated_drop import DropOrder
from recorders.simulated_payload import PayloadOrder
from recorders.simulated_shot import ShotOrder
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.read_options import ReadingOptions, reading_of


def read_episode(path: AnyPath, **reading: Unpack[ReadingOptions]) -> Episode:
    """Read any log or video into memory; pictures are read when `Episode.frames` is asked.

    Args:
        path: of a log, a video, a table, a bag or a bag's folder.
        **reading: what the file does not say itself; see `ReadingOptions`.

    Raises:
        LogError: there is no such file, or nothing in it can be read.
        UsageError: an option that makes no sense.
    """
    from tunenet_logs.reader import read_episode as read

    return read(Path(path), reading_of(reading))


def simulate(
    order: DropOrder | PayloadOrder | ShotOrder,
    *,
    film: FilmOrder | None = None,
    engine: str | None = None,
) -> Episode:
    """Simulate an episode, as `tunenet-record --simulate` does. The same order gives the same bits.

    Args:
        order: of a drop, an arm's run with a payload, or a bounce shot.
        film: how a camera films a drop: then the episode has pictures in place of positions.
        engine: see `tune`.

    Raises:
        UsageError: a value that is out of range, or a film of something else than a drop.
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
    """Write an episode as a log (MCAP) that `tune` and every tool of the ecosystem reads.

    Args:
        episode: positions, joints and pictures.
        path: of the log, `NAME.mcap`.
        overwrite: whether a file of that name may be replaced.

    Raises:
        LogError: it exists, or cannot be written.
    """
    from recorders.session import record_episode
    from tunenet_logs.terminal import Progress

    record_episode(episode, Path(path), overwrite=overwrite, progress=Progress(quiet=True))
    return Path(path)
