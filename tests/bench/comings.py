"""Record cameras that come and go, each fault many times, and tune the logs.

`python -m tests.bench.comings` lets a camera of MJPEG (our own) and one of RTSP (GStreamer's
server) start late, be cut off, freeze and be killed at a random moment of a drop that it shows over
and over; of the last three every other one stays away. `--runs N` is how often each, `--jobs N` how
many at a time, `--quick` waits less; `--tuned N` is how many of each are tuned, which takes longer
than all the rest. Each log has to be whole, its gap marked between the two pictures where it is,
and the tuned drop on one side of it. It prints the worst of what it measures, and exits with 1 if
anything fails.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.recorders.coming_camera import ComingCamera, ComingRtspCamera
from tests.recorders.live_wait import ending, wait_until
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import Gap, noted_gaps

FAULTS = ("late", "cut", "frozen", "killed")
KINDS = {"mjpeg": ComingCamera, "rtsp": ComingRtspCamera}
STALL_S = 5.0
BEGUN_BYTES = 100_000


@dataclass(frozen=True)
class Ran:
    """Result of one recording."""

    wrong: str  # what is, in words; "" where nothing
    verdict: str  # of the tuner; "not tuned" where it was not asked
    gap_s: float  # the length of its gap; 0 without one
    stop_s: float  # from Ctrl-C to the end of the process; 0 where it ended by itself


_RECORD = (sys.executable, "-m", "tunenet_logs.recorders.cli")


def shown_film(folder: Path) -> Path:
    """Render a drop of restitution .63, 3 s, 60 Hz."""
    path = folder / "film.mcap"
    words = ["--simulate", "drop", "--render", "--seed", "7", "--seconds", "3", "-o", str(path)]
    subprocess.run([*_RECORD, *words], check=True, capture_output=True)
    return path


@contextmanager
def recording(address: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Open the recorder; what it says is in FOLDER/said."""
    words = ["--camera", address, "--stall", str(STALL_S), "--wait", "60"]
    with (folder / "said").open("w") as said:
        process = subprocess.Popen(
            [*_RECORD, *words, "-o", str(folder / "a.mcap")],
            stdout=subprocess.PIPE, stderr=said, text=True,
        )  # fmt: skip
    with ending(process):
        yield process


def run(camera: ComingCamera, planned: Planned, folder: Path) -> Ran:
    """Record a camera with a fault, and check the log."""
    fault, returns = planned.fault, planned.returns
    log, active = folder / "a.mcap", folder / "a.mcap.active"
    if fault != "late":
        camera.come()
    with recording(camera.address, folder) as recorder:
        if fault == "late":
            time.sleep(planned.wait_s)
            camera.come()

        def has_begun() -> bool:
            return active.exists() and active.stat().st_size > BEGUN_BYTES

        wait_until(has_begun, "pictures")
        time.sleep(random.uniform(0.0, 3.0))
        _let_it_go(camera, fault, returns=returns)
        if returns:
            time.sleep(4.0 if planned.is_tuned else 1.5)
            recorder.send_signal(signal.SIGINT)
        begun = time.monotonic()
        line, _ = recorder.communicate(timeout=60)
        stop_s = time.monotonic() - begun if returns else 0.0
    camera.go()
    wrong, verdict, gap_s = _looked_at(log, line, planned)
    if recorder.returncode:
        wrong = f"exit code {recorder.returncode}: {(folder / 'said').read_text()}"
    return Ran(wrong, verdict, gap_s, stop_s)


def _let_it_go(camera: ComingCamera, fault: str, *, returns: bool) -> None:
    away_s = random.uniform(1.2, 2.5)
    if fault == "cut":
        camera.send(signal.SIGUSR1)
        if not returns:
            camera.go()
    elif fault == "frozen":
        camera.send(signal.SIGSTOP)
        if returns:
            time.sleep(away_s)
            camera.send(signal.SIGCONT)
    elif fault == "killed":
        camera.go()
        if returns:
            camera.come()


