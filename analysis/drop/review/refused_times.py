"""Review of impact times that are no bouncing ball's: how long each is after the one before."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.record import Tuning
from analysis.review.drawing import OBSERVED, entity_of, send_scalars, ticked
from tunenet_logs.terminal import short_name

_MAX = 3  # signals with a view of their own
_MAX_LETTERS = 40  # of a signal's name in a title
_MS = 1000.0


def log_refused_times(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send the gaps between the times of each signal; None where none has two."""
    signals = tuning.episode.signals.values() if tuning.episode else ()
    views: list[rrb.View] = []
    for signal in [one for one in signals if len(one.stamps_ns) > 1][:_MAX]:
        seconds = np.sort(signal.seconds)
        gaps_ms = _MS * np.diff(seconds)
        entity = entity_of("gaps", str(len(views)))
        marks = rr.SeriesPoints(
            colors=[OBSERVED], names=["since the one before"], marker_sizes=[5.0]
        )
        stream.log(entity, marks, static=True)
        send_scalars(stream, entity, seconds[1:], gaps_ms)
        name = short_name(signal.name, _MAX_LETTERS)
        views.append(
            rrb.TimeSeriesView(
                origin=f"/{entity}",
                name=f"{name}: time since the one before [ms]; a ball's shrinks by a ratio",
                axis_y=rrb.ScalarAxis(range=ticked(0.0, 1.1 * max(float(gaps_ms.max()), 1.0))),
                plot_legend=rrb.PlotLegend(visible=False),
            )
        )
    return rrb.Vertical(*views) if views else None
