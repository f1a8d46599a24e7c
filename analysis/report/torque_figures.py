"""Figures of an arm's torques, read from its review."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.report.drop_figures import thinned
from analysis.report.style import (
    OBSERVED,
    SIMULATED,
    THIRD,
    WIDE_IN,
    Drawing,
    new_figure,
    styled,
)
from analysis.review.read_back import ReviewedTorque

_MAX_SAMPLES = 250  # drawn of one joint
_COLUMNS = 2


@styled
def torques_drawing(torques: Sequence[ReviewedTorque]) -> Drawing | None:
    """Plot measured and simulated torques, a chart per joint; None without any."""
    if not torques:
        return None
    rows = -(-len(torques) // _COLUMNS)
    columns = min(_COLUMNS, len(torques))
    figure = new_figure(WIDE_IN, 1.15 * rows + 0.5)
    grid: Any = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for axes in grid.flat[len(torques) :]:
        axes.set_axis_off()
    for axes, torque in zip(grid.flat, torques, strict=False):
        part = thinned(len(torque.seconds), _MAX_SAMPLES)
        seconds = torque.seconds[part]
        axes.plot(seconds, torque.observed_nm[part], ".", color=OBSERVED, markersize=1.8)
        axes.plot(seconds, torque.simulated_nm[part], color=SIMULATED, linewidth=0.9)
        if torque.fitted_nm is not None:
            axes.plot(seconds, torque.fitted_nm[part], color=THIRD, linewidth=0.9)
        axes.set_title(f"joint {torque.joint} [N·m]", pad=2)
    for axes in grid.flat[max(0, len(torques) - columns) : len(torques)]:
        axes.xaxis.set_tick_params(labelbottom=True)
    figure.supxlabel("time [s]", fontsize=8)
    lines = grid.flat[0].get_lines()
    names = ["measured", "rigid arm with the payload", "with friction, offsets and the rest"]
    figure.legend(lines, names[: len(lines)], loc="outside upper right", ncols=3)
    fitted = [torque for torque in torques if torque.fitted_nm is not None]
    caption = (
        f"Torques of {len(torques)} joints that the payload is felt in or that were measured: "
        "dots as measured, one line for the rigid arm with the tuned payload"
    )
    caption += ", one for all that was fitted." if fitted else "."
    spans = ", ".join(
        f"joint {torque.joint} {np.nanmin(torque.observed_nm):.1f} to "
        f"{np.nanmax(torque.observed_nm):.1f}"
        for torque in torques
    )
    alt = f"A chart for each joint of torque over time. Measured [N·m]: {spans}."
    return Drawing("torques", "Measured and simulated torques", caption, alt, figure)