def _looked_at(log: Path, line: str, planned: Planned) -> tuple[str, str, float]:
    """Return what is wrong with a log, its verdict, and the length of its gap [s]."""
    fault, returns = planned.fault, planned.returns
    episode = read_episode(log)
    stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
    gaps = noted_gaps(episode.info.notes)
    if episode.warnings:
        return f"not whole: {episode.warnings}", "", 0.0
    is_lost = fault in ("cut", "killed") or float(np.diff(stamps_ns).max()) > 1e9
    if len(gaps) != (is_lost and returns):  # a frozen server may send all of it when it thaws
        return f"{len(gaps)} gaps: {line}", "", 0.0
    if not returns and "no frame for" not in line:
        return f"ended otherwise: {line}", "", 0.0
    for gap in gaps:
        at = int(np.searchsorted(stamps_ns, gap.last_ns))
        if tuple(stamps_ns[at : at + 2].tolist()) != gap:
            around = [int(one) - gap.last_ns for one in stamps_ns[max(0, at - 2) : at + 4]]
            return f"a gap of {gap.seconds:.3f} s in the wrong place: {around} ns", "", 0.0
    wrong, verdict = "", "not tuned"
    if planned.is_tuned:
        wrong, verdict = _tuned(log, gaps, int(stamps_ns[0]))
    return wrong, verdict, sum(gap.seconds for gap in gaps)


def _tuned(log: Path, gaps: tuple[Gap, ...], first_ns: int) -> tuple[str, str]:
    """Return what is wrong with the tuning of a log, and its verdict."""
    tuning = tune_log(log, TuneOptions())
    if tuning.detection is not None:
        start_s, end_s = (tuning.detection.window[name] for name in ("start_s", "end_s"))
        for gap in gaps:
            gap_at_s = (gap.last_ns - first_ns) * 1e-9
            if start_s < gap_at_s and gap_at_s + gap.seconds < end_s + 1e-3:
                return f"tuned across the gap: {start_s:.2f} to {end_s:.2f} s", tuning.verdict
    return "", tuning.verdict


@dataclass(frozen=True)
class Planned:
    """One recording to come."""

    kind: str  # of camera, by its name in `KINDS`
    fault: str
    number: int  # of this fault; what is random in it follows from these three
    wait_s: float  # until a late camera comes
    film: Path  # what it shows
    is_tuned: bool  # whether the tuner is asked for its verdict

    @property
    def returns(self) -> bool:
        """Whether the camera comes back."""
        return self.fault == "late" or self.number % 2 == 0

    def run(self) -> Ran:
        """Record in a folder of its own."""
        random.seed(f"{self.kind} {self.fault} {self.number}")
        camera = KINDS[self.kind](self.film)
        with tempfile.TemporaryDirectory() as folder:
            try:
                ran = run(camera, self, Path(folder))
            finally:
                camera.go()
        if ran.wrong:
            print(f"{self.kind} {self.fault} {self.number}: {ran.wrong}", flush=True)
        return ran


def tell(kind: str, fault: str, runs: list[Ran]) -> None:
    """Print one line about all runs of a fault."""
    verdicts = [one.verdict for one in runs]
    counts = ", ".join(f"{verdicts.count(one)} {one}" for one in sorted(set(verdicts)))
    right = sum(not one.wrong for one in runs)
    print(
        f"{kind}, {fault}: {right} of {len(runs)} as they should be ({counts}), gaps "
        f"up to {max(one.gap_s for one in runs):.1f} s, "
        f"Ctrl-C within {max(one.stop_s for one in runs):.2f} s",
        flush=True,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--jobs", type=int, default=4, help="recordings at a time")
    parser.add_argument("--tuned", type=int, default=30, help="recordings of each that are tuned")
    parser.add_argument("--quick", action="store_true", help="late by 1 s, not by 5 s")
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=FAULTS)
    arguments = parser.parse_args()
    failed = 0
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn")) as pool,
    ):
        film = shown_film(Path(folder))
        for kind in [arguments.only] if arguments.only else KINDS:
            KINDS[kind](film)  # lays out its pictures, which all that follow use
            for fault in arguments.faults:
                wait_s = 1.0 if arguments.quick else 5.0
                numbers = range(arguments.runs)
                planned = [
                    Planned(kind, fault, number, wait_s, film, is_tuned=number < arguments.tuned)
                    for number in numbers
                ]
                runs = list(pool.map(Planned.run, planned))
                failed += sum(bool(one.wrong) for one in runs)
                tell(kind, fault, runs)
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
