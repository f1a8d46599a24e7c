"""motion and nginx: logins, encryption and redirections as servers of others have them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import Command
from tests.recorders.certificates import fingerprint_of, self_signed
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import playing
from tests.recorders.motion_server import motion_server
from tests.recorders.nginx_server import nginx_server
from tunenet_logs.reader import read_episode

pytestmark = pytest.mark.live

CAMERA = ("tunenet-record", "--stall", LAST_RESORT_S, "-o", "a.mcap", "--camera")
WRONG = "refuses this user and password (401)"
MISSING = "wants a password (401)"


def test_motion_with_its_digest(command: Command, tmp_path: Path):
    files = tmp_path / "motion"
    files.mkdir()
    with (
        playing(frames=100_000, rate_hz=20.0, distinct=20) as camera,
        motion_server(files, camera, "digest") as address,
    ):
        url = f"http://me:secret@{address}"
        wrong = command(*CAMERA, url.replace("secret", "guess"), cwd=tmp_path)
        missing = command(*CAMERA, f"http://{address}", cwd=tmp_path)
        good = command(*CAMERA, url, "--seconds", 0.5, cwd=tmp_path)
    assert good.returncode == 0, good.stderr
    assert wrong.returncode == missing.returncode == 1
    assert WRONG in wrong.stderr
    assert MISSING in missing.stderr
    assert b"secret" not in (tmp_path / "a.mcap").read_bytes()


def test_nginx_with_a_password_and_its_own_certificate(command: Command, tmp_path: Path):
    files = tmp_path / "nginx"
    files.mkdir()
    with playing(frames=20, rate_hz=200.0) as camera:
        place, _, path = camera.partition("/")
        rules = f"""location / {{ auth_basic "camera"; auth_basic_user_file {files}/users;
            proxy_pass http://{place}; proxy_buffering off; }}
            location /moved {{ return 302 /{path}; }}"""
        with nginx_server(files, rules, self_signed()) as address:
            pinned = ("--fingerprint", fingerprint_of(self_signed()))
            url = f"https://me:secret@{address}/moved"
            wrong = command(*CAMERA, url.replace("secret", "guess"), *pinned, cwd=tmp_path)
            missing = command(*CAMERA, f"https://{address}/moved", *pinned, cwd=tmp_path)
            unknown = command(*CAMERA, url, cwd=tmp_path)
            good = command(*CAMERA, url, *pinned, cwd=tmp_path)
    assert good.returncode == 0, good.stderr
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 20
    assert WRONG in wrong.stderr
    assert MISSING in missing.stderr
    assert "--fingerprint" in unknown.stderr


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("http://10.0.0.9/video", "sends on to http://10.0.0.9/video; if that is right"),
        ("file:///etc/hosts", "sends on to file:///etc/hosts, which is no camera's address"),
        ("http://me:pw@localhost/x?pwd=hidden", "sends on to http://localhost/x; if that"),
    ],
)
def test_nginx_sends_elsewhere(command: Command, tmp_path: Path, place: str, says: str):
    files = tmp_path / "nginx"
    files.mkdir()
    with nginx_server(files, f"return 301 {place};") as address:
        result = command(*CAMERA, f"http://{address}/video", cwd=tmp_path)
    assert result.returncode == 1
    assert says in result.stderr
    assert "hidden" not in result.stderr
