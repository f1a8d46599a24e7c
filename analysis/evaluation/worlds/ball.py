"""Drop balls whose truth is known, by integrators that share nothing with the fits or simulators.

`fallen` steps balls in air that bounce on a plane. `run_ball` steps one among obstacles, with spin,
in the hidden world of the bounce shot. `bounced` is in closed form, with contacts that last: the
truth behind a sound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.shot import ShotRig

Range = tuple[float, float]

TEST_SEEDS = 7_000_000  # test targets are drawn from seeds above it, training's from below


# ---- Balls that bounce in air, several at once: those of a fit's derivatives.
# dv/dt = -g - k v |v| is stepped by the classical Runge-Kutta method (Kutta 1901). A flight is cut
# at its apex, where v |v| is not smooth, and the step onto the table is found by Newton's method.

GRAVITY_M_S2 = 9.81

MIN_SPEED_M_S = 0.05  # of the balls of a table: slower impacts have the restitution at this speed
_STILL_M_S = 1e-3  # a ball that rebounds slower lies still: it would rise by 50 nm
STEPS = 32  # of half a flight at the first impact's speed; of slower ones fewer, in proportion

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True)
class RealBall:
    """Ball and its drop."""

    restitution: float  # e, at the first impact's speed
    slope: float  # p of e(v) = e (v / v_first)^-p, kept from 0 to 1
    drag_1_m: float  # k of dv/dt = -g - k v |v|
    drop_m: float  # from its contact with the table up to where it is let go, at rest

    @property
    def values(self) -> Array:
        """Parameters in the order of the fields, shape (4,)."""
        return np.array([self.restitution, self.slope, self.drag_1_m, self.drop_m])

    @property
    def fall_s(self) -> float:
        """Duration of the fall without air."""
        return float(np.sqrt(2 * self.drop_m / GRAVITY_M_S2))


@dataclass(frozen=True, eq=False)
class Paths:
    """Motion of B balls: states from each of which one step reaches the next."""

    drops_m: Array  # see `RealBall`, shape (B,)
    drags_1_m: Array  # likewise, shape (B,)
    times_s: Array  # of M states, after the release, shape (B, M), never falling
    heights_m: Array  # over the contact, shape (B, M)
    speeds_m_s: Array  # upward, after an impact, shape (B, M)
    impacts_s: Array  # of N impacts, shape (B, N); those after the end asked for are not all there
    impact_speeds_m_s: Array  # downward, shape (B, N); 0 once it lies
    rests_s: Array  # from when on a ball lies still, shape (B,); inf where it does not

    def at(self, seconds: Array) -> Array:
        """Return heights over the contact [m], shape (B, T), at times after the release, (B, T)."""
        rows = np.arange(len(seconds))[:, None]
        since = np.maximum(seconds, 0.0)
        found = [
            np.searchsorted(own, asked, side="right") - 1
            for own, asked in zip(self.times_s, since, strict=True)
        ]
        states = np.array(found)
        heights, _ = _stepped(
            self.heights_m[rows, states],
            self.speeds_m_s[rows, states],
            since - self.times_s[rows, states],
            self.drags_1_m[:, None],
        )
        heights = np.where(since >= self.rests_s[:, None], 0.0, heights)
        return np.where(seconds <= 0, self.drops_m[:, None], heights)


def fallen(
    balls: Array, until_s: float, steps: int = STEPS, slowest_m_s: float = MIN_SPEED_M_S
) -> Paths:
    """Integrate balls (restitution, slope, drag [1/m], drop [m]), shape (B, 4), until they lie.

    Below the slowest impact the restitution no longer changes.
    """
    restitutions, slopes, drags, drops = np.asarray(balls, dtype=np.float64).T
    tape = _Tape(drags, np.zeros(len(drops)), drops, np.zeros(len(drops)))
    first = tape.fall(steps)
    impacts, speeds = [tape.time], [first]
    rests = np.full(len(drops), np.inf)
    hit = first
    while True:
        ratio = np.maximum(hit, slowest_m_s) / first
        up = np.clip(restitutions * ratio**-slopes, 0.0, 1.0) * hit
        still = up < _STILL_M_S
        rests = np.where(still & np.isinf(rests), tape.time, rests)
        if np.all(still | (tape.time > until_s)):
            break
        count = max(2, int(np.ceil(steps * np.max(up / first))))
        tape.rise(np.where(still, 0.0, up), count)
        hit = np.where(still, 0.0, tape.fall(count))
        impacts.append(tape.time)
        speeds.append(hit)
    return Paths(
        drops,
        drags,
        *(np.array(column).T for column in zip(*tape.states, strict=True)),
        impacts_s=np.array(impacts).T,
        impact_speeds_m_s=np.array(speeds).T,
        rests_s=rests,
    )


@dataclass(frozen=True, eq=False)
class Fall:
    """Motion of one ball."""

    heights_m: Array  # over its contact, at the given times, shape (T,)
    impacts_s: Array  # up to the last of these times, and some beyond, shape (N,)
    impact_speeds_m_s: Array  # downward, shape (N,)


def drop_ball(ball: RealBall, seconds: Array) -> Fall:
    """Integrate one ball at increasing times after its release, shape (T,); held before."""
    path = fallen(ball.values[None], float(seconds[-1]), slowest_m_s=_STILL_M_S)
    return Fall(path.at(seconds[None])[0], path.impacts_s[0], path.impact_speeds_m_s[0])


@dataclass(frozen=True)
class HomeDrop:
    """Ball as people let it go: by a hand that moves, onto a table that gives, with a kick.

    Time 0 is when the ball would have been at rest for this fall. Until it leaves the hand it goes
    with it, at the speed that it then has.
    """

    ball: RealBall
    hand_m_s: float = 0.0  # downward, when it lets go
    ease_s: float = 0.1  # for which the hand has moved, from rest, before it does
    contact_s: float = 0.0  # how long each impact's contact lasts; meanwhile the ball is squashed
    kick_m_s: tuple[float, float] = (0.0, 0.0)  # sideways and away, from the first impact on
    push_m_s: tuple[float, float] = (0.0, 0.0)  # likewise, from when it leaves the hand on

    @property
    def released_s(self) -> float:
        """When it leaves the hand."""
        return self.hand_m_s / GRAVITY_M_S2

    def points_m(self, seconds: Array) -> Array:
        """Return points over the first contact at these times, shape (T, 3) [m]."""
        free = drop_ball(self.ball, np.append(seconds, seconds[-1] + 1.0))  # and one impact more
        begins_s = free.impacts_s + self.contact_s * np.arange(len(free.impacts_s))
        number = np.searchsorted(begins_s, seconds, side="right") - 1  # of the last impact
        at = np.maximum(number, 0)
        since = np.where(number < 0, 0.0, seconds - begins_s[at])
        touches = (number >= 0) & (since < self.contact_s)
        flown_s = seconds - self.contact_s * (number + 1)
        heights = drop_ball(self.ball, np.maximum.accumulate(np.maximum(flown_s, 0.0))).heights_m
        # A spring gives way as a half sine.
        depth_m = free.impact_speeds_m_s[at] * self.contact_s / np.pi
        phase = np.pi * since / max(self.contact_s, 1e-9)
        heights = np.where(touches, -depth_m * np.sin(np.minimum(phase, np.pi)), heights)
        # In the hand, which gains its speed evenly.
        left_s = self.released_s
        before = np.clip(left_s - seconds, 0.0, self.ease_s)
        way_m = self.hand_m_s * (before - before**2 / (2 * self.ease_s))
        release_m = self.ball.drop_m - GRAVITY_M_S2 / 2 * left_s**2
        heights = np.where(seconds < left_s, release_m + way_m, heights)
        pushed = np.maximum(seconds - left_s, 0.0)[:, None] * np.array(self.push_m_s)
        kicked = np.maximum(seconds - begins_s[0], 0.0)[:, None] * np.array(self.kick_m_s)
        return np.column_stack([(pushed + kicked)[:, ::-1], heights])


class _Tape:
    """States of B balls as they are stepped, each a time, a height and a speed of shape (B,)."""

    def __init__(self, drags: Array, time: Array, height: Array, speed: Array) -> None:
        self._drags = drags
        self.time, self._height, self._speed = time, height, speed
        self.states: list[tuple[Array, Array, Array]] = []

    def _go(self, step: Array) -> None:
        self.states.append((self.time, self._height, self._speed))
        self._height, self._speed = _stepped(self._height, self._speed, step, self._drags)
        self.time = self.time + step

    def rise(self, speed: Array, count: int) -> None:
        """Step from the table to the apex; dv / (g + k v²) is integrated by Gauss and Legendre."""
        self._height, self._speed = np.zeros_like(speed), speed
        inner = speed[:, None] / 2 * (_NODES + 1)
        pace = 1 / (GRAVITY_M_S2 + self._drags[:, None] * inner**2)
        step = speed / 2 * (pace @ _WEIGHTS) / count
        for _ in range(count):
            self._go(step)

    def fall(self, count: int) -> Array:
        """Step from the apex to the table; return the speed there, downward, shape (B,).

        As long as it would take without air in `count` steps, nearly all of the rest in a few.
        """
        self._height = np.maximum(self._height, 0.0)
        without_air = np.sqrt(2 * self._height / GRAVITY_M_S2)
        for _ in range(count):
            self._go(without_air / count)
        few = max(1, count // 4)
        slowed = 0.98 * self._rest()
        for _ in range(few):
            self._go(slowed / few)
        self._go(self._rest())
        return -self._speed

    def _rest(self) -> Array:
        """Find by Newton's method how long one step to the table takes, shape (B,)."""
        pull = GRAVITY_M_S2 - self._drags * self._speed**2
        height, speed = np.maximum(self._height, 0.0), np.minimum(self._speed, 0.0)
        rest = (speed + np.sqrt(speed**2 + 2 * pull * height)) / pull
        for _ in range(5):
            after, faster = _stepped(height, speed, rest, self._drags)
            rest = np.maximum(rest - after / np.minimum(faster, -1e-9), 0.0)
        return rest


