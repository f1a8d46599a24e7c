"""Synthesise bounces as a phone hears them, with the truth behind them, and sounds that are none.

A ball and a table ring, in a room, before a phone; a quiet room, a fan, speech or music is behind
them at a given ratio. Nothing is a recording: all of it is made from random numbers.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.worlds.ball import (
    START_NS,
    BounceHistory,
    BounceOrder,
    Range,
    RealBall,
    ball_log,
    bounced,
)
from tunenet_logs.analysis.evaluation.worlds.camera import SIZES_PX, upright
from tunenet_logs.analysis.evaluation.worlds.clips import (
    ClipOrder,
    aac_stream,
    add_sound,
    clip_frames,
    draw_clip_of,
    frame_seconds,
    mp4,
)
from tunenet_logs.episode import Array, Channel, Episode, Sound
from tunenet_logs.recorders.simulators.known import Ball

# ---- Music that nobody wrote: chords, a melody and drums on a beat.

_SCALE = (0, 2, 4, 5, 7, 9, 11)  # semitones of a major scale


def music(seconds: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise a band, about as loud as 1 at the loudest."""
    sound = np.zeros(int(seconds * rate_hz))
    beat_s = 60 / rng.uniform(70, 160)
    root_hz = 110 * 2 ** (rng.integers(12) / 12)
    pluck_s, has_drums = rng.uniform(0.002, 0.02), rng.random() < 0.75
    starts_s = -rng.uniform(0.0, beat_s)
    for beat in range(int(seconds / beat_s) + 2):
        at_s = starts_s + beat * beat_s
        if beat % 4 == 0:
            degree = int(rng.integers(6))
            for step in (0, 2, 4):
                hz = root_hz * _ratio(degree + step)
                _add(sound, at_s, _note(4 * beat_s, hz, 0.04, 1.5, rate_hz, rng), 0.25, rate_hz)
        for half in range(2):
            if rng.random() < 0.6:
                hz = 2 * root_hz * _ratio(int(rng.integers(10)))
                long_s = beat_s * rng.choice([0.5, 1.0])
                tone = _note(long_s, hz, pluck_s, rng.uniform(0.1, 0.5), rate_hz, rng)
                _add(sound, at_s + half * beat_s / 2, tone, 0.4, rate_hz)
            if has_drums and rng.random() < 0.8:
                _add(sound, at_s + half * beat_s / 2, _drum("hat", rate_hz, rng), 0.25, rate_hz)
        if has_drums:
            kind = "kick" if beat % 2 == 0 else "snare"
            _add(sound, at_s, _drum(kind, rate_hz, rng), 0.8, rate_hz)
    return sound / _peak(sound)


def _peak(sound: Array) -> float:
    """Return the loudest sample, a little more than 0 of silence."""
    return max(float(np.max(np.abs(sound), initial=0.0)), 1e-9)


def _ratio(degree: int) -> float:
    octave, step = divmod(degree, len(_SCALE))
    return 2 ** (octave + _SCALE[step] / 12)


def _add(sound: Array, at_s: float, part: Array, gain: float, rate_hz: float) -> None:
    """Add what is within the sound."""
    start = int(at_s * rate_hz)
    if start < 0:
        part, start = part[-start:], 0
    end = min(len(sound), start + len(part))
    if start < end:
        sound[start:end] += gain * part[: end - start]


