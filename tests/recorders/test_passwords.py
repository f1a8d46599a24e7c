"""A camera's password that stands in no argument: from a file, the environment, or `~/.netrc`."""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import Command
from tests.recorders.http_camera import HttpCamera, http_camera
from tunenet_logs.errors import UsageError
from tunenet_logs.passwords import netrc_login, read_password

USER, PASSWORD = "me", 'ge he"im#ü'
PROOF = "Basic " + b64encode(f"{USER}:{PASSWORD}".encode()).decode()


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user without a `.netrc`."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("NETRC", raising=False)
    monkeypatch.delenv("TUNENET_CAMERA_PASSWORD", raising=False)
    return tmp_path


@pytest.fixture
def camera() -> Iterator[HttpCamera]:
    with http_camera(HttpCamera(('Basic realm="x"',), lambda given: given == PROOF)) as served:
        yield served


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text, "utf-8")
    path.chmod(mode)
    return path


@pytest.mark.live
@pytest.mark.parametrize("way", ["file", "variable", "netrc", "netrc without the user"])
def test_a_password_needs_no_argument(
    camera: HttpCamera, home: Path, command: Command, monkeypatch: pytest.MonkeyPatch, way: str
):
    user = "" if way == "netrc without the user" else f"{USER}@"
    words = ["--camera", f"http://{user}{camera.address}/", "-o", str(home / "drop.mcap")]
    if way == "file":
        words += ["--password-file", str(written(home / "password", f"{PASSWORD}\n"))]
    elif way == "variable":
        monkeypatch.setenv("TUNENET_CAMERA_PASSWORD", PASSWORD)
    else:
        quoted = PASSWORD.replace('"', '\\"')
        written(home / ".netrc", f'machine 127.0.0.1 login {USER} password "{quoted}"\n')
    done = command("tunenet-record", *words)
    assert done.returncode == 0, done.stderr
    assert "processes" not in done.stderr
    assert camera.seen[-1] == PROOF
    assert PASSWORD.encode() not in (home / "drop.mcap").read_bytes()


@pytest.mark.live
def test_of_a_password_that_others_can_see_one_line_is_said(
    camera: HttpCamera, home: Path, command: Command
):
    file = written(home / "password", PASSWORD, 0o644)
    words = ("tunenet-record", "-o", str(home / "drop.mcap"), "--overwrite", "--camera")
    done = command(*words, f"http://{USER}@{camera.address}/", "--password-file", str(file))
    assert f"{file}: others can read this password; chmod 600 {file}" in done.stderr
    done = command(*words, f"http://{USER}:ge%20he%22im%23%C3%BC@{camera.address}/")
    assert done.returncode == 0
    assert done.stderr.count("shows in the list of processes (ps)") == 1


@pytest.mark.live
def test_a_password_of_another_host_or_user_goes_nowhere(
    camera: HttpCamera, home: Path, command: Command
):
    words = ("tunenet-record", "-o", str(home / "drop.mcap"), "--camera")
    for text, says in (
        (f"machine 127.0.0.2 login {USER} password x\ndefault login a password b", "wants a"),
        ("machine 127.0.0.1 login you password x", "no password of this user"),
        ("machine 127.0.0.1 login", "no password of this user"),
    ):
        written(home / ".netrc", text)
        address = f"{USER}@{camera.address}" if "you" in text else camera.address
        done = command(*words, f"http://{address}/")
        assert done.returncode == 1
        assert "(401" in done.stderr
        assert says in done.stderr
        assert done.stderr.count("\n") == 1
        assert not any("eDo" in seen for seen in camera.seen)
    written(home / ".netrc", f"machine 127.0.0.1 login {USER} password x", 0o644)
    done = command(*words, f"http://{camera.address}/")
    assert f"chmod 600 {home / '.netrc'}" in done.stderr
    assert set(camera.seen) <= {"", f"Basic {b64encode(b'me:').decode()}"}


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is empty"),
        (b"\n", "is empty"),
        (b"one\ntwo\n", "has several lines"),
        (b"a\tb\n", "nobody can type"),
        (b"\xff\xfea\x00", "no UTF-8"),
        (b"x" * 5000, "larger than 4.096 kB"),
    ],
)
def test_a_file_without_one_password_is_refused(home: Path, data: bytes, says: str):
    (home / "password").write_bytes(data)
    with pytest.raises(UsageError, match=says):
        read_password(home / "password", "--password-file")


@pytest.mark.parametrize("data", [b"a b#\r\n", b"a b#", b"\xef\xbb\xbfa b#\n"])
def test_a_line_is_a_password(home: Path, data: bytes):
    (home / "password").write_bytes(data)
    assert read_password(home / "password", "--password-file")[0] == "a b#"


def test_what_is_no_file_is_refused(home: Path, command: Command):
    os.mkfifo(home / "pipe")
    for place, says in (("pipe", "no regular file"), ("gone", "No such file"), (".", "directory")):
        done = command(
            "tunenet-record", "--camera", "http://me@127.0.0.1:1/", "--password-file", home / place
        )
        assert done.returncode == 2
        assert says in done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        ("http://127.0.0.1:1/", "Write USER@ before the host"),
        ("http://me:x@127.0.0.1:1/", "leave one out"),
        ("drop.mp4", "leave it out"),
        ("tcp://127.0.0.1:1", "leave it out"),
    ],
)
def test_a_file_that_is_for_no_user_is_refused(
    home: Path, command: Command, camera: str, says: str
):
    file = written(home / "password", "x")
    done = command("tunenet-record", "--camera", camera, "--password-file", str(file), cwd=home)
    assert done.returncode == 2
    assert says in done.stderr


@pytest.mark.parametrize(
    "text",
    [
        "# wandb\nmachine api.wandb.ai\n  login user\n  password 0123\nmachine cam\n  login me\n"
        "  password x#y\n",
        "machine cam\n\tlogin me\n\tpassword x#y\n\tmacdef init\n\tbin\n\n",
        "macdef up\nput $1\n\nmachine cam login me password x#y # mine\n",
        "machine cam\r\n  login me\r\n  password x#y\r\n",
        "machine CAM login me account a password x#y\ndefault login anonymous password b\n",
        "\ufeffmachine cam login me password x#y\n",
        "machine cam login me password x#y\nmachine other login a\n",
        "machine cam protocol https login me password x#y\n",
        "machine cam login you password z\nmachine cam login me password x#y\n",
        "machine cam login me password x#y\nmachine cam login you password z\n",
    ],
)
def test_netrc_files_as_others_write_them(home: Path, text: str):
    written(home / ".netrc", text)
    known = netrc_login("cam", "me")
    assert (known.user, known.password, known.trouble) == ("me", "x#y", "")
