"""Options that change nothing of one log: nobody should think that they had an effect."""

from __future__ import annotations

from typing import Any

from analysis.estimators.base import Estimator
from analysis.experiment import Experiment
from analysis.selection import Options
from recorders.simulators.balls import UNKNOWN_BALL

FIT = "fit"
"""The method that needs no start."""


def unused_options(
    options: Options, experiment: Experiment, method: type[Estimator], detection: Any
) -> list[str]:
    """What was given for nothing, one line each with the reason.

    What only a detection can tell (hints for pictures, an arm's options), it says itself.

    Args:
        options: of the user.
        experiment: that was detected.
        method: that estimates.
        detection: of it.
    """
    selection, reading = options.selection, options.selection.reading
    has_positions = experiment.name == "drop"
    found: list[str] = []
    if selection.height_m is not None and experiment.name != "drop-times":
        found.append("--height not used: it is for logs of impact times alone")
    if reading.length_unit and not has_positions:
        found.append("--length-unit not used: no position is taken from the log")
    if reading.torque_constants and experiment.kind != "payload":
        found.append(f"--torque-constants not used: this is a {experiment.kind}")
    if (
        selection.ball != UNKNOWN_BALL
        and experiment.name in ("drop", "drop-times")
        and detection.ball.drag_1_m is None
    ):
        found.append(
            "--ball-diameter not used: without --ball-mass it does not say what the air does"
        )
    if options.initial is not None and method.name == FIT:
        found.append("--initial not used: a fit needs no start")
    return found
