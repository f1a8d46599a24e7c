"""GStreamer's RTSP server: what it asks for, and all ways in which its pictures come."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import Command
from tests.recorders.certificates import fingerprint_of, self_signed
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.rtsp_servers import gst_rtsp_server
from tunenet_logs.reader import read_episode

pytestmark = pytest.mark.live

CAMERA = ("tunenet-record", "--stall", LAST_RESORT_S, "--seconds", 1, "-o", "a.mcap", "--camera")
RATE_HZ = 30


def check_log(log: Path, transport: str) -> None:
    """A second of pictures, none missing."""
    episode = read_episode(log)
    assert len(list(episode.frames())) == RATE_HZ
    assert episode.info.notes["transport"] == transport
    assert "lost_packets" not in episode.info.notes


@pytest.mark.parametrize(
    ("transports", "options", "transport"),
    [
        ("tcp,udp", (), "tcp"),
        ("udp", (), "udp"),
        ("tcp,udp", ("--rtsp-transport", "udp"), "udp"),
    ],
)
def test_packets_come_as_server_and_user_want_it(
    command: Command, tmp_path: Path, transports: str, options: tuple[str, ...], transport: str
):
    with gst_rtsp_server(transports=transports) as address:
        result = command(*CAMERA, f"rtsp://{address}", *options, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    check_log(tmp_path / "a.mcap", transport)


@pytest.mark.parametrize(("transports", "forced"), [("tcp", "udp"), ("udp", "tcp")])
def test_a_transport_that_is_forced_and_refused_is_one_line(
    command: Command, tmp_path: Path, transports: str, forced: str
):
    with gst_rtsp_server(transports=transports) as address:
        url = f"rtsp://{address}"
        result = command(*CAMERA, url, "--rtsp-transport", forced, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert f"refuses {forced.upper()} (461)" in result.stderr


@pytest.mark.parametrize("auth", ["basic", "digest"])
def test_a_login(command: Command, tmp_path: Path, auth: str):
    with gst_rtsp_server(auth=auth) as address:
        wrong = command(*CAMERA, f"rtsp://me:guess@{address}", cwd=tmp_path)
        missing = command(*CAMERA, f"rtsp://{address}", cwd=tmp_path)
        good = command(*CAMERA, f"rtsp://me:secret@{address}", cwd=tmp_path)
    assert good.returncode == 0, good.stderr
    check_log(tmp_path / "a.mcap", "tcp")
    assert wrong.returncode == missing.returncode == 1
    assert "refuses this user and password (401)" in wrong.stderr
    assert "wants a password (401)" in missing.stderr
    assert "guess" not in wrong.stderr


def test_an_encrypted_camera(command: Command, tmp_path: Path):
    with gst_rtsp_server(tls=self_signed(), auth="digest") as address:
        url = f"rtsps://me:secret@{address}"
        refused = command(*CAMERA, url, cwd=tmp_path)
        plain = command(*CAMERA, url.replace("rtsps", "rtsp"), cwd=tmp_path)
        pinned = fingerprint_of(self_signed())
        result = command(*CAMERA, url, "--fingerprint", pinned, cwd=tmp_path)
    assert refused.returncode == 1
    assert pinned.replace(":", "") in refused.stderr
    assert result.returncode == 0, result.stderr
    check_log(tmp_path / "a.mcap", "tcp")
    assert plain.returncode == 1
    assert plain.stderr.count("\n") == 1


def test_a_path_that_is_none(command: Command, tmp_path: Path):
    with gst_rtsp_server() as address:
        result = command(*CAMERA, f"rtsp://{address}er", cwd=tmp_path)
    assert result.returncode == 1
    assert "answers 404 Not Found to DESCRIBE; check the path" in result.stderr
