"""Compute the Cramér-Rao bound of any fit of a filmed ideal ball, for the sets of tracks.

`python -m tests.bench.film_bound` prints, for each set, noise and range of restitutions of
`tunenet-eval video`, the mean absolute error that an efficient estimator would have which knows
that the ball keeps its restitution, and the median width of its 95 % interval.
"""

from __future__ import annotations

import numpy as np

from tunenet_logs.analysis.drop.bounce_model import (
    IDEAL,
    PERSPECTIVE,
    PERSPECTIVE_SD,
    BounceSamples,
)
from tunenet_logs.analysis.evaluation.worlds.camera import (
    NARROW,
    NOISES_PX,
    TRACK_SETS,
    WIDE,
    BallRanges,
    TrackScene,
    draw_scene,
    upright,
)

SEED = -1
COUNT = 400
ROUNDING_PX2 = 1 / 12


def bound(scene: TrackScene) -> float:
    """Return the standard deviation of the restitution by an efficient estimator."""
    places, depths = scene.view.image_from_world(upright(np.array([0.0, scene.ball.drop_m])))
    fall_s = scene.ball.fall_s
    span_px = float(np.linalg.norm(places[1] - places[0]))
    perspective = float(np.log(depths[0] / depths[1]))
    truth = [
        scene.ball.restitution,
        fall_s,
        np.log(fall_s),
        0.0,
        span_px,
        perspective,
        0.0,
        0.0,
        0.0,
    ]
    seconds = scene.seconds[~scene.lost]
    noise_px = float(np.sqrt(scene.noise_px**2 + ROUNDING_PX2))
    slopes = BounceSamples(seconds, np.zeros(len(seconds)), noise_px).jacobian(
        np.array(truth), IDEAL
    )
    information = slopes.T @ slopes / noise_px**2
    information[PERSPECTIVE, PERSPECTIVE] += PERSPECTIVE_SD**-2
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


def main() -> None:
    for which in TRACK_SETS:
        for noise_px in NOISES_PX:
            for low, high in (NARROW, WIDE):
                scenes = [
                    draw_scene(which, BallRanges((low, high)), noise_px, SEED, number)
                    for number in range(COUNT)
                ]
                sds = np.array([bound(scene) for scene in scenes])
                print(
                    f"{which.name}, {noise_px:g} px, {low:g} to {high:g}: mean absolute error "
                    f"{np.sqrt(2 / np.pi) * sds.mean():.4f}, width {3.92 * np.median(sds):.4f}"
                )


if __name__ == "__main__":
    main()
