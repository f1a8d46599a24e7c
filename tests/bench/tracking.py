"""Measure speed and memory of tuning from a film, and how well the ball is followed.

`python -m tests.bench.tracking` prints how much longer a clip of 640 x 480 at 60 fps lasts than it
takes to tune from it on one core, imports left out, as an mp4 and as a log of JPEGs; the peak
memory for a clip and for one that is ten times as long; and the distances of tracked from true
centres over drawn clips of a seed that nothing is reported on.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.evaluation.studies.video import track_errors_px
from tunenet_logs.analysis.evaluation.worlds.clips import ClipOrder, draw_clip, write_clip
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import track_ball
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.errors import NotFoundError
from tunenet_logs.reader import read_episode

SEED = 1000
CLIP = 34  # 640 x 480 at 60 fps
CLIP_S = 5.0
LONGER = 10
COUNT = 12


def the_clip(*, as_log: bool, longer: int = 1) -> ClipOrder:
    """Return the clip whose speed is measured; a longer one is held longer."""
    order = draw_clip(SEED, CLIP)
    assert (order.view.size_px, order.rate_hz) == ((640, 480), 60.0)
    held_s = longer * CLIP_S - order.length_s
    return replace(order, held_s=held_s, as_log=as_log)


def speed() -> None:
    """Measure how much faster than real time it is, on one core."""
    import cv2

    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [write_clip(the_clip(as_log=one), folder) for one in (False, True)]
        tune_log(paths[0], TuneOptions())  # everything is imported now
        for path in paths:
            wall, cpu = time.perf_counter(), time.process_time()
            tuning = tune_log(path, TuneOptions())
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            print(
                f"{path.suffix[1:]:5} {CLIP_S:g} s of 640 x 480 at 60 fps: {wall:.1f} s, of them "
                f"{cpu:.1f} s at work; {CLIP_S / wall:.2f} times real time ({tuning.verdict})",
                flush=True,
            )


def peak_mib(path: str) -> None:
    """Tune, and print this process's peak memory."""
    tune_log(Path(path), TuneOptions())
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def memory() -> None:
    """Measure the peak of a process for a clip, and for a longer one."""
    peaks = []
    for longer in (1, LONGER):
        with tempfile.TemporaryDirectory() as name:
            path = write_clip(the_clip(as_log=False, longer=longer), Path(name))
            code = f"from tests.bench.tracking import peak_mib; peak_mib({str(path)!r})"
            run = subprocess.run(
                [sys.executable, "-c", code], check=True, capture_output=True, text=True
            )
            peaks.append(float(run.stdout))
    print(f"peak {peaks[0]:.0f} MiB; {LONGER} times the clip: {peaks[1] / peaks[0]:.2f} times that")


def centres() -> None:
    """Measure the distances of tracked from true centres."""
    rms, found = [], 0
    for index in range(COUNT):
        order = draw_clip(SEED, index)
        with tempfile.TemporaryDirectory() as name:
            episode = read_episode(write_clip(order, Path(name)))
            try:
                track = track_ball(Pictures(episode, episode.picture_topics[0]))
            except NotFoundError:
                continue
        off = track_errors_px(order, track)
        off = off[np.isfinite(off[:, 0])]
        found += 1
        rms.append((np.sqrt((off**2).sum(axis=1).mean()), np.median(off.std(axis=0))))
    whole, moving = np.median(rms, axis=0)
    print(f"{found} of {COUNT} balls followed; centres off by {whole:.2f} px rms (median clip)")
    print(f"  {moving:.2f} px where what is constant in a clip is left out")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.parse_args()
    memory()
    centres()
    speed()


if __name__ == "__main__":
    main()