def _stepped(height: Array, speed: Array, step: Array, drag: Array) -> tuple[Array, Array]:
    """Return heights and speeds one Runge-Kutta step later."""

    def pull(speed: Array) -> Array:
        return -GRAVITY_M_S2 - drag * speed * np.abs(speed)

    half = step / 2
    first = pull(speed)
    second = pull(speed + half * first)
    third = pull(speed + half * second)
    fourth = pull(speed + step * third)
    went = step * (speed + step / 6 * (first + second + third))
    return height + went, speed + step / 6 * (first + 2 * (second + third) + fourth)


# ---- Recorded drops of balls that a stranger may have, and their logs.

# Of the stranger's balls, drawn evenly, the drag in its logarithm.
RESTITUTIONS: Range = (0.3, 0.92)
SLOPES: Range = (0.0, 0.12)
DRAGS_1_M: Range = (0.003, 0.18)
DROPS_M: Range = (0.3, 2.0)
RATES_HZ = (30.0, 60.0, 120.0)
SCALES = (0.5, 1.0, 2.0)  # of a cell: slope and both ends of the drag's range are multiplied by it
NOISES_M = (0.001, 0.005)  # of a cell: standard deviation of each coordinate

# From the release to the last sample; a ball that lies earlier is recorded a little longer.
MAX_S = 3.0