def _note(
    seconds: float,
    hz: float,
    rise_s: float,
    fall_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> Array:
    time = np.arange(int(seconds * rate_hz)) / rate_hz
    sound = np.zeros(len(time))
    steep = rng.uniform(0.8, 1.8)
    for number in range(1, 9):
        if number * hz < 0.4 * rate_hz:
            turn = rng.uniform(0, 2 * np.pi)
            sound += number**-steep * np.sin(2 * np.pi * number * hz * time + turn)
    end = np.clip((seconds - time) / 0.02, 0, 1)
    return sound / 2 * np.minimum(time / rise_s, 1) * np.exp(-time / fall_s) * end


def _drum(kind: str, rate_hz: float, rng: np.random.Generator) -> Array:
    time = np.arange(int(0.25 * rate_hz)) / rate_hz
    noise = rng.standard_normal(len(time))
    if kind == "kick":
        sweep = 50 * time + 4.0 * (1 - np.exp(-time / 0.03))
        return np.sin(2 * np.pi * sweep) * np.exp(-time / 0.09) * np.minimum(time / 0.001, 1)
    if kind == "hat":
        return 0.5 * np.diff(noise, prepend=0.0) * np.exp(-time / rng.uniform(0.01, 0.05))
    ring = np.sin(2 * np.pi * 190 * time) * np.exp(-time / 0.05)
    return 0.5 * ring + 0.4 * noise * np.exp(-time / rng.uniform(0.04, 0.1))


# ---- Speech without words: a pulsed throat through resonances, hisses, pauses.

# First three formants of vowels (Peterson and Barney 1952, men).
_VOWELS_HZ = (
    *((730, 1090, 2440), (270, 2290, 3010), (300, 870, 2240), (530, 1840, 2480)),
    *((570, 840, 2410), (660, 1720, 2410), (440, 1020, 2240), (490, 1350, 1690)),
)


def speech(seconds: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise somebody who talks, about as loud as 1 at the loudest."""
    sound = np.zeros(int(seconds * rate_hz))
    pitch_hz, size = rng.uniform(90, 230), rng.uniform(0.95, 1.2)
    at_s = rng.uniform(0.0, 0.4)
    while at_s < seconds:
        for _ in range(int(rng.integers(2, 9))):  # a phrase of syllables, most with a consonant
            own_hz = pitch_hz * np.exp(rng.normal(0, 0.12))
            kind = rng.choice(["hiss", "burst", "none"], p=[0.35, 0.4, 0.25])
            parts: list[Array] = []
            if kind == "hiss":
                parts.append(_hiss(rng.uniform(0.05, 0.14), rate_hz, rng))
            elif kind == "burst":
                parts.append(np.zeros(int(rng.uniform(0.02, 0.08) * rate_hz)))
                parts.append(_burst(rate_hz, rng))
            parts.append(_vowel(rng.uniform(0.08, 0.26), own_hz, size, rate_hz, rng))
            for part in parts:
                _add(sound, at_s, part, 1.0, rate_hz)
                at_s += len(part) / rate_hz
            at_s += rng.choice([0.0, 0.0, rng.uniform(0.02, 0.1)])
        at_s += rng.uniform(0.15, 0.8)
    return sound / _peak(sound)


def _vowel(
    seconds: float, pitch_hz: float, size: float, rate_hz: float, rng: np.random.Generator
) -> Array:
    from scipy.signal import lfilter

    count = int(seconds * rate_hz)
    glide = np.linspace(1.0, np.exp(rng.normal(-0.05, 0.08)), count)
    phase = np.cumsum(pitch_hz * glide * (1 + 0.01 * rng.standard_normal(count))) / rate_hz
    pulses = np.zeros(count)
    pulses[1:] = np.diff(np.floor(phase)) > 0
    pulses = lfilter([1.0], [1.0, -0.96], pulses)  # a throat's closing, 6 dB an octave
    pulses = pulses + 0.02 * rng.standard_normal(count)
    formants = _VOWELS_HZ[int(rng.integers(len(_VOWELS_HZ)))]
    for hz, width in zip(formants, (70.0, 100.0, 150.0), strict=True):
        radius = np.exp(-np.pi * width / rate_hz)
        turn = 2 * np.pi * hz * size / rate_hz
        shape = [1.0, -2 * radius * np.cos(turn), radius**2]
        pulses = lfilter([sum(shape)], shape, pulses)
    sound = np.diff(pulses, prepend=0.0)  # the lips
    rise, fall = int(rng.uniform(0.008, 0.04) * rate_hz), int(0.04 * rate_hz)
    envelope = np.minimum(np.arange(count) / rise, 1) * np.minimum(np.arange(count)[::-1] / fall, 1)
    sound = sound * envelope
    return rng.uniform(0.4, 1.0) * sound / _peak(sound)


def _hiss(seconds: float, rate_hz: float, rng: np.random.Generator) -> Array:
    low = rng.uniform(1500, 4500)
    high = min(low + rng.uniform(2000, 5000), 0.45 * rate_hz)
    count = int(seconds * rate_hz)
    noise = _band_passed(rng.standard_normal(count), rate_hz, (low, high), 2)
    noise *= np.sin(np.pi * (np.arange(count) + 0.5) / count) ** rng.uniform(0.3, 1.0)
    return rng.uniform(0.1, 0.4) * noise / _peak(noise)


def _burst(rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise p, t or k, which start at once."""
    count = int(rng.uniform(0.012, 0.04) * rate_hz)
    low = rng.uniform(500, 3000)
    high = low * rng.uniform(1.5, 3.0)
    noise = _band_passed(rng.standard_normal(count), rate_hz, (low, high), 1)
    noise *= np.exp(-np.arange(count) / rate_hz / rng.uniform(0.003, 0.01))
    return rng.uniform(0.2, 0.7) * noise / _peak(noise)


def _band_passed(samples: Array, rate_hz: float, ends_hz: Range, order: int) -> Array:
    """Filter as Butterworth did, from the past alone."""
    from scipy.signal import butter, sosfilt

    sections = butter(order, ends_hz, "bandpass", fs=rate_hz, output="sos")
    return np.asarray(sosfilt(sections, samples))


# ---- Backgrounds: a quiet room, a fan, speech, music.

Background = Literal["quiet", "noise", "speech", "music"]
BACKGROUNDS: tuple[Background, ...] = get_args(Background)


def background_sound(
    kind: Background, seconds: float, rate_hz: float, rng: np.random.Generator
) -> Array:
    """Synthesise a background of any loudness, shape (N,).

    Args:
        kind: "quiet" has noise that falls with frequency, and hum; "noise" is white, pink or of a
            fan with its blades; "speech" and "music" have a little of the first below them.
        seconds: how long.
        rate_hz: of its samples.
        rng: draws it.
    """
    count = int(seconds * rate_hz)
    time = np.arange(count) / rate_hz
    if kind == "noise":
        noise = coloured_noise(count, rate_hz, rng.choice([0.0, 0.5, 1.0]), rng)
        if rng.random() < 0.4:
            noise = noise * (1 + 0.5 * np.sin(2 * np.pi * rng.uniform(20, 90) * time))
        return noise
    room = coloured_noise(count, rate_hz, rng.uniform(0.5, 1.0), rng)
    strength, mains_hz = rng.uniform(0.0, 1.0), rng.choice([50.0, 60.0])
    hum = np.zeros(count)
    for number, turn in enumerate(rng.uniform(0, 2 * np.pi, 6), 1):
        hum += np.sin(2 * np.pi * mains_hz * number * time + turn) / number
    room += strength * hum
    if kind == "quiet":
        return room
    made = (speech if kind == "speech" else music)(seconds, rate_hz, rng)[:count]
    loud = np.sqrt(np.mean(made**2))
    return made + loud * 10 ** (-rng.uniform(20, 35) / 20) * room / np.sqrt(np.mean(room**2))


def coloured_noise(count: int, rate_hz: float, fall: float, rng: np.random.Generator) -> Array:
    """Synthesise noise with amplitude f^-`fall`: 0 is white, .5 pink, 1 brown."""
    spectrum = np.fft.rfft(rng.standard_normal(count))
    hz = np.fft.rfftfreq(count, 1 / rate_hz)
    return np.fft.irfft(spectrum * np.maximum(hz, 30.0) ** -fall, count) * 30.0**fall


# ---- Balls and tables that sound: sizes, masses, contacts, and the modes that ring.


@dataclass(frozen=True)
class SoundingBall:
    """Kind of ball."""

    name: str  # in tables
    diameter_m: Range  # range that one is drawn from
    density_kg_m3: Range  # of the whole ball, likewise
    drag_coefficient: float  # Cd at the speeds of a drop
    contact_s: Range  # range of a contact's duration at 1 m/s
    strike_s: Range  # range of the time in which a touch gets to its full strength
    ball_hz: Range  # range of the ball's own modes
    ball_ring_s: Range  # range of the time in which one falls to 1/e
    slap: Range  # range of the strength of the noise of the touch, over the modes'


# Contacts from .3 to 8 ms, drags from .0013 to .13 per m.
SOUNDING_BALLS = (
    SoundingBall(
        *("table tennis", (0.0398, 0.0402), (79.0, 82.5), 0.47, (0.0008, 0.0013)),
        *((0.0001, 0.0003), (4500.0, 9500.0), (0.001, 0.004), (0.3, 1.0)),
    ),
    SoundingBall(
        *("golf", (0.0427, 0.0430), (1090.0, 1128.0), 0.50, (0.0005, 0.0008)),
        *((0.0001, 0.0003), (2500.0, 8000.0), (0.001, 0.004), (0.2, 0.8)),
    ),
    SoundingBall(
        *("tennis", (0.0654, 0.0686), (355.0, 385.0), 0.55, (0.0045, 0.0065)),
        *((0.0003, 0.0010), (250.0, 1400.0), (0.003, 0.012), (0.5, 1.5)),
    ),
    SoundingBall(
        *("racquetball", (0.0567, 0.0577), (395.0, 415.0), 0.47, (0.0045, 0.0080)),
        *((0.0003, 0.0010), (300.0, 1800.0), (0.003, 0.012), (0.5, 1.5)),
    ),
    SoundingBall(
        *("steel", (0.012, 0.040), (7750.0, 7900.0), 0.47, (0.0003, 0.0004)),
        *((0.00005, 0.0002), (9000.0, 16000.0), (0.0005, 0.002), (0.1, 0.6)),
    ),
    SoundingBall(
        *("marble", (0.014, 0.025), (2450.0, 2550.0), 0.47, (0.0003, 0.0004)),
        *((0.00005, 0.0002), (7000.0, 16000.0), (0.0005, 0.002), (0.1, 0.6)),
    ),
    SoundingBall(
        *("rubber", (0.025, 0.050), (1000.0, 1250.0), 0.47, (0.0025, 0.0050)),
        *((0.0002, 0.0008), (500.0, 3000.0), (0.002, 0.008), (0.4, 1.2)),
    ),
    SoundingBall(
        *("wood", (0.025, 0.060), (600.0, 800.0), 0.47, (0.0005, 0.0010)),
        *((0.0001, 0.0004), (1500.0, 6000.0), (0.001, 0.004), (0.2, 0.8)),
    ),
    SoundingBall(
        *("hollow plastic", (0.060, 0.075), (100.0, 150.0), 0.50, (0.0020, 0.0040)),
        *((0.0002, 0.0006), (700.0, 4000.0), (0.002, 0.010), (0.3, 1.0)),
    ),
)


@dataclass(frozen=True)
class SoundingTable:
    """Kind of table or floor."""

    name: str  # for a reader
    modes: tuple[int, int]  # how many there are, at least and at most
    table_hz: Range  # range of their frequencies
    table_ring_s: Range  # range of the time in which one falls to 1/e


SOUNDING_TABLES = (
    SoundingTable("wooden table", (8, 14), (120.0, 3500.0), (0.006, 0.040)),
    SoundingTable("laminate floor", (8, 14), (150.0, 2500.0), (0.004, 0.025)),
    SoundingTable("stone", (5, 10), (700.0, 9000.0), (0.001, 0.010)),
    SoundingTable("glass", (5, 10), (500.0, 7000.0), (0.010, 0.080)),
    SoundingTable("metal plate", (8, 14), (300.0, 6000.0), (0.030, 0.150)),
)


def draw_ball(kind: SoundingBall, rng: np.random.Generator) -> tuple[Ball, float, float]:
    """Draw a ball: what a user says of it, who weighs and measures it to 1 %, drag, contact."""
    diameter_m = float(rng.uniform(*kind.diameter_m))
    mass_kg = float(rng.uniform(*kind.density_kg_m3)) * np.pi / 6 * diameter_m**3
    area_m2 = np.pi / 4 * diameter_m**2
    drag = 1.2 * kind.drag_coefficient * area_m2 / (2 * mass_kg)  # in air of 1.2 kg/m³
    # by 5 % a drag differs from what size and mass say: seams, nap, air
    off = np.exp(rng.normal(0.0, [0.01, 0.01, 0.05]))
    told = Ball(float(diameter_m * off[0]), float(mass_kg * off[1]), kind.drag_coefficient)
    contact_s = float(np.exp(rng.uniform(*np.log(kind.contact_s))))  # at 1 m/s
    return told, float(drag * off[2]), contact_s


Voice = Callable[..., None]  # see `draw_voice`


def draw_voice(
    kind: SoundingBall, table: SoundingTable, loudness: float, rng: np.random.Generator
) -> Voice:
    """Draw the sound of a ball of this kind on such a table: damped modes, and a touch's noise.

    What is returned adds impacts, each (onset [s], speed [m/s]), to a sound in place, shape (N,).
    All grows with the speed to the power of `loudness`; by `uneven` the strength of each mode
    differs from impact to impact (log, one sd).
    """
    of_ball, of_table = int(rng.integers(3, 7)), int(rng.integers(*table.modes, endpoint=True))
    modes_hz, rings_s = (
        np.concatenate([_log_drawn(own, of_ball, rng), _log_drawn(tables, of_table, rng)])
        for own, tables in (
            (kind.ball_hz, table.table_hz),
            (kind.ball_ring_s, table.table_ring_s),
        )
    )
    # of each mode in an impact at 1 m/s, before the strike's own low pass
    usual = np.exp(rng.normal(0.0, 0.6, len(modes_hz))) * rng.choice([-1.0, 1.0], len(modes_hz))
    usual[:of_ball] *= rng.uniform(0.2, 1.5)
    usual /= np.sqrt(np.sum(usual**2))
    usual_strike_s = float(_log_drawn(kind.strike_s, 1, rng)[0])  # likewise
    slap_gain, slap_s = rng.uniform(*kind.slap), rng.uniform(0.0008, 0.004)
    low_hz, high_hz = rng.uniform(600, 2000), rng.uniform(4000, 12000)  # of the slap
    own = rng.uniform(0.05, 0.25)

    def add(
        samples: Array,
        rate_hz: float,
        impacts: Iterable[tuple[float, float]],
        rng: np.random.Generator,
        uneven: float = own,
    ) -> None:
        for begins_s, speed_m_s in impacts:
            first = int(np.ceil(begins_s * rate_hz))
            last = min(len(samples), first + int(1.2 * rate_hz))
            gains = usual * np.exp(rng.normal(0.0, uneven, len(usual)))
            overall = np.exp(rng.normal(0.0, 0.1))
            slap_seed = int(rng.integers(2**31))
            if first >= last or first < 0:
                continue
            seconds = np.arange(first, last) / rate_hz - begins_s
            strike_s = usual_strike_s * speed_m_s**-0.3  # fast impacts are brighter
            part = np.clip(seconds / strike_s, 0.0, 1.0)
            sound = np.zeros(len(seconds))
            for hz, ring_s, gain in zip(modes_hz, rings_s, gains, strict=True):
                if hz <= 0.47 * rate_hz:
                    heard = seconds[: int(7.0 * ring_s * rate_hz) + 1]
                    dulled = gain / (1 + (hz * strike_s) ** 2)
                    wave = dulled * np.exp(-heard / ring_s) * np.sin(2 * np.pi * hz * heard)
                    sound[: len(heard)] += wave
            slap = seconds[: int(8 * slap_s * rate_hz) + 1]
            white = np.random.default_rng(slap_seed).standard_normal(len(slap) + 200)
            noise = _band_passed(white, rate_hz, (low_hz, min(high_hz, 0.45 * rate_hz)), 1)[200:]
            sound[: len(slap)] += slap_gain * noise * np.exp(-slap / slap_s)
            strength = part * part * (3 - 2 * part)
            samples[first:last] += overall * speed_m_s**loudness * (strength * sound)

    return add


def _log_drawn(ends: Range, count: int, rng: np.random.Generator) -> Array:
    return np.exp(rng.uniform(np.log(ends[0]), np.log(ends[1]), count))


# ---- Loudness: impacts beside the background.

OCTAVES_HZ = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)  # middles of bands an octave wide


def impact_ratio(foreground: Array, background: Array, rate_hz: float, impacts_s: Array) -> float:
    """Return the signal-to-noise ratio of a bounce [dB].

    Of the impacts, the one of median power in its first 20 ms is taken, and the octave in which it
    has most power in that time. The ratio is that power over the background's mean power in the
    same octave. An ear that listens there hears that impact at this ratio, louder ones better.

    Args:
        foreground: the ball alone, as recorded, shape (N,).
        background: the rest, shape (N,).
        rate_hz: of both.
        impacts_s: when the sound of each impact begins, after the first sample.
    """
    count = int(0.02 * rate_hz)
    windows = [foreground[(at := int(time * rate_hz)) : at + count] for time in impacts_s]
    powers = np.array([float(np.mean(window**2)) for window in windows])
    middle = windows[int(np.argsort(powers)[(len(powers) - 1) // 2])]
    bands = np.array([_power(middle, rate_hz, hz) for hz in OCTAVES_HZ])
    loudest = int(np.argmax(bands))
    below = max(_power(background, rate_hz, OCTAVES_HZ[loudest]), 1e-30)
    return float(10 * np.log10(bands[loudest] / below))


def _power(samples: Array, rate_hz: float, middle_hz: float) -> float:
    """Return the mean power in an octave (by Parseval's theorem)."""
    power = np.abs(np.fft.rfft(samples)) ** 2
    hz = np.fft.rfftfreq(len(samples), 1 / rate_hz)
    inside = (hz >= middle_hz / np.sqrt(2)) & (hz < middle_hz * np.sqrt(2))
    return float(2 * power[inside].sum() / len(samples) ** 2)


# ---- A room, a microphone and a phone's electronics.

Codec = Literal["pcm", "aac"]


def draw_room(rng: np.random.Generator) -> Callable[[Array, float], Array]:
    """Draw any room, the phone up to a few steps from the ball; return what it does to a sound."""
    echo_s = rng.uniform(0.2, 0.8)  # in which echoes fall by 60 dB
    direct_db = rng.uniform(0.0, 15.0)  # power of the direct sound over that of the echo's tail
    reflections, seed = int(rng.integers(2, 8)), int(rng.integers(2**31))

    def heard(samples: Array, rate_hz: float) -> Array:
        from scipy.signal import fftconvolve

        rng = np.random.default_rng(seed)
        count = int(min(echo_s, 0.9) * rate_hz)
        seconds = np.arange(count) / rate_hz
        tail = rng.standard_normal(count) * 10 ** (-3 * seconds / echo_s)
        tail *= np.clip((seconds - 0.004) / 0.012, 0.0, 1.0)
        smooth = rng.uniform(0.1, 0.6)  # walls take more of high notes
        tail[1:] = (1 - smooth) * tail[1:] + smooth * tail[:-1]
        tail *= np.sqrt(10 ** (-direct_db / 10) / np.sum(tail**2))
        tail[0] = 1.0  # the direct sound
        for _ in range(reflections):
            at_s = rng.uniform(0.0015, 0.03)
            gain = rng.uniform(0.1, 0.5) * rng.choice([-1.0, 1.0], p=[0.2, 0.8])
            whole, part = int(at_s * rate_hz), at_s * rate_hz % 1
            tail[whole] += gain * (1 - part)
            tail[whole + 1] += gain * part
        return fftconvolve(samples, tail)[: len(samples)]

    return heard


@dataclass(frozen=True)
class SoundPhone:
    """Microphone and electronics of a phone."""

    low_hz: float  # lower end of its band
    high_hz: float  # upper end
    peak: float  # loudest sample of what it records, of full scale; over 1 is clipped
    gain_ratio: float = 1.0  # compression of its automatic gain; 1 for none
    release_s: float = 0.5  # in which that gain comes back

    def band(self, samples: Array, rate_hz: float) -> Array:
        """Apply the microphone's band-pass filter; causal, as every microphone."""
        return _band_passed(samples, rate_hz, (self.low_hz, min(self.high_hz, 0.46 * rate_hz)), 2)

    def recorded(self, samples: Array, rate_hz: int, codec: Codec) -> NDArray[np.float32]:
        """Apply gain, full scale, 16 bits and a codec."""
        if self.gain_ratio > 1:
            samples = samples * _automatic_gain(samples, rate_hz, self.gain_ratio, self.release_s)
        loudest = float(np.max(np.abs(samples), initial=1e-9))
        clipped = np.clip(self.peak / loudest * samples, -1.0, 32767 / 32768)
        whole = (np.round(clipped * 32768) / 32768).astype(np.float32)
        if codec == "aac":
            whole = through_aac(whole, rate_hz)
        whole.flags.writeable = False
        return whole


def _automatic_gain(samples: Array, rate_hz: float, ratio: float, release_s: float) -> Array:
    """Return a gain for each sample that falls within 5 ms and comes back slowly."""
    block = 64  # samples that it is the same for, before it is smoothed
    count = -(-len(samples) // block)
    padded = np.pad(np.abs(samples), (0, count * block - len(samples)))
    peaks = padded.reshape(count, block).max(axis=1)
    up, down = (np.exp(-block / rate_hz / within_s) for within_s in (0.005, release_s))
    floor = 0.02 * float(peaks.max(initial=1e-9))
    level, levels = floor, np.empty(count)
    for at, peak in enumerate(np.maximum(peaks, floor).tolist()):
        keep = up if peak > level else down
        level = keep * level + (1 - keep) * peak
        levels[at] = level
    gains = (levels / floor) ** (1 / ratio - 1)
    middles = (np.arange(count) + 1.0) * block  # what a block's gain is known from lies before it
    return np.interp(np.arange(len(samples)), middles, gains)


def draw_phone(rng: np.random.Generator) -> SoundPhone:
    """Draw any phone: a fourth with automatic gain, a sixth of them overdriven."""
    clips = rng.random() < 1 / 6
    return SoundPhone(
        low_hz=float(rng.uniform(60.0, 200.0)),
        high_hz=float(rng.uniform(10000.0, 18000.0)),
        peak=float(rng.uniform(1.2, 3.0) if clips else rng.uniform(0.1, 0.95)),
        gain_ratio=float(rng.uniform(1.5, 4.0)) if rng.random() < 0.25 else 1.0,
        release_s=float(rng.uniform(0.2, 1.5)),
    )


# ---- Files as users have them: PCM in WAV, or AAC in M4A.


def write_sound(samples: NDArray[np.float32], rate_hz: int, path: Path) -> None:
    """Write .wav (16 bits) or .m4a (AAC, 64 kbit/s), by the path's end."""
    if path.suffix != ".wav":
        path.write_bytes(aac_bytes(samples, rate_hz))
        return
    import wave

    whole = np.clip(np.round(samples.astype(np.float64) * 32768), -32768, 32767).astype("<i2")
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, rate_hz, 0, "NONE", ""))
        file.writeframes(whole.tobytes())


def aac_bytes(samples: NDArray[np.float32], rate_hz: int) -> bytes:
    """Encode an M4A file, with the encoder's priming before the first sample, as phones do."""
    import av

    held = io.BytesIO()
    with av.open(held, "w", format="mp4") as container:
        add_sound(container, aac_stream(container, rate_hz), samples, rate_hz)
    return held.getvalue()


def through_aac(samples: NDArray[np.float32], rate_hz: int) -> NDArray[np.float32]:
    """Pass a sound through AAC: as long as before, at the same times."""
    import av

    heard = np.zeros(len(samples), np.float32)
    with av.open(io.BytesIO(aac_bytes(samples, rate_hz)), "r") as container:
        for frame in container.decode(audio=0):
            assert frame.pts is not None
            assert frame.time_base is not None
            start = round(float(frame.pts * frame.time_base) * rate_hz)
            piece = frame.to_ndarray()[0]
            low, high = max(start, 0), min(start + len(piece), len(heard))
            if low < high:
                heard[low:high] = piece[low - start : high - start]
    return np.clip(heard, -1.0, 1.0)


# ---- A bounce drawn at random, as a phone hears it, with the truth behind it.


@dataclass(frozen=True, eq=False)
class SoundScene:
    """Bounce and where it is heard, before any background."""

    what: str  # the ball's kind and the table's
    told: Ball  # what a user can say of the ball: size and mass of the kind's middle
    history: BounceHistory  # the bounce
    voice: Voice  # how they sound together
    room: Callable[[Array, float], Array]  # around them, by `draw_room`
    phone: SoundPhone  # that records
    audible: int  # how many impacts are recorded and at most 30 dB below the loudest
    rate_hz: int  # of the samples
    release_s: float  # when the ball is let go, after the first sample
    lasts_s: float  # length of the recording
    distance_m: float  # from ball to microphone at the release
    walk_m_s: float  # by which that grows
    seed: int  # of what differs from impact to impact

    @property
    def touches_s(self) -> Array:
        """Start of each contact after the first sample, to the end of the recording."""
        touches = self.release_s + self.history.touches_s
        return touches[touches < self.lasts_s]

    @property
    def impacts_s(self) -> Array:
        """Arrival of each contact's sound at the microphone, after the first sample."""
        away_m = self.distance_m + self.walk_m_s * (self.touches_s - self.release_s)
        return self.touches_s + np.maximum(away_m, 0.05) / 343.0

    def foreground(self) -> Array:
        """Synthesise the ball alone, in its room, by the phone's microphone, shape (N,)."""
        samples = np.zeros(int(self.lasts_s * self.rate_hz))
        impacts = zip(self.impacts_s, self.history.speeds_m_s, strict=False)
        self.voice(samples, self.rate_hz, impacts, np.random.default_rng(self.seed))
        return self.phone.band(self.room(samples, self.rate_hz), self.rate_hz)


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recording."""

    samples: NDArray[np.float32]  # full scale 1, shape (N,)
    rate_hz: int
    codec: Codec  # that the samples went through

    def write(self, path: Path) -> None:
        """Write as .wav or .m4a; the first as it is, the second encoded (once more, if it was)."""
        write_sound(self.samples, self.rate_hz, path)

    def sound(self, name: str = "/audio", start_ns: int = 0) -> Sound:
        """Return the sound in memory, as a reader gives it."""
        codec = "pcm_s16le" if self.codec == "pcm" else "aac"
        rate_hz = float(self.rate_hz)
        return Sound(name, start_ns, rate_hz, self.samples, rate_hz, codec=codec)


@dataclass(frozen=True, eq=False)
class SoundClip(Recorded):
    """Recording of a bounce and its truth."""

    scene: SoundScene  # the bounce
    background: Background  # what else is heard
    snr_db: float  # see `impact_ratio`

    @property
    def impacts_s(self) -> Array:
        """Arrival of each impact's sound, after the first sample, shape (N,)."""
        return self.scene.impacts_s

    @property
    def restitutions(self) -> Array:
        """Restitution of each impact, shape (N,)."""
        return self.scene.history.restitutions[: len(self.impacts_s)]


def draw_sound(
    seed: int,
    number: int,
    *,
    background: Background | None = None,
    snr_db: float | None = None,
    codec: Codec = "pcm",
    uneven: float = 0.0,
) -> SoundClip:
    """Draw clip `number` of a seed: the same bounce for any background, ratio and codec.

    Negative seeds are for choosing, positive ones for reporting.
    """
    rng = np.random.default_rng([1_000_000 + seed, number, *b"bounce"])
    scene = draw_scene(rng, uneven=uneven)
    rng = np.random.default_rng([1_000_000 + seed, number, *b"background"])
    drawn = BACKGROUNDS[int(rng.integers(len(BACKGROUNDS)))]
    ratio_db = float(rng.uniform(20.0, 40.0))
    ratio_db = ratio_db if snr_db is None else snr_db
    return recorded(scene, background or drawn, ratio_db, codec, int(rng.integers(2**31)))


def recorded(
    scene: SoundScene, background: Background, snr_db: float, codec: Codec, seed: int
) -> SoundClip:
    """Mix a bounce with a background, and record it by the phone."""
    rate_hz, lasts_s = scene.rate_hz, scene.lasts_s
    foreground = scene.foreground()
    other = background_sound(background, lasts_s, rate_hz, np.random.default_rng(seed))
    other = scene.phone.band(other[: len(foreground)], rate_hz)
    heard = scene.impacts_s[: scene.audible]
    off_db = impact_ratio(foreground, other, rate_hz, heard) - snr_db
    mixed = foreground + 10 ** (off_db / 20) * other
    samples = scene.phone.recorded(mixed, rate_hz, codec)
    return SoundClip(samples, rate_hz, codec, scene, background, snr_db)


def draw_scene(
    rng: np.random.Generator, lasts_s: float | None = None, uneven: float = 0.0
) -> SoundScene:
    """Draw any ball on any table that is heard at least five times.

    Args:
        rng: draws it.
        lasts_s: of the recording after the release; None to end it after 5 to 14 audible impacts.
        uneven: see `BounceOrder`.
    """
    while True:
        kind = SOUNDING_BALLS[int(rng.integers(len(SOUNDING_BALLS)))]
        table = SOUNDING_TABLES[int(rng.integers(len(SOUNDING_TABLES)))]
        told, drag_1_m, contact_s = draw_ball(kind, rng)
        order = BounceOrder(
            height_m=float(rng.uniform(0.3, 1.5)),
            restitution=float(rng.uniform(0.5, 0.95)),
            slope=float(rng.uniform(0.0, 0.15)),
            drag_1_m=drag_1_m,
            contact_s=contact_s,
            uneven=uneven,
            seed=int(rng.integers(2**31)) if uneven else 0,
        )
        loudness = float(rng.uniform(1.2, 1.8))
        history = bounced(order)
        loud, touches = history.speeds_m_s**loudness, history.touches_s
        audible = int(np.count_nonzero(loud > 10**-1.5 * loud[0]))  # down to 30 dB below the first
        release_s = float(rng.uniform(0.2, 1.2))
        count = min(audible, int(rng.integers(5, 15)))
        if lasts_s:
            end_s = lasts_s
        elif count < len(touches):  # in the flight after the last of these
            flight = touches[count] - touches[count - 1]
            end_s = min(touches[count - 1] + rng.uniform(0.4, 0.95) * flight, 10.0)
        else:
            end_s = min(touches[-1] + rng.uniform(0.3, 1.0), 10.0)
        audible = min(audible, int(np.count_nonzero(touches < end_s - 0.02)))
        scene = SoundScene(
            what=f"{kind.name} on {table.name}",
            told=told,
            history=history,
            voice=draw_voice(kind, table, loudness, rng),
            room=draw_room(rng),
            phone=draw_phone(rng),
            audible=audible,
            rate_hz=int(rng.choice((44_100, 48_000))),
            release_s=release_s,
            lasts_s=release_s + float(end_s),
            distance_m=float(rng.uniform(0.15, 1.5)),
            walk_m_s=float(rng.normal(0.0, 0.03)),
            seed=int(rng.integers(2**31)),
        )
        if audible >= 5:
            return scene


# ---- Sounds that are no bounce of one ball, and must not be taken for one.

_RATE_HZ = 48_000


def _striker(strike_s: Range, hz: Range, ring_s: Range, slap: Range) -> SoundingBall:
    """Return what strikes, in place of a ball: only its modes and its slap count."""
    return replace(SOUNDING_BALLS[0], strike_s=strike_s, ball_hz=hz, ball_ring_s=ring_s, slap=slap)


_HAND = _striker((0.0003, 0.001), (500.0, 2500.0), (0.001, 0.006), (1.0, 3.0))
_HEEL = _striker((0.0005, 0.003), (80.0, 600.0), (0.004, 0.02), (0.1, 0.6))
_KEY = _striker((0.0001, 0.0004), (1500.0, 7000.0), (0.001, 0.006), (0.3, 1.0))
_DROP = _striker((0.0001, 0.0006), (800.0, 9000.0), (0.0005, 0.004), (0.5, 2.0))


@dataclass(frozen=True, eq=False)
class NoBounce(Recorded):
    """Recording of something else."""

    kind: str  # one of `NO_BOUNCES`


# From the length [s] and random numbers, a sound before room and microphone.
Maker = Callable[[float, np.random.Generator], Array]


def _struck(
    striker: SoundingBall,
    events: list[tuple[float, float]],
    lasts_s: float,
    rng: np.random.Generator,
) -> Array:
    """Synthesise strikes at these times [s] with these speeds [m/s]."""
    table = SOUNDING_TABLES[int(rng.integers(len(SOUNDING_TABLES)))]
    add, uneven = draw_voice(striker, table, 1.5, rng), float(rng.uniform(0.15, 0.4))
    samples = np.zeros(int(lasts_s * _RATE_HZ))
    add(samples, _RATE_HZ, events, rng, uneven)
    return samples


def _beats(
    lasts_s: float, period_s: float, jitter_s: float, uneven: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Draw times about a period apart, and speeds."""
    events: list[tuple[float, float]] = []
    at_s = rng.uniform(0.2, 0.8)
    while at_s < lasts_s - 0.1:
        events.append((at_s, _hard(uneven, rng)))
        at_s += max(period_s + rng.normal(0.0, jitter_s), 0.05)
    return events


def _hard(uneven: float, rng: np.random.Generator) -> float:
    """Draw a speed about 1 m/s."""
    return float(np.exp(rng.normal(0.0, uneven)))


def _claps(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise claps, even, or faster and faster."""
    events = _beats(lasts_s, rng.uniform(0.25, 0.7), rng.uniform(0.003, 0.03), 0.2, rng)
    if rng.random() < 0.4:
        begins_s, shorter = events[0][0], rng.uniform(0.85, 0.97)
        gaps = rng.uniform(0.4, 0.8) * shorter ** np.arange(30) * rng.normal(1, 0.02, 30)
        times = begins_s + np.cumsum(gaps)
        events = [(float(at), _hard(0.2, rng)) for at in times if at < lasts_s - 0.1]
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
        scene.voice(one, _RATE_HZ, zip(begins, speeds, strict=True), rng)
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
            events.append((at_s, _hard(0.2, rng)))
            at_s += period_s * rng.normal(1, 0.06)
        at_s += rng.uniform(0.6, 2.0)
    return _struck(_HAND, events, lasts_s, rng)


def _keyboard(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise keys that go down and up."""
    events: list[tuple[float, float]] = []
    at_s = rng.uniform(0.1, 0.6)
    while at_s < lasts_s - 0.2:
        hard = _hard(0.4, rng)
        events += [(at_s, hard), (at_s + rng.uniform(0.05, 0.12), 0.4 * hard)]
        at_s += rng.gamma(3.0, 0.06) + (rng.random() < 0.1) * rng.uniform(0.3, 1.0)
    return _struck(_KEY, sorted(events), lasts_s, rng)


def _rain(lasts_s: float, rng: np.random.Generator) -> Array:
    """Synthesise drops or clicks at random, few or many."""
    count = rng.poisson(lasts_s * np.exp(rng.uniform(np.log(1.5), np.log(25.0))))
    times = np.sort(rng.uniform(0.1, lasts_s - 0.1, count))
    return _struck(_DROP, [(float(at), _hard(0.5, rng)) for at in times], lasts_s, rng)


def _single(lasts_s: float, rng: np.random.Generator) -> Array:
    kind = SOUNDING_BALLS[int(rng.integers(len(SOUNDING_BALLS)))]
    return _struck(kind, [(float(rng.uniform(0.3, lasts_s - 0.5)), 3.0)], lasts_s, rng)


def _nothing(lasts_s: float, _: np.random.Generator) -> Array:
    return np.zeros(int(lasts_s * _RATE_HZ))


# By name, what is heard. Of "noise" only the background is, of "silence" nothing at all.
NO_BOUNCES: dict[str, Maker] = {
    "speech": lambda lasts_s, rng: speech(lasts_s, _RATE_HZ, rng),
    "music": lambda lasts_s, rng: music(lasts_s, _RATE_HZ, rng),
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


def draw_negative(seed: int, number: int) -> NoBounce:
    """Draw sound `number` of a seed, in a room, by a phone, a third of them through AAC."""
    rng = np.random.default_rng([2_000_000 + seed, number, *b"no bounce"])
    kind = list(NO_BOUNCES)[number % len(NO_BOUNCES)]
    lasts_s = float(rng.uniform(3.0, 8.0))
    codec: Codec = "aac" if rng.random() < 1 / 3 else "pcm"
    made = NO_BOUNCES[kind](lasts_s, rng)
    if kind == "silence":
        return NoBounce(made.astype(np.float32), _RATE_HZ, codec, kind)
    phone, room = draw_phone(rng), draw_room(rng)
    heard = phone.band(room(made, _RATE_HZ), _RATE_HZ)
    behind = "quiet" if kind != "noise" or rng.random() < 0.5 else "noise"
    other = background_sound(behind, lasts_s, _RATE_HZ, rng)[: len(heard)]
    other = phone.band(other, _RATE_HZ)
    loud = float(np.max(np.abs(heard))) or 1.0
    weak_db = float(rng.uniform(30, 55))
    other *= loud * 10 ** (-weak_db / 20) / np.sqrt(np.mean(other**2))
    return NoBounce(phone.recorded(heard + other, _RATE_HZ, codec), _RATE_HZ, codec, kind)


# ---- A bounce filmed and heard: a phone's mp4, its sound off by a constant; or a track.

FILM_HZ = 30.0


@dataclass(frozen=True, eq=False)
class Beside:
    """Sound beside a bounce that is seen."""

    clip: SoundClip  # the sound
    offset_s: float  # by which it is late, on the pictures' clock

    @property
    def restitution(self) -> float:
        """Restitution at the first impact."""
        return self.clip.scene.history.order.restitution


@dataclass(frozen=True, eq=False)
class FilmedSound(Beside):
    """Video with its sound."""

    order: ClipOrder  # the pictures

    def write(self, path: Path, *, with_sound: bool = True) -> None:
        """Write H.264 and AAC at 64 kbit/s, in an mp4."""
        late = round(self.offset_s * self.clip.rate_hz)
        heard = self.clip.samples[max(-late, 0) :], self.clip.rate_hz, max(late, 0)
        size_px, factor = self.order.view.size_px, self.order.h264_factor
        seconds = (frame_seconds(self.order) + self.order.held_s).tolist()
        with mp4(path, size_px, factor, heard if with_sound else None) as add:
            for picture, second in zip(clip_frames(self.order), seconds, strict=True):
                add(picture, second)


def film_with_sound(
    seed: int,
    number: int,
    snr_db: float = 20.0,
    background: Background | None = None,
    uneven: float = 0.0,
) -> FilmedSound:
    """Draw video `number` of a seed, 30 fps, pictures up to 640 by 360."""
    rng = np.random.default_rng([3_000_000 + seed, number, *b"film"])
    scene = short_scene(rng, uneven)
    bounce = scene.history.order
    ball = RealBall(bounce.restitution, bounce.slope, bounce.drag_1_m, bounce.height_m)
    order = replace(
        draw_clip_of(ball, rng, SIZES_PX[:5]),
        rate_hz=FILM_HZ,
        held_s=scene.release_s,
        length_s=scene.lasts_s - scene.release_s,
        exposure_s=float(rng.uniform(0.0, 0.008)),
        person=None,
        as_log=False,
        points_m=lambda seconds: upright(scene.history.heights_m(seconds)),
    )
    return FilmedSound(*_heard(scene, snr_db, background, rng), order)


def short_scene(rng: np.random.Generator, uneven: float = 0.0) -> SoundScene:
    """Draw a bounce that is recorded for four seconds after the release at most."""
    scene = draw_scene(rng, uneven=uneven)
    end_s = scene.release_s + 4.0
    if scene.lasts_s - scene.release_s <= 4.0:
        return scene
    audible = int(np.count_nonzero(scene.impacts_s[: scene.audible] < end_s - 0.02))
    return replace(scene, lasts_s=end_s, audible=audible)


def _heard(
    scene: SoundScene, snr_db: float, background: Background | None, rng: np.random.Generator
) -> tuple[SoundClip, float]:
    """Record a bounce, its sound early or late by up to 40 ms."""
    drawn = BACKGROUNDS[int(rng.integers(len(BACKGROUNDS)))]
    seed, offset_s = int(rng.integers(2**31)), float(rng.uniform(-0.040, 0.040))
    return recorded(scene, background or drawn, snr_db, "pcm", seed), offset_s


@dataclass(frozen=True, eq=False)
class TrackedSound(Beside):
    """Track of the ball's positions at 30 Hz, and its sound."""

    seconds: Array  # of the positions, after the first, shape (T,)
    positions_m: Array  # z is up, shape (T, 3)

    def episode(self) -> Episode:
        """Build the log in memory."""
        log = ball_log(self.seconds, self.positions_m, "/ball/pose")
        return with_sound(log, self.clip, self.offset_s)


def track_with_sound(
    seed: int,
    number: int,
    snr_db: float = 20.0,
    background: Background | None = None,
    uneven: float = 0.0,
) -> TrackedSound:
    """Draw track `number` of a seed; see `film_with_sound`."""
    rng = np.random.default_rng([3_000_000 + seed, number, *b"track"])
    scene = short_scene(rng, uneven)
    seconds = np.arange(0.0, scene.lasts_s, 1 / FILM_HZ)
    positions = np.tile([*rng.uniform(-1, 1, 2), rng.uniform(0, 1)], (len(seconds), 1))
    positions[:, 2] += scene.history.heights_m(seconds - scene.release_s)
    positions += rng.normal(0.0, 0.002, positions.shape)
    return TrackedSound(*_heard(scene, snr_db, background, rng), seconds, positions)


def with_sound(episode: Episode, heard: SoundClip | NoBounce, offset_s: float = 0.0) -> Episode:
    """Add a sound that begins `offset_s` after the episode's first sample or picture."""
    stamps = [int(signal.stamps_ns[0]) for signal in episode.signals.values()]
    stamps += [int(channel.log_ns[0]) for channel in episode.channels if len(channel.log_ns)]
    start_ns = min(stamps, default=START_NS) + round(offset_s * 1e9)
    channel = Channel("/audio", "", "", np.array([start_ns]), sounds=True)
    return replace(
        episode,
        channels=(*episode.channels, channel),
        open_sound=lambda topic: heard.sound(topic, start_ns),
    )
