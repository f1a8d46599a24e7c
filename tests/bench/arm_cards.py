"""Measure what an arm's card is worth beside tares of the log itself.

    python -m tests.bench.arm_cards                 36 arms, ten minutes
    python -m tests.bench.arm_cards --arms 4 --troubles LIGHT

Each arm is a stranger (`worlds.arm`): a log whose payload is sought, three runs of the empty
gripper and one with another payload, all along other motions, the sensors' zeros drifting between
any two runs. Every card is from runs that the log knows nothing of.
"""

from __future__ import annotations

import argparse

import numpy as np

from tunenet_logs.analysis.evaluation.worlds import arm as stranger_arm
from tunenet_logs.analysis.evaluation.worlds.arm import stranger_runs
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.analysis.payload.noise import NormalEquations
from tunenet_logs.analysis.payload.torque_fit import fit_payload
from tunenet_logs.analysis.payload.torque_model import ArmMotion, arm_motion
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.arm.description import JACO_TOOL_LINK, JACO_URDF, jaco
from tunenet_logs.terminal import Progress

WAYS = (
    "alone",
    "one tare",
    "three tares",
    "card of an empty run",
    "card of another payload's run",
    "card of that and one tare",
    "card of that and three tares",
    "the same, learnt in two steps",
)

FIRST_SEED = 6000


def main() -> None:
    """Print a row for each way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=36)
    parser.add_argument("--troubles", choices=["CLEAN", "LIGHT", "FULL"], default="FULL")
    parser.add_argument("--jobs", type=int)
    arguments = parser.parse_args()
    pieces = [
        Piece((FIRST_SEED + at, getattr(stranger_arm, arguments.troubles)))
        for at in range(arguments.arms)
    ]
    rows = parallel_map(one_arm, pieces, arguments.jobs, Progress(), ("tuning", "arm"))
    masses_kg, lows, highs, truths = np.stack(rows).transpose(2, 1, 0)
    errors_g = 1000 * np.abs(masses_kg - truths)
    print("| | mean error [g] | median | worst | than with one tare | 95 % contain | width [g] |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for at, way in enumerate(WAYS):
        own = errors_g[at]
        more = own - errors_g[WAYS.index("one tare")]
        inside = np.mean((lows[at] <= truths[at]) & (truths[at] <= highs[at]))
        width_g = 1000 * np.median(highs[at] - lows[at])
        print(
            f"| {way} | {_mean(own)} | {np.median(own):.0f} | {own.max():.0f} | {_mean(more)} | "
            f"{100 * inside:.0f} % | {width_g:.0f} |"
        )


def _mean(values: Array) -> str:
    return f"{values.mean():.0f} ± {values.std() / np.sqrt(len(values)):.0f}"


def one_arm(work: tuple[int, stranger_arm.Troubles]) -> Array:
    """Return mass, lower and upper end, truth [kg] in each way, shape (W, 4)."""
    seed, troubles = work
    rng = np.random.default_rng([seed, 77])
    mass_kg, other_kg = rng.uniform(0.0, 2.5), rng.uniform(0.2, 2.5)
    away = rng.standard_normal(3)
    centre_m = 0.015 * away / np.linalg.norm(away)
    payloads = [(mass_kg, centre_m), (other_kg, -centre_m), None, None, None]
    runs = stranger_runs(JACO_URDF, JACO_TOOL_LINK, seed, troubles, payloads)
    arm = jaco()
    log, other, *empty = (arm_motion(read_arm_log(run.episode, arm)) for run in runs)

    def learnt(
        motion: ArmMotion, tares: list[ArmMotion], known: NormalEquations | None = None
    ) -> NormalEquations:
        return fit_payload(arm, motion, tares, known=known).learnt

    one = learnt(other, empty[:1])
    fits = (
        fit_payload(arm, log),
        fit_payload(arm, log, empty[:1]),
        fit_payload(arm, log, empty),
        fit_payload(arm, log, known=learnt(empty[0], [])),
        fit_payload(arm, log, known=learnt(other, [])),
        fit_payload(arm, log, known=one),
        fit_payload(arm, log, known=learnt(other, empty)),
        fit_payload(arm, log, known=learnt(empty[1], empty[2:], one)),
    )
    return np.array([[fit.held.mass_kg, *fit.held.interval95, mass_kg] for fit in fits])


if __name__ == "__main__":
    main()
