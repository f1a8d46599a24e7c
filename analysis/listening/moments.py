"""Onset time of a knock, to a sample.

It is where the sound, whitened by the background before it, changes its variance (Akaike's
criterion, as seismologists pick the arrival of a wave; Maeda, Zisin 38, 1985). A codec spreads a
little of a knock over the milliseconds before it (pre-echo), in bands that were silent: that is a
change, too. So from the first change on the next is looked for, up to the loudest moment, in a
sound that is whitened less; the last of them is the knock.
"""

from __future__ import annotations

import numpy as np

from tunenet_logs.arrays import Array

_AROUND_S = (0.010, 0.006)  # before and after a rise, where the moment is looked for
# Of background before it, and of the linear prediction that whitens it.
_BACKGROUND_S, _ORDER = 0.05, 16

# White noise that the prediction believes in, over the background's power: of the first change, and
# of those after it.
_FIRM, _MILD = 1e-4, 0.1

# Of a change after the first: by how much the power rises, and the log likelihood.
_MIN_STEP_DB, _MIN_GAIN = 5.0, 10.0

_MAX_STEPS = 6  # changes that are followed
# Over which power is averaged where its largest is looked for, and until when after that.
_LOUDEST_S, _PAST_LOUDEST_S = 0.0005, 0.0015

_EDGE = 8  # samples on both sides of a change


def moment_of(samples: Array, at: int, rate_hz: float) -> tuple[float, float]:
    """Pick an onset by Akaike's criterion; return it and its standard deviation [samples].

    Args:
        samples: shape (N,).
        at: where it rises, within some milliseconds.
        rate_hz: of the samples.
    """
    low = max(at - round(_AROUND_S[0] * rate_hz), 0)
    high = min(at + round(_AROUND_S[1] * rate_hz), len(samples))
    begin = max(low - round(_BACKGROUND_S * rate_hz), 0)
    change = _change(_whitened(samples[begin:high], low - begin, _FIRM))
    if change is None:
        return float(at), 0.001 * rate_hz
    moment, sd, *_ = change
    mild = _whitened(samples[begin:high], low - begin, _MILD)
    wide = max(round(_LOUDEST_S * rate_hz), 1)
    loudest = int(np.convolve(mild**2, np.ones(wide), "same").argmax())
    last = loudest + round(_PAST_LOUDEST_S * rate_hz)
    for _ in range(_MAX_STEPS):
        change = _change(mild[int(moment) : last])
        if change is None or change[2] < _MIN_STEP_DB or change[3] < _MIN_GAIN:
            break
        moment, sd = int(moment) + change[0], change[1]
    return low + moment, sd


def _change(piece: Array) -> tuple[float, float, float, float] | None:
    """Locate where a piece of white noise changes its variance.

    Returns:
        That and its standard deviation [samples], the change [dB], and what it gains in log
        likelihood; None where the piece is too short.
    """
    count = len(piece)
    if count < 2 * _EDGE + 4:
        return None
    squares = np.cumsum(piece**2) + 1e-30
    left = np.arange(_EDGE, count - _EDGE)
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
    from scipy.signal import lfilter

    background = samples[:from_sample]
    if len(background) < 4 * _ORDER or not background.any():
        return np.diff(samples[from_sample:], prepend=0.0)
    spectrum = np.abs(np.fft.rfft(background, 2 * len(background))) ** 2
    correlation = np.fft.irfft(spectrum)[: _ORDER + 1] / len(background)
    correlation[0] *= 1 + white
    predicts = solve_toeplitz(correlation[:-1], correlation[1:])
    return np.asarray(lfilter(np.append(1.0, -predicts), [1.0], samples))[from_sample:]
