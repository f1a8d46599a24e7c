"""Cameras that ask who is there, in all the ways in which they do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import Command
from tests.recorders.http_camera import PICTURES, HttpCamera, digest_of, http_camera
from tests.recorders.live_wait import LAST_RESORT_S
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera import network as login_module
from tunenet_logs.recorders.camera.network import Login
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.sources import open_source

USER, PASSWORD = "me", 'se"cr\\et'
URL = f"http://{USER}:se%22cr%5Cet@"


def pictures(url: str) -> int:
    return len(list(open_source(url, CameraOptions(stall_s=LAST_RESORT_S)).frames()))


def wanting(*challenges: str, kind: str = "md5") -> HttpCamera:
    """A camera that wants a digest, of a known user and password."""

    def proves(given: str) -> bool:
        found = re.search(r'response="([0-9a-f]+)"', given)
        return bool(found) and found[1] == digest_of(given, kind, USER, PASSWORD)

    return HttpCamera(challenges, proves)


@pytest.mark.live
@pytest.mark.parametrize("quality", ["", ', qop="auth"', ", qop=auth", ', qop="auth-int,auth"'])
@pytest.mark.parametrize(
    ("algorithm", "kind"),
    [
        ("", "md5"),
        (", algorithm=MD5", "md5"),
        (", algorithm=md5", "md5"),
        (', algorithm="MD5-sess"', "md5"),
        (", algorithm=SHA-256", "sha256"),
        (", algorithm=SHA-256-sess", "sha256"),
        (", algorithm=sha-512-256", "sha512_256"),
    ],
)
def test_a_digest_in_each_form(algorithm: str, kind: str, quality: str):
    challenge = f'Digest realm="a, b", nonce="n0", opaque="o"{algorithm}{quality}'
    with http_camera(wanting(challenge, kind=kind)) as camera:
        assert pictures(URL + camera.address) == PICTURES
        assert camera.seen[0] == ""
        assert 'opaque="o"' in camera.seen[1]
        assert PASSWORD not in camera.seen[1]


@pytest.mark.live
@pytest.mark.parametrize(
    "challenges",
    [
        ('Basic realm="x", Digest nonce="a", Digest realm="x", nonce="n", algorithm=SHA-256',),
        ('Basic realm="x"', 'Digest realm="x", nonce="a"', 'Digest algorithm=SHA-256, nonce="n"'),
        ("NTLM abc==", 'Digest algorithm=SHA-256,realm="x",nonce="n",qop="auth"', "Digest nonce=a"),
    ],
)  # fmt: skip
def test_of_several_ways_the_strongest_is_taken(challenges: tuple[str, ...]):
    with http_camera(wanting(*challenges, kind="sha256")) as camera:
        assert pictures(URL + camera.address) == PICTURES


@pytest.mark.live
@pytest.mark.parametrize(
    ("challenge", "login", "says"),
    [
        ('Digest realm="x", nonce="n"', "", r"wants a password \(401\)"),
        ('Basic realm="x"', "", r"wants a password \(401\)"),
        ('Digest realm="x", nonce="n"', "me:no@", r"refuses this user and password \(401\)"),
        ('Basic realm="x"', "me:no@", r"refuses this user and password \(401\)"),
        ('Digest realm="x", nonce="n", qop="auth-int"', "me:no@", "digest auth-int"),
        ('Digest realm="x", nonce="n", algorithm=X', "me:no@", "digest X"),
        ("NTLM", "me:no@", "login by ntlm"),
        ("", "me:no@", "login by nothing"),
    ],
)
def test_wrong_missing_and_unknown_are_told_apart(challenge: str, login: str, says: str):
    never = HttpCamera((challenge,), lambda _given: False)
    with http_camera(never) as camera, pytest.raises(CameraError, match=says):
        open_source(f"http://{login}{camera.address}", CameraOptions(stall_s=LAST_RESORT_S))
    assert len(never.seen) <= 2


@pytest.mark.live
def test_nonces_that_are_always_stale_have_an_end():
    never = HttpCamera(('Digest realm="x", nonce="n", stale=TRUE',), lambda _given: False)
    with http_camera(never) as camera, pytest.raises(CameraError, match="answers 401"):
        open_source(URL + camera.address, CameraOptions(stall_s=LAST_RESORT_S))
    assert len(never.seen) < 20


@pytest.mark.parametrize(
    ("algorithm", "response"),
    [
        ("MD5", "8ca523f5e9506fed4657c9700eebdbec"),
        ("SHA-256", "753927fa0e85d155564e2e272a28d1802ca10daf4496794697cf8db5856cb6c1"),
    ],
)
def test_the_examples_of_rfc_7616(monkeypatch: pytest.MonkeyPatch, algorithm: str, response: str):
    own_nonce = "f2/wE4q74E6zIJEtWaHKaf5wv/H5QzzpXusqGemxURZJ"
    monkeypatch.setattr(login_module.secrets, "token_hex", lambda _size: own_nonce)
    login = Login("Mufasa", "Circle of Life")
    login.take(
        [
            'Digest realm="http-auth@example.org", qop="auth, auth-int", '
            f"algorithm={algorithm}, "
            'nonce="7ypf/xlj9XXwfDPEoM4URrv/xwf94BcCAzFZH4GiTo0v", '
            'opaque="FQhe/qaU925kfnzjCev0ciny7QMkPqMAFRtzCUYo5tdS"'
        ]
    )
    assert f'response="{response}"' in (login.header("GET", "/dir/index.html") or "")


@pytest.mark.parametrize("scheme", ["http", "rtsp"])
def test_a_user_cannot_say_more_than_a_name(command: Command, tmp_path: Path, scheme: str):
    url = f"{scheme}://me%0d%0aX:%20y@127.0.0.1:1/"
    result = command("tunenet-record", "--camera", url, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1


def test_a_login_is_given_anew_where_a_nonce_has_served():
    login = Login("me", "secret")
    assert login.header("GET", "/") is None
    login.take(['Digest realm="x", nonce="a"'])
    login.header("GET", "/1")
    login.header("GET", "/2")
    login.take(['Digest realm="x", nonce="b"'])
    assert 'nonce="b"' in (login.header("GET", "/2") or "")
    with pytest.raises(CameraError, match="refuses"):
        login.take(['Digest realm="x", nonce="c"'])
