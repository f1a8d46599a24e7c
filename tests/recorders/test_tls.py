"""Encrypted cameras: which certificate is believed, and where a password goes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import Command
from tests.recorders.certificates import fingerprint_of, self_signed
from tests.recorders.http_camera import PICTURES, HttpCamera, http_camera
from tests.recorders.live_wait import LAST_RESORT_S
from tunenet_logs.reader import read_episode

pytestmark = pytest.mark.live

CAMERA = ("tunenet-record", "--stall", LAST_RESORT_S, "-o", "a.mcap", "--camera")
OTHER = "0" * 64


def test_an_unknown_certificate_is_refused_with_what_would_let_it_in(
    command: Command, tmp_path: Path
):
    with http_camera(HttpCamera(), self_signed()) as camera:
        url = f"https://{camera.address}/video"
        refused = command(*CAMERA, url, cwd=tmp_path)
        assert refused.returncode == 1
        assert refused.stderr.count("\n") == 1
        assert not camera.seen
        options = refused.stderr.partition("add ")[2].split(";")[0].split()
        assert options[1] == fingerprint_of(self_signed()).replace(":", "")
        assert "--insecure" in refused.stderr
        wrong = command(*CAMERA, url, "--fingerprint", OTHER, cwd=tmp_path)
        assert wrong.returncode == 1
        assert wrong.stderr.count("\n") == 1
        assert OTHER in wrong.stderr
        assert options[1] in wrong.stderr
        allowed = command(*CAMERA, url, *options, cwd=tmp_path)
    assert allowed.returncode == 0, allowed.stderr
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == PICTURES


@pytest.mark.parametrize("form", [str, str.lower, lambda text: text.replace(":", "")])
def test_a_fingerprint_is_taken_as_it_is_printed_anywhere(command: Command, tmp_path: Path, form):
    given = form(fingerprint_of(self_signed()))
    with http_camera(HttpCamera(), self_signed()) as camera:
        url = f"https://{camera.address}/video"
        result = command(*CAMERA, url, "--fingerprint", given, cwd=tmp_path)
    assert result.returncode == 0, result.stderr


def test_insecure_believes_any(command: Command, tmp_path: Path):
    with http_camera(HttpCamera(), self_signed()) as camera:
        result = command(*CAMERA, f"https://{camera.address}/", "--insecure", cwd=tmp_path)
    assert result.returncode == 0, result.stderr


def test_what_speaks_no_tls_is_told(command: Command, tmp_path: Path):
    with http_camera(HttpCamera()) as camera:
        result = command(*CAMERA, f"https://{camera.address}/", "--insecure", cwd=tmp_path)
    assert result.returncode == 1
    assert "encryption" in result.stderr


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["http://127.0.0.1/", "--insecure"], "--insecure"),
        (["rtsp://127.0.0.1/", "--fingerprint", OTHER], "--fingerprint"),
        (["https://127.0.0.1/", "--fingerprint", "12:34"], "64 hex digits"),
        (["https://127.0.0.1/", "--fingerprint", OTHER, "--insecure"], "--insecure"),
        (["a.mp4", "--insecure"], "--insecure"),
        (["http://127.0.0.1/", "--rtsp-transport", "udp"], "--rtsp-transport"),
        (["rtsps://127.0.0.1/", "--rtsp-transport", "udp"], "--rtsp-transport"),
    ],
)
def test_options_of_other_cameras_are_refused(
    command: Command, tmp_path: Path, words: list[str], names: str
):
    result = command("tunenet-record", "--camera", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert names in result.stderr


def test_a_password_never_leaves_its_encryption(command: Command, tmp_path: Path):
    words = ("--insecure",)
    with http_camera(HttpCamera(('Basic realm="x"',))) as plain:
        moved = HttpCamera(moved=f"http://{plain.address}/video")
        with http_camera(moved, self_signed()) as camera:
            url = f"https://me:secret@{camera.address}/moved"
            refused = command(*CAMERA, url, *words, cwd=tmp_path)
    assert refused.returncode == 1
    assert f"sends on to http://{plain.address}/video" in refused.stderr
    assert not plain.seen


def test_a_camera_may_send_on_to_its_own_encryption(command: Command, tmp_path: Path):
    with http_camera(HttpCamera(), self_signed()) as safe:
        moved = HttpCamera(moved=f"https://{safe.address}/video")
        with http_camera(moved) as camera:
            url = f"http://{camera.address}/moved"
            result = command(*CAMERA, url, cwd=tmp_path)
    assert result.returncode == 1
    assert "--fingerprint" in result.stderr  # the address is http: it has to be given as https
