"""The page of a live camera, over real HTTP, beside a real recording."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from recorders.camera.preview import Preview
from recorders.camera.sources import open_source
from tests.conftest import BIN, Command
from tests.pages import Page, assert_for_this_machine_alone
from tests.recorders.mjpeg_camera import number_in, picture, playing
from tunenet_logs.episode import Frame
from tunenet_logs.reader import read_episode

pytestmark = pytest.mark.live


class PreviewPage(Page):
    """The page of a recorder that runs in a process of its own."""

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
        until = time.monotonic() + 20
        while (state := self.state())["frames"] < frames:
            assert time.monotonic() < until
            time.sleep(0.02)
        return state


@contextmanager
def previewing(folder: Path, **plan: object) -> Iterator[PreviewPage]:
    with playing(**{"frames": 6000, "distinct": 600, **plan}) as address:
        words = [BIN / "tunenet-record", "--camera", f"http://{address}", "--preview"]
        process = subprocess.Popen(
            [*words, "-o", "a.mcap"],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            yield PreviewPage(process)
        finally:
            process.kill()
            process.communicate()


def test_from_aiming_to_a_log(tmp_path: Path):
    with previewing(tmp_path) as page:
        code, html = page.ask("GET", "/")
        assert code == 200
        assert b"Record" in html
        before = page.wait(40)
        assert not before["is_recording"]
        assert before["rate_hz"] == pytest.approx(60, rel=0.2)
        assert before["size_px"] == [320, 240]
        assert 0.4 < before["brightness"] < 0.8
        assert 0 <= before["blown_out"] < 0.1
        assert page.ask("POST", "/ball", json.dumps({"x": 100.25, "y": 60}))[0] == 204
        assert page.state()["ball_at_px"] == [100.25, 60]
        assert page.ask("POST", "/record")[0] == 204
        assert page.wait(before["frames"] + 90)["is_recording"]
        assert page.ask("POST", "/stop")[0] == 204
        out, err = page.process.communicate(timeout=20)
    assert page.process.returncode == 0, err
    assert "stopped on the page" in out
    episode = read_episode(tmp_path / "a.mcap")
    numbers = [number_in(frame.decode()) for frame in episode.frames()]
    assert numbers[0] >= 40  # nothing from before the button was pressed
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    counts = episode.info.counts
    assert counts["captured"] == counts["written"] == len(numbers) > 10
    assert episode.info.notes["ball_at_px"] == "100.2,60.0"
    stamps = [frame.stamp_ns for frame in episode.frames()]
    assert 0 < stamps[-1] - int(episode.info.notes["ball_at_stamp_ns"]) < 60e9


def test_figures_are_there_from_the_first_frame_on():
    preview = Preview()
    try:
        assert preview.state()["rate_hz"] == 0
        for stamp_ns in (5, 6, 7):  # three frames that arrived in one read
            preview.show(Frame(stamp_ns, "jpeg", picture(1)), 0)
            assert preview.state()["size_px"] == [320, 240]
        assert preview.state()["rate_hz"] > 0
    finally:
        preview.close()


def test_the_picture_is_the_cameras_own(tmp_path: Path):
    with previewing(tmp_path) as page:
        source = open_source(page.url + "live")
        frames = source.frames()
        numbers = [number_in(next(frames).decode()) for _ in range(10)]
        source.close()
    assert numbers == sorted(numbers)
    assert source.damaged == 0


def test_it_is_for_this_machine_alone(tmp_path: Path):
    with previewing(tmp_path) as page:
        page.wait(5)
        port = page.host.partition(":")[2]
        assert page.ask("GET", "/state", Host=f"localhost:{port}")[0] == 200
        refused = (("GET", "/"), ("GET", "/live"), ("POST", "/record"))
        assert_for_this_machine_alone(page, refused)
        assert not page.state()["is_recording"]


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


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PreviewPage]:
    with previewing(tmp_path_factory.mktemp("page")) as page:
        page.wait(5)
        yield page


@pytest.mark.parametrize(
    ("method", "path"), [("GET", "/../cli.py"), ("GET", "/nix"), ("POST", "/"), ("POST", "/nix")]
)
def test_there_is_nothing_else_on_it(page: PreviewPage, method: str, path: str):
    assert page.ask(method, path)[0] in (400, 404)


def test_stopped_before_recording_it_leaves_no_log(tmp_path: Path):
    with previewing(tmp_path) as page:
        page.wait(5)
        page.ask("POST", "/stop")
        _, err = page.process.communicate(timeout=20)
    assert page.process.returncode == 1
    assert err.count("\n") == 1
    assert "before a frame was recorded" in err
    assert not list(tmp_path.iterdir())


def test_a_file_has_none(command: Command, tmp_path: Path):
    from tests.recorders.test_video_file import write_video

    video = write_video(tmp_path / "a.mp4", [0, 10, 20])
    result = command("tunenet-record", "--camera", video, "--preview", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert [one.name for one in tmp_path.iterdir()] == ["a.mp4"]
