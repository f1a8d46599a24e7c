"""Measure the cost of tuning a film beside decoding it once, and beside its duration.

`python -m tests.bench.films` draws films of 1920 x 1080 at 30 Hz and of 640 x 480 at 60 Hz, stores
them as phones do (H.264, arithmetic coding), and tunes each from the file to JSON and review, in
one process that has tuned a film before: start-up is left out. Recordings of others are tuned too
where they are there. Printed: CPU time over that of decoding the film once to luma, in one thread;
wall time over the film's duration.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.answers import REAL, SAMPLES
from tunenet_logs.analysis.batch.run import Work, Writing, tuned_and_written
from tunenet_logs.analysis.evaluation.worlds.camera import View
from tunenet_logs.analysis.evaluation.worlds.clips import (
    ClipOrder,
    clip_frames,
    draw_clip,
    draw_stage,
)
from tunenet_logs.analysis.options import TuneOptions

_SEED = 77
# Number of a drawn clip, and of the film made of it: size [px], pictures a second, seconds before
# the release, and in all.
_FILMS = {
    "1080p, 7 s": (10, (1920, 1080), 30, 2.5, 7.2),
    "640 x 480, 10 s": (19, (640, 480), 60, 3.0, 10.0),
    "1080p, 7 s, another": (2, (1920, 1080), 30, 2.5, 7.2),
    "640 x 480, 10 s, another": (23, (640, 480), 60, 3.0, 10.0),
    "1080p, the fall alone": (10, (1920, 1080), 30, 2.5, 2.8),
}

_GIVEN = {
    "slow motion of another": "videos/red_ball_drop_120fps.mp4",
    "a ball in a hand": "negatives/green_ball_in_hand.mp4",
    "a ball tossed": "negatives/green_ball_tossed.mp4",
}


def drawn_film(
    path: Path, number: int, size_px: tuple[int, int], rate_hz: int, held_s: float, whole_s: float
) -> Path:
    """Render a clip in another size and length, and store it as a phone does."""
    import av

    order = _order(number, size_px, rate_hz, held_s, whole_s)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=rate_hz, options={"crf": "20"})
        stream.width, stream.height = size_px
        stream.pix_fmt = "yuv420p"
        for picture in clip_frames(order):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def _order(
    number: int, size_px: tuple[int, int], rate_hz: int, held_s: float, whole_s: float
) -> ClipOrder:
    order = draw_clip(_SEED, number)
    view = View(replace(order.view.camera, size_px=size_px), order.view.roll_rad)
    stage = draw_stage(view, order.ball.drop_m, np.random.default_rng(_SEED))
    length_s = whole_s - held_s
    return replace(order, view=view, stage=stage, rate_hz=rate_hz, held_s=held_s, length_s=length_s)


def luma(path: Path) -> tuple[float, float]:
    """Return the CPU time of decoding every picture to luma, and the film's duration [s]."""
    import av

    begin_s = time.process_time()
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "NONE"
        for picture in container.decode(stream):
            picture.to_ndarray(format="gray")
        duration_s = (container.duration or 0) / av.time_base
    return time.process_time() - begin_s, duration_s


def cost(path: Path, out: Path) -> dict[str, Any]:
    """Measure one film, from the file to JSON and review."""
    bare_s, duration_s = min(luma(path) for _ in range(2))
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    result = tuned_and_written(Work(path, out / path.stem), TuneOptions(), Writing())
    cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
    return {
        "verdict": result.row.record.verdict,
        "cpu_s": round(cpu_s, 2),
        "luma_s": round(bare_s, 2),
        "times_luma": round(cpu_s / bare_s, 2),
        "times_duration": round(wall_s / duration_s, 2),
    }


def figures(drawn: int) -> dict[str, Any]:
    """Measure so many drawn films and all given ones, printed as they come."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tuned_and_written(Work(SAMPLES / "filmed.mcap", folder / "first"), TuneOptions(), Writing())
        paths = {
            film: drawn_film(folder / f"{at}.mp4", *what)
            for at, (film, what) in enumerate(list(_FILMS.items())[:drawn])
        }
        given = {film: REAL / path for film, path in _GIVEN.items()}
        paths |= {film: path for film, path in given.items() if path.exists()}
        for film, path in paths.items():
            one = found[film] = cost(path, folder)
            print(
                f"{film:26} {one['times_luma']:5.1f} times decoding to luma ({one['luma_s']:.2f} "
                f"s), {one['times_duration']:4.2f} times its duration: {one['verdict']}",
                flush=True,
            )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    found = figures(len(_FILMS))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
