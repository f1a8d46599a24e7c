"""The page on which the ball of a recording is marked, over real HTTP, and its pictures."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
import pytest

from tests import conftest
from tests.analysis.films import film_of
from tests.conftest import BIN, Command
from tests.pages import Page, assert_for_this_machine_alone
from tests.recorders.films import write_video
from tunenet_logs.analysis.tracking import picker as thumbnails
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.picker import Album, Marking, album_of
from tunenet_logs.episode import Frame
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.terminal import Progress


def picture(width: int = 64, height: int = 48, quality: int = 90) -> bytes:
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


BALL_PX, BALL_PICTURE = (159.5, 119.0), 21  # where the ball of `film` is in flight


class MarkingPage(Page):
    """The page on which the ball is marked."""

    def tune(self, x: object, y: object, picture: object) -> int:
        return self.ask("POST", "/tune", json.dumps({"x": x, "y": y, "picture": picture}))[0]


@contextmanager
def tuning(log: Path, *words: str) -> Iterator[tuple[MarkingPage, subprocess.Popen[str]]]:
    process = subprocess.Popen(
        [BIN / "tunenet-tune", log, "--preview", *words],
        cwd=log.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("mark the ball at http://127.0.0.1:"), line
        yield MarkingPage(line.removeprefix("mark the ball at ").strip()), process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    order = {"restitution": 0.6, "height_m": 1.0, "seconds": 1.35, "seed": 3}
    return conftest.film(tmp_path_factory.mktemp("film") / "film.mcap", **order)


@pytest.fixture(scope="module")
def whole(film: Path) -> Album:
    return album_of(read_episode(film), "/camera/image_raw/compressed")


@pytest.fixture
def page(whole: Album) -> Iterator[tuple[MarkingPage, Marking]]:
    marking = Marking(whole)
    try:
        yield MarkingPage(marking.url), marking
    finally:
        marking.close()


@pytest.fixture
def still(film: Path, tmp_path: Path) -> Path:
    """The film after 0.2 s of the room without a ball, and a pause until 1 s."""
    frames = list(read_episode(film).frames())
    empty = np.median([frame.decode() for frame in frames[::4]], axis=0).astype(np.uint8)
    data = cv2.imencode(".jpg", empty[:, :, ::-1])[1].tobytes()
    before = [Frame(number * 10**7, "jpeg", data) for number in range(20)]
    after = [replace(frame, stamp_ns=frame.stamp_ns + 10**9) for frame in frames]
    late, path = film_of([*before, *after]), tmp_path / "still.mcap"
    record_episode(late, path, overwrite=False, progress=Progress(quiet=True))
    return path


def test_from_a_click_to_a_tuned_ball(still: Path):
    with tuning(still, "--start", "0.5", "-o", "marked") as (page, process):
        code, html = page.ask("GET", "/")
        assert code == 200
        assert b"Tune with this mark" in html
        contents = json.loads(page.ask("GET", "/album")[1])
        assert contents["size_px"] == [320, 240]
        assert len(contents["seconds"]) == 81
        assert contents["seconds"][0] == 1
        assert page.tune(*BALL_PX, BALL_PICTURE) == 204
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert not err
    assert " ok " in out
    result = json.loads((still.parent / "marked" / "still.json").read_text())
    assert result["parameters"]["restitution"]["value"] == pytest.approx(0.6, abs=0.02)


def test_the_mark_is_what_tuning_goes_by(still: Path):
    with tuning(still) as (page, process):
        assert page.tune(*BALL_PX, 10) == 204
        out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "nothing moves at 160, 119 px at 0.10 s; mark the ball in flight" in out + err


def test_a_mark_counts_from_the_first_picture_whatever_is_left_out(film: Path):
    pictures = Pictures(read_episode(film), "/camera/image_raw/compressed", start_s=0.5)
    x, y, at_s = pictures.scaled((160, 120, 0.75))
    assert (x, y, at_s) == pytest.approx((160 / pictures.scale, 120 / pictures.scale, 0.25))


@pytest.mark.slow
def test_without_a_mark_it_is_as_without_a_page(film: Path, command: Command):
    with tuning(film) as (page, process):
        assert page.ask("POST", "/without")[0] == 204
        _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    by_page = json.loads(film.with_suffix(".json").read_text())
    assert command("tunenet-tune", film).returncode == 0
    assert by_page["parameters"] == json.loads(film.with_suffix(".json").read_text())["parameters"]


@pytest.mark.parametrize("how", ["signal", "closed"])
def test_an_end_without_a_decision_is_one_line(film: Path, tmp_path: Path, how: str):
    with tuning(film, "-o", str(tmp_path / "out")) as (page, process):
        assert page.ask("GET", "/")[0] == 200
        if how == "signal":
            process.send_signal(signal.SIGINT)
        else:
            assert page.ask("POST", "/leave")[0] == 204
        out, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert (out, err) == ("", "tunenet-tune: interrupted\n")
    assert not (tmp_path / "out").exists()


def test_a_page_that_is_loaded_again_is_not_closed(
    page: tuple[MarkingPage, Marking], monkeypatch: pytest.MonkeyPatch
):
    asked, marking = page
    monkeypatch.setattr(
        "tunenet_logs.analysis.tracking.picker._AWAY_SECONDS", -1.0
    )  # who is away is gone at once
    assert asked.ask("POST", "/leave")[0] == 204
    with pytest.raises(KeyboardInterrupt):
        marking.wait()
    look, seen = marking._is_closed, []

    def looked() -> bool:
        seen.append(look())
        assert asked.tune(1, 2, 0) == 204
        return seen[-1]

    monkeypatch.setattr(marking, "_is_closed", looked)
    assert asked.ask("GET", "/")[0] == 200
    assert marking.wait() == (1, 2, 0)
    assert seen == [False]


NO_MARKS = (
    "", "x", "[]", "{}", '{"x": 1, "y": 1}', '{"x": 1, "y": 1, "picture": 81}',
    '{"x": 1, "y": 1, "picture": -1}', '{"x": 1, "y": 1, "picture": 1.5}',
    '{"x": 1, "y": 1, "picture": null}', '{"x": NaN, "y": 1, "picture": 1}',
    '{"x": -1, "y": 1, "picture": 1}', '{"x": 320, "y": 1, "picture": 1}',
    '{"x": 1, "y": 240, "picture": 1}', '{"x": 1e400, "y": 1, "picture": 1}',
    "[" * 1000, '{"x": 1, "y": 1, "picture": 1}' + " " * 1000, "[" * 60_000,
)  # fmt: skip


def test_a_click_is_a_place_and_a_time_and_anything_else_is_refused(
    page: tuple[MarkingPage, Marking], whole: Album
):
    asked, marking = page
    for body in NO_MARKS:
        assert asked.ask("POST", "/tune", body)[0] == 400, body[:50]
    assert asked.tune(100.25, 60, 30) == 204
    assert marking.wait() == (100.25, 60, whole.thumbnails[30].seconds)
    assert whole.thumbnails[30].seconds == pytest.approx(0.5)
    assert asked.ask("POST", "/without")[0] == 204
    assert marking.wait() is None


NOWHERE = (
    "/picture/81", "/picture/-1", "/picture/", "/picture/x", "/picture/1/..", "/7", "/../cli",
    "/picture/99999999999999999999", "/picture/٣", "/nix",
)  # fmt: skip


def test_pictures_are_the_recordings_own_for_this_machine_alone_and_there_is_nothing_else(
    page: tuple[MarkingPage, Marking], film: Path
):
    asked, marking = page
    frames = list(read_episode(film).frames())
    for number in (0, 7, 80):
        assert asked.ask("GET", f"/picture/{number}") == (200, frames[number].data)
    for path in NOWHERE:
        assert asked.ask("GET", quote(path))[0] == 404
    port = asked.host.partition(":")[2]
    assert asked.ask("GET", "/album", Host=f"localhost:{port}")[0] == 200
    refused = (("GET", "/"), ("GET", "/picture/0"), ("POST", "/without"))
    assert_for_this_machine_alone(asked, refused)
    asked.tune(1, 2, 0)
    assert marking.wait() == (1, 2, 0)  # nothing of the others' came before


def test_long_recordings_are_thinned_evenly(monkeypatch: pytest.MonkeyPatch):
    data = picture()
    monkeypatch.setattr(thumbnails, "MAX_BYTES", 20 * len(data))
    frames = [Frame(10**9 + number * 10**7, "jpeg", data) for number in range(500)]
    kept = album_of(film_of(frames), "video")
    seconds = [thumbnail.seconds for thumbnail in kept.thumbnails]
    assert 10 <= len(seconds) <= 20
    assert seconds[0] == 0
    assert np.ptp(np.diff(seconds)) < 1e-9


def test_a_video_is_made_smaller_and_its_marks_are_not(tmp_path: Path):
    stamps = [number * 10 for number in range(350)]
    path = write_video(tmp_path / "a.mp4", stamps)
    video = read_episode(path)
    kept = album_of(video, "video")
    assert 150 <= len(kept.thumbnails) <= thumbnails.MAX_REDUCED
    assert all(thumbnail.data.startswith(b"\xff\xd8") for thumbnail in kept.thumbnails)
    pixels = np.zeros((1000, 2000, 3), np.uint8)
    large = Frame(0, "rgb8", pixels.tobytes(), (2000, 1000))
    kept = album_of(film_of([large]), "video")
    assert kept.size_px == (2000, 1000)
    shown = cv2.imdecode(np.frombuffer(kept.thumbnails[0].data, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    assert shown.shape == (480, 960, 3)
    heavy = Frame(0, "jpeg", picture(1200, 900, quality=100))
    (thumbnail,) = album_of(film_of([heavy]), "video").thumbnails
    assert len(thumbnail.data) < len(heavy.data)


def test_what_cannot_be_shown_is_left_out():
    whole = picture()
    good = Frame(0, "jpeg", whole)
    frames = [
        Frame(0, "jpeg", b"none"),
        replace(good, stamp_ns=10**9),
        Frame(2 * 10**9, "jpeg", whole[:-200]),  # cut off
        replace(good, stamp_ns=10**9),  # time stands still
        Frame(3 * 10**9, "jpeg", picture(32, 32)),  # of another size
        Frame(4 * 10**9, "jpeg", whole[:30]),
        replace(good, stamp_ns=5 * 10**9),
    ]
    kept = album_of(film_of(frames), "video")
    assert [thumbnail.seconds for thumbnail in kept.thumbnails] == [1, 5]
    kept = album_of(film_of(frames), "video", start_s=0.5, end_s=4.5)
    assert [thumbnail.seconds for thumbnail in kept.thumbnails] == [1]
    with pytest.raises(UsageError, match="no picture"):
        album_of(film_of(frames[:1]), "video")
