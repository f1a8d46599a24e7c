"""Draw a log's ball for viewers that open the log itself: `rerun drop.mcap`, Foxglove.

They draw no PoseStamped by itself. So its height goes beside it as a plain number, its surface once
as points in a frame of its own, and transforms that move that frame. Channels say in their metadata
what they draw, so that nothing is read twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tunenet_logs import messages
from tunenet_logs.episode import Array
from tunenet_logs.writing.writer import EpisodeWriter

TF_TOPIC, _WORLD = "/tf", "world"
_TABLE_TOPIC, _TABLE_M = "/table", 0.8  # a square around the ball
_BALL_RGB, _TABLE_RGB = (255, 150, 40), (110, 115, 125)
_UNKNOWN_RADIUS_M = 0.03
_POINTS = 300  # of a ball's surface


@dataclass
class DrawnBall:
    """Poses of a ball on a topic, each written with what draws it."""

    topic: str
    radius_m: float  # 0 where unknown
    stands_on_table: bool  # whether z is the height over a table
    _is_begun: bool = field(default=False, init=False)

    def write(self, writer: EpisodeWriter, stamp_ns: int, position_m: Array) -> None:
        """Write the pose at `position_m`, shape (3,)."""
        writer.write_pose(self.topic, stamp_ns, position_m)
        for topic, type_name, message in self._drawing(stamp_ns, position_m):
            data = messages.encode(message, type_name)
            writer.write_message(topic, type_name, stamp_ns, data, shows=self.topic)

    def _drawing(self, stamp_ns: int, position_m: Array) -> Iterator[tuple[str, str, Any]]:
        frame = self.topic.strip("/")
        if not self._is_begun:
            self._is_begun = True
            ball_m = _sphere() * (self.radius_m or _UNKNOWN_RADIUS_M)
            cloud = messages.point_cloud(stamp_ns, frame, ball_m, _BALL_RGB)
            yield f"{self.topic}/surface", messages.POINT_CLOUD, cloud
            if self.stands_on_table:
                cloud = messages.point_cloud(stamp_ns, _WORLD, _table_m(), _TABLE_RGB)
                yield _TABLE_TOPIC, messages.POINT_CLOUD, cloud
        placed = messages.transform(stamp_ns, _WORLD, frame, position_m)
        yield TF_TOPIC, messages.TRANSFORMS, messages.transforms([placed])
        name, values = "position_m", position_m
        if self.stands_on_table:
            name, values = "height_m", position_m[2:]
        yield f"{self.topic}/{name}", messages.NUMBERS, messages.numbers(values)


def _sphere() -> Array:
    """Return points all over the unit sphere, on a golden spiral, shape (N, 3)."""
    number = np.arange(_POINTS)
    z = 1 - (2 * number + 1) / _POINTS
    ring, angle = np.sqrt(1 - z**2), number * np.pi * (3 - np.sqrt(5))
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _table_m() -> Array:
    """Return points of a square at z = 0, shape (N, 3)."""
    side = np.linspace(-_TABLE_M / 2, _TABLE_M / 2, 17)
    x, y = np.meshgrid(side, side)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
