"""A network camera over real sockets: what it sends arrives, whatever it or the disk does."""

from __future__ import annotations

import io
import itertools
import re
import signal
import socket
import subprocess
import threading
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import Command, files_no_larger_than
from tests.recorders.conftest import Refuses
from tests.recorders.films import PATIENT, MadeSource, numbers, recorded
from tests.recorders.live_wait import (
    LAST_RESORT_S,
    Terminal,
    ended,
    recorder,
    wait_for_pictures,
    wait_until,
)
from tests.recorders.mjpeg_camera import ComingCamera, check_times, picture, playing
from tests.recorders.servers import MULTIPART, PART, STREAM, Server, answering, http, part, parts
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import CapturedFrame, Source
from tunenet_logs.recorders.camera.reconnecting import lasting_camera
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.camera.streams import MultipartParser
from tunenet_logs.recorders.session import Summary
from tunenet_logs.terminal import Bar, Progress
from tunenet_logs.timing.stamps import (
    MAX_SPEED_CAMERA_HZ,
    Gap,
    measured_hz,
    noted_gaps,
    now_ns,
    parts_between,
)

pytestmark = pytest.mark.live

CAMERA = ("--stall", LAST_RESORT_S, "--camera")
ENDLESS = {"frames": 100_000, "rate_hz": 100.0, "distinct": 20}
TWENTY = [picture(number) for number in range(20)]


def record_from(address: str, path: Path, **limits: Any) -> tuple[Summary, Episode]:
    return recorded(open_source(f"http://{address}", PATIENT), path, **limits)


@pytest.mark.parametrize(
    "plan",
    [
        {"rate_hz": 120.0, "jitter_s": 0.005},
        pytest.param({"rate_hz": 30.0}, marks=pytest.mark.slow),
    ],
)
def test_every_frame_arrives_in_order_with_its_bytes_and_time(tmp_path: Path, plan: dict):
    with playing(**plan) as address:
        summary, episode = record_from(address, tmp_path / "a.mcap", stamps="arrival")
        check_times(tmp_path / "a.mcap", address)
    assert summary.dropped == 0
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(60)]
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    assert np.all(np.diff(stamps_ns) > 0)
    info, rate_hz = episode.info, measured_hz(stamps_ns, MAX_SPEED_CAMERA_HZ)
    assert (info.kind, info.source) == ("drop", f"camera http://{address}")
    assert info.notes["size_px"] == "320x240"
    assert float(info.notes["measured_hz"]) == pytest.approx(rate_hz, abs=0.001)
    assert summary.rate_hz == pytest.approx(rate_hz, abs=0.001)
    assert "closed" in info.notes["ended"]


