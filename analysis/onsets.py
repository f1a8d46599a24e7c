"""Detect onsets in a sound, each with its uncertainty, its loudness and its colour.

A knock raises many bands at once and within a millisecond; speech, music and an echo's tail rise
slower, or in few bands. `moment_of` then picks the onset to a sample: where the sound, whitened by
a linear prediction of the background before it, changes its variance (Akaike's criterion, as
seismologists pick the arrival of a wave; Maeda, Zisin 38, 1985).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.audio import reduced_hz
from tunenet_logs.episode import Array, Sound

# ---- Onset time, to a sample.
# A codec spreads a little of a knock over the milliseconds before it (pre-echo): that is a change,
# too. So changes are followed up to the loudest moment, in a sound that is whitened less.

_AROUND_S = (0.010, 0.006)  # before and after a rise, where the moment is looked for
_ORDER = 16  # of the linear prediction that whitens the sound
# White noise that regularises the prediction, over the background's power: for the first change,
# and for those after it.
_FIRM, _MILD = 1e-4, 0.1
# Over which power is averaged where its largest is looked for, and until when after that.
_LOUDEST_S, _PAST_LOUDEST_S = 0.0005, 0.0015
_EDGE_SAMPLES = 8  # on both sides of a change


def moment_of(samples: Array, at: int, rate_hz: float) -> tuple[float, float]:
    """Pick the onset near sample `at` by Akaike's criterion; return it and its sd [samples]."""
    low = max(at - round(_AROUND_S[0] * rate_hz), 0)
    high = min(at + round(_AROUND_S[1] * rate_hz), len(samples))
    begin = max(low - round(0.05 * rate_hz), 0)
    change = _change(_whitened(samples[begin:high], low - begin, _FIRM))
    if change is None:
        return float(at), 0.001 * rate_hz
    moment, sd, *_ = change
    mild = _whitened(samples[begin:high], low - begin, _MILD)
    wide = max(round(_LOUDEST_S * rate_hz), 1)
    loudest = int(np.convolve(mild**2, np.ones(wide), "same").argmax())
    last = loudest + round(_PAST_LOUDEST_S * rate_hz)
    for _ in range(6):  # changes that rise by 5 dB, and gain 10 in log likelihood
        change = _change(mild[int(moment) : last])
        if change is None or change[2] < 5.0 or change[3] < 10.0:
            break
        moment, sd = int(moment) + change[0], change[1]
    return low + moment, sd


def _change(piece: Array) -> tuple[float, float, float, float] | None:
    """Locate where a piece of white noise changes its variance; None where it is too short.

    Returns that and its standard deviation [samples], the change [dB], and the gain in log
    likelihood.
    """
    count = len(piece)
    if count < 2 * _EDGE_SAMPLES + 4:
        return None
    squares = np.cumsum(piece**2) + 1e-30
    left = np.arange(_EDGE_SAMPLES, count - _EDGE_SAMPLES)
    first = squares[left - 1] / left
    second = np.maximum((squares[-1] - squares[left - 1]) / (count - left), 1e-30)
    cost = 0.5 * (left * np.log(first) + (count - left) * np.log(second))
    weights = np.exp(cost.min() - cost)
    weights /= weights.sum()
    mean = float(weights @ left)
    sd = float(np.sqrt(max(weights @ (left - mean) ** 2, 0.0)))
    step_db = 10 * np.log10(second / first)[int(cost.argmin())]
    gain = 0.5 * count * np.log(squares[-1] / count) - cost.min()
    return mean, sd, float(step_db), float(gain)


def _whitened(samples: Array, from_sample: int, white: float) -> Array:
    """Whiten from `from_sample` on by a linear prediction, learnt before it."""
    from scipy.linalg import solve_toeplitz

    background = samples[:from_sample]
    if len(background) < 4 * _ORDER or not background.any():
        return np.diff(samples[from_sample:], prepend=0.0)
    spectrum = np.abs(np.fft.rfft(background, 2 * len(background))) ** 2
    correlation = np.fft.irfft(spectrum)[: _ORDER + 1] / len(background)
    correlation[0] *= 1 + white
    predicts = solve_toeplitz(correlation[:-1], correlation[1:])
    return np.convolve(np.append(1.0, -predicts), samples)[from_sample : len(samples)]


