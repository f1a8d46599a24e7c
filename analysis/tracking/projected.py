"""A simulated drop's track without rendering: for training, where rendering would take hours.

It differs from the track of the rendered pictures by about a tenth of a pixel.
"""

from __future__ import annotations

import numpy as np

from analysis.tracking.track import Track
from recorders.simulators.drop import TOPIC
from recorders.simulators.pinhole import PinholeCamera
from tunenet_logs.episode import Episode

_GREY = (128, 128, 128)


def projected_track(
    episode: Episode,
    camera: PinholeCamera,
    noise_px: float,
    lost_share: float,
    rng: np.random.Generator,
) -> Track:
    """Where the camera would see the ball of a simulated episode.

    Args:
        episode: with the ball's positions.
        camera: where from.
        noise_px: standard deviation of a coordinate.
        lost_share: share of the pictures in which the ball is not found.
        rng: draws both.
    """
    signal = episode.signals[TOPIC]
    places = camera.image_from_world(signal.values)
    low, high = signal.values[:, 2].argmin(), signal.values[:, 2].argmax()
    down = places[low] - places[high]
    radius_m = episode.info.rig["ball_diameter_m"] / 2
    radius_px = camera.radius_px(signal.values, radius_m)
    places = places + rng.normal(0.0, 1.0, places.shape) * noise_px
    inside = np.all((places > 0) & (places < np.array(camera.size_px) - 1), axis=1)
    seen = inside & (rng.random(len(places)) >= lost_share)
    places[~seen] = np.nan
    return Track(
        stamps_ns=signal.stamps_ns,
        places_px=places,
        radius_px=np.where(seen, radius_px, np.nan),
        confidence=seen.astype(np.float64),
        size_px=camera.size_px,
        gravity_px=down,
        colour=_GREY,
    )
