"""Rows of the paper's table 3, motion prediction, with the published figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tunenet_logs.arrays import Array

# Of 400 (1.7 s): the first impact is always among them, at step 51 to 58, and often a second.
SEEN_STEPS = 100

# What a predictor is given of a run: its release; every true state, to predict the next from; or
# the true states of the first 100 steps, to predict the rest from (those 100 count as predicted one
# step ahead, so that every figure is over all 400).
Protocol = Literal["rollout", "one step ahead", "100 steps seen"]


@dataclass(frozen=True)
class MotionError:
    """Error of predicted heights.

    Attributes:
        percent: 100 mean(|z_hat - z_T| / z_T), over runs and steps.
        cm: mean |z_hat - z_T|, over runs and steps.
    """

    percent: float
    cm: float


@dataclass(frozen=True)
class MotionRow:
    """Method under a protocol.

    Attributes:
        name: as JSON and CSV have it.
        label: as the table has it.
        protocol: what it is given of each run.
        paper: the published figure of the method. Those of Neural and VRNN hybrid are said to be
            of one-step predictions; but nothing that errs by 5.8 cm can be one step of 1/60 s
            ahead, so they stand in every row of theirs.
        ours: measured, one for each seed; None for a row that is not measured.
        note: what a reader must know.
    """

    name: str
    label: str
    protocol: Protocol
    paper: MotionError | None = None
    ours: tuple[MotionError, ...] | None = None
    note: str = ""


_NEURAL = MotionError(9.16, 5.8)
_HYBRID = MotionError(2.42, 1.6)

ROWS = (
    MotionRow("zero", "Zero", "rollout", MotionError(100.0, 97.0), note="predicts z = 0 m"),
    MotionRow(
        "untuned",
        "Un-tuned physics",
        "rollout",
        MotionError(20.57, 13.8),
        note=(
            "rollout of the first guess, U(.3, .7); one restitution of about .665 for every ball "
            "would give the published figures"
        ),
    ),
    MotionRow(
        "neural-ahead",
        "Neural",
        "one step ahead",
        _NEURAL,
        note="the published error is larger than that of saying that nothing moves",
    ),
    MotionRow("neural-seen", "Neural", "100 steps seen", _NEURAL),
    MotionRow("neural-rollout", "Neural", "rollout", _NEURAL),
    MotionRow("hybrid-ahead", "VRNN hybrid", "one step ahead", _HYBRID),
    MotionRow(
        "hybrid-seen",
        "VRNN hybrid",
        "100 steps seen",
        _HYBRID,
        note="its memory holds the impacts that it saw",
    ),
    MotionRow(
        "hybrid-rollout",
        "VRNN hybrid",
        "rollout",
        _HYBRID,
        note="no warm-up: it has seen no impact, so it cannot know the ball",
    ),
    MotionRow("still-ahead", "nothing moves", "one step ahead", note="what one step is worth"),
    MotionRow(
        "middle-ahead",
        "physics at 0.5",
        "one step ahead",
        note="the simulator within the hybrid, alone",
    ),
    MotionRow(
        "middle-seen",
        "physics at 0.5",
        "100 steps seen",
        note="the simulator within the hybrid, alone",
    ),
    MotionRow(
        "middle-rollout",
        "physics at 0.5",
        "rollout",
        note="the simulator within the hybrid, alone",
    ),
    MotionRow(
        "tunenet-obs",
        "TuneNet (Obs)",
        "rollout",
        MotionError(6.03, 5.7),
        note="sees the ball's row in the picture, of an unknown camera; the paper's text, K = 5",
    ),
    MotionRow("ours-obs", "ours (Obs)", "rollout", note="sees the same rows; K = 5"),
    MotionRow(
        "tunenet-gt",
        "TuneNet (GT)",
        "rollout",
        MotionError(1.08, 0.7),
        note="the paper's network and training, K = 5",
    ),
    MotionRow("ours", "ours", "rollout", note="K = 5"),
)


def motion_error(predicted_m: Array, true_m: Array) -> MotionError:
    """Compute the paper's two figures, of heights [m] of one shape.

    Heights are of the ball's centre over the plane: 0.5 m for a ball that lies on it.
    """
    off_m = np.abs(predicted_m - true_m)
    return MotionError(100 * float(np.mean(off_m / true_m)), 100 * float(np.mean(off_m)))


def with_figures(seeds: Sequence[Mapping[str, MotionError]]) -> tuple[MotionRow, ...]:
    """Fill `ROWS` with what was measured for each seed, by the rows' names."""
    return tuple(
        MotionRow(
            row.name,
            row.label,
            row.protocol,
            row.paper,
            tuple(one[row.name] for one in seeds if row.name in one) or None,
            row.note,
        )
        for row in ROWS
    )