# ---- Onsets: find the frames in which many bands rise.

_BAND_EDGES_HZ = (150.0, 400.0, 800.0, 1600.0, 3200.0, 6400.0, 12_800.0, 20_000.0)
_MIN_RATE_HZ = 2000.0  # of a sound in which knocks are detected
# Between frames, and how much of the sound each sees.
_HOP_S, _FRAME_S = 0.001, 0.002
# Frames of the background before a knock, of the gap between, and of the knock.
_BEFORE, _GUARD, _AFTER = 12, 2, 4
_MIN_RISE_DB = 2.0  # of a knock, mean over all bands
_APART = 20  # frames between two knocks: of nearer ones, the louder counts
MAX_ONSETS = 400  # that are kept: those that rise the most
# After a knock, softer ones within this time, by this much, are its echoes.
_ECHO_S, _ECHO_DB = 0.05, 1.0
_MIN_SD_S = 2e-5  # of a moment: one sample
_RINGS_S = 0.1  # a band is silent again so long after a knock, to 1e-12
_LOUD_S = 0.010  # after an onset, in which its peak is measured


@dataclass(frozen=True, eq=False)
class Onsets:
    """Onsets of a sound, in order."""

    times_s: Array  # on the sound's clock, 0 at its first sample, shape (N,) [s]
    sds_s: Array  # of them, shape (N,) [s]
    rises_db: Array  # mean rise over all bands, shape (N,)
    loudness_db: Array  # less the background before it, re full scale, shape (N,)
    colours_db: Array  # of its bands less their mean, shape (N, B)
    peaks: Array  # largest sample of each, full scale 1, shape (N,)

    def __len__(self) -> int:
        return len(self.times_s)

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Onsets:
        """Return the chosen onsets."""
        return Onsets(
            self.times_s[chosen],
            self.sds_s[chosen],
            self.rises_db[chosen],
            self.loudness_db[chosen],
            self.colours_db[chosen],
            self.peaks[chosen],
        )


def onsets(sound: Sound) -> Onsets:
    """Detect all onsets; the times are on the sound's own clock, by `rate_hz`."""
    samples = np.nan_to_num(sound.samples.astype(np.float64), posinf=0.0, neginf=0.0)
    heard_hz = reduced_hz(sound.file_rate_hz)  # of the samples that were kept
    hop = _hop(heard_hz)
    if len(samples) < (_BEFORE + _GUARD + _AFTER + 2) * hop or heard_hz < _MIN_RATE_HZ:
        none = np.zeros(0)
        return Onsets(none, none, none, none, np.zeros((0, 0)), none)
    powers = _band_powers(samples, heard_hz)
    rises, before, after = _rises(powers)
    rise = rises.mean(axis=0)
    frames = np.sort(_peaks(rise)[:MAX_ONSETS])
    picked = [moment_of(samples, frame * hop, heard_hz) for frame in frames.tolist()]
    own = np.maximum(after[:, frames] - before[:, frames], 1e-12 + 0.05 * after[:, frames])
    colours_db = 10 * np.log10(own)
    at, sds = np.array(picked, dtype=np.float64).reshape(-1, 2).T
    found = Onsets(
        at / sound.rate_hz,
        np.maximum(sds / sound.rate_hz, _MIN_SD_S * heard_hz / sound.rate_hz),
        rises.mean(axis=0)[frames],
        10 * np.log10(own.sum(axis=0)),
        (colours_db - colours_db.mean(axis=0)).T,
        np.array([_peak(samples, at, heard_hz) for at, _ in picked]),
    )
    found = found.only(np.argsort(found.times_s, kind="stable"))
    since_s = found.times_s[:, None] - found.times_s[None, :]
    louder = found.loudness_db[None, :] > found.loudness_db[:, None] + _ECHO_DB
    return found.only(~np.any((since_s > 0) & (since_s < _ECHO_S) & louder, axis=1))