MIN_FALL = 0.01  # of the drop: a bounce that ends with a lower fall is not in view
LIES_S: Range = (0.2, 0.6)
START_NS = 1_700_000_000_000_000_000  # of logs


@dataclass(frozen=True)
class WorldCell:
    """Drops of one kind."""

    scale: float  # of slope and drag; restitution, fall and rate are the same in all cells
    noise_m: float  # standard deviation of each coordinate

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
    """Ball let go and recorded."""

    ball: RealBall  # what fell
    level_m: float  # z of the ball's centre when it touches the table
    seconds: Array  # of the samples, after the release, shape (T,)
    positions_m: Array  # of the ball's centre, with noise, shape (T, 3); z is up
    noise_m: float  # standard deviation of each coordinate
    path: Paths  # what it does in truth, up to the last sample

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps of the samples, shape (T,)."""
        return START_NS + np.round((self.seconds - self.seconds[0]) * 1e9).astype(np.int64)

    @property
    def last_bounce_s(self) -> float:
        """Last impact in view, after the release: see `MIN_FALL`."""
        times, speeds = self.path.impacts_s[0], self.path.impact_speeds_m_s[0]
        seen = (times <= self.seconds[-1]) & (speeds >= np.sqrt(MIN_FALL) * speeds[0])
        return float(times[seen].max())

    def seconds_of(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Convert stamps on the log's clock to times after the release, shape (T,)."""
        return (stamps_ns - START_NS).astype(np.float64) * 1e-9 + self.seconds[0]

    def truth_m(self, seconds: Array) -> Array:
        """Return the height over the contact at times after the release, shape (T,)."""
        return self.path.at(seconds[None])[0]

    def until(self, end_s: float) -> RecordedDrop:
        """Return the drop recorded up to a time after the release."""
        kept = self.seconds <= end_s
        return replace(self, seconds=self.seconds[kept], positions_m=self.positions_m[kept])

    def episode(self) -> Episode:
        """Build the log in memory: positions alone, nothing of ball, table or release."""
        return ball_log(self.seconds - self.seconds[0], self.positions_m)


def ball_log(seconds: Array, positions_m: Array, topic: str = "/vrpn/ball/pose") -> Episode:
    """Build a log in memory of positions, shape (T, 3), z up, at times after its start, (T,)."""
    stamps_ns = START_NS + np.round(seconds * 1e9).astype(np.int64)
    signal = Signal(topic, stamps_ns, positions_m, ("x", "y", "z"), "m")
    return Episode(EpisodeInfo(), {topic: signal})


def drawn_ball(rng: np.random.Generator, scale: float = 1.0) -> tuple[RealBall, float]:
    """Draw a stranger's ball and its drop, and a rate [Hz]; the scale is of slope and drag."""
    ball = RealBall(
        rng.uniform(*RESTITUTIONS),
        scale * rng.uniform(*SLOPES),
        scale * float(np.exp(rng.uniform(*np.log(DRAGS_1_M)))),
        rng.uniform(*DROPS_M),
    )
    return ball, RATES_HZ[int(rng.integers(len(RATES_HZ)))]


def draw_drop(cell: WorldCell, seed: int, number: int) -> RecordedDrop:
    """Draw drop `number` of a seed: the same ball, but for the scale, in every cell."""
    rng = np.random.default_rng([seed, number, 1919])
    ball, rate_hz = drawn_ball(rng, cell.scale)
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
    level_m = rng.uniform(-0.5, 1.2) + rng.uniform(0.015, 0.12)
    held_s, rest_s = rng.uniform(0.3, 1.0), rng.uniform(*lies_s)
    path = fallen(ball.values[None], longest_s)
    until_s = min(float(path.rests_s[0]) + rest_s, longest_s)
    seconds = np.arange(-held_s, until_s, 1 / rate_hz)
    positions = np.tile([*rng.uniform(-1, 1, 2), level_m], (len(seconds), 1))
    positions[:, 2] += path.at(seconds[None])[0]
    positions += rng.normal(0, noise_m, positions.shape)
    return RecordedDrop(ball, level_m, seconds, positions, noise_m, path)


# ---- Airless bound: what parabolas with one restitution can do at best.


def parabolas(restitution: float, drop_m: float, seconds: Array) -> Array:
    """Return the height over the contact of a ball without air, after the release, shape (T,)."""
    fall_s = float(np.sqrt(2 * drop_m / GRAVITY_M_S2))
    hit = GRAVITY_M_S2 * fall_s
    # until it rebounds at a thousandth of the first impact's speed; at most .999, so that it does
    count = max(1, int(np.ceil(np.log(1e-3) / np.log(np.clip(restitution, 1e-9, 0.999)))))
    ups = hit * restitution ** np.arange(1, count + 1)
    starts = fall_s + np.concatenate([[0.0], np.cumsum(2 * ups / GRAVITY_M_S2)])
    flight = np.searchsorted(starts, seconds, side="right") - 1
    since = seconds - starts[flight]
    up = np.append(ups, 0.0)[flight]
    rebound = np.maximum(up * since - GRAVITY_M_S2 / 2 * since**2, 0.0)
    fall = drop_m - GRAVITY_M_S2 / 2 * np.maximum(seconds, 0.0) ** 2
    return np.where(flight < 0, fall, rebound)


def first_rebound(drop: RecordedDrop) -> float:
    """Return the restitution that gives the first rebound's height without air."""
    first, second = drop.path.impacts_s[0, :2]
    between = np.linspace(first, second, 2001)
    return float(np.sqrt(drop.truth_m(between).max() / drop.ball.drop_m))


