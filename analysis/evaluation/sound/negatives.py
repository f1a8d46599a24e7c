"""Synthesise sounds that are no bounce of one ball, and must not be taken for one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.sound.backgrounds import background_sound
from analysis.evaluation.sound.clip import draw_scene
from analysis.evaluation.sound.impact_sound import add_impacts
from analysis.evaluation.sound.music import music
from analysis.evaluation.sound.room import draw_phone, draw_room
from analysis.evaluation.sound.sound_file import through_aac, write_sound
from analysis.evaluation.sound.sounding_balls import (
    SOUNDING_BALLS,
    SOUNDING_TABLES,
    ImpactVoice,
    SoundingBall,
    SoundingTable,
    draw_voice,
)
from analysis.evaluation.sound.speech import speech
from tunenet_logs.arrays import Array
from tunenet_logs.sound import Sound

_LASTS_S = (3.0, 8.0)
_RATE_HZ = 48_000
_SEEDS = 2_000_000

_HAND = SoundingBall(
    *("hand", (0.1, 0.1), (1000.0, 1000.0), 0.5, (0.004, 0.004)),
    *((0.0003, 0.001), (500.0, 2500.0), (0.001, 0.006), (1.0, 3.0)),
)
_HEEL = SoundingBall(
    *("heel", (0.1, 0.1), (1000.0, 1000.0), 0.5, (0.004, 0.004)),
    *((0.0005, 0.003), (80.0, 600.0), (0.004, 0.02), (0.1, 0.6)),
)
_KEY = SoundingBall(
    *("key", (0.1, 0.1), (1000.0, 1000.0), 0.5, (0.004, 0.004)),
    *((0.0001, 0.0004), (1500.0, 7000.0), (0.001, 0.006), (0.3, 1.0)),
)
# What strikes, in place of a ball: only its modes and its slap count.
_DROP = SoundingBall(
    *("drop", (0.1, 0.1), (1000.0, 1000.0), 0.5, (0.004, 0.004)),
    *((0.0001, 0.0006), (800.0, 9000.0), (0.0005, 0.004), (0.5, 2.0)),
)


@dataclass(frozen=True, eq=False)
class NoBounce:
    """Recording of something else.

    Attributes:
        kind: one of `NO_BOUNCES`.
        samples: full scale 1, shape (N,).
        rate_hz: of them.
        codec: that they went through: "pcm" or "aac".
    """

    kind: str
    samples: NDArray[np.float32]
    rate_hz: int
    codec: str

    def write(self, path: Path) -> None:
        """Write as .wav or .m4a."""
        write_sound(self.samples, self.rate_hz, path)

    def sound(self, name: str = "/audio", start_ns: int = 0) -> Sound:
        """Return the sound in memory, as a reader gives it."""
        rate_hz = float(self.rate_hz)
        return Sound(name, start_ns, rate_hz, self.samples, rate_hz, codec=self.codec)


# From the length [s] and random numbers, a sound before room and microphone.
Maker = Callable[[float, np.random.Generator], Array]


def _struck(
    striker: SoundingBall,
    events: list[tuple[float, float]],
    lasts_s: float,
    rng: np.random.Generator,
) -> Array:
    """Synthesise strikes at these times [s] with these speeds [m/s]."""
    voice = _voice(striker, SOUNDING_TABLES[int(rng.integers(len(SOUNDING_TABLES)))], rng)
    samples = np.zeros(int(lasts_s * _RATE_HZ))
    add_impacts(samples, _RATE_HZ, voice, events, rng)
    return samples


def _voice(striker: SoundingBall, table: SoundingTable, rng: np.random.Generator) -> ImpactVoice:
    return replace(draw_voice(striker, table, 1.5, rng), uneven=float(rng.uniform(0.15, 0.4)))


def _beats(
    lasts_s: float, period_s: float, jitter_s: float, uneven: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Draw times about a period apart, and speeds."""
    events: list[tuple[float, float]] = []
    at_s = rng.uniform(0.2, 0.8)
    while at_s < lasts_s - 0.1:
        events.append((at_s, float(np.exp(rng.normal(0.0, uneven)))))
        at_s += max(period_s + rng.normal(0.0, jitter_s), 0.05)
    return events


