"""Onsets in a sound, each with its uncertainty, its loudness and its colour.

A knock raises many bands at once and within a millisecond; speech, music and an echo's tail rise
slower, or in few bands. Its exact moment is picked by `moments`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from analysis.listening.moments import moment_of
from tunenet_logs.arrays import Array
from tunenet_logs.formats.gathered_sound import reduced_hz
from tunenet_logs.sound import Sound

_EDGES_HZ = (150.0, 400.0, 800.0, 1600.0, 3200.0, 6400.0, 12_800.0, 20_000.0)  # of the bands
_MIN_RATE_HZ = 2000.0  # of a sound in which a knock is told from what is not
# Between the moments at which bands are looked at, and how much of the sound each sees.
_HOP_S, _FRAME_S = 0.001, 0.002

# Frames: of the background before a knock, left away between, and of the knock.
_BEFORE, _GUARD, _AFTER = 12, 2, 4

# Below a band's median over the whole sound nothing is told apart from digital silence.
_FLOOR_DB = 12.0

_MAX_DB = 25.0  # more than that in one band counts no more
_MIN_RISE_DB = 2.0  # of a knock, mean over all bands
_APART = 20  # frames between two knocks: in less, the louder counts
MAX_ONSETS = 400  # that are kept: those that rise the most
# After a knock, in which softer ones are its echoes; and by how much softer.
_ECHO_S, _ECHO_DB = 0.05, 1.0

_MIN_SD_S = 2e-5  # of a moment: one sample
_LOUD_S = 0.010  # after the onset, in which its largest sample is looked for


@dataclass(frozen=True, eq=False)
class Onsets:
    """Onsets of a sound, in order.

    Attributes:
        times_s: on the sound's clock, 0 at its first sample, shape (N,) [s].
        sds_s: of them, shape (N,) [s].
        rises_db: mean rise over all bands, shape (N,).
        loudness_db: of each, over the background before it taken off, re full scale, shape (N,).
        colours_db: of its bands less their mean, shape (N, B).
        peaks: largest sample of each, full scale 1, shape (N,).
    """

    times_s: Array
    sds_s: Array
    rises_db: Array
    loudness_db: Array
    colours_db: Array
    peaks: Array

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
    frames = _peaks(rises.mean(axis=0))
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
    return found.only(~_echoes(found.times_s, found.loudness_db))


def _echoes(times_s: Array, loudness_db: Array) -> NDArray[np.bool_]:
    """Return which onsets follow a louder one so soon that they may be its echo."""
    since_s = times_s[:, None] - times_s[None, :]
    louder = loudness_db[None, :] > loudness_db[:, None] + _ECHO_DB
    return np.any((since_s > 0) & (since_s < _ECHO_S) & louder, axis=1)


def _hop(rate_hz: float) -> int:
    return max(round(_HOP_S * rate_hz), 1)


def _band_powers(samples: Array, rate_hz: float) -> Array:
    """Return each band's power in each frame, shape (B, F), without bands above the sound's own."""
    from scipy.signal import butter, sosfilt

    hop, wide = _hop(rate_hz), max(round(_FRAME_S / _HOP_S), 1)
    edges = [edge for edge in _EDGES_HZ if edge < 0.46 * rate_hz]
    found = []
    for low, high in pairwise(edges):
        sos = butter(2, (low, high), "bandpass", fs=rate_hz, output="sos")
        band = np.asarray(sosfilt(sos, samples)) ** 2
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
    floor = usual * 10 ** (-_FLOOR_DB / 10) + 1e-12
    # the loudest moment shortly before, so that an echo's ripples are no knocks
    before = maximum_filter1d(powers, _BEFORE, axis=1, mode="nearest", origin=0)
    before = np.roll(before, _BEFORE // 2 + _GUARD, axis=1)
    before[:, : _BEFORE + _GUARD] = np.maximum(before[:, : _BEFORE + _GUARD], usual)
    after = maximum_filter1d(powers, _AFTER, axis=1, mode="nearest")
    after = np.roll(after, -(_AFTER // 2), axis=1)
    rises = 10 * np.log10((after + floor) / (before + floor))
    return np.clip(rises, 0.0, _MAX_DB), before, after


def _peaks(rise: Array) -> NDArray[np.int64]:
    from scipy.signal import find_peaks

    frames, shape = find_peaks(rise, height=_MIN_RISE_DB, distance=_APART)
    most = np.argsort(-shape["peak_heights"])[:MAX_ONSETS]
    return np.sort(frames[most])


def _peak(samples: Array, at: float, rate_hz: float) -> float:
    """Return the largest sample of the knock that begins there."""
    begin = max(int(at), 0)
    return float(np.abs(samples[begin : begin + round(_LOUD_S * rate_hz)]).max(initial=0.0))