def best_of_all(drop: RecordedDrop) -> float:
    """Fit the restitution whose parabolas are nearest to the heights, release and fall known."""
    inside = drop.seconds >= 0
    seconds = drop.seconds[inside]
    heights = drop.positions_m[inside, 2] - drop.level_m

    def off(restitution: float) -> float:
        return float(np.mean((parabolas(restitution, drop.ball.drop_m, seconds) - heights) ** 2))

    grid = np.linspace(0.05, 0.99, 189)
    for step in (5e-4, 5e-5, 5e-6):
        best = grid[np.argmin([off(float(value)) for value in grid])]
        grid = np.clip(best + step * np.arange(-11, 12), 0.01, 0.999)
    return float(grid[np.argmin([off(float(value)) for value in grid])])


def airless_off(restitution: float, drop: RecordedDrop) -> Array:
    """Return its position error over the drop, shape (T,); see `real_balls.off_path`."""
    seconds = np.linspace(0.0, drop.last_bounce_s, 2001)
    drop_m = drop.ball.drop_m
    return (parabolas(restitution, drop_m, seconds) - drop.truth_m(seconds)) / drop_m


# ---- Balls that people drop: their masses, sizes and restitutions, and drops of them.

HEIGHTS_M = (0.5, 1.0, 2.0)  # that each ball is dropped from
NOISE_M = 0.001  # standard deviation of each coordinate of these drops
# From the release to the last sample of what the paper's network is given: it needs 6.7 s.
PAPER_S = 7.2


@dataclass(frozen=True)
class TableBall:
    """Kind of ball."""

    name: str  # in tables
    diameter_m: float  # of the ball
    mass_kg: float  # likewise
    drag_coefficient: float  # Cd at the speeds of a drop
    restitution: float  # at an impact with `speed_m_s`
    speed_m_s: float  # see there
    slope: float  # p of the restitution's fall with speed

    @property
    def drag_1_m(self) -> float:
        """Drag deceleration over speed squared: rho Cd A / (2 m) [1/m]."""
        area_m2 = np.pi / 4 * self.diameter_m**2
        # in air at 20 degrees Celsius and 101.3 kPa
        return float(1.204 * self.drag_coefficient * area_m2 / (2 * self.mass_kg))

    def dropped(self, drop_m: float) -> RealBall:
        """Drop this ball from a height, with the restitution at its impact speed."""
        falling = fallen(np.array([[0.5, 0.0, self.drag_1_m, drop_m]]), 0.0)
        speed = max(float(falling.impact_speeds_m_s[0, 0]), MIN_SPEED_M_S)
        restitution = self.restitution * (speed / self.speed_m_s) ** -self.slope
        return RealBall(restitution, self.slope, self.drag_1_m, drop_m)


# Cd .47 to .5: a smooth sphere at Reynolds numbers of 1e4 to 1e5 (Achenbach 1972). Restitutions are
# on a hard floor. Slopes are plausible rather than measured, but where a source is named.
TABLE_BALLS = (
    # ITTF, technical leaflet T3: 40 mm, 2.7 g, rebounds to 24 to 26 cm from 30.5 cm, and the
    # air takes its part.
    TableBall("table tennis", 0.0400, 0.0027, 0.47, 0.93, 2.4, 0.04),
    # ITF, rule 3: 6.54 to 6.86 cm, 56.0 to 59.4 g, 135 to 147 cm from 254 cm; Cd with the nap
    # (Mehta 2008). It falls with speed (Cross 1999, "The bounce of a ball", Am. J. Phys. 67).
    TableBall("tennis", 0.0670, 0.0577, 0.55, 0.755, 6.9, 0.06),
    # World Squash, appendix 7: 40 mm, 24 g, a cold one rebounds by 12 % at least from 254 cm.
    TableBall("squash", 0.0400, 0.0240, 0.47, 0.38, 7.0, 0.11),
    # USA Racquetball, rule 2.2: 57 mm, 39.7 g, 68 to 72 inches from 100 inches.
    TableBall("racquetball", 0.0572, 0.0397, 0.47, 0.845, 7.0, 0.03),
    # R&A and USGA: 42.67 mm, 45.93 g; Cd below the drag crisis (Bearman and Harvey 1976).
    TableBall("golf", 0.0427, 0.0459, 0.50, 0.84, 4.4, 0.05),
    # A bearing's, 1 inch, 7.8 g/cm³, on a thick plate: plastic yielding makes e fall (Johnson 1985,
    # "Contact Mechanics", section 11.5).
    TableBall("steel", 0.0254, 0.0669, 0.47, 0.90, 1.0, 0.10),
    # A hollow play ball: the lightest for its size.
    TableBall("play ball", 0.0740, 0.0100, 0.47, 0.72, 3.8, 0.03),
)


@dataclass(frozen=True, eq=False)
class TableDrop:
    """Drop of a ball of the table."""

    ball: TableBall  # which
    view: RecordedDrop  # what is recorded of it, for `MAX_S` at most
    # the same and more, for the paper's network: 60 Hz, `PAPER_S`, whether it lies or not
    whole: RecordedDrop


def table_drops(ball: TableBall, seed: int, count: int) -> Iterator[TableDrop]:
    """Yield `count` drops from each of `HEIGHTS_M`, at rates in turn."""
    for at, drop_m in enumerate(HEIGHTS_M):
        for number in range(count):
            named = [seed, number, at, *ball.name.encode()]
            rate_hz = RATES_HZ[(number + at) % len(RATES_HZ)]
            real = ball.dropped(drop_m)
            view = record_drop(real, rate_hz, NOISE_M, np.random.default_rng(named), MAX_S)
            rng = np.random.default_rng([*named, 1])
            whole = record_drop(real, 60.0, NOISE_M, rng, PAPER_S, lies_s=(PAPER_S, PAPER_S))
            yield TableDrop(ball, view, whole)


