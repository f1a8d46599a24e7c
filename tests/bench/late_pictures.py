"""Delay pictures over a network: check their stamps, and what is tuned from them.

`python -m tests.bench.late_pictures` films twelve drops (30 to 120 Hz), sends each as MJPEG over
the loopback, in real time and with delays, to `tunenet-record` in a process of its own, and tunes
what came. The delays: up to 40 ms, exponential with a mean of 10 ms, and bursts every 100 ms; each
with all pictures, and with 3 % of them missing. It prints, for each kind of delay, how many
verdicts are those of the film itself, how many values lie in its interval, how many are wrong and
`ok`, and how far the stamps are from when the pictures were taken, without what they are all off
by: of all pictures, and of those over 0.1 s from one that is missing.

`--films N` takes fewer films, `--folder DIR` keeps the films and logs.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.writing.writer import header_stamps_ns

BIN = Path(sys.executable).parent
RATES_HZ = (30, 60, 90, 120)
RESTITUTIONS = (0.82, 0.7, 0.58)
DELAYS = ("none", "up to 40 ms", "exponential 10 ms", "bursts of 100 ms")
MISSING = (0.0, 0.03)
AWAY_S = 0.1
AT_ONCE = 2


class Film(NamedTuple):
    """Film of a drop."""

    path: Path  # its log
    pictures: list[bytes]  # JPEGs
    taken_s: NDArray[np.float64]  # when they were taken, shape (T,)


def film(folder: Path, number: int) -> Film:
    """Return the film of that number, made if it is not there yet."""
    rate_hz, restitution = RATES_HZ[number % 4], RESTITUTIONS[number // 4]
    path = folder / f"film_{number:02d}_{rate_hz}hz.mcap"
    if not path.exists():
        words = ["--rate", rate_hz, "--restitution", restitution, "--height", 1.0, "--seconds", 3.5]
        words += ["--simulate", "drop", "--render", "--size", "480x360", "--seed", 40 + number]
        run("tunenet-record", *words, "--quiet", "-o", path)
    frames = list(read_episode(path).frames())
    stamps = np.array([frame.stamp_ns for frame in frames], np.float64)
    return Film(path, [frame.data for frame in frames], (stamps - stamps[0]) * 1e-9)


def run(*words: object) -> str:
    """Return what a command prints; its exit code does not matter."""
    command = [str(BIN / str(words[0])), *map(str, words[1:])]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def sent(film: Film, delay: str, missing: float, seed: int) -> tuple[NDArray, NDArray]:
    """Return the numbers of the pictures that are sent, and when [s]: none overtakes another."""
    rng = np.random.default_rng(seed)
    kept = rng.random(len(film.pictures)) >= missing
    kept[[0, -1]] = True
    taken_s = film.taken_s[kept]
    if delay == "up to 40 ms":
        late_s = rng.uniform(0, 0.04, len(taken_s))
    elif delay == "exponential 10 ms":
        late_s = rng.exponential(0.01, len(taken_s))
    elif delay == "bursts of 100 ms":
        since = rng.uniform(0, 0.1)
        late_s = since + 0.1 * np.ceil((taken_s - since) / 0.1) - taken_s
    else:
        late_s = np.zeros(len(taken_s))
    return np.flatnonzero(kept), np.maximum.accumulate(taken_s + late_s)


class Server(ThreadingHTTPServer):
    """Server that sends one film as MJPEG to whoever asks."""

    daemon_threads = True

    def __init__(self, pictures: list[bytes], at_s: NDArray[np.float64]) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.pictures, self.at_s = pictures, at_s
        threading.Thread(target=self.serve_forever, daemon=True).start()


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        begin = time.perf_counter() + 0.2
        server = self.server
        assert isinstance(server, Server)
        for data, at_s in zip(server.pictures, server.at_s, strict=True):
            time.sleep(max(0.0, begin + at_s - time.perf_counter()))
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            self.wfile.write(head.encode() + data + b"\r\n")
        self.wfile.write(b"--frame--\r\n")

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        """Log nothing."""


def recorded(film: Film, delay: str, missing: float, seed: int, path: Path) -> tuple[float, float]:
    """Send a film and record it; return the stamps' RMS errors [ms]: of all, and off losses."""
    numbers, at_s = sent(film, delay, missing, seed)
    server = Server([film.pictures[number] for number in numbers], at_s)
    address = f"http://127.0.0.1:{server.server_address[1]}/video"
    run("tunenet-record", "--camera", address, "--stall", 2, "--quiet", "--overwrite", "-o", path)
    server.shutdown()
    stamps_ns = np.array(header_stamps_ns(path, CAMERA_TOPIC), np.int64)
    if len(stamps_ns) != len(numbers):
        print(f"{path.name}: {len(stamps_ns)} of {len(numbers)} pictures", file=sys.stderr)
        return np.nan, np.nan
    taken_s = film.taken_s[numbers]
    error_ms = (stamps_ns - stamps_ns[0]) * 1e-6 - 1e3 * taken_s
    lost_s = film.taken_s[np.setdiff1d(np.arange(len(film.pictures)), numbers)]
    away = np.ones(len(taken_s), bool)
    for one_s in lost_s:
        away &= np.abs(taken_s - one_s) > AWAY_S
    error_ms -= np.median(error_ms[away]) if away.any() else np.median(error_ms)
    return rms(error_ms), rms(error_ms[away]) if away.any() else np.nan


