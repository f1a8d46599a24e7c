"""Break logs and recordings, and count what was lost or not said: sections of `python -m
tests.bench`. Fuzzing has a command of its own, `python -m tests.bench.fuzz`.
"""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as BagWriter

from tests import strangers
from tests.bench import BIN, Figures
from tests.hostile import forged_jpeg, spent
from tests.hostile_files import EVERY
from tests.recorders.coming_camera import ComingCamera, ComingRtspCamera
from tests.recorders.contender import ATTACKS, attack, contend, contenders
from tests.recorders.live_recorder import JOINTS, PICTURES, check_whole_file, missing_s, started
from tests.recorders.live_wait import ending, wait_until
from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import noted_gaps
from tunenet_logs.writing.writer import EpisodeWriter


def counted(works: Sequence[Callable[[], Any]]) -> tuple[int, list[Any]]:
    """Count the works that raise, which is said, and list the results of the others."""
    results = []
    for work in works:
        try:
            results.append(work())
        except Exception as error:  # noqa: BLE001 (what goes wrong is what is counted here)
            print(f"  {type(error).__name__}: {error}", file=sys.stderr)
    return len(works) - len(results), results


# ---- Logs: one of every kind, damaged ones, hostile ones.


def write_log(path: Path, *, samples: int, pictures: int) -> None:
    """Write a log of positions, joints and pictures by our writer."""
    rng = np.random.default_rng(0)
    info = EpisodeInfo(kind="drop", truth={"restitution": 0.5})
    with EpisodeWriter(path, info, live=False) as out:
        for index in range(samples):
            out.write_pose("/ball/pose", index * 10_000_000, rng.normal(size=3))
            if samples > 20:
                names = [f"joint{number}" for number in range(7)]
                out.write_joints("/joint_states", index * 10_000_000, names, rng.normal(size=7))
        for index in range(pictures):
            pixels = rng.integers(0, 255, (24, 32, 3), np.uint8)
            data = cv2.imencode(".jpg", pixels)[1].tobytes()
            out.write_frame("/camera/image_raw/compressed", Frame(index * 10**7, "jpeg", data))


def write_all(folder: Path) -> None:
    """Write one small log of every kind that is read, each under a name that says its kind."""
    samples = strangers.Stranger(0.6, seconds=0.4, hold_s=0.1).samples()
    ours = folder / "ours.mcap"
    write_log(ours, samples=24, pictures=2)
    strangers.without_chunks(ours, folder / "plain.mcap")
    # checksums hide what is behind them from a fuzzer
    strangers.without_chunks(ours, folder / "bare.mcap", crcs=False)
    strangers.without_chunks(ours, folder / "chunks.mcap", chunks=True, crcs=False)
    for name, write in {
        "lz4.mcap": strangers.write_poses,
        "ros1.mcap": strangers.write_ros1,
        "protobuf.mcap": strangers.write_protobuf,
        "json.mcap": strangers.write_json,
        "table.csv": strangers.write_table,
    }.items():
        write(folder / name, *samples)
    for number, compression in enumerate((None, *BagWriter.CompressionFormat)):
        strangers.write_poses_bag(folder / f"{number}.bag", *samples, compression=compression)
    strangers.write_poses_folder(folder / "folder", *samples).rename(folder / "a.db3")
    shutil.rmtree(folder / "folder")
    forged_jpeg(folder / "pictures.mcap")


Contents = tuple[tuple[Any, ...], ...]