# ---- Hidden world of the bounce shot: one ball among obstacles, unknown to the planner.
# It is stepped at 960 Hz (midpoint rule) through quadratic drag; a step that would end inside of
# something ends where the ball touches it. Friction at impacts is sliding, with spin.

Vector = tuple[float, float, float]

RATE_HZ = 960.0  # of steps: a ball at 5 m/s goes 5 mm in one, a sixth of its radius
RADIUS_M, MASS_KG = 0.03, 0.040  # of every ball: about a racquetball's
FRICTION = 0.25  # Coulomb's coefficient, at all that a ball hits

DRAG_1_M = 0.5 * 1.2 * 0.47 * math.pi * RADIUS_M**2 / MASS_KG  # in air of 1.2 kg/m³, Cd .47
_AT_REST_M_S = 0.03  # slower impacts give no rebound: a ball comes to rest


@dataclass(frozen=True)
class HiddenBall:
    """Ball as it is."""

    name: str  # as on a label
    restitution: float  # at an impact of 3 m/s
    slope: float  # p, by which it falls with an impact's speed
    # standard deviation of the angle by which an impact's normal is off, in any direction
    off_round_deg: float = 0.0

    @property
    def is_round(self) -> bool:
        """Whether its impacts are as they should be."""
        return self.off_round_deg == 0

    def restitution_at(self, speed_m_s: float) -> float:
        """Return the restitution at an impact of this speed along the normal."""
        ratio = max(speed_m_s, _AT_REST_M_S) / 3.0
        # the power law alone would pass 1 at the slowest impacts
        return min(self.restitution * ratio**-self.slope, 0.95)


@dataclass(frozen=True)
class Obstacle:
    """Obstacle for a ball."""

    gap: Callable[[Vector], float]  # from a ball's skin to it, by the ball's centre
    normal: Callable[[Vector], Vector]  # unit vector out of it there
    restitution: float | None = None  # of any ball on it; None where it is the ball's own


@dataclass(frozen=True, eq=False)
class BallPath:
    """Path of a ball."""

    positions_m: Array  # of its centre at 960 Hz, shape (T, 3)
    hits: tuple[tuple[int, int], ...]  # which obstacle at which sample, in order

    def at(self, seconds: Array) -> Array:
        """Interpolate positions at `seconds` after the release, shape (N, 3) [m]."""
        clock = np.arange(len(self.positions_m)) / RATE_HZ
        return np.column_stack([np.interp(seconds, clock, axis) for axis in self.positions_m.T])


def run_ball(
    ball: HiddenBall,
    start_m: Vector,
    obstacles: Sequence[Obstacle],
    seconds: float,
    rng: np.random.Generator,
    velocity_m_s: Vector = (0.0, 0.0, 0.0),
    is_over: Callable[[Vector], bool] | None = None,
) -> BallPath:
    """Release a ball and step it for `seconds`, or until `is_over`."""
    position, velocity, spin = start_m, velocity_m_s, (0.0, 0.0, 0.0)
    positions, hits = [position], []
    for sample in range(1, int(seconds * RATE_HZ) + 1):
        remaining_s = 1 / RATE_HZ
        for _ in range(8):
            end, end_velocity = _flown(position, velocity, remaining_s)
            hit, used_s = _first_hit(position, velocity, remaining_s, end, obstacles)
            if hit < 0:
                position, velocity = end, end_velocity
                break
            position, velocity = _flown(position, velocity, used_s)
            velocity, spin = _impact(ball, obstacles[hit], position, velocity, spin, rng)
            hits.append((hit, sample))
            remaining_s -= used_s
        positions.append(position)
        if is_over is not None and is_over(position):
            break
    return BallPath(np.array(positions), tuple(hits))


def table(edge_m: float, heading_rad: float) -> Obstacle:
    """Make a level table at height 0 that ends in a sharp edge in that direction."""
    ahead, aside = math.cos(heading_rad), math.sin(heading_rad)

    def from_table(center: Vector) -> tuple[float, float]:
        return max(center[0] * ahead + center[1] * aside - edge_m, 0.0), center[2]

    def gap(center: Vector) -> float:
        beyond, up = from_table(center)
        return math.inf if beyond == 0 and up < -RADIUS_M else math.hypot(beyond, up) - RADIUS_M

    def normal(center: Vector) -> Vector:
        beyond, up = from_table(center)
        away = math.hypot(beyond, up) or 1e-12
        return ahead * beyond / away, aside * beyond / away, up / away

    return Obstacle(gap, normal)


def plane(tilt_rad: float = 0.0, reach_m: float = math.inf, up_m: float = 0.0) -> Obstacle:
    """Make a plane over the origin, down along x, that ends `reach_m` down its slope."""
    normal = (math.sin(tilt_rad), 0.0, math.cos(tilt_rad))
    down = (math.cos(tilt_rad), 0.0, -math.sin(tilt_rad))

    def gap(center: Vector) -> float:
        away = _dot(center, normal) - up_m
        if _dot(center, down) > reach_m or away < -RADIUS_M:
            return math.inf
        return away - RADIUS_M

    return Obstacle(gap, lambda _: normal)


