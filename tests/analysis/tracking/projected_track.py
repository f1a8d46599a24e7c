"""A simulated drop's track without rendering.

It differs from the track of the rendered pictures by about a tenth of a pixel.
"""

from __future__ import annotations

import numpy as np

from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import PinholeCamera

_GREY = (128, 128, 128)  # RGB of the ball: a track has a colour, and no light falls on this one


def projected_track(
    episode: Episode,
    camera: PinholeCamera,
    noise_px: float,
    lost_fraction: float,
    rng: np.random.Generator,
) -> Track:
    """Project a simulated ball into a pinhole camera, with noise and gaps as tracking leaves them.

    Args:
        episode: with the ball's positions.
        camera: where from.
        noise_px: standard deviation of each coordinate [px].
        lost_fraction: fraction of the pictures in which the ball is not found.
        rng: draws both.

    Returns:
        A picture for each of the episode's T samples.
    """
    signal = episode.signals[TOPIC]
    positions = camera.image_from_world(signal.values)
    low, high = signal.values[:, 2].argmin(), signal.values[:, 2].argmax()
    down = positions[low] - positions[high]
    radius_m = episode.info.rig["ball_diameter_m"] / 2
    radius_px = camera.radius_px(signal.values, radius_m)
    positions = positions + rng.normal(0.0, 1.0, positions.shape) * noise_px
    inside = np.all((positions > 0) & (positions < np.array(camera.size_px) - 1), axis=1)
    seen = inside & (rng.random(len(positions)) >= lost_fraction)
    positions[~seen] = np.nan
    return Track(
        stamps_ns=signal.stamps_ns,
        places_px=positions,
        radius_px=np.where(seen, radius_px, np.nan),
        confidence=seen.astype(np.float64),
        size_px=camera.size_px,
        gravity_px=down,
        colour=_GREY,
    )
