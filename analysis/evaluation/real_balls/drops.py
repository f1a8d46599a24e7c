"""Draw recorded drops of balls that a stranger may have, and their logs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.real_balls.physics import Paths, RealBall, fallen
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal

Range = tuple[float, float]

RESTITUTIONS: Range = (0.3, 0.92)
SLOPES: Range = (0.0, 0.12)
DRAGS_1_M: Range = (0.003, 0.18)
DROPS_M: Range = (0.3, 2.0)
RATES_HZ = (30.0, 60.0, 120.0)  # the stranger's balls: even, the drag in its logarithm
SCALES = (0.5, 1.0, 2.0)
# Of the cells: what slope and both ends of the drag's range are multiplied by, and the standard
# deviation of each coordinate.
NOISES_M = (0.001, 0.005)

# From the release to the last sample; a ball that lies earlier is recorded a little longer.
MAX_S = 3.0

MIN_FALL = 0.01  # of the drop: a bounce that ends with a lower fall is not in view
LIES_S: Range = (0.2, 0.6)
_HELD_S: Range = (0.3, 1.0)
_RADII_M: Range = (0.015, 0.12)
_TABLES_M: Range = (-0.5, 1.2)
_START_NS = 1_700_000_000_000_000_000
_TOPIC = "/vrpn/ball/pose"


@dataclass(frozen=True)
class WorldCell:
    """Drops of one kind.

    Attributes:
        scale: of slope and drag; restitution, fall and rate are the same in all cells.
        noise_m: standard deviation of each coordinate.
    """

    scale: float
    noise_m: float

    @property
    def label(self) -> str:
        """Label in tables."""
        return f"x {self.scale:g}, {1000 * self.noise_m:g} mm"

    @property
    def slopes(self) -> Range:
        """Range of slopes."""
        return SLOPES[0] * self.scale, SLOPES[1] * self.scale

    @property
    def drags_1_m(self) -> Range:
        """Range of drags [1/m]."""
        return DRAGS_1_M[0] * self.scale, DRAGS_1_M[1] * self.scale


CELLS = tuple(WorldCell(scale, noise) for noise in NOISES_M for scale in SCALES)


@dataclass(frozen=True, eq=False)
class RecordedDrop:
    """Ball let go and recorded.

    Attributes:
        ball: what fell.
        level_m: z of the ball's centre when it touches the table.
        seconds: of the samples, after the release, shape (T,).
        positions_m: of the ball's centre, with noise, shape (T, 3); z is up.
        noise_m: standard deviation of each coordinate.
        path: what it does in truth, up to the last sample.
    """

    ball: RealBall
    level_m: float
    seconds: Array
    positions_m: Array
    noise_m: float
    path: Paths

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps of the samples, shape (T,)."""
        return _START_NS + np.round((self.seconds - self.seconds[0]) * 1e9).astype(np.int64)

    @property
    def last_bounce_s(self) -> float:
        """Last impact in view, after the release: see `MIN_FALL`."""
        times, speeds = self.path.impacts_s[0], self.path.impact_speeds_m_s[0]
        seen = (times <= self.seconds[-1]) & (speeds >= np.sqrt(MIN_FALL) * speeds[0])
        return float(times[seen].max())

    def seconds_of(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Convert stamps on the log's clock to times after the release, shape (T,)."""
        return (stamps_ns - _START_NS).astype(np.float64) * 1e-9 + self.seconds[0]

    def truth_m(self, seconds: Array) -> Array:
        """Return the height over the contact at times after the release, shape (T,)."""
        return self.path.at(seconds[None])[0]

    def until(self, end_s: float) -> RecordedDrop:
        """Return the drop recorded up to a time after the release."""
        kept = self.seconds <= end_s
        return replace(self, seconds=self.seconds[kept], positions_m=self.positions_m[kept])

    def episode(self) -> Episode:
        """Build the log in memory: positions alone, nothing of ball, table or release."""
        signal = Signal(_TOPIC, self.stamps_ns, self.positions_m, ("x", "y", "z"), "m")
        return Episode(EpisodeInfo(), {_TOPIC: signal})


def draw_drop(cell: WorldCell, seed: int, number: int) -> RecordedDrop:
    """Draw drop `number` of a seed: the same ball, but for the scale, in every cell."""
    rng = np.random.default_rng([seed, number, 1919])
    low, high = np.log(DRAGS_1_M)
    ball = RealBall(
        rng.uniform(*RESTITUTIONS),
        cell.scale * rng.uniform(*SLOPES),
        cell.scale * float(np.exp(rng.uniform(low, high))),
        rng.uniform(*DROPS_M),
    )
    rate_hz = RATES_HZ[int(rng.integers(len(RATES_HZ)))]
    return record_drop(ball, rate_hz, cell.noise_m, rng)


def record_drop(
    ball: RealBall,
    rate_hz: float,
    noise_m: float,
    rng: np.random.Generator,
    longest_s: float = MAX_S,
    lies_s: Range = LIES_S,
) -> RecordedDrop:
    """Hold a ball for a while, let it go, and record it until it has lain for `lies_s`.

    It is recorded for `longest_s` after the release at most.
    """
    level_m = rng.uniform(*_TABLES_M) + rng.uniform(*_RADII_M)
    held_s, rest_s = rng.uniform(*_HELD_S), rng.uniform(*lies_s)
    path = fallen(ball.values[None], longest_s)
    until_s = min(float(path.rests_s[0]) + rest_s, longest_s)
    seconds = np.arange(-held_s, until_s, 1 / rate_hz)
    positions = np.tile([*rng.uniform(-1, 1, 2), level_m], (len(seconds), 1))
    positions[:, 2] += path.at(seconds[None])[0]
    positions += rng.normal(0, noise_m, positions.shape)
    return RecordedDrop(ball, level_m, seconds, positions, noise_m, path)
