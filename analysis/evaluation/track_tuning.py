"""Tune from a track that was made, not found in pictures."""

from __future__ import annotations

from analysis.drop.detection import FilmDetection
from analysis.drop.from_film import DropFromFilm
from analysis.record import Tuning
from analysis.selection import Options
from analysis.tracking.track import Track
from analysis.tuning import Stopwatch, tune_detected


def tune_track(track: Track, options: Options) -> Tuning:
    """Tune from the track of a filmed ball, as `tune_log` does once it has found one."""
    experiment = DropFromFilm()
    selection = options.selection
    detection = FilmDetection(
        physical=experiment.presets[options.preset].physical,
        topic="",
        start_ns=int(track.stamps_ns[0]),
        track=track,
        ball=selection.ball,
    )
    return tune_detected(experiment, lambda: detection, options, Stopwatch())
