"""Break logs and recordings, and count what was lost or not said: sections of `python -m
tests.bench`. Fuzzing has a command of its own, `python -m tests.bench.fuzz`.
"""

from __future__ import annotations

import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as BagWriter

from tests import strangers
from tests.bench import BIN, SAMPLES, Figures
from tests.hostile import forged_jpeg, spent
from tests.hostile_files import EVERY
from tests.recorders.live_recorder import (
    ATTACKS,
    JOINTS,
    PICTURES,
    attack,
    check_whole_file,
    contend,
    contenders,
    missing_s,
    started,
)
from tests.recorders.live_wait import ended, recorder, wait_for_pictures
from tests.recorders.mjpeg_camera import ComingCamera
from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import noted_gaps
from tunenet_logs.writing.writer import EpisodeWriter


def counted(works: Sequence[Callable[[], Any]], jobs: int = 1) -> tuple[int, list[Any]]:
    """Count the works that raise, which is said, and list the results of the others."""

    def tried(work: Callable[[], Any]) -> list[Any]:
        try:
            return [work()]
        except Exception as error:  # noqa: BLE001 (what goes wrong is what is counted here)
            print(f"  {type(error).__name__}: {error}", file=sys.stderr)
            return []

    with ThreadPoolExecutor(jobs) as pool:
        results = list(chain.from_iterable(pool.map(tried, works)))
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


def comings(runs: int, jobs: int, late_s: float) -> Figures:
    """Let a camera be late, cut off, frozen and killed at random moments, each `runs` times."""
    for fault in ("late", "cut", "frozen", "killed"):
        works = [partial(_came, fault, number, late_s) for number in range(runs)]
        bad, found = counted(works, jobs)
        yield f"bad: {fault}, of {runs}", bad
        gap_s, stop_s = np.max(found or [(np.nan, np.nan)], axis=0).tolist()
        yield f"{fault}: longest gap [s]", gap_s
        yield f"{fault}: longest Ctrl-C [s]", stop_s


def _came(fault: str, number: int, late_s: float) -> tuple[float, float]:
    """Record such a camera; return the length of the gap, and how long Ctrl-C took [s].

    Of all but late ones every other stays away. The log has to be whole, and its gap marked between
    the two pictures where it is.
    """
    chance, returns = random.Random(f"{fault} {number}"), fault == "late" or number % 2 == 0
    camera = ComingCamera(SAMPLES / "filmed.mcap")
    with tempfile.TemporaryDirectory() as name:
        if fault != "late":
            camera.come()
        folder = Path(name)
        words = ("--camera", camera.address, "--stall", "5", "--wait", "60")
        with recorder(folder, *words) as process, ExitStack() as stack:
            stack.callback(camera.go)
            if fault == "late":
                time.sleep(late_s)
                camera.come()
            wait_for_pictures(folder)
            time.sleep(chance.uniform(0.0, 3.0))
            if fault == "frozen":
                camera.send(signal.SIGSTOP)
            elif fault == "killed" or not returns:
                camera.go()
            elif fault == "cut":
                camera.send(signal.SIGUSR1)
            if returns:
                time.sleep(chance.uniform(1.2, 2.5))
                if fault == "frozen":
                    camera.send(signal.SIGCONT)
                elif fault == "killed":
                    camera.come()
                wait_for_pictures(folder)
            begun_s = time.monotonic()
            line, _ = ended(process, signal.SIGINT if returns else 0)
            stop_s = time.monotonic() - begun_s if returns else 0.0
        episode = read_episode(folder / "a.mcap")
        stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
    gaps = noted_gaps(episode.info.notes)
    assert not episode.warnings, f"not whole: {episode.warnings}"
    # a frozen server may send all of it when it thaws
    is_lost = fault in ("cut", "killed") or float(np.diff(stamps_ns).max()) > 1e9
    assert len(gaps) == (is_lost and returns), f"{len(gaps)} gaps: {line}"
    assert returns or "no frame for" in line, f"ended otherwise: {line}"
    for gap in gaps:
        at = int(np.searchsorted(stamps_ns, gap.last_ns))
        around = stamps_ns[at : at + 2].tolist()
        assert tuple(around) == gap, f"{gap} lies between other pictures: {around}"
    return sum(gap.seconds for gap in gaps), stop_s
