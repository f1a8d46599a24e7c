"""Who may look: passwords and where they stand, digests, certificates, and where neither goes."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from tests.recorders.conftest import Record, Refuses
from tests.recorders.films import PATIENT
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import playing
from tests.recorders.programs import gst_rtsp_server, motion_server, nginx_server
from tests.recorders.servers import (
    PICTURES,
    HttpServer,
    digest_of,
    fingerprint_of,
    http_camera,
    self_signed,
)
from tunenet_logs.errors import CameraError, UsageError
from tunenet_logs.passwords import netrc_login, read_password
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.sources import open_source

CAMERA = ("--stall", LAST_RESORT_S, "-o", "a.mcap", "--camera")
WRONG, MISSING = "refuses this user and password (401)", "wants a password (401)"
OTHER = "0" * 64
live = pytest.mark.live

# ---- Digests, in all the ways in which cameras ask

PASSWORD = 'se"cr\\et'
URL = "http://me:se%22cr%5Cet@"


def pictures(url: str) -> int:
    return len(list(open_source(url, PATIENT).frames()))


def digest_camera(*challenges: str, kind: str = "md5") -> AbstractContextManager[HttpServer]:
    def proves(given: str) -> bool:
        found = re.search(r'response="([0-9a-f]+)"', given)
        return bool(found) and found[1] == digest_of(given, kind, "me", PASSWORD)

    return http_camera(*challenges, proves=proves)


@live
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
    with digest_camera(challenge, kind=kind) as camera:
        assert pictures(URL + camera.address) == PICTURES
        assert camera.seen[0] == ""
        assert 'opaque="o"' in camera.seen[1]
        assert PASSWORD not in camera.seen[1]


@live
@pytest.mark.parametrize(
    "challenges",
    [
        ('Basic realm="x", Digest nonce="a", Digest realm="x", nonce="n", algorithm=SHA-256',),
        ('Basic realm="x"', 'Digest realm="x", nonce="a"', 'Digest algorithm=SHA-256, nonce="n"'),
        ("NTLM abc==", 'Digest algorithm=SHA-256,realm="x",nonce="n",qop="auth"', "Digest nonce=a"),
    ],
)  # fmt: skip
def test_of_several_ways_the_strongest_is_taken(challenges: tuple[str, ...]):
    with digest_camera(*challenges, kind="sha256") as camera:
        assert pictures(URL + camera.address) == PICTURES


@live
@pytest.mark.parametrize(
    ("challenge", "login", "says"),
    [
        ('Digest realm="x", nonce="n"', "", MISSING),
        ('Basic realm="x"', "", MISSING),
        ('Digest realm="x", nonce="n"', "me:no@", WRONG),
        ('Basic realm="x"', "me:no@", WRONG),
        ('Digest realm="x", nonce="n", qop="auth-int"', "me:no@", "digest auth-int"),
        ('Digest realm="x", nonce="n", algorithm=X', "me:no@", "digest X"),
        ("NTLM", "me:no@", "login by ntlm"),
        ("", "me:no@", "login by nothing"),
        ('Digest realm="x", nonce="n", stale=TRUE', "me:no@", "answers 401"),  # for ever
    ],
)
def test_wrong_missing_and_unknown_are_told_apart(challenge: str, login: str, says: str):
    with http_camera(challenge, proves=lambda _given: False) as camera:
        with pytest.raises(CameraError, match=re.escape(says)):
            open_source(f"http://{login}{camera.address}", PATIENT)
        assert len(camera.seen) < (20 if "stale" in challenge else 3)


@pytest.mark.parametrize(
    ("kind", "response"),
    [
        ("md5", "8ca523f5e9506fed4657c9700eebdbec"),
        ("sha256", "753927fa0e85d155564e2e272a28d1802ca10daf4496794697cf8db5856cb6c1"),
    ],
)
def test_what_proves_it_here_proves_it_in_the_example_of_rfc_7616(kind: str, response: str):
    given = (
        'realm="http-auth@example.org", nonce="7ypf/xlj9XXwfDPEoM4URrv/xwf94BcCAzFZH4GiTo0v", '
        'uri="/dir/index.html", nc=00000001, qop=auth, '
        'cnonce="f2/wE4q74E6zIJEtWaHKaf5wv/H5QzzpXusqGemxURZJ"'
    )
    assert digest_of(given, kind, "Mufasa", "Circle of Life") == response


# ---- A password in no argument: from a file, the environment, or `~/.netrc`

ODD = 'ge he"im#ü'
PROOF = "Basic " + b64encode(f"me:{ODD}".encode()).decode()


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("NETRC", raising=False)
    monkeypatch.delenv("TUNENET_CAMERA_PASSWORD", raising=False)
    return tmp_path


@pytest.fixture
def camera() -> Iterator[HttpServer]:
    with http_camera('Basic realm="x"', proves=PROOF.__eq__) as served:
        yield served


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text, "utf-8")
    path.chmod(mode)
    return path


@live
@pytest.mark.parametrize("way", ["file", "variable", "netrc", "netrc without the user"])
def test_a_password_needs_no_argument(
    camera: HttpServer, home: Path, record: Record, monkeypatch: pytest.MonkeyPatch, way: str
):
    user = "" if way == "netrc without the user" else "me@"
    words: list[object] = [*CAMERA, f"http://{user}{camera.address}/"]
    if way == "file":
        words += ["--password-file", written(home / "password", f"{ODD}\n")]
    elif way == "variable":
        monkeypatch.setenv("TUNENET_CAMERA_PASSWORD", ODD)
    else:
        quoted = ODD.replace('"', '\\"')
        written(home / ".netrc", f'machine 127.0.0.1 login me password "{quoted}"\n')
    done = record(*words)
    assert "processes" not in done.stderr
    assert camera.seen[-1] == PROOF
    assert ODD.encode() not in (home / "a.mcap").read_bytes()


@live
def test_of_a_password_that_others_can_see_one_line_is_said(camera, home, record: Record):
    file = written(home / "password", ODD, 0o644)
    done = record(*CAMERA, f"http://me@{camera.address}/", "--password-file", file)
    assert f"{file}: others can read this password; chmod 600 {file}" in done.stderr
    done = record(*CAMERA, f"http://me:ge%20he%22im%23%C3%BC@{camera.address}/", "--overwrite")
    assert done.stderr.count("shows in the list of processes (ps)") == 1


@live
def test_a_password_of_another_host_or_user_goes_nowhere(camera, home, command, refuses: Refuses):
    for text, says in (
        ("machine 127.0.0.2 login me password x\ndefault login a password b", "wants a"),
        ("machine 127.0.0.1 login you password x", "no password of this user"),
        ("machine 127.0.0.1 login", "no password of this user"),
    ):
        written(home / ".netrc", text)
        user = "me@" if "you" in text else ""
        refuses(1, *CAMERA, f"http://{user}{camera.address}/", says=("(401", says))
        assert not any("eDo" in seen for seen in camera.seen)
    written(home / ".netrc", "machine 127.0.0.1 login me password x", 0o644)
    done = command("tunenet-record", *CAMERA, f"http://{camera.address}/", cwd=home)
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
        *((data, "") for data in (b"a b#\r\n", b"a b#", b"\xef\xbb\xbfa b#\n")),
    ],
)
def test_a_file_holds_one_password_or_is_refused(tmp_path: Path, data: bytes, says: str):
    file = tmp_path / "password"
    file.write_bytes(data)
    if not says:
        assert read_password(file, "--password-file")[0] == "a b#"
        return
    with pytest.raises(UsageError, match=says):
        read_password(file, "--password-file")


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


# ---- Encrypted cameras: which certificate is believed, and where a password goes


@live
def test_an_unknown_certificate_is_refused(record: Record, refuses: Refuses, tmp_path: Path):
    known = fingerprint_of(self_signed())
    plain = known.replace(":", "")
    with http_camera(certificate=self_signed()) as camera:
        url = f"https://{camera.address}/video"
        said = refuses(1, *CAMERA, url, says="--insecure")
        assert not camera.seen
        options = said.partition("add ")[2].split(";")[0].split()
        assert options == ["--fingerprint", plain]
        refuses(1, *CAMERA, url, "--fingerprint", OTHER, says=(OTHER, plain))
        for allowed in (options, ["--fingerprint", known], [options[0], known.lower()]):
            record(*CAMERA, url, *allowed, "--overwrite")
            assert len(list(read_episode(tmp_path / "a.mcap").frames())) == PICTURES
        record(*CAMERA, url, "--insecure", "--overwrite")  # believes any


@live
def test_a_password_never_leaves_its_encryption(refuses: Refuses):
    with http_camera('Basic realm="x"') as plain:
        refuses(1, *CAMERA, f"https://{plain.address}/", "--insecure", says="encryption")
        del plain.seen[:]
        target = f"http://{plain.address}/video"
        with http_camera(moved=target, certificate=self_signed()) as camera:
            url = f"https://me:secret@{camera.address}/moved"
            refuses(1, *CAMERA, url, "--insecure", says=f"sends on to {target}")
    assert not plain.seen


@live
def test_a_camera_may_send_on_to_its_own_encryption(refuses: Refuses):
    with (
        http_camera(certificate=self_signed()) as safe,
        http_camera(moved=f"https://{safe.address}/video") as camera,
    ):  # the address is http: it has to be given as https
        refuses(1, *CAMERA, f"http://{camera.address}/moved", says="--fingerprint")


# ---- Servers that others wrote


def check_login(record: Record, refuses: Refuses, url: str, *options: object) -> None:
    """Check that me with secret may look, and nobody else; `url` has no user."""
    scheme, _, place = url.partition("://")
    said = refuses(1, *CAMERA, f"{scheme}://me:guess@{place}", *options, says=WRONG)
    assert "guess" not in said
    refuses(1, *CAMERA, url, *options, says=MISSING)
    record(*CAMERA, f"{scheme}://me:secret@{place}", *options)


@live
def test_motion_with_its_digest(record: Record, refuses: Refuses, tmp_path: Path):
    with (
        playing(frames=100_000, rate_hz=20.0, distinct=20) as camera,
        motion_server(tmp_path / "motion", camera) as address,
    ):
        check_login(record, refuses, f"http://{address}", "--seconds", 0.5)
    assert b"secret" not in (tmp_path / "a.mcap").read_bytes()


@live
def test_nginx_with_its_own_certificate(record: Record, refuses: Refuses, tmp_path: Path):
    with playing(frames=20, rate_hz=200.0) as camera:
        place, _, path = camera.partition("/")
        rules = f"""location / {{ auth_basic "camera"; auth_basic_user_file {tmp_path}/nginx/users;
            proxy_pass http://{place}; proxy_buffering off; }}
            location /moved {{ return 302 /{path}; }}"""
        with nginx_server(tmp_path / "nginx", rules, self_signed()) as address:
            pinned = ("--fingerprint", fingerprint_of(self_signed()))
            refuses(1, *CAMERA, f"https://me:secret@{address}/moved", says="--fingerprint")
            check_login(record, refuses, f"https://{address}/moved", *pinned)
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 20


@live
@pytest.mark.parametrize("auth", ["basic", "digest"])
def test_gstreamer_over_rtsp(record: Record, refuses: Refuses, tmp_path: Path, auth: str):
    with gst_rtsp_server(auth=auth) as address:
        check_login(record, refuses, f"rtsp://{address}", "--seconds", 0.29)
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 9


@live
def test_gstreamer_over_encrypted_rtsp(record: Record, refuses: Refuses):
    pinned = fingerprint_of(self_signed())
    with gst_rtsp_server(tls=self_signed(), auth="digest") as address:
        refuses(1, *CAMERA, f"rtsps://me:secret@{address}", says=pinned.replace(":", ""))
        refuses(1, *CAMERA, f"rtsp://me:secret@{address}")
        options = ("--fingerprint", pinned, "--seconds", 0.29)
        check_login(record, refuses, f"rtsps://{address}", *options)
