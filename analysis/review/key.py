"""Legend strip above curves, where it hides none of them."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from analysis.review.drawing import MUTED, Color, screen_radius

_LINE = 0.3  # length of an entry's line, of what the entry takes up
KEY_SHARES = (0.6, 8.0)  # heights of a key and of what is below it


def log_key(
    stream: rr.RecordingStream, entries: Sequence[tuple[str, Sequence[Color]]], entity: str = "key"
) -> rrb.View:
    """Log a legend of each entry's text and line colours, and return its view."""
    strips, colors = [], []
    for entry, (_, line_colors) in enumerate(entries):
        width = _LINE / len(line_colors)
        for number, color in enumerate(line_colors):
            begin = entry - _LINE / 2 + number * width
            strips.append([[begin, 0.0], [begin + width, 0.0]])
            colors.append(color)
    lines = rr.LineStrips2D(strips, colors=colors, radii=screen_radius(2.0))
    stream.log(f"{entity}/lines", lines, static=True)
    words = rr.Points2D(
        [[float(entry), 0.02] for entry in range(len(entries))],
        labels=[text for text, _ in entries],
        colors=[MUTED],
        radii=screen_radius(0.1),
        show_labels=True,
    )
    stream.log(f"{entity}/words", words, static=True)
    return rrb.Spatial2DView(
        origin=f"/{entity}",
        name="key",
        titlebar=False,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, len(entries) - 0.5), y_range=(-0.06, 0.18)),
    )
