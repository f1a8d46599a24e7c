"""Parameters that a log cannot determine: slope and drag that only their priors say."""

from __future__ import annotations

import numpy as np

from analysis.drop.bounce_posterior import BallPosterior

SLOPE_AND_DRAG = 2  # index of the last of the parameters that this is about, in the task's order
_TRADE = 0.9  # correlation of slope and drag from which on these trade places
# Fraction of a prior's width that a log has to take away, or it tells little of a parameter.
_TOLD = 0.5

_MAX_COUNTED = 6  # flights; more have other reasons than their number


def untold(posterior: BallPosterior) -> tuple[str, ...]:
    """Return one sentence for each parameter that the samples leave to its prior."""
    unknown = [
        name for name, told in zip(("slope", "drag"), posterior.told, strict=True) if told < _TOLD
    ]
    if not unknown:
        return ()
    if abs(posterior.correlation) > _TRADE:
        return (f"drag and slope cannot be told apart in this log: {_seen(posterior)}",)
    return tuple(
        f"this log does not tell the {name}: its interval is what is known of balls, from "
        f"{low:.3f} to {high:.3f}"
        for name, (low, high) in zip(
            ("slope", "drag"), posterior.interval95[1:].tolist(), strict=True
        )
        if name in unknown
    )


def _seen(posterior: BallPosterior) -> str:
    """Describe how many flights the fit has, the one that is cut off too."""
    fit = posterior.fit
    seconds = fit.samples.seconds
    count = len(fit.projection().impacts(float(seconds[-1]))) if len(seconds) else 0
    if not 0 < count <= _MAX_COUNTED:
        return f"their correlation is {np.round(posterior.correlation, 2):+.2f}"
    words = ("one flight", "two flights", "three flights", "four flights", "five flights")
    return words[count - 1] if count <= len(words) else f"{count} flights"
