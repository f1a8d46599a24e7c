"""Draw motions of a stranger's arm: each joint along a sum of sines, from rest to rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tunenet_logs.arrays import Array

_TERMS = 3  # sines of a joint
_MIN_S, _MAX_S = 6.0, 10.0  # of a motion
_LOWEST_RAD, _MAX_SPAN_RAD = -2.8, 5.6  # of a joint, within its own limits
_MAX_RAD_S = 1.5  # of a joint, within its own limit
_LOOKS = 1000  # times at which its speed is looked at
_EASING_S = 1.0  # how long starting and stopping take


@dataclass(frozen=True, eq=False)
class StrangerMotion:
    """Joint positions over time.

    Attributes:
        middle: of each joint [rad], shape (J,).
        amplitudes: of each sine [rad], shape (K, J).
        rates: of each sine [rad/s], shape (K, J).
        phases: of each sine at 0 s [rad], shape (K, J).
        length_s: from rest to rest.
    """

    middle: Array
    amplitudes: Array
    rates: Array
    phases: Array
    length_s: float

    @classmethod
    def drawn(cls, model: Any, rng: np.random.Generator) -> StrangerMotion:
        """Draw a motion of 6 to 10 s within the model's limits of position and speed."""
        shape = (_TERMS, model.nq)
        low = np.maximum(model.lowerPositionLimit, _LOWEST_RAD)
        high = np.minimum(model.upperPositionLimit, low + _MAX_SPAN_RAD)
        length_s = float(rng.uniform(_MIN_S, _MAX_S))
        rank = np.arange(1, _TERMS + 1)[:, None]
        rates = 2 * np.pi * rank / length_s
        rates = rates * rng.uniform(0.8, 1.2, shape)
        amplitudes = rng.normal(0.0, 0.5, shape) / rank
        fastest = np.minimum(model.velocityLimit, _MAX_RAD_S)
        reach = np.minimum(np.sum(np.abs(amplitudes), axis=0), (high - low) / 2.2)
        amplitudes *= reach / np.maximum(np.sum(np.abs(amplitudes), axis=0), 1e-9)
        middle = rng.uniform(low + reach, high - reach)
        motion = cls(middle, amplitudes, rates, rng.uniform(0, 6.28, shape), length_s)
        seconds = np.linspace(0.0, length_s, _LOOKS)
        steepest = np.abs(np.gradient(motion.at(seconds), seconds, axis=0)).max(axis=0)
        slower = np.minimum(1.0, fastest / np.maximum(steepest, 1e-9))
        return replace(motion, amplitudes=amplitudes * slower)

    def at(self, seconds: Array) -> Array:
        """Return positions [rad] at times of shape (T,), shape (T, J); eased in and out."""
        ends = (np.minimum(seconds, self.length_s - seconds) / _EASING_S).clip(0.0, 1.0)
        ease = ends**3 * (10 - 15 * ends + 6 * ends**2)
        waves = self.rates * seconds[:, None, None] + self.phases
        return self.middle + ease[:, None] * np.sum(self.amplitudes * np.sin(waves), axis=1)
