"""Published figures of the second experiment: table 2 of Allevato et al. 2019.

Table 3 stands in `motion.rows`.
"""

from __future__ import annotations

from collections.abc import Mapping

ROLLOUTS = (1, 5, 10, 100)  # the columns of table 2, K
_TABLE_2: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "Easy": {
        "mean": (0.0968, 0.0968, 0.0968, 0.0968),
        "entropy-search": (0.1433, 0.0622, 0.0553, 0.0533),
        "cma-es": (0.0540, 0.0540, 0.0540, 0.0097),
        "direct": (0.0120, 0.0120, 0.0120, 0.0120),
        "tunenet": (0.0145, 0.0050, 0.0053, 0.0053),
    },
    "Hard": {
        "mean": (0.2353, 0.2353, 0.2353, 0.2353),
        "entropy-search": (0.2876, 0.1021, 0.1153, 0.0939),
        "cma-es": (0.2766, 0.2766, 0.2766, 0.0605),
        "direct": (0.0493, 0.0493, 0.0493, 0.0493),
        "tunenet": (0.1103, 0.0212, 0.0145, 0.0175),
    },
}

# Our names of its methods; its text and its authors' code are two of ours.
_OURS_OF = {
    "mean": "mean",
    "entropy-search": "entropy-search",
    "cma-es": "cma-es",
    "direct": "direct",
    "tunenet-paper": "tunenet",
    "tunenet-paper-code": "tunenet",
}

# Its text describes one Hard and its code draws another; its figures stand beside both.
_SETS = {"Easy": "Easy", "Hard": "Hard", "Hard (target only)": "Hard"}


def published_error(which: str, method: str, rollouts: int) -> float | None:
    """Return the mean absolute error of restitution in table 2; None where there is none."""
    row = _TABLE_2.get(_SETS.get(which, ""), {}).get(_OURS_OF.get(method, ""))
    if row is None or rollouts not in ROLLOUTS:
        return None
    return row[ROLLOUTS.index(rollouts)]