def ring(center_m: Vector, ring_m: float, rod_m: float, restitution: float) -> Obstacle:
    """Make a horizontal ring of a round rod: radius to the rod's middle, and of the rod."""

    def from_rod(center: Vector) -> Vector:
        x, y = center[0] - center_m[0], center[1] - center_m[1]
        outward = 1 - ring_m / (math.hypot(x, y) or 1e-12)
        return x * outward, y * outward, center[2] - center_m[2]

    def gap(center: Vector) -> float:
        away = from_rod(center)
        return math.sqrt(_dot(away, away)) - rod_m - RADIUS_M

    def normal(center: Vector) -> Vector:
        x, y, z = from_rod(center)
        away = math.sqrt(x * x + y * y + z * z) or 1e-12
        return x / away, y / away, z / away

    return Obstacle(gap, normal, restitution)


def _flown(position: Vector, velocity: Vector, seconds: float) -> tuple[Vector, Vector]:
    """Return position and velocity after one step of the midpoint rule (Runge-Kutta 2)."""
    x, y, z = velocity
    slow = DRAG_1_M * math.sqrt(x * x + y * y + z * z)
    half = seconds / 2
    mx, my, mz = x - half * slow * x, y - half * slow * y, z - half * (GRAVITY_M_S2 + slow * z)
    slow = DRAG_1_M * math.sqrt(mx * mx + my * my + mz * mz)
    after = (
        x - seconds * slow * mx,
        y - seconds * slow * my,
        z - seconds * (GRAVITY_M_S2 + slow * mz),
    )
    x, y, z = position
    return (x + seconds * mx, y + seconds * my, z + seconds * mz), after


def _first_hit(
    position: Vector, velocity: Vector, seconds: float, end: Vector, obstacles: Sequence[Obstacle]
) -> tuple[int, float]:
    """Find by bisection which obstacle a step ends in, and when it touches; -1 for none."""
    found, soonest = -1, math.inf
    for index, obstacle in enumerate(obstacles):
        if obstacle.gap(end) >= 0:
            continue
        low, high = 0.0, seconds
        for _ in range(40):
            middle = (low + high) / 2
            if obstacle.gap(_flown(position, velocity, middle)[0]) >= 0:
                low = middle
            else:
                high = middle
        if low < soonest:
            found, soonest = index, low
    return found, soonest


def _impact(
    ball: HiddenBall,
    obstacle: Obstacle,
    position: Vector,
    velocity: Vector,
    spin: Vector,
    rng: np.random.Generator,
) -> tuple[Vector, Vector]:
    """Return velocity and spin of a solid sphere after an impact with Coulomb friction."""
    true_normal = obstacle.normal(position)
    normal = true_normal if ball.is_round else _tilted(true_normal, ball.off_round_deg, rng)
    arm = _plus((0.0, 0.0, 0.0), normal, -RADIUS_M)
    touching = _plus(velocity, _cross(spin, arm))
    inward = -_dot(touching, normal)
    if inward <= 0:
        return _kept_out(velocity, true_normal), spin
    kept = ball.restitution_at(inward) if obstacle.restitution is None else obstacle.restitution
    push = (1 + (kept if inward >= _AT_REST_M_S else 0.0)) * inward
    slip = _plus(touching, normal, inward)
    slipping = math.sqrt(_dot(slip, slip))
    grip = min(FRICTION * push, slipping / 3.5) / slipping if slipping > 1e-9 else 0.0
    kick = _plus(_plus((0.0, 0.0, 0.0), normal, push), slip, -grip)
    turned = _plus(spin, _cross(arm, kick), 1 / (0.4 * RADIUS_M**2))  # inertia of a unit mass
    return _kept_out(_plus(velocity, kick), true_normal), turned


def _kept_out(velocity: Vector, normal: Vector) -> Vector:
    """Keep a ball from leaving into what it hit."""
    # along the normal, so that the next step does not start inside
    more = 0.003 - _dot(velocity, normal)
    return velocity if more <= 0 else _plus(velocity, normal, more)


def _plus(one: Vector, other: Vector, factor: float = 1.0) -> Vector:
    """Return `one + factor * other`."""
    x, y, z = other
    return one[0] + factor * x, one[1] + factor * y, one[2] + factor * z


def _tilted(normal: Vector, sd_deg: float, rng: np.random.Generator) -> Vector:
    off, turn = math.radians(rng.normal(0.0, sd_deg)), rng.uniform(0.0, 2 * math.pi)
    one = np.cross(normal, (0.0, 1.0, 0.0) if abs(normal[1]) < 0.9 else (1.0, 0.0, 0.0))
    one /= np.linalg.norm(one)
    other = np.cross(normal, one)
    aside = math.cos(turn) * one + math.sin(turn) * other
    turned = np.array(normal) + math.tan(off) * aside
    turned /= np.linalg.norm(turned)
    return float(turned[0]), float(turned[1]), float(turned[2])


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _cross(one: Vector, other: Vector) -> Vector:
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


# ---- A shot in the hidden world, on the rig as it stands there.

_RELEASE_SD_M = (0.0015, 0.0015, 0.002)  # of a robot's: along each horizontal axis, in height


@dataclass(frozen=True)
class HiddenShot:
    """Result of a shot."""

    is_through: bool  # the ball fell through the hoop
    has_touched: bool  # it hit the rim
    # from the hoop's centre where its centre first came down through the hoop's plane after the
    # bounce, negative where that was short of it; None where it never did
    miss_m: float | None


