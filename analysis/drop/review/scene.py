"""The 3D scene: the observed ball and those of all iterations, falling side by side."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.review.story import ReviewData
from analysis.review.sending import at_seconds, screen_radius

_BALL = 0.045
_PITCH = 4.5
"""A ball's radius in drop heights, and the distance between two balls in radii."""

_GROUND = (16, 18, 24)
_TABLE = (70, 70, 78)


def log_scene(stream: rr.RecordingStream, story: ReviewData) -> None:
    """Send the entities of `scene_view`. The balls are drawn larger than life, to be seen."""
    balls = [story.observed, *story.simulated]
    radius = _BALL * story.drop_height_m
    places = (np.arange(len(balls)) - (len(balls) - 1) / 2) * _PITCH * radius
    places[0] -= _PITCH / 3 * radius
    half, thick = 2.5 * radius - places[0], 0.2 * radius
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    table = rr.Boxes3D(
        centers=[[0, 0, -thick]],
        half_sizes=[[half, 3 * radius, thick]],
        colors=[_TABLE],
        fill_mode="solid",
    )
    stream.log("scene/table", table, static=True)
    names = ["observed"] + [one.name for one in story.simulated]
    labels = rr.Points3D(
        [[x, -3.2 * radius, -1.2 * radius] for x in places],
        labels=names,
        colors=[curve.color for curve in balls],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log("scene/labels", labels, static=True)
    for name, x, curve in zip(names, places, balls, strict=True):
        entity = f"scene/{name.replace('=', '')}"
        ball = rr.Ellipsoids3D.from_fields(
            half_sizes=[[radius] * 3], colors=[curve.color], fill_mode="solid"
        )
        stream.log(entity, ball, static=True)
        # All at the observed times, or the balls would take their steps one after the other.
        heights = np.interp(story.observed.seconds, curve.seconds, curve.heights_m)
        centers = np.column_stack([np.full_like(heights, x), 0 * heights, heights + radius])
        columns = rr.Ellipsoids3D.columns(centers=centers)
        stream.send_columns(entity, indexes=[at_seconds(story.observed.seconds)], columns=columns)


def scene_view(story: ReviewData) -> rrb.View:
    """The camera stands where the whole drop fills the view."""
    top = story.drop_height_m
    return rrb.Spatial3DView(
        origin="/scene",
        name="observed ball beside each iteration's",
        background=_GROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(0.0, -1.42 * top, 0.62 * top),
            look_target=(0.0, 0.0, 0.48 * top),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