@pytest.mark.parametrize("boundary", ["frame", "--frame", '"frame"', ""])
@pytest.mark.parametrize("with_length", [True, False])
def test_senders_differ_in_their_delimiters(tmp_path: Path, boundary: str, with_length: bool):
    kind = "multipart/x-mixed-replace" + f"; boundary={boundary}" * bool(boundary)
    sent = parts(*TWENTY) if with_length else b"".join(map(part, TWENTY))
    with answering(http(sent, kind)) as server:
        _, episode = record_from(server.place, tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == TWENTY


@pytest.mark.parametrize(
    ("stalls", "says"), [(False, "the stream was closed by the camera"), (True, "for 0.5 s")]
)
def test_a_camera_that_closes_or_falls_silent_ends_it_with_the_reason(tmp_path, stalls, says):
    sent = STREAM + b"".join(part(one, stated=len(one)) for one in TWENTY)
    with answering(sent, drips=stalls) as server:
        limits = {"stall_s": 0.5} if stalls else {}
        summary, episode = record_from(server.place, tmp_path / "a.mcap", **limits)
    assert numbers(episode) == list(range(20))
    assert says in summary.ended
    assert episode.info.notes["ended"] == summary.ended


def test_a_camera_that_is_silent_from_the_beginning_is_told_and_leaves_no_log(tmp_path: Path):
    words = r"no frame came \(no frame for 0.3 s\); try again with a longer --stall"
    with answering(STREAM, drips=True) as server, pytest.raises(CameraError, match=words):
        record_from(server.place, tmp_path / "a.mcap", stall_s=0.3)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("stated", ["nothing", "what comes", "the whole"])
def test_cut_pictures_are_counted_and_skipped(tmp_path: Path, stated: str):
    sent = STREAM
    for number, whole in enumerate(TWENTY):
        data = whole[: len(whole) // 2] if number % 10 == 9 else whole
        length = {"nothing": None, "what comes": len(data), "the whole": len(whole)}[stated]
        sent += part(data, stated=length)
    with answering(sent + b"--frame--\r\n") as server:
        summary, episode = record_from(server.place, tmp_path / "a.mcap")
    assert numbers(episode) == [number for number in range(20) if number % 10 != 9]
    assert summary.damaged == episode.info.counts["damaged"] == 2


class SlowBar(Progress):
    """Holds the writer up, as a slow disk does, until the camera's reader has read it all."""

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
        yield self

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
        pass

    def update(self, _done: int, /) -> None:
        for thread in threading.enumerate():
            if thread.name == "camera":
                thread.join(LAST_RESORT_S)


def test_a_slow_writer_drops_the_newest_and_counts(tmp_path: Path):
    with playing(frames=60, rate_hz=500.0) as address:
        source = open_source(f"http://{address}", PATIENT)
        held: dict[str, Any] = {"progress": SlowBar(), "queue_bytes": 100_000}
        summary, episode = recorded(source, tmp_path / "a.mcap", **held)
    sizes = np.cumsum([len(picture(number)) for number in range(60)])
    fit = int(np.count_nonzero(sizes <= 100_000))  # beside the one that is taken out first
    seen = numbers(episode)
    assert fit > 2
    assert seen[:fit] == list(range(fit))
    assert seen == sorted(set(seen))
    assert len(seen) <= fit + 1
    assert (summary.captured, summary.dropped) == (60, 60 - len(seen))
    assert episode.info.counts == {"captured": 60, "written": len(seen), "dropped": 60 - len(seen)}


def test_so_many_seconds_by_the_frames_own_clock(tmp_path: Path):
    with playing(**ENDLESS) as address:
        summary, episode = record_from(address, tmp_path / "a.mcap", seconds=0.5)
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    assert stamps_ns[-1] - stamps_ns[0] < 500_000_000
    assert numbers(episode) == [number % 20 for number in range(summary.written)]
    assert "ended" not in episode.info.notes


# ---- In a process of its own


def test_a_terminal_shows_frames_rate_and_losses(tmp_path: Path):
    with closing(Terminal()) as terminal, playing(**ENDLESS) as address:
        words = (*CAMERA, f"http://{address}")
        with recorder(tmp_path, *words, stderr=terminal.theirs) as process:
            terminal.wait_for(r"recording: \d+frame .*frame/s, 0 dropped")
            ended(process, signal.SIGINT)


def test_a_full_disk_ends_it_and_keeps_what_was_written(command: Command, tmp_path: Path):
    plan = {"frames": 100_000, "rate_hz": 200.0, "distinct": 60}
    with playing(**plan) as address, files_no_larger_than(600_000):
        words = ("tunenet-record", *CAMERA, f"http://{address}", "-o", "a.mcap")
        result = command(*words, cwd=tmp_path)
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    seen, counts = numbers(episode), episode.info.counts
    assert len(seen) > 3
    assert seen == list(range(len(seen)))
    assert counts["captured"] == counts["written"] + counts["dropped"]
    kept = f"{len(seen)} of {counts['captured']} messages are kept in a.mcap"
    assert all(one in result.stderr for one in ("writing failed", kept))
    assert "writing failed" in episode.info.notes["ended"]


# ---- Cameras that are none, answer nonsense or break


CUT = picture(1)[:999]


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "404"),
        (http(b"<html>hello</html>", "text/html"), "answers with a web page"),
        (http(b"x", "image/jpeg"), "is no video that is known here"),
        (http(b"x" * 999, MULTIPART), "no frame came"),
        (STREAM + parts(*[CUT] * 12), "12 parts were no whole JPEG"),
    ],
)
def test_what_is_no_stream_is_one_line_and_leaves_no_file(refuses: Refuses, answer, says: str):
    with answering(answer) as server:
        refuses(1, *CAMERA, server.url, says=(says, server.place))