def take_shot(
    ball: HiddenBall, rig: ShotRig, height_m: float, rng: np.random.Generator, *, errs: bool = True
) -> HiddenShot:
    """Drop a ball above the plane with a robot's release error, or none if not `errs`."""
    tilt = math.radians(rig.plane.incline_deg)
    x, y, z = (rng.normal(0.0, 1.0, 3) * _RELEASE_SD_M * errs).tolist()
    up_m = max(height_m + z, 0.001)
    start: Vector = (RADIUS_M * math.sin(tilt) + x, y, RADIUS_M * math.cos(tilt) + up_m)
    hoop = rig.hoop
    rod_m, rim = hoop.rim_m / 2, 0.55  # restitution on the rim: less lively than on the plane
    obstacles = (
        plane(tilt, rig.plane.downhill_m),
        ring((hoop.forward_m, 0.0, hoop.up_m), hoop.free_radius_m + rod_m, rod_m, rim),
    )
    low_m = hoop.up_m - 3 * RADIUS_M  # a ball is there long before 4 s
    run = run_ball(ball, start, obstacles, 4.0, rng, is_over=lambda at: at[2] < low_m)
    path = run.positions_m
    above = path[:, 2] >= hoop.up_m
    crossings: list[list[float]] = []  # where it comes down through the hoop's plane
    for row in np.flatnonzero(above[:-1] & ~above[1:]):
        part = (path[row, 2] - hoop.up_m) / (path[row, 2] - path[row + 1, 2])
        crossings.append((path[row] + part * (path[row + 1] - path[row])).tolist())
    misses = [math.hypot(x - hoop.forward_m, y) for x, y, _ in crossings]
    return HiddenShot(
        is_through=bool(misses) and misses[-1] < hoop.free_radius_m,
        has_touched=any(which == 1 for which, _ in run.hits),
        miss_m=math.copysign(misses[0], crossings[0][0] - hoop.forward_m) if misses else None,
    )


# ---- A drop on a table in the hidden world, and the mishaps of those that leave it.

DROP_M = 0.5  # how far the robot lets balls fall: about as fast as they will hit the plane
HELD_S, FILMED_S = 0.25, 2.6  # filmed before and after the release: the fall takes 0.32 s
# The ball hits the table's edge first; rolls off the table; or leaves the picture.
MISHAPS = ("edge", "rolls off", "out of view")

_FAR_M = 100.0  # to the edge of a table that no ball leaves


@dataclass(frozen=True, eq=False)
class HiddenDrop:
    """Drop in the hidden world."""

    ball: HiddenBall
    mishap: str | None  # one of `MISHAPS`; None where it stays on the table and in view
    path: BallPath  # the ball's, from its release on
    leaves_s: float | None = None  # when it goes out of view; None unless that is its mishap
    heading_rad: float = 0.0  # which way it moves then, from the camera's line of sight

    @property
    def impact_m_s(self) -> float:
        """Speed of a fall from that height without air."""
        return math.sqrt(2 * GRAVITY_M_S2 * DROP_M)


def drop_of(ball: HiddenBall, mishap: str | None, rng: np.random.Generator) -> HiddenDrop:
    """Drop a ball on the table, with or without a mishap."""
    if mishap is None:
        return HiddenDrop(ball, None, _run(ball, _FAR_M, 0.0, rng))
    heading = float(rng.uniform(0.0, 2 * math.pi))
    if mishap == "edge":
        beyond_m = RADIUS_M * math.sin(math.radians(rng.uniform(10.0, 45.0)))
        return HiddenDrop(ball, mishap, _run(ball, -beyond_m, heading, rng))
    first_m_s = math.sqrt(2 * GRAVITY_M_S2 * DROP_M)
    if mishap == "rolls off":
        speed = float(rng.uniform(0.05, 0.25)) * first_m_s
        state = rng.bit_generator.state
        whole = _run(ball, _FAR_M, heading, rng, speed)
        impacts = impact_seconds(whole)
        leaves_s = rng.uniform(impacts[0], impacts[min(2, len(impacts) - 1)])
        x, y, _ = whole.at(np.array([leaves_s]))[0]
        edge_m = float(x * math.cos(heading) + y * math.sin(heading))
        again = np.random.default_rng()
        again.bit_generator.state = state
        return HiddenDrop(ball, mishap, _run(ball, edge_m, heading, again, speed))
    heading = math.pi / 2 * float(rng.choice([-1.0, 1.0])) + float(rng.uniform(-0.5, 0.5))
    path = _run(ball, _FAR_M, heading, rng, float(rng.uniform(0.25, 1.0)))
    impacts = impact_seconds(path)
    leaves_s = float(rng.uniform(impacts[0] / 2, impacts[1]))
    return HiddenDrop(ball, mishap, path, leaves_s, heading)


def impact_seconds(run: BallPath) -> Array:
    """Return when the ball hit something [s], shape (N,); hits of one contact count once."""
    samples = np.array([sample for _, sample in run.hits])
    # hits that follow each other faster are one contact
    first = np.diff(samples, prepend=-100) > 0.01 * RATE_HZ
    return samples[first] / RATE_HZ


def _run(
    ball: HiddenBall,
    edge_m: float,
    heading_rad: float,
    rng: np.random.Generator,
    sideways_m_s: float = 0.0,
) -> BallPath:
    x, y, z = (rng.normal(0.0, 1.0, 3) * _RELEASE_SD_M).tolist()
    speed = (sideways_m_s * math.cos(heading_rad), sideways_m_s * math.sin(heading_rad), 0.0)
    floor = plane(up_m=-0.75)  # below a table of common height
    things = (table(edge_m, heading_rad), floor)
    return run_ball(ball, (x, y, RADIUS_M + DROP_M + z), things, FILMED_S, rng, speed)


# ---- Touches, speeds and contact times of a bounce: the truth behind a sound.
# Between two contacts the ball flies in air that slows it by k v²; V = sqrt(g / k) is its final
# speed. The next flight begins when the contact ends.