def _peaks(rise: Array) -> NDArray[np.intp]:
    """Find the frames in which it rises most, no two nearer than `_APART`, the highest first."""
    # A plateau is a peak in its middle.
    edges = np.flatnonzero(np.diff(rise, prepend=np.nan, append=np.nan) != 0)
    first, last = edges[:-1], edges[1:] - 1
    inner = (first > 0) & (last < len(rise) - 1)
    first, last = first[inner], last[inner]
    above = (rise[first] > rise[first - 1]) & (rise[first] > rise[last + 1])
    frames = ((first + last) // 2)[above & (rise[first] >= _MIN_RISE_DB)]
    kept = np.ones(len(frames), dtype=bool)
    order = np.argsort(rise[frames])[::-1]
    for at in order.tolist():
        if kept[at]:
            kept[np.abs(frames - frames[at]) < _APART] = False
            kept[at] = True
    return frames[order[kept[order]]]


def _hop(rate_hz: float) -> int:
    return max(round(_HOP_S * rate_hz), 1)


def _band_powers(samples: Array, rate_hz: float) -> Array:
    """Return each band's power in each frame, shape (B, F), without bands above the sound's own.

    The bands are Butterworth's of the second order, by the bilinear transform, as products of
    spectra: silence behind the sound takes up what would come round.
    """
    from numpy.fft import irfft, rfft
    from scipy.fft import next_fast_len

    hop, wide = _hop(rate_hz), max(round(_FRAME_S / _HOP_S), 1)
    edges = [edge for edge in _BAND_EDGES_HZ if edge < 0.46 * rate_hz]
    wanted = len(samples) + math.ceil(_RINGS_S * rate_hz)
    size = cast("int", next_fast_len(wanted, real=True))  # SciPy's types say that it is None
    spectrum = rfft(samples, size)
    analog = np.tan(np.arange(len(spectrum)) * (np.pi / size))  # frequencies, prewarped
    found = []
    for low, high in pairwise(np.tan(np.array(edges) * (np.pi / rate_hz))):
        across = analog * (high - low)
        turn = analog * analog - low * high  # over `across` it is a low-pass filter's frequency
        gain = across**2 / (across**2 - turn**2 + 1j * math.sqrt(2) * across * turn)
        band = irfft(spectrum * gain, size)[: len(samples)] ** 2
        count = len(band) // hop
        short = band[: count * hop].reshape(count, hop).mean(axis=1)
        found.append(short)
    powers = np.array(found)
    sums = np.cumsum(np.pad(powers, ((0, 0), (1, 0))), axis=1)
    return (sums[:, wide:] - sums[:, :-wide]) / wide


def _rises(powers: Array) -> tuple[Array, Array, Array]:
    """Return each band's rise at each frame [dB], and the powers before and after, (B, F) each."""
    from scipy.ndimage import maximum_filter1d

    usual = np.median(powers, axis=1, keepdims=True)
    floor = usual * 10 ** (-12.0 / 10) + 1e-12  # quieter frames count as silent
    # the loudest moment shortly before, so that an echo's ripples are no knocks
    before = maximum_filter1d(powers, _BEFORE, axis=1, mode="nearest", origin=0)
    before = np.roll(before, _BEFORE // 2 + _GUARD, axis=1)
    before[:, : _BEFORE + _GUARD] = np.maximum(before[:, : _BEFORE + _GUARD], usual)
    after = maximum_filter1d(powers, _AFTER, axis=1, mode="nearest")
    after = np.roll(after, -(_AFTER // 2), axis=1)
    rises = 10 * np.log10((after + floor) / (before + floor))
    return np.clip(rises, 0.0, 25.0), before, after  # more of one band counts as this


def _peak(samples: Array, at: float, rate_hz: float) -> float:
    """Return the largest sample of the knock that begins there."""
    begin = max(int(at), 0)
    return float(np.abs(samples[begin : begin + round(_LOUD_S * rate_hz)]).max(initial=0.0))