@pytest.mark.parametrize("scheme", ["http://", "rtsp://me:secret@"])
def test_a_port_where_nobody_listens_is_one_line(refuses: Refuses, scheme: str):
    with socket.socket() as one:  # nobody else gets it meanwhile
        one.bind(("127.0.0.1", 0))
        said = refuses(1, *CAMERA, f"{scheme}127.0.0.1:{one.getsockname()[1]}/video")
    assert "secret" not in said


@pytest.mark.parametrize(
    "answer",
    [
        b"SSH-2.0-OpenSSH_9.6\r\n",
        b"",
        STREAM + b"--frame\r\n" + b"X-Header: 1\r\n" * 5000,
        STREAM + b"--frame\r\n" + b"x" * 100_000,
        STREAM + b"--frame\r\nContent-Length: 99999999999999\r\n\r\n" + b"\xff\xd8",
        STREAM + b"--frame\r\nContent-Length: -5\r\n\r\n\r\n--frame--\r\n",
    ],
)
def test_nonsense_is_one_clear_error(tmp_path: Path, answer: bytes):
    with answering(answer) as server, pytest.raises(CameraError, match=r"127\.0\.0\.1"):
        record_from(server.place, tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_picture_of_a_forged_size_is_damage(tmp_path: Path):
    whole = picture(1)
    at = whole.index(b"\xff\xc0")
    forged = whole[: at + 5] + b"\x75\x30\x75\x30" + whole[at + 9 :]
    with answering(STREAM + parts(whole, forged, whole)) as server:
        summary, _ = record_from(server.place, tmp_path / "a.mcap")
    assert (summary.written, summary.damaged) == (2, 1)


def test_a_part_without_an_end_keeps_what_came_before(tmp_path: Path):
    stream = STREAM + part(picture(1)) + PART + bytes(80 * 1024 * 1024)
    words = "the 1 frames before that are kept in"
    with answering(stream) as server, pytest.raises(CameraError, match=words):
        record_from(server.place, tmp_path / "a.mcap")
    episode = read_episode(tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(1)]
    assert "more than" in episode.info.notes["ended"]


def test_a_failure_in_the_reading_thread_reaches_the_user(tmp_path: Path):
    def breaking() -> Iterator[CapturedFrame]:
        yield CapturedFrame(Frame(1, "jpeg", picture(1)))
        raise ZeroDivisionError("oops")

    with pytest.raises(CameraError, match=r"camera made up: .*ZeroDivisionError.*1 frames before"):
        recorded(MadeSource(breaking()), tmp_path / "a.mcap")
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 1


@pytest.mark.parametrize(("arrivals_s", "is_late"), [((-9, -9), True), ((-9, 9), False)])
def test_late_is_what_waits_to_be_written(tmp_path: Path, arrivals_s, is_late: bool):
    """A picture that is known to be whole by the next one alone does not wait meanwhile."""
    shots = (
        CapturedFrame(Frame(now_ns() + arrival_s * 10**9, "jpeg", picture(number)))
        for number, arrival_s in enumerate(arrivals_s)
    )
    summary, episode = recorded(MadeSource(shots), tmp_path / "a.mcap")
    assert (summary.lag_s > 8) is is_late
    assert ("longest_lag_s" in episode.info.notes) is is_late


# ---- The stream of parts

PARTS = part(TWENTY[0]) + part(TWENTY[1], stated=len(TWENTY[1])) + part(TWENTY[2])


def parser_of(data: bytes, sizes: list[int], boundary: str = "frame"):
    """A parser of a stream that arrives in pieces of these sizes, and where each piece began."""
    file, reads = io.BytesIO(data), list[int]()
    lengths = itertools.chain(sizes, itertools.repeat(100_000))

    def read(most: int) -> bytes:
        reads.append(file.tell())
        return file.read(min(most, next(lengths)))

    return MultipartParser(read, boundary, lambda: len(reads)).parts(), reads


@given(st.lists(st.integers(1, 3000), max_size=60), st.sampled_from(["frame", "--frame", ""]))
def test_it_does_not_matter_how_a_stream_is_cut_on_its_way(sizes: list[int], boundary: str):
    """And a part has the time of the read that brought its first byte."""
    parts, reads = parser_of(PARTS, sizes, boundary)
    found = list(parts)
    assert [part.data for part in found] == [picture(number) for number in range(3)]
    if boundary == "frame":
        firsts = [PARTS.index(picture(number)) for number in range(3)]
        assert [part.arrived_ns for part in found] == [bisect_right(reads, one) for one in firsts]


@given(st.binary(max_size=400), st.integers(0, len(PARTS)), st.integers(0, 400))
def test_damage_costs_the_part_that_it_hits_and_no_more_than_the_next(noise, at: int, lost: int):
    damaged = PARTS[:at] + noise + PARTS[at + lost :] + PARTS
    with suppress(CameraError):
        found = [part.data for part in parser_of(damaged, [])[0]]
        assert found[-2:] == [picture(1), picture(2)]


# ---- Cameras that start late, are cut off, freeze, or are killed and started again


@pytest.fixture
def camera() -> Iterator[ComingCamera]:
    one = ComingCamera()
    yield one
    one.go()


def wait_for(folder: Path, words: str) -> None:
    """Until the recorder there has said so on standard error."""
    wait_until(lambda: words in (folder / "said").read_text(), words)


@contextmanager
def recording(
    camera: ComingCamera, folder: Path, *words: object
) -> Iterator[subprocess.Popen[str]]:
    with (folder / "said").open("w") as said:
        options = ("--camera", camera.address, *words)
        with recorder(folder, *options, stderr=said.fileno()) as process:
            yield process


@pytest.fixture
def process(camera: ComingCamera, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A recorder that has some pictures of a camera that is there."""
    camera.come()
    with recording(camera, tmp_path, "--stall", LAST_RESORT_S) as one:
        wait_for_pictures(tmp_path)
        yield one


def cut(camera: ComingCamera, _folder: Path) -> None:
    camera.send(signal.SIGUSR1)


def freeze(camera: ComingCamera, folder: Path) -> None:
    camera.send(signal.SIGSTOP)
    wait_for(folder, "fell silent")
    camera.send(signal.SIGCONT)


def kill(camera: ComingCamera, folder: Path) -> None:
    camera.go()
    wait_for(folder, "trying again")
    camera.come()


@pytest.mark.parametrize(
    ("fault", "end"),
    [
        (cut, signal.SIGINT),
        (cut, signal.SIGKILL),
        (kill, signal.SIGINT),
        pytest.param(freeze, signal.SIGINT, marks=pytest.mark.slow),
    ],
)
def test_a_gap_is_marked_where_a_camera_comes_back(camera, process, tmp_path: Path, fault, end):
    fault(camera, tmp_path)
    wait_for(tmp_path, "camera back after")
    wait_for_pictures(tmp_path)
    if end == signal.SIGKILL:
        ended(process, end, -end)
        assert len(noted_gaps(read_episode(tmp_path / "a.mcap.active").info.notes)) == 1
        return
    line, _ = ended(process, end)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.mcap", "said"]
    assert re.search(r", 1 gap of \d+\.\d s\b.*\(stopped by a signal\)$", line.strip())
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
    assert len(stamps_ns) == episode.info.counts["written"]
    (gap,) = noted_gaps(episode.info.notes)
    at = int(np.searchsorted(stamps_ns, gap.last_ns))
    assert gap == Gap(*stamps_ns[at : at + 2].tolist())
    assert np.diff(stamps_ns).argmax() == at or fault is cut
    assert set(parts_between(stamps_ns, [gap])) == {0, 1}


def test_a_signal_ends_a_recording_whose_camera_is_away(camera, process, tmp_path: Path):
    camera.go()
    wait_for(tmp_path, "trying again")
    assert "(stopped by a signal)" in ended(process, signal.SIGINT)[0]
    assert not read_episode(tmp_path / "a.mcap").warnings


def test_one_that_stays_away_ends_it_with_all_that_came(camera: ComingCamera, tmp_path: Path):
    camera.come()
    with recording(camera, tmp_path, "--stall", 1) as process:
        wait_for_pictures(tmp_path)
        camera.go()
        line, _ = ended(process)
    assert "no frame for 1.0 s: the" in line
    assert "then cannot be reached (Connection refused))" in line
    assert not noted_gaps(read_episode(tmp_path / "a.mcap").info.notes)


def test_one_that_starts_late_is_waited_for(camera: ComingCamera, tmp_path: Path):
    with recording(camera, tmp_path, "--wait", LAST_RESORT_S) as process:
        waits = "cannot be reached (Connection refused); waiting for it, 120 s at most"
        wait_for(tmp_path, waits)
        camera.come()
        wait_for_pictures(tmp_path)
        assert "gap" not in ended(process, signal.SIGINT)[0]
    assert (tmp_path / "said").read_text().count("\n") == 1


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_waiting(camera: ComingCamera, tmp_path: Path, number: int, code: int):
    with recording(camera, tmp_path, "--wait", LAST_RESORT_S) as process:
        wait_for(tmp_path, "waiting for it")
        ended(process, number, code)
    assert not list(tmp_path.glob("a.mcap*"))


# ---- Servers that hang up, in this process

ONE = STREAM + part(picture(1))
BETWEEN_S = "tunenet_logs.recorders.camera.reconnecting._BETWEEN_S"


def lasting(server: Server, stall_s: float = LAST_RESORT_S) -> Source:
    return lasting_camera(
        lambda: open_source(server.url), wait_s=0, stall_s=stall_s, say=lambda _text: None
    )


def test_a_server_that_hangs_up_at_once_is_not_hurried():
    before = threading.active_count()
    with answering(ONE, STREAM) as server:
        source = lasting(server, 0.7)
        assert len(list(source.frames())) == 1
    why = "no frame for 0.7 s: the stream was closed by the camera, then"
    assert source.ended.startswith(why)
    assert server.calls <= 3  # one each half second
    wait_until(lambda: threading.active_count() <= before, "the threads to end")


def test_one_that_hangs_up_for_ever_ends_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(BETWEEN_S, 0.01)
    with answering(ONE) as server:
        summary, episode = recorded(lasting(server), tmp_path / "a.mcap")
    said = "the stream was closed by the camera, 10 times in a row within 1 s of its first picture"
    assert summary.ended == episode.info.notes["ended"] == said
    assert server.calls == summary.written == 10


def test_cut_pictures_of_every_connection_are_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(BETWEEN_S, 0.01)
    whole = picture(1)
    with answering(STREAM + part(whole[: len(whole) // 2]) + part(whole)) as server:
        summary, episode = recorded(lasting(server), tmp_path / "a.mcap")
    assert summary.written == summary.damaged == episode.info.counts["damaged"] == 10


def test_one_that_delivers_for_a_while_each_time_is_asked_again(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(BETWEEN_S, 0.01)
    monkeypatch.setattr("tunenet_logs.recorders.camera.reconnecting._BRIEF_S", 0.0)
    with answering(ONE) as server:
        source = lasting(server)
        shots = source.frames()
        assert [next(shots).connection for _ in range(12)] == list(range(1, 13))
        source.close()


def test_what_is_final_ends_it_and_keeps_what_came():
    refusal = b'HTTP/1.0 401 No\r\nWWW-Authenticate: Basic realm="x"\r\n\r\n'
    with answering(ONE, refusal) as server:
        shots = lasting(server).frames()
        assert next(shots).connection == 1
        with pytest.raises(CameraError, match="401"):
            next(shots)
    with answering(STREAM + parts(picture(1))) as server:  # the camera ended it itself
        assert len(list(lasting(server).frames())) == 1
        assert server.calls == 1


def test_parts_lie_between_gaps_that_nothing_fills():
    stamps_ns = np.array([0, 10, 20, 1000, 1010, 1020], np.int64)
    assert list(parts_between(stamps_ns, [Gap(20, 1000)])) == [0, 0, 0, 1, 1, 1]
    assert list(parts_between(stamps_ns, [Gap(12, 1003)])) == [0, 0, 0, 1, 1, 1]
    assert not parts_between(np.arange(0, 1020, 10), [Gap(20, 1000)]).any()  # what was late came
    assert list(parts_between(stamps_ns, [Gap(1010, 1011)])) == [0, 0, 0, 0, 0, 1]
    assert noted_gaps({"gaps": "5-9,9-5,x,12-99999999999999999999,7-8"}) == (Gap(5, 9), Gap(7, 8))
