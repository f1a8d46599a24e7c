"""Report options that have no effect on a log."""

from __future__ import annotations

from typing import Any

from analysis.estimators.base import Estimator
from analysis.experiment import Experiment
from analysis.registry import experiments_of
from analysis.selection import Options
from tunenet_logs.episode import Episode
from tunenet_logs.unused_reading import said_unused


def unused_options(
    options: Options,
    experiment: Experiment,
    method: type[Estimator],
    episode: Episode | None,
    detection: Any,
) -> list[str]:
    """List options without effect, one line each with the reason.

    Args:
        options: Of the user.
        experiment: That was looked for.
        method: That estimates.
        episode: The log as read; None for a detection that was made without one.
        detection: Of it; None if nothing was found.
    """
    selection = options.selection
    found: list[str] = []
    of_its_kind = {about for way in experiments_of(experiment.kind) for about in way.takes}
    said = episode.warnings if episode else ()
    for about, given in selection.given.items():
        names = [name for name in given if not said_unused(name, said)]
        if about in experiment.takes or not names:
            continue
        why = f"it is tuned by {experiment.observed}"
        if about not in of_its_kind:
            why = f"this is a {experiment.kind}"
        elif about == "pictures" and episode and episode.picture_topics:
            why += f" (to use its pictures: --topic {episode.picture_topics[0]})"
        found.append(f"{', '.join(names)} not used: {why}")
    ball = selection.ball
    only_size = ball.diameter_m is not None and ball.mass_kg is None
    if detection and only_size and "ball" in experiment.takes and not detection.uses_ball:
        found.append(
            "--ball-diameter not used: without --ball-mass it does not say what the air does"
        )
    if options.weights and not method.uses_network:
        found.append(f"--weights not used: the method {method.name} has no network")
    if options.initial is not None and not method.takes_steps:
        found.append(f"--initial not used: the method {method.name} needs no start")
    if options.iterations != Options.iterations and not method.takes_steps:
        found.append(f"--iterations not used: the method {method.name} spends none")
    return found