def damage(flips: int, seed: int) -> Figures:
    """Flip single bits in logs of positions, joints and pictures; cut one of 2 kB at every byte."""
    with tempfile.TemporaryDirectory() as name:
        folder, rng = Path(name), random.Random(seed)
        broken = folder / "broken.mcap"
        write_log(folder / "chunks.mcap", samples=60, pictures=4)
        strangers.without_chunks(folder / "chunks.mcap", folder / "plain.mcap")
        for kind in ("chunks", "plain"):
            whole = (folder / f"{kind}.mcap").read_bytes()
            truth, _ = contents(folder / f"{kind}.mcap")
            outcomes: Counter[str] = Counter()
            for _ in range(flips // 2):
                data = bytearray(whole)
                data[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
                broken.write_bytes(data)
                outcomes[_outcome(broken, truth)] += 1
            yield f"{kind}, {len(whole)} bytes, {flips // 2} flips", str(dict(outcomes))
            yield f"bad: {kind}: differ, and nothing was said", outcomes["differs"]
        write_log(folder / "small.mcap", samples=16, pictures=0)
        whole = (folder / "small.mcap").read_bytes()
        truth, _ = contents(folder / "small.mcap")
        outcomes = Counter()
        for end in range(len(whole)):
            broken.write_bytes(whole[:end])
            outcomes[_outcome(broken, truth, is_cut=True)] += 1
        yield f"cut at each of {len(whole)} bytes", str(dict(outcomes))
        cut = outcomes.total() - outcomes["refused"] - outcomes["shorter, damage said"]
        yield "bad: cut: neither refused nor shorter with damage said", cut


def contents(path: Path) -> tuple[Contents, bool]:
    """Return all that a tuning would see of a log, and whether anything was said about it."""
    episode = read_episode(path)
    seen: list[tuple[Any, ...]] = [
        (name, one.stamps_ns.tobytes(), one.values.tobytes(), one.columns)
        for name, one in sorted(episode.signals.items())
    ]
    for topic in episode.picture_topics:
        seen += [(topic, one.stamp_ns, one.data) for one in episode.frames(topic)]
    said = bool(episode.warnings) and bool(check(path, Progress(quiet=True)).damage)
    return tuple(seen), said


def _outcome(path: Path, truth: Contents, *, is_cut: bool = False) -> str:
    """Say what became of a damaged log."""
    try:
        seen, said = contents(path)
    except TuneNetError:
        return "refused"
    if is_cut:
        whole = {entry[0]: entry for entry in truth}
        begins = all(
            bytes(whole[name][1]).startswith(stamps) and bytes(whole[name][2]).startswith(values)
            for name, stamps, values, _ in seen
        )
        return "shorter, damage said" if said and begins else "differs"
    return ("the same" if seen == truth else "differs") + ", damage said" * said


_COMMANDS = {
    "info": ("tunenet-logs", "info", "{}"),
    "check": ("tunenet-logs", "check", "{}"),
    "recover": ("tunenet-logs", "recover", "{}", "-o", "saved.mcap", "--overwrite"),
    "tune": ("tunenet-tune", "{}", "-o", "tuned", "--overwrite"),
}


def hostile(only: str) -> Figures:
    """Give small files that claim much to four commands, each in a process of its own."""
    for what, bomb in EVERY.items():
        if only and what not in only.split(","):
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            path = bomb.write(folder)
            for command, (program, *words) in _COMMANDS.items():
                line = [str(BIN / program), *(word.format(path.name) for word in words)]
                told = spent(line, folder)
                yield f"{what}, {command}: CPU [s]", told.cpu_s
                yield f"{what}, {command}: memory [MiB]", told.peak_kib / 1024
                yield f"{what}, {command}: exit code", told.code
                yield f"bad: {what}, {command}: a traceback", int("Traceback" in told.said)


# ---- Recordings that are killed, stopped, doubled, taken away.


def durability(kills: int, signals: int, seed: int) -> Figures:
    """End a camera (60 Hz, 640 x 480 JPEG) and an arm (1 kHz, seven joints) at random moments.

    Every file is read back, every message compared with what its number says. Pictures fill chunks
    quickly; so the arm alone is killed, too.
    """
    rng, both = random.Random(seed), (PICTURES, JOINTS)
    for what, topics, count in (
        ("camera and arm", both, kills), ("arm alone", (JOINTS,), round(0.3 * kills)),
    ):  # fmt: skip
        works = [_ending(signal.SIGKILL, rng.uniform(0.3, 3.0), topics) for _ in range(count)]
        bad, missing = counted(works)
        yield f"bad: {what}, killed {count} times: files or messages", bad
        ms = np.array(missing or [np.nan]) * 1e3
        for share, of in {"median": 0.5, "95 %": 0.95, "worst": 1.0}.items():
            yield f"{what}: missing at the end, {share} [ms]", float(np.quantile(ms, of))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        works = [_ending(number, rng.uniform(0.3, 3.0), both) for _ in range(signals)]
        yield f"bad: {number.name} {signals} times: files", counted(works)[0]


def _ending(number: int, seconds: float, topics: Sequence[str]) -> Callable[[], float]:
    def end() -> float:
        """Record, send the signal, check the log; return what is missing [s] if it was killed."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            process = started(folder, topics)
            time.sleep(seconds)
            process.send_signal(number)
            said, _ = process.communicate(timeout=60)
            if number == signal.SIGKILL:
                return missing_s(folder, folder / "a.mcap.active")
            assert process.returncode == 0, f"exit code {process.returncode}"
            check_whole_file(folder / "a.mcap", said)
            return 0.0

    return end


def ownership(tries: int, moments: int, seed: int) -> Figures:
    """Begin two recordings to one name at one moment, half of them with `overwrite`, over nothing,
    a log, or what a killed recorder left; and remove, move, replace or link the file that is being
    written, or its folder.
    """
    ways = ((False, ""), (True, ""), (False, ""), (True, "log"), (False, ""), (True, "active"))
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as name, contenders(2) as both:

        def begin(number: int) -> None:
            overwrite, left = ways[number % len(ways)]
            try:
                contend(both, Path(name), rng, overwrite=overwrite, left=left)
            except AssertionError:
                for one in Path(name).iterdir():
                    one.unlink()
                raise

        bad, _ = counted([lambda number=number: begin(number) for number in range(tries)])
    yield f"bad: {tries} pairs to one name: without one whole log by one", bad

    def take(how: str) -> None:
        with tempfile.TemporaryDirectory() as name:
            attack(Path(name), how, rng.uniform(0.05, 2.5), ends=rng.random() < 0.5)

    for at, how in enumerate(ATTACKS):
        count = len(range(at, moments, len(ATTACKS)))
        lost, _ = counted([lambda how=how: take(how)] * count)
        yield f"bad: {how}, {count} times: anything lost", lost


# ---- Cameras that come and go.

_FAULTS = ("late", "cut", "frozen", "killed")
_KINDS = {"mjpeg": ComingCamera, "rtsp": ComingRtspCamera}
_RECORD = (sys.executable, "-m", "tunenet_logs.recorders.cli")


@dataclass(frozen=True)
class Coming:
    """One recording of a camera with a fault at a random moment of a drop that it shows again and
    again; of all but late ones every other stays away.
    """

    kind: str
    fault: str
    number: int  # of this fault; what is random in it follows from these three
    late_s: float
    film: Path  # what it shows
    is_tuned: bool

    def ran(self) -> tuple[str, str, float, float]:
        """Record; return what is wrong, the verdict, its gap [s] and how long Ctrl-C took [s]."""
        random.seed(f"{self.kind} {self.fault} {self.number}")
        returns = self.fault == "late" or self.number % 2 == 0
        camera = _KINDS[self.kind](self.film)
        with tempfile.TemporaryDirectory() as name:
            log = Path(name) / "a.mcap"
            try:
                code, line, said, stop_s = self._record(camera, log, returns=returns)
            finally:
                camera.go()
            wrong, verdict, gap_s = self._looked_at(log, line, returns=returns)
            wrong = f"exit code {code}: {said}" if code else wrong
        if wrong:
            print(f"{self.kind} {self.fault} {self.number}: {wrong}", flush=True)
        return wrong, verdict, gap_s, stop_s

    def _record(
        self, camera: ComingCamera, log: Path, *, returns: bool
    ) -> tuple[int, str, str, float]:
        if self.fault != "late":
            camera.come()
        active, said = log.with_name("a.mcap.active"), log.with_name("said")
        words = ["--camera", camera.address, "--stall", "5", "--wait", "60", "-o", str(log)]
        with said.open("w") as file:
            process = subprocess.Popen(
                [*_RECORD, *words], stdout=subprocess.PIPE, stderr=file, text=True
            )
        with ending(process) as recorder:
            if self.fault == "late":
                time.sleep(self.late_s)
                camera.come()
            wait_until(lambda: active.exists() and active.stat().st_size > 100_000, "pictures")
            time.sleep(random.uniform(0.0, 3.0))
            self._let_go(camera, returns=returns)
            if returns:
                time.sleep(4.0 if self.is_tuned else 1.5)
                recorder.send_signal(signal.SIGINT)
            begun_s = time.monotonic()
            line, _ = recorder.communicate(timeout=60)
            stop_s = time.monotonic() - begun_s if returns else 0.0
        return process.returncode, line, said.read_text(), stop_s

    def _let_go(self, camera: ComingCamera, *, returns: bool) -> None:
        away_s = random.uniform(1.2, 2.5)
        if self.fault == "cut":
            camera.send(signal.SIGUSR1)
            if not returns:
                camera.go()
        elif self.fault == "frozen":
            camera.send(signal.SIGSTOP)
            if returns:
                time.sleep(away_s)
                camera.send(signal.SIGCONT)
        elif self.fault == "killed":
            camera.go()
            if returns:
                camera.come()

    def _looked_at(self, log: Path, line: str, *, returns: bool) -> tuple[str, str, float]:
        """Return what is wrong with a log, its verdict, and the length of its gap [s].

        It has to be whole, its gap marked between the two pictures where it is, and the tuned drop
        on one side of it.
        """
        episode = read_episode(log)
        stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
        gaps = noted_gaps(episode.info.notes)
        if episode.warnings:
            return f"not whole: {episode.warnings}", "", 0.0
        is_lost = self.fault in ("cut", "killed") or float(np.diff(stamps_ns).max()) > 1e9
        if len(gaps) != (is_lost and returns):  # a frozen server may send all of it when it thaws
            return f"{len(gaps)} gaps: {line}", "", 0.0
        if not returns and "no frame for" not in line:
            return f"ended otherwise: {line}", "", 0.0
        for gap in gaps:
            at = int(np.searchsorted(stamps_ns, gap.last_ns))
            if tuple(stamps_ns[at : at + 2].tolist()) != gap:
                around = [int(one) - gap.last_ns for one in stamps_ns[max(0, at - 2) : at + 4]]
                return f"a gap of {gap.seconds:.3f} s in the wrong place: {around} ns", "", 0.0
        gap_s = sum(gap.seconds for gap in gaps)
        if not self.is_tuned:
            return "", "not tuned", gap_s
        from tunenet_logs.analysis.options import TuneOptions
        from tunenet_logs.analysis.tuning import tune_log

        tuning, wrong = tune_log(log, TuneOptions()), ""
        if tuning.detection is not None:
            start_s, end_s = (tuning.detection.window[name] for name in ("start_s", "end_s"))
            for gap in gaps:
                gap_at_s = (gap.last_ns - int(stamps_ns[0])) * 1e-9
                if start_s < gap_at_s and gap_at_s + gap.seconds < end_s + 1e-3:
                    wrong = f"tuned across the gap: {start_s:.2f} to {end_s:.2f} s"
        return wrong, tuning.verdict, gap_s


def comings(runs: int, tuned: int, jobs: int, only: str, late_s: float) -> Figures:
    """Let cameras of MJPEG (ours) and RTSP (GStreamer's) be late, cut off, frozen and killed, each
    `runs` times; `tuned` of each are tuned, which takes longer than all the rest.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(jobs, get_context("spawn")) as pool,
    ):
        film = Path(folder) / "film.mcap"  # restitution .63
        words = ["--simulate", "drop", "--render", "--seed", "7", "--seconds", "3"]
        subprocess.run([*_RECORD, *words, "-o", str(film)], check=True, capture_output=True)
        for kind in [only] if only else _KINDS:
            _KINDS[kind](film)  # lays out its pictures, which all that follow use
            for fault in _FAULTS:
                every = [
                    Coming(kind, fault, number, late_s, film, is_tuned=number < tuned)
                    for number in range(runs)
                ]
                wrong, verdicts, gaps_s, stops_s = zip(*pool.map(Coming.ran, every), strict=True)
                yield f"bad: {kind}, {fault}, of {runs}", sum(map(bool, wrong))
                yield f"{kind}, {fault}: verdicts", str(dict(Counter(verdicts)))
                yield f"{kind}, {fault}: longest gap [s]", max(gaps_s)
                yield f"{kind}, {fault}: longest Ctrl-C [s]", max(stops_s)