def rms(values: NDArray[np.float64]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--films", type=int, default=12)
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        films = [film(folder, number) for number in range(arguments.films)]
        run("tunenet-tune", *(one.path for one in films), "-o", folder / "films", "--quiet")
        truths = [tuned(folder / "films", one.path) for one in films]
        print("films:", ", ".join(str(truth["verdict"]) for truth in truths))
        for missing in MISSING:
            for delay in DELAYS:
                name = f"{delay.replace(' ', '_')}_{missing:g}"
                report(name, films, truths, delay, missing, folder)


def report(
    name: str, films: list[Film], truths: list[dict], delay: str, missing: float, folder: Path
) -> None:
    """Print one row."""
    logs = [folder / f"{one.path.stem}_{name}.mcap" for one in films]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        jobs = [
            pool.submit(recorded, one, delay, missing, number, log)
            for number, (one, log) in enumerate(zip(films, logs, strict=True))
        ]
        errors = np.array([job.result() for job in jobs])
    run("tunenet-tune", *logs, "-o", folder / name, "--quiet")
    same = inside = wrong = 0
    for log, truth in zip(logs, truths, strict=True):
        found = tuned(folder / name, log)
        same += found["verdict"] == truth["verdict"]
        is_inside = holds(truth, found)
        inside += is_inside
        wrong += found["verdict"] == "ok" and not is_inside
    print(
        f"{delay}, {missing:.0%} missing: verdict {same}/{len(logs)}, value {inside}/{len(logs)}, "
        f"wrong and ok {wrong}; stamps rms {np.nanmedian(errors[:, 0]):.2f} "
        f"(worst {np.nanmax(errors[:, 0]):.2f}) ms, away {np.nanmedian(errors[:, 1]):.2f} "
        f"(worst {np.nanmax(errors[:, 1]):.2f}) ms",
        flush=True,
    )


def tuned(folder: Path, log: Path) -> dict:
    """Read what was written of a log's tuning."""
    return json.loads((folder / f"{log.stem}.json").read_text())


def holds(truth: dict, found: dict) -> bool:
    """Check whether a value lies in the film's interval, or without one within .01 of it."""
    if truth["parameters"] is None or found["parameters"] is None:
        return truth["parameters"] is found["parameters"]
    own = truth["parameters"]["restitution"]
    low, high = own["interval95"] or (own["value"] - 0.01, own["value"] + 0.01)
    return low <= found["parameters"]["restitution"]["value"] <= high


if __name__ == "__main__":
    main()
