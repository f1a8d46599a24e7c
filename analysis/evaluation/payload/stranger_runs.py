"""Draw several runs of one stranger's arm, as people have them who keep a card of theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from analysis.evaluation.payload.stranger_arm import (
    DRAW,
    StrangerArm,
    StrangerRun,
    Troubles,
)
from analysis.evaluation.payload.stranger_motion import StrangerMotion
from tunenet_logs.arrays import Array


def stranger_runs(
    urdf: Path,
    tool: str,
    seed: int,
    troubles: Troubles,
    payloads: Sequence[tuple[float, Array] | None],
) -> list[StrangerRun]:
    """Draw an arm, and runs of it along other motions, its sensors' zeros drifting in between."""
    rng = np.random.default_rng([seed, DRAW, 1])
    arm = StrangerArm.drawn(urdf, tool, rng, troubles)
    rate_hz = float(rng.choice([50.0, 80.0, 100.0, 125.0]))
    runs: list[StrangerRun] = []
    for payload in payloads:
        motion = StrangerMotion.drawn(arm.model, rng)
        draws = {**arm.draws, "drift": rng.standard_normal(len(arm.limit_nm))}
        drifted = replace(arm, draws=draws)
        runs.append(drifted.run(motion, rate_hz, payload, rng, before=False))
    return runs
