"""Draw logs for `tests.bench.network_worth`, by generators that share no code with the fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests import strangers
from tunenet_logs.analysis.evaluation.worlds.ball import DroppedBall, drop_ball
from tunenet_logs.analysis.evaluation.worlds.clips import draw_clip, write_clip
from tunenet_logs.episode import Array, Episode
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import (
    drawn,
    driver_episode,
    through_kinovas_driver,
)

_SEEDS = 19_000_000  # logs are drawn from these and a seed: nothing was chosen on them
_DROP_M = (0.3, 2.0)  # how far a ball falls: on a table, in a room
_BALL_START_NS = 1_700_000_000_000_000_000
# Of an integrated ball: a usual tracker's rate, 4 s, and some of them before the release.
_BALL_HZ, _BALL_SAMPLES, _HELD_S = 120.0, 480, 0.4

_TRACKER_M = 0.001  # noise of a motion capture system
_MASS_KG = (0.05, 1.5)  # from what a driver's torques just show to what a Jaco lifts
# Samples of an arm's motion, its duration, and messages of a Jaco's driver.
_PATH_HZ, _PATH_S, _DRIVER_HZ = 500.0, 5.2, 65.0


@dataclass(frozen=True, eq=False)
class MadeLog:
    """Log, the first parameter as it was made with, and the empty run that goes with it."""

    episode: Episode
    truth: float
    tares: tuple[Episode, ...] = ()


def made_log(kind: str, seed: int, index: int, folder: Path) -> MadeLog:
    """Draw one log of a kind of `MAKERS`; the folder is to stay as long as the log is in use."""
    return MAKERS[kind](np.random.default_rng([_SEEDS, seed, index, *kind.encode()]), folder)


def _ideal(rng: np.random.Generator, folder: Path) -> MadeLog:
    return _strangers_ball(rng, folder, (60.0, 240.0), (0.0, 0.005))


def _coarse(rng: np.random.Generator, folder: Path) -> MadeLog:
    """Draw few samples and much noise: where a fit may lose its way."""
    return _strangers_ball(rng, folder, (20.0, 40.0), (0.01, 0.03))


def _strangers_ball(
    rng: np.random.Generator,
    folder: Path,
    rates_hz: tuple[float, float],
    noises_m: tuple[float, float],
) -> MadeLog:
    """Draw an ideal ball in closed form, as another laboratory's tracker records it."""
    ball = strangers.Stranger(
        restitution=float(rng.uniform(0.1, 0.95)),
        gap_m=float(rng.uniform(*_DROP_M)),
        rate_hz=float(rng.uniform(*rates_hz)),
        hold_s=float(rng.uniform(0.2, 1.0)),
        noise_m=float(rng.uniform(*noises_m)),
        seed=int(rng.integers(2**31)),
    )
    return MadeLog(_written(*ball.samples(), folder), ball.restitution)


def _not_ideal(rng: np.random.Generator, folder: Path) -> MadeLog:
    """Integrate a ball in air whose restitution falls with speed."""
    ball = DroppedBall(
        drop_m=float(rng.uniform(*_DROP_M)),
        restitution=float(rng.uniform(0.1, 0.92)),
        slope=float(rng.uniform(0.0, 0.12)),
        drag_1_m=float(np.exp(rng.uniform(np.log(0.003), np.log(0.18)))),
    )
    seconds = np.arange(_BALL_SAMPLES) / _BALL_HZ - _HELD_S
    heights_m = drop_ball(ball, seconds).heights_m
    positions_m = np.column_stack([np.zeros((len(seconds), 2)), heights_m])
    positions_m += rng.normal(0.0, _TRACKER_M, positions_m.shape)
    stamps_ns = _BALL_START_NS + np.round(seconds * 1e9).astype(np.int64)
    return MadeLog(_written(stamps_ns, positions_m, folder), ball.restitution)


def _written(stamps_ns: np.ndarray, positions_m: Array, folder: Path) -> Episode:
    path = folder / "ball.mcap"
    strangers.write_poses(path, stamps_ns, positions_m)
    return read_episode(path)


def _film(rng: np.random.Generator, folder: Path) -> MadeLog:
    """Draw a clip, as a phone's file or a log of JPEGs."""
    order = draw_clip(int(rng.integers(2**31)), 0)
    return MadeLog(read_episode(write_clip(order, folder)), order.ball.restitution)


def _payload(rng: np.random.Generator, folder: Path) -> MadeLog:
    """Draw a payload as a real arm's driver reports it; torques by inverse dynamics."""
    del folder
    arm, seed, truth = jaco(), int(rng.integers(2**31)), float(rng.uniform(*_MASS_KG))
    is_circle = rng.random() < 0.5
    when = (_PATH_HZ, _PATH_S)
    moved = circle(*when) if is_circle else random_path(arm, seed, *when)
    disturbances = through_kinovas_driver(drawn(seed, arm), _DRIVER_HZ)
    tare = driver_episode(arm, moved, None, disturbances.another_run())
    return MadeLog(driver_episode(arm, moved, Payload(truth), disturbances), truth, (tare,))


PAYLOADS, FILMS = "payloads with a tare", "films"
# By their line in the table.
MAKERS: Mapping[str, Callable[[np.random.Generator, Path], MadeLog]] = {
    "positions, ideal balls": _ideal,
    "positions, air and slope": _not_ideal,
    "positions, 20 to 40 Hz, 1 to 3 cm of noise": _coarse,
    FILMS: _film,
    PAYLOADS: _payload,
}
