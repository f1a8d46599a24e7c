"""The page of a live camera, over real HTTP, beside a real recording."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.pages import Page, assert_for_this_machine_alone
from tests.recorders.films import PATIENT, numbers
from tests.recorders.live_wait import LAST_RESORT_S, ended, recorder, wait_until
from tests.recorders.mjpeg_camera import picture, playing
from tunenet_logs.episode import Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.local_page import Preview
from tunenet_logs.timing.stamps import now_ns

pytestmark = pytest.mark.live

DISTINCT = 60


class PreviewPage(Page):
    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("preview at http://127.0.0.1:"), line
        super().__init__(line.removeprefix("preview at ").strip())
        self.process = process

    def state(self) -> dict[str, Any]:
        code, body = self.ask("GET", "/state")
        assert code == 200
        return json.loads(body)

    def wait(self, frames: int) -> dict[str, Any]:
        wait_until(lambda: self.state()["frames"] >= frames, f"{frames} frames on the page")
        return self.state()


@contextmanager
def previewing(folder: Path) -> Iterator[PreviewPage]:
    with playing(frames=100_000, rate_hz=100.0, distinct=DISTINCT) as address:
        words = ("--camera", f"http://{address}", "--preview", "--stall", LAST_RESORT_S)
        with recorder(folder, *words) as process:
            yield PreviewPage(process)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PreviewPage]:
    """One at which nobody presses a button."""
    with previewing(tmp_path_factory.mktemp("page")) as page:
        page.wait(5)
        yield page


def test_from_aiming_to_a_log(tmp_path: Path):
    started_ns = now_ns()
    with previewing(tmp_path) as page:
        code, html = page.ask("GET", "/")
        assert code == 200
        assert b"Record" in html
        before = page.wait(20)
        assert not before["is_recording"]
        assert before["rate_hz"] > 0
        assert before["size_px"] == [320, 240]
        assert 0.4 < before["brightness"] < 0.8
        assert 0 <= before["blown_out"] < 0.1
        assert page.ask("POST", "/ball", json.dumps({"x": 100.25, "y": 60}))[0] == 204
        assert page.state()["ball_at_px"] == [100.25, 60]
        assert page.ask("POST", "/record")[0] == 204
        wait_until(lambda: page.state()["is_recording"], "the page records")
        page.wait(page.state()["frames"] + 30)
        assert page.ask("POST", "/stop")[0] == 204
        assert "stopped on the page" in ended(page.process)[0]
    episode = read_episode(tmp_path / "a.mcap")
    seen, info = numbers(episode), episode.info
    assert seen == [(seen[0] + index) % DISTINCT for index in range(len(seen))]
    assert info.counts["captured"] == info.counts["written"] == len(seen) > 10
    assert info.notes["ball_at_px"] == "100.2,60.0"
    clicked_ns = int(info.notes["ball_at_stamp_ns"])  # of the newest frame then
    first_ns = next(episode.frames()).stamp_ns
    assert started_ns < clicked_ns < first_ns  # nothing from before the button was pressed


@pytest.mark.parametrize(
    ("stamps_ns", "rate_hz"),
    [
        ([5, 6, 7], 0),  # three frames that arrived in one read: of such a burst nothing is known
        (np.cumsum([100_000_000] * 60 + [16_666_667] * 60).tolist(), 60.0),
    ],
)
def test_the_rate_is_that_of_the_latest_frames(stamps_ns: list[int], rate_hz: float):
    with closing(Preview()) as preview:
        assert preview.state()["rate_hz"] == 0
        for stamp_ns in stamps_ns:
            preview.show(Frame(stamp_ns, "jpeg", picture(1)), 0)
            assert preview.state()["size_px"] == [320, 240]
        assert preview.state()["rate_hz"] == rate_hz


def test_a_slow_viewer_sees_the_newest_picture():
    with closing(Preview()) as preview:
        preview.show(Frame(1, "jpeg", b"first"), 0)
        seen = preview.pictures()
        assert next(seen) == b"first"
        for stamp_ns, data in ((2, b"missed"), (3, b"newest")):
            preview.show(Frame(stamp_ns, "jpeg", data), 0)
        assert next(seen) == b"newest"


def test_the_picture_is_the_cameras_own(page: PreviewPage):
    source = open_source(page.url + "live", PATIENT)
    shown = [shot.frame for shot, _ in zip(source.frames(), range(10), strict=False)]
    source.close()
    assert {frame.data for frame in shown} <= {picture(number) for number in range(DISTINCT)}
    assert len({frame.data for frame in shown}) > 1
    assert source.damaged == 0


def test_it_is_for_this_machine_alone(page: PreviewPage):
    port = page.host.partition(":")[2]
    assert page.ask("GET", "/state", Host=f"localhost:{port}")[0] == 200
    refused = (("GET", "/"), ("GET", "/live"), ("POST", "/record"))
    assert_for_this_machine_alone(page, refused)
    assert not page.state()["is_recording"]
    nothing = (("GET", "/../cli.py"), ("GET", "/nix"), ("POST", "/"), ("POST", "/nix"))
    assert {page.ask(*each)[0] for each in nothing} <= {400, 404}
    with closing(Preview()) as one, closing(Preview()) as other:  # it cannot be guessed
        secrets = {Page(each.url).secret for each in (one, other)}
    assert len(secrets) == 2
    assert all(len(secret) >= 20 for secret in secrets)


@pytest.mark.parametrize(
    "body",
    [
        "", "x", "[]", "{}", '{"x": 1}', '{"x": "a", "y": 1}', '{"x": NaN, "y": 1}',
        '{"x": -1, "y": 1}', '{"x": 320, "y": 1}', '{"x": 1e400, "y": 1}', "[" * 2000,
    ],
)  # fmt: skip
def test_a_click_that_is_none_is_refused(page: PreviewPage, body: str):
    assert page.ask("POST", "/ball", body)[0] == 400
    assert page.state()["ball_at_px"] is None


def test_stopped_before_recording_it_leaves_no_log(tmp_path: Path):
    """Though a viewer takes nothing: that does not hold up the end."""
    with previewing(tmp_path) as page:
        page.wait(5)
        host, port = page.host.split(":")
        with socket.create_connection((host, int(port)), LAST_RESORT_S) as viewer:
            viewer.sendall(f"GET {page.secret}/live HTTP/1.0\r\nHost: {page.host}\r\n\r\n".encode())
            page.wait(page.state()["frames"] + 50)
            ended(page.process, signal.SIGINT, 1)
    with previewing(tmp_path) as page:
        page.wait(5)
        page.ask("POST", "/stop")
        _, err = ended(page.process, code=1)
    assert err.count("\n") == 1
    assert "before a frame was recorded" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_request_that_drips_and_too_many_of_them_are_ended(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.recorders.local_page._MAX_REQUEST_S", 1.0)
    with closing(Preview()) as preview, ExitStack() as callers:
        page, ended = Page(preview.url), threading.Event()
        host, port = page.host.split(":")
        dripping = [
            callers.enter_context(socket.create_connection((host, int(port)), LAST_RESORT_S))
            for _ in range(40)
        ]

        def drip() -> None:
            while not ended.wait(0.05):
                for caller in dripping:
                    with suppress(OSError):
                        caller.send(b"G")

        threading.Thread(target=drip, daemon=True).start()
        for caller in dripping:
            with suppress(ConnectionError):
                assert caller.recv(1) == b""  # it hung up, though something came all the time
        ended.set()
        assert page.ask("GET", "/state")[0] == 200