MIN_HEARD_M_S = 0.06  # a ball that touches more slowly is left lying: nobody hears it
_MAX_BOUNCES = 60
_MAX_RESTITUTION = 0.975
_MIN_DRAG_1_M = 1e-7


@dataclass(frozen=True)
class BounceOrder:
    """Specification of a bounce."""

    height_m: float  # of the fall
    restitution: float  # at the first impact
    slope: float  # p of e_n = e_1 (v_n / v_1)^-p
    drag_1_m: float  # deceleration by the air over speed squared
    contact_s: float  # how long a contact at 1 m/s lasts
    uneven: float = 0.0  # standard deviation of an impact's own restitution about that law (log)
    seed: int = 0  # of what each impact is off by


@dataclass(frozen=True, eq=False)
class BounceHistory:
    """Impacts of a bounce, shape (N,) each."""

    order: BounceOrder  # what was dropped
    touches_s: Array  # when contacts begin, after the release
    contacts_s: Array  # how long they last
    speeds_m_s: Array  # at touch, downward
    restitutions: Array  # speed after over speed before
    by_law: Array  # what they were without being uneven

    def heights_m(self, seconds: Array) -> Array:
        """Return heights over the table, shape (T,); in a contact a little below 0."""
        order, drag = self.order, max(self.order.drag_1_m, _MIN_DRAG_1_M)
        heights = np.full(len(seconds), order.height_m)
        falling = (seconds > 0) & (seconds < self.touches_s[0])
        heights[falling] -= _fallen_m(seconds[falling], drag)
        starts = self.touches_s + self.contacts_s
        ends = np.append(self.touches_s[1:], np.inf)
        ups = self.speeds_m_s * self.restitutions
        for touch, start, end, speed, up in zip(
            self.touches_s, starts, ends, self.speeds_m_s, ups, strict=True
        ):
            pressed = (seconds >= touch) & (seconds < start)
            phase = (seconds[pressed] - touch) / (start - touch)
            heights[pressed] = -speed * (start - touch) / np.pi * np.sin(np.pi * phase)
            flying = (seconds >= start) & (seconds < end)
            if np.isfinite(end):
                heights[flying] = _flight_m(seconds[flying] - start, up, drag)
            else:
                heights[flying] = 0.0
        return heights


def bounced(order: BounceOrder) -> BounceHistory:
    """Drop a ball and compute its impacts until it is slow."""
    drag = max(order.drag_1_m, _MIN_DRAG_1_M)
    clock, speed = fall_of(order.height_m, drag)
    first = speed
    own = np.random.default_rng(order.seed).normal(0.0, order.uneven, _MAX_BOUNCES)
    rows: list[tuple[float, float, float, float, float]] = []
    while speed > MIN_HEARD_M_S and len(rows) < _MAX_BOUNCES:
        by_law = min(order.restitution * (speed / first) ** -order.slope, _MAX_RESTITUTION)
        kept = min(by_law * float(np.exp(own[len(rows)])), _MAX_RESTITUTION)
        # a contact lasts as the speed to this power (Hertz 1881)
        contact = order.contact_s * speed ** (-0.2)
        rows.append((clock, contact, speed, kept, by_law))
        flight_s, speed = flight_of(kept * speed, drag)
        clock += contact + flight_s
    return BounceHistory(order, *np.array(rows).reshape(-1, 5).T)


Flight = tuple[float, float]


def rise_of(speed_m_s: float, drag_1_m: float, gravity_m_s2: float = GRAVITY_M_S2) -> Flight:
    """Return duration V / g atan(v / V) [s] and height ln(1 + v² / V²) / 2k [m] of a rise."""
    final = np.sqrt(gravity_m_s2 / drag_1_m)
    ratio = speed_m_s / final
    return float(final / gravity_m_s2 * np.arctan(ratio)), float(np.log1p(ratio**2) / 2 / drag_1_m)


def fall_of(height_m: float, drag_1_m: float, gravity_m_s2: float = GRAVITY_M_S2) -> Flight:
    """Return duration V / g arcosh(exp(k h)) [s] and last speed [m/s] of a fall from rest."""
    final = np.sqrt(gravity_m_s2 / drag_1_m)
    speed = final * np.sqrt(-np.expm1(-2 * drag_1_m * height_m))
    return float(final / gravity_m_s2 * np.arctanh(speed / final)), float(speed)


def flight_of(speed_m_s: float, drag_1_m: float, gravity_m_s2: float = GRAVITY_M_S2) -> Flight:
    """Return duration [s] and last speed [m/s] of a flight from the table back to it."""
    rise_s, apex_m = rise_of(speed_m_s, drag_1_m, gravity_m_s2)
    fall_s, speed = fall_of(apex_m, drag_1_m, gravity_m_s2)
    return rise_s + fall_s, speed


def _fallen_m(seconds: Array, drag_1_m: float) -> Array:
    """Return how far a ball falls from rest."""
    final = np.sqrt(GRAVITY_M_S2 / drag_1_m)
    return np.log(np.cosh(GRAVITY_M_S2 * seconds / final)) / drag_1_m


def _flight_m(seconds: Array, up_m_s: float, drag_1_m: float) -> Array:
    """Return the height of a ball that left the table at this speed."""
    final = np.sqrt(GRAVITY_M_S2 / drag_1_m)
    rise_s, apex_m = rise_of(up_m_s, drag_1_m)
    left = np.clip(rise_s - seconds, 0.0, None)
    rising = apex_m + np.log(np.cos(GRAVITY_M_S2 * left / final)) / drag_1_m
    return np.where(left > 0, rising, apex_m - _fallen_m(np.maximum(seconds - rise_s, 0), drag_1_m))