def _claps(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise claps, even, or faster and faster."""
    events = _beats(lasts_s, rng.uniform(0.25, 0.7), rng.uniform(0.003, 0.03), 0.2, rng)
    if rng.random() < 0.4:
        begins_s, shorter = events[0][0], rng.uniform(0.85, 0.97)
        gaps = rng.uniform(0.4, 0.8) * shorter ** np.arange(30) * rng.normal(1, 0.02, 30)
        times = begins_s + np.cumsum(gaps)
        events = [(float(t), float(np.exp(rng.normal(0, 0.2)))) for t in times if t < lasts_s - 0.1]
    return _struck(_HAND, events, lasts_s, rng)


def _dribble(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise a dribbled ball; the hand is heard, too, in some."""
    period_s = rng.uniform(0.35, 0.8)
    touches = _beats(lasts_s, period_s, rng.uniform(0.01, 0.05), 0.12, rng)
    kind = SOUNDING_BALLS[int(rng.choice([2, 3, 6, 8]))]
    sound = _struck(kind, touches, lasts_s, rng)
    if rng.random() < 0.6:
        pats = [(at + rng.uniform(0.35, 0.6) * period_s, 0.4 * hard) for at, hard in touches]
        sound += _struck(_HAND, pats, lasts_s, rng)
    return sound


def _two_balls(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise two balls, released within six tenths of a second, of similar loudness."""
    samples = np.zeros(int((lasts_s + 1.0) * _RATE_HZ))
    later_s = 0.0
    for _ in range(2):
        scene = draw_scene(rng, lasts_s)
        one = np.zeros_like(samples)
        begins = scene.history.touches_s + 0.4 + later_s
        speeds = scene.history.speeds_m_s
        add_impacts(one, _RATE_HZ, scene.voice, zip(begins, speeds, strict=True), rng)
        samples += one / np.max(np.abs(one)) * 10 ** (rng.uniform(-6, 0) / 20)
        later_s = rng.uniform(0.02, 0.6)
    return samples[: int(lasts_s * _RATE_HZ)]


def _metronome(lasts_s: float, rng: np.random.Generator) -> Array:
    period_s = 60 / rng.uniform(60, 208)
    return _struck(_KEY, _beats(lasts_s, period_s, 0.00005, 0.02, rng), lasts_s, rng)


def _footsteps(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise steps, each a heel and a sole; somebody comes or goes."""
    steps = _beats(lasts_s, rng.uniform(0.4, 0.65), 0.015, 0.2, rng)
    nearer = rng.uniform(-0.4, 0.4)
    heels = [(at, hard * float(np.exp(nearer * (at - lasts_s / 2)))) for at, hard in steps]
    soles = [(at + rng.uniform(0.06, 0.12), 0.5 * hard) for at, hard in heels]
    return _struck(_HEEL, heels, lasts_s, rng) + _struck(_HEEL, soles, lasts_s, rng)


def _knocking(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise groups of three to six knocks."""
    events: list[tuple[float, float]] = []
    at_s = rng.uniform(0.2, 1.0)
    while at_s < lasts_s - 0.2:
        period_s = rng.uniform(0.12, 0.35)
        for _ in range(int(rng.integers(3, 7))):
            events.append((at_s, float(np.exp(rng.normal(0, 0.2)))))
            at_s += period_s * rng.normal(1, 0.06)
        at_s += rng.uniform(0.6, 2.0)
    return _struck(_HAND, events, lasts_s, rng)


def _keyboard(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise keys that go down and up."""
    events: list[tuple[float, float]] = []
    at_s = rng.uniform(0.1, 0.6)
    while at_s < lasts_s - 0.2:
        hard = float(np.exp(rng.normal(0, 0.4)))
        events += [(at_s, hard), (at_s + rng.uniform(0.05, 0.12), 0.4 * hard)]
        at_s += rng.gamma(3.0, 0.06) + (rng.random() < 0.1) * rng.uniform(0.3, 1.0)
    return _struck(_KEY, sorted(events), lasts_s, rng)


def _rain(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise drops or clicks at random, few or many."""
    count = rng.poisson(lasts_s * np.exp(rng.uniform(np.log(1.5), np.log(25.0))))
    times = np.sort(rng.uniform(0.1, lasts_s - 0.1, count))
    events = [(float(at), float(np.exp(rng.normal(0, 0.5)))) for at in times]
    return _struck(_DROP, events, lasts_s, rng)


def _single(lasts_s: float, rng: np.random.Generator) -> Array:
    kind = SOUNDING_BALLS[int(rng.integers(len(SOUNDING_BALLS)))]
    return _struck(kind, [(float(rng.uniform(0.3, lasts_s - 0.5)), 3.0)], lasts_s, rng)


def _speech(lasts_s: float, rng: np.random.Generator) -> Array:
    return speech(lasts_s, _RATE_HZ, rng)


def _music(lasts_s: float, rng: np.random.Generator) -> Array:
    return music(lasts_s, _RATE_HZ, rng)


def _nothing(lasts_s: float, rng: np.random.Generator) -> Array:  # noqa: ARG001
    return np.zeros(int(lasts_s * _RATE_HZ))


# By name, what is heard. Of "noise" only the background is, of "silence" nothing at all.
NO_BOUNCES: dict[str, Maker] = {
    "speech": _speech,
    "music": _music,
    "claps": _claps,
    "dribble": _dribble,
    "two balls": _two_balls,
    "metronome": _metronome,
    "footsteps": _footsteps,
    "knocking": _knocking,
    "keyboard": _keyboard,
    "rain": _rain,
    "one impact": _single,
    "noise": _nothing,
    "silence": _nothing,
}


def draw_negatives(seed: int, count: int) -> Iterator[NoBounce]:
    """Yield `count` sounds, of each kind in turn; the same however many are drawn."""
    for number in range(count):
        yield draw_negative(seed, number)


def draw_negative(seed: int, number: int) -> NoBounce:
    """Draw sound `number` of a seed, in a room, by a phone, a third of them through AAC."""
    rng = np.random.default_rng([_SEEDS + seed, number, *b"no bounce"])
    kind = list(NO_BOUNCES)[number % len(NO_BOUNCES)]
    lasts_s = float(rng.uniform(*_LASTS_S))
    codec = "aac" if rng.random() < 1 / 3 else "pcm"
    made = NO_BOUNCES[kind](lasts_s, rng)
    if kind == "silence":
        return NoBounce(kind, made.astype(np.float32), _RATE_HZ, codec)
    phone, room = draw_phone(rng), draw_room(rng)
    heard = phone.band(room.heard(made, _RATE_HZ), _RATE_HZ)
    behind = "quiet" if kind != "noise" or rng.random() < 0.5 else "noise"
    other = background_sound(behind, lasts_s, _RATE_HZ, rng)[: len(heard)]
    other = phone.band(other, _RATE_HZ)
    loud = float(np.max(np.abs(heard))) or 1.0
    weak_db = float(rng.uniform(30, 55))
    other *= loud * 10 ** (-weak_db / 20) / np.sqrt(np.mean(other**2))
    samples = phone.recorded(heard + other, _RATE_HZ).astype(np.float32)
    if codec == "aac":
        samples = through_aac(samples, _RATE_HZ)
    samples.flags.writeable = False
    return NoBounce(kind, samples, _RATE_HZ, codec)
