"""Who competes in the second experiment: the paper's methods, a user's, ours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from analysis.estimators.base import Estimator


@dataclass(frozen=True)
class Method:
    """A row of the table.

    Attributes:
        name: as JSON, CSV and `--methods` have it.
        label: as the table has it.
        group: whose it is.
        estimator: the method, ready to be asked.
        budget: rollouts after which it gives nothing new, or the most of the experiment.
        free_release: it is given the height of release as a second parameter to find.
    """

    name: str
    label: str
    group: Literal["paper", "user", "ours"]
    estimator: Estimator
    budget: int
    free_release: bool = False
