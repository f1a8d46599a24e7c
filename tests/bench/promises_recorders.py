"""Record by `tunenet-record` from each kind of source: a part of `tests.bench.promises`.

Of a simulation or a file all of it is told; of a source that has a clock of its own, what is
neither a time nor due to one. MCAP's own reader reads the logs.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np
from mcap.reader import make_reader

from tests.bench.promised_runs import JOBS, digest, make_clips, ran
from tests.recorders.mjpeg_camera import playing
from tests.recorders.ros2_publisher import STATES, TORQUES, publishing
from tests.recorders.ros2_recorder import free_domain
from tests.recorders.rtsp_camera import rtsp_camera

_STAMP_BYTES = 12  # of a message with a header: CDR's own four bytes, seconds and nanoseconds


@dataclass(frozen=True)
class Recording:
    """A log to record."""

    words: str  # after `tunenet-record`; SOURCE is what `source` says
    # A server, while it is recorded.
    source: Callable[[], AbstractContextManager[str]] = field(default=lambda: nullcontext(""))
    live: bool = False  # whether its times and its pace are a clock's
    uncounted: tuple[str, ...] = ()  # topics whose messages have no number of their own
    stdin: str = ""  # a file of the inputs that is piped in


_OPENING = Lock()


@contextmanager
def _mjpeg() -> Iterator[str]:
    """Play pictures over HTTP; the first caller starts the server that all share."""
    with ExitStack() as stack:
        with _OPENING:
            address = stack.enter_context(playing(frames=60, rate_hz=30.0))
        yield address


def _pictures_by_rtsp() -> AbstractContextManager[str]:
    return rtsp_camera([np.full((48, 64, 3), 5 * number, np.uint8) for number in range(30)], 30)


@contextmanager
def _joints() -> Iterator[str]:
    plan = {"messages": 200, "rate_hz": 200.0, "topics": {STATES: "states", TORQUES: "angles"}}
    with free_domain() as domain, publishing(domain, **plan):
        yield str(domain)


_DROPS = ("", "--preset paper", "--rate 240 --noise 0.001 --hold 0.3 --slope 0.1 --drag 0.1")
_FILMS = ("", "--size 160x120 --blur 4 --pixel-noise 5 --lost 0.1 --fov 50")
_ARMS = (
    "", "--driver", "--empty --driver --rate 10", "--mass 0.5 --com 0.01,0,0.02 --arm ur5e",
    "--preset paper", "--path random --torque-noise 0.1 --lag 5", "--arm panda --driver",
)  # fmt: skip
_LIVE = "--camera http://SOURCE"
RECORDINGS = [
    *(
        Recording(f"--simulate {kind} {words} --seed 7 --engine {engine}")
        for engine in ("pybullet", "mujoco")
        for kind, all_words in {
            "drop --seconds 2": _DROPS,
            "drop --render --seconds 0.5": _FILMS,
            "payload --seconds 1": _ARMS,
            "bounce-shot": ("", "--restitution 0.7 --height 0.335"),
        }.items()
        for words in all_words
    ),
    Recording("--simulate payload --save-path path.csv"),
    Recording("--camera clip.mp4 --ball tennis --drop-height 1"),
    Recording("--camera film.mkv --fps 60"),
    Recording("--camera -", live=True, stdin="film.mkv"),
    Recording("--camera - --transcode", live=True, stdin="film.mkv"),
    Recording(_LIVE, _mjpeg, live=True),
    Recording(f"{_LIVE} --stamps arrival --seconds 9 --ball golf", _mjpeg, live=True),
    Recording(f"{_LIVE} --microphone clicks.wav", _mjpeg, live=True, uncounted=("/audio",)),
    Recording("--camera rtsp://SOURCE --stall 2", _pictures_by_rtsp, live=True),
    Recording("--camera rtsp://SOURCE --stall 2 --transcode", _pictures_by_rtsp, live=True),
    Recording(
        f"--joint-states {STATES},{TORQUES} --loopback --domain SOURCE --timeout 3",
        _joints, live=True,
    ),
    Recording("--outcome success --ball tennis --miss 0.01 --at 2026-11-22T14:30:00Z"),
    Recording("--outcome failure --ball red --attempt 3 --reason rim --at 2026-11-22T14:30:00Z"),
]  # fmt: skip


def recorders(folder: Path) -> dict[str, str]:
    """Record a log of each kind and tell what is in it."""
    folder = folder / "recorders"
    if not folder.exists():
        folder.mkdir(parents=True)
        make_clips(folder)
    with ThreadPoolExecutor(JOBS) as pool:
        told = list(pool.map(partial(_recorded, folder), RECORDINGS))
    return {one.words: text for one, text in zip(RECORDINGS, told, strict=True)}


def _recorded(inputs: Path, recording: Recording) -> str:
    with tempfile.TemporaryDirectory() as name, recording.source() as source:
        folder = Path(name) / "here"
        shutil.copytree(inputs, folder)
        words = recording.words.replace("SOURCE", source).split()
        if "--outcome" not in words and "--save-path" not in words:
            words += ["-o", "a.mcap"]
        stdin = (inputs / recording.stdin).read_bytes() if recording.stdin else b""
        done = ran(["tunenet-record", *words], folder, stdin)
        new = sorted(path for path in folder.iterdir() if not (inputs / path.name).exists())
        told = [f"exit code {done.code}", _timeless(done.out + done.err, live=recording.live)]
        for path in new:
            is_log = path.suffix == ".mcap"
            told += [path.name, *(_log(path, recording) if is_log else [digest(path.read_bytes())])]
    return "\n".join(told)


def _timeless(text: str, *, live: bool) -> str:
    """Return what was said of a live source, without numbers, gaps, and its clock's evenness."""
    if not live:
        return text
    text = re.sub(r", stamps: [^()]*(\([^()]*\))?|, (no|\d+) gaps?[^,;]*", "", text)
    return re.sub(r"\d+(\.\d+)*", "#", text)


def _log(path: Path, recording: Recording) -> Iterator[str]:
    """Tell what is in a log, line by line."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        assert summary is not None
        yield f"{header.profile}, {header.library}"
        yield f"compressed: {sorted({one.compression for one in summary.chunk_indexes})}"
        hashes = {number: hashlib.sha256() for number in summary.channels}
        counts = dict.fromkeys(hashes, 0)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            counts[channel.id] += 1
            stamps = message.log_time, message.publish_time, message.sequence
            told = b"" if recording.live else repr(stamps).encode()
            hashes[channel.id].update(told + message.data[_STAMP_BYTES * recording.live :])
        for number, channel in sorted(summary.channels.items(), key=lambda one: one[1].topic):
            schema = summary.schemas[channel.schema_id]
            yield f"{channel.topic}: {channel.message_encoding}, {dict(channel.metadata)}"
            yield f"  {schema.name}, {schema.encoding}, {digest(schema.data)}"
            if channel.topic not in recording.uncounted:
                yield f"  {counts[number]} messages, {hashes[number].hexdigest()}"
        for one in reader.iter_metadata():
            yield from (f"{one.name}: {line}" for line in _notes(one.metadata, recording))
        for one in reader.iter_attachments():
            yield f"{one.name}, {one.media_type}, {digest(one.data)}"


def _notes(metadata: Mapping[str, str], recording: Recording) -> Iterator[str]:
    for name, text in metadata.items():
        is_kept = not (recording.live and name == "notes.stamps")
        yield f"{name} = {_timeless(text, live=recording.live) if is_kept else '...'}"
