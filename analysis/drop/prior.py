"""Priors and measurements of a fit's unknowns, one linear combination of them at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prior:
    """Prior on one linear combination of the unknowns.

    Attributes:
        slopes: of the combination over the unknowns in it, by index.
        off: from the likeliest.
        sd: standard deviation.
        freedom: of Student's t; infinite for a normal distribution.
        measured: whether it is a measurement, not a prior of balls and cameras.
    """

    slopes: dict[int, float]
    off: float
    sd: float
    freedom: float = np.inf
    measured: bool = False

    @property
    def cost(self) -> float:
        """Negative log density, without constants."""
        square = (self.off / self.sd) ** 2
        if np.isinf(self.freedom):
            return 0.5 * square
        return 0.5 * (self.freedom + 1) * float(np.log1p(square / self.freedom))

    @property
    def weight(self) -> float:
        """Weight of its squared residual, where t is fitted by reweighting."""
        if np.isinf(self.freedom):
            return self.sd**-2
        square = (self.off / self.sd) ** 2
        return (self.freedom + 1) / (self.freedom + square) / self.sd**2
