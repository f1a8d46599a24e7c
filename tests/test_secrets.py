"""What proves a right to a log or a camera is in no file, name and line of any command."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from urllib.parse import quote, unquote

import pytest

from tests.analysis.batch.test_ledger import ledger_of, write_drop
from tests.conftest import Command
from tests.recorders.servers import HttpServer, http_camera, http_server
from tunenet_logs.addresses import Address, without_secrets

pytest.importorskip("aiohttp")
pytestmark = pytest.mark.live

USER, PASSWORD = "meuser", "hunter2/s@cret+%"
PROOF = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
SIGNATURE = "5f3c9a1be7d2Signature"
PARTS = ("hunter2", "s@cret", "s%40cret")  # of the password, however it is written
SECRETS = (USER, *PARTS, PROOF, SIGNATURE, "AKIAEXAMPLE")
LOGIN = f"{USER}:{quote(PASSWORD, safe='')}@"
SIGNED = (
    "X-Amz-Algorithm=AWS4-HMAC-SHA256&X-Amz-Credential=AKIAEXAMPLE%2F20261127%2Fs3&X-Amz-Date="
    f"20261127T000000Z&X-Amz-Expires=900&X-Amz-SignedHeaders=host&X-Amz-Signature={SIGNATURE}"
)


def log_server(logs: Mapping[str, bytes], moved: str = "") -> AbstractContextManager[HttpServer]:
    """Logs by path for whoever has a login or a signature; of a number, that code.

    It sends on from /moved.mcap to another server, whose address is without a scheme.
    """

    def answer(path: str, given: str) -> tuple[int, list[tuple[str, str]], bytes]:
        name, _, query = path.partition("?")
        if name[1:4].isdecimal():
            return int(name[1:4]), [("Content-Length", "0")], b""
        if given != f"Basic {PROOF}" and SIGNATURE not in unquote(query):
            return 401, [("Content-Length", "0")], b""
        if name == "/moved.mcap":
            return 302, [("Location", f"http://{moved}/drop.mcap"), ("Content-Length", "0")], b""
        data = logs.get(name, b"")
        return (200 if data else 404), [("Content-Length", str(len(data)))], data

    return http_server(HttpServer(answer))


def contents(file: Path) -> Iterator[bytes]:
    """A file's bytes, and what compression hides of them."""
    yield file.read_bytes()
    if file.suffix == ".parquet":
        from pyarrow import parquet

        yield repr(parquet.read_table(file).to_pylist()).encode()
    elif file.suffix == ".mcap":
        from mcap.reader import make_reader

        with file.open("rb") as opened:
            reader = make_reader(opened)
            yield repr([repr(one) for one in reader.iter_metadata()]).encode()
            yield from (message.data for _, _, message in reader.iter_messages())
    elif file.suffix == ".rrd":
        from rerun.chunk import RrdReader

        for chunk in RrdReader(file).stream():
            yield repr(chunk.to_record_batch().to_pydict()).encode()


def found_secrets(folder: Path, *said: str) -> list[str]:
    """Where which secret is: in names, files, what a command said."""
    places = [(str(file.relative_to(folder)), str(file).encode()) for file in folder.rglob("*")]
    files = [file for file in folder.rglob("*") if file.is_file()]
    places += [(file.name, part) for file in files for part in contents(file)]
    places += [("what is said", text.encode()) for text in said]
    return [
        f"{secret} in {at}" for at, text in places for secret in SECRETS if secret.encode() in text
    ]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_drop(tmp_path_factory.mktemp("log") / "drop.mcap", 1).read_bytes()


@pytest.fixture
def server(log: bytes) -> Iterator[HttpServer]:
    logs = {"/drop.mcap": log, "/cut.mcap": log[: len(log) // 2], "/none.mcap": b"none" * 100}
    with log_server(logs) as served:
        yield served


def addresses(host: str, name: str) -> list[str]:
    return [f"http://{LOGIN}{host}/{name}", f"http://{host}/{name}?{SIGNED}"]


FAILING = ("401.mcap", "403.mcap", "404.mcap", "none.mcap", "gone.mcap")


@pytest.mark.parametrize("flags", [(), ("-v", "--debug"), ("--json", "-", "--quiet")])
def test_a_log_that_fails_tells_no_secret(server, tmp_path: Path, command: Command, flags):
    hosts = [(server.address, name) for name in FAILING]
    hosts += [("127.0.0.1:1", "refused.mcap"), ("nobody.invalid", "dns.mcap")]
    for way in (0, 1):
        out = tmp_path / f"out{way}"
        named = [addresses(host, name)[way] for host, name in hosts]
        done = command(
            "tunenet-tune", *named, "-o", out, "--csv", out / "all.csv", "--jobs", 1, *flags
        )
        assert done.returncode == 1
        assert len(ledger_of(out)) == len(hosts)
        assert found_secrets(tmp_path, done.stdout, done.stderr) == []
    one = command("tunenet-tune", addresses(server.address, "403.mcap")[1], "-o", tmp_path / "one")
    assert "/403.mcap: cannot be read (403 Forbidden)" in one.stderr + one.stdout
    assert found_secrets(tmp_path, one.stdout, one.stderr) == []


def test_a_log_that_is_tuned_tells_no_secret(server: HttpServer, tmp_path: Path, command: Command):
    out = tmp_path / "out"
    named = [addresses(server.address, "drop.mcap")[0], addresses(server.address, "cut.mcap")[1]]
    words = ("tunenet-tune", *named, "-o", out, "--json", out / "all.jsonl", "--resume", "-v")
    said = [command(*words, "--jobs", 1)]
    assert {row["log"] for row in ledger_of(out)} == {
        f"http://{server.address}/{name}.mcap" for name in ("drop", "cut")
    }
    tuned = out / "drop.json"
    assert json.loads(tuned.read_text())["verdict"] == "ok"
    said += [
        command("tunenet-report", tuned, "-o", tmp_path / "page.html"),
        command("tunenet-compare", tuned, out / "cut.json"),
        command("tunenet-export", tuned, "--to", "yaml", "-o", tmp_path / "ball.yaml"),
        command("tunenet-review", out, "-o", tmp_path / "review.rrd"),
    ]
    assert [one.returncode for one in said[1:]] == [0] * 4
    assert (out / "ledger.rrd").exists()
    texts = [text for one in said for text in (one.stdout, one.stderr)]
    assert found_secrets(tmp_path, *texts) == []


def test_another_host_gets_no_login(log: bytes, tmp_path: Path, command: Command):
    with log_server({"/drop.mcap": log}) as other, log_server({}, other.address) as server:
        for way, address in enumerate(addresses(server.address, "moved.mcap")):
            done = command("tunenet-tune", address, "-o", tmp_path / f"{way}", "--no-review")
            assert done.returncode == 1
            assert found_secrets(tmp_path, done.stdout, done.stderr) == []
        assert set(other.seen) <= {""}


def test_a_log_signed_anew_is_the_same(server: HttpServer, tmp_path: Path, command: Command):
    words = partial(command, "tunenet-tune", "-o", tmp_path, "--no-review", "--resume")
    host = f"http://{server.address}/drop.mcap"
    assert "1 logs: 1 tuned" in words(f"{host}?{SIGNED}&run=7").stdout
    anew = SIGNED.replace("20261127", "20261128").replace("900", "60")
    assert "1 logs: 0 tuned" in words(f"{host}?run=7&{anew}").stdout
    assert ledger_of(tmp_path)[0]["log"] == f"{host}?run=7"
    assert [path.name for path in tmp_path.glob("drop*")] == ["drop.json"]
    twice = words(f"{host}?{SIGNED}", f"{host}?{anew}")
    assert twice.returncode == 2
    assert "is named twice, with other logins or signatures" in twice.stderr
    assert found_secrets(tmp_path, twice.stderr) == []


def test_the_login_of_a_log_may_stand_in_netrc(
    server: HttpServer, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
):
    file = tmp_path / "netrc"
    file.write_text(f"machine 127.0.0.1 login {USER} password {PASSWORD}")
    monkeypatch.setenv("NETRC", str(file))
    words = ("tunenet-tune", f"http://{server.address}/none.mcap", "-o", tmp_path / "out")
    for mode, says in ((0o600, "is not an MCAP log"), (0o644, f"401 Unauthorized, and {file} is")):
        file.chmod(mode)
        done = command(*words)
        assert says in done.stderr + done.stdout
        assert found_secrets(tmp_path / "out", done.stdout, done.stderr) == []
    assert set(server.seen) == {f"Basic {PROOF}", ""}


@pytest.mark.parametrize(
    "words",
    [
        ("tunenet-logs", "info"),
        ("tunenet-logs", "import"),
        ("tunenet-tune", "drop.mcap", "-o"),
        ("tunenet-tune", "drop.mcap", "--tare"),
        ("tunenet-tune", "drop.mcap", "--task"),
        ("tunenet-tune", "--preview"),
        ("tunenet-report", "-o", "page.html"),
        ("tunenet-record", "--camera", "0", "-o"),
        ("tunenet-record", "--camera", "0"),
        ("tunenet-record", "--outcome", "success", "--ball", "x", "-o"),
    ],
)
@pytest.mark.parametrize(
    "form",
    [
        f"https://{LOGIN}host/drop.mcap",
        f"https:/{LOGIN}host/drop.mcap?sig={SIGNATURE}",
        f"{LOGIN}host.local/drop.mcap",
        f"s3://AKIAEXAMPLE:{PASSWORD}@bucket/drop.mcap",
    ],
)
def test_where_no_address_is_read_none_is_told(tmp_path, command: Command, words, form: str):
    done = command(*words, form, cwd=tmp_path)
    assert done.returncode in (1, 2) or words[1:3] == ("--outcome", "success")
    assert found_secrets(tmp_path, done.stdout, done.stderr) == []
    assert done.stderr.count("\n") <= 1


KEPT = "https://host/drop.mcap?run=7"


@pytest.mark.parametrize(
    "query",
    [
        SIGNED,
        f"X-Goog-Algorithm=GOOG4-RSA-SHA256&X-Goog-Credential=a%40b.iam&X-Goog-Signature={SIGNATURE}",
        f"GoogleAccessId=a%40b.iam&Expires=1700000000&Signature={SIGNATURE}",
        f"AWSAccessKeyId=AKIAEXAMPLE&Expires=1700000000&Signature={SIGNATURE}",
        f"sv=2022-11-02&ss=b&srt=o&sp=r&st=2026-01-01T00%3A00Z&se=2026-01-02&spr=https&sr=b&sig={SIGNATURE}",
        f"Policy=eyJTdGF0ZW1lbnQ_&Signature={SIGNATURE}&Key-Pair-Id=K2JCJMDEHXQW5F&Hash-Algorithm=SHA1",
        f"OSSAccessKeyId=LTAI&Expires=1700000000&Signature={SIGNATURE}",
        f"x-oss-signature-version=OSS4-HMAC-SHA256&x-oss-credential=L&x-oss-signature={SIGNATURE}",
        f"q-sign-algorithm=sha1&q-ak=AKID&q-sign-time=1;2&q-header-list=host&q-signature={SIGNATURE}",
        f"temp_url_sig={SIGNATURE}&temp_url_expires=1700000000",
        f"Authorization=4_00{SIGNATURE}",
        f"md5={SIGNATURE}&expires=1700000000",
        f"hdnts=exp=1700000000~acl=/*~hmac={SIGNATURE}",
        f"verify=1700000000-{SIGNATURE}",
        f"token={SIGNATURE}",
        f"access_token={SIGNATURE}&user={USER}",
        f"private_token={SIGNATURE}",
        f"api-key={SIGNATURE}",
        f"subscription-key={SIGNATURE}",
        f"rlkey={SIGNATURE}&st=abc12345&dl=1",
        f"tempauth={SIGNATURE}",
        f"jwt=eyJh.{SIGNATURE}.abc",
        f"__token__=exp=1700000900~hmac={SIGNATURE}&__gda__=1700000000_abc",
        f"skoid=1a&sktid=2b&skt=2026-11-27&ske=2026-11-28&sks=b&skv=2022-11-02&sig={SIGNATURE}",
        f"X-Amz-Credential=AKIAEXAMPLE&amp;X-Amz-Signature={SIGNATURE}",
        f"x%2Damz%2Dsignature={SIGNATURE}&%74oken={SIGNATURE}",
        f"user={USER}&password={quote(PASSWORD)}",
        f"loginuse={USER}&loginpas={quote(PASSWORD)}",
    ],
)  # fmt: skip
def test_of_each_kind_of_signature_nothing_is_left(query: str):
    address = Address.of(f"https://{LOGIN}host/drop.mcap?{query}&run=7")
    kept = KEPT.replace("?", "?dl=1&") if "dl=1" in query else KEPT
    assert str(address) == kept
    assert query in address.url
    said = without_secrets(f"GET ({address.full_url!r}#access_token={SIGNATURE}) failed")
    for text in (str(address), repr(address), said):
        assert not any(secret in text for secret in SECRETS if secret != "AKIAEXAMPLE"), text


@pytest.mark.parametrize(
    "query",
    ["run=7", "file=day1/drop.mcap", "policy=ppo&seed=3", "t=12", "versionId=3HL4kqtJlcpXroDTDmJ"],
)
def test_what_picks_a_log_stays(query: str):
    assert str(Address.of(f"https://host/get?{query}")) == f"https://host/get?{query}"


def test_what_may_be_a_secret_tells_logs_apart_by_a_digest():
    one, other = (Address.of(f"https://host/get?id=1A2b3C4d5E6f7G8h{end}") for end in "ij")
    assert one != other
    assert re.fullmatch(r"https://host/get\?id=~[0-9a-f]{12}", str(one))


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("https://me:pw@host", "host"),
        ("https://host/get.php?file=day1/drop.mcap&token=a", "drop.mcap"),
        ("https://host/drop.mcap?file=other.mcap", "drop.mcap"),
        ("https://host/1?rsp=attachment%3B%20filename%3Ddrop.mcap", "drop.mcap"),
        ("https://host/get?api=SYNO.FileStation.Download&path=%2Fdrop.mcap", "drop.mcap"),
        ("s3://key:se/cr+et@bucket/day 1/drop#2.mcap", "drop#2.mcap"),
        ("abfs://runs@account.dfs.core.windows.net/drop.mcap", "drop.mcap"),
    ],
)
def test_what_a_log_at_an_address_is_called(text: str, name: str):
    address = Address.of(text)
    assert address.name == name
    assert "se/cr" not in str(address)
    assert address.user == {"s3": "key", "ht": "me" if "me:" in text else "", "ab": ""}[text[:2]]


@pytest.mark.parametrize(
    "text",
    ["https://me:pa/ss@host/x", "https://me:12/3@host/x", "s3://a:b/c@d@lab/x", "https://:pw@/x"],
)
def test_a_login_that_cannot_be_told_is_refused(tmp_path: Path, command: Command, text: str):
    done = command("tunenet-tune", text, "-o", tmp_path)
    assert done.returncode == 2
    said = r"tunenet-tune: that is no (https|s3) address; write (/ \? # @ %|it like https://).*\n"
    assert re.fullmatch(said, done.stderr)


@pytest.mark.parametrize("flags", [(), ("--debug",)])
def test_a_recording_tells_no_secret(tmp_path: Path, command: Command, flags: tuple[str, ...]):
    with http_camera('Basic realm="x"', proves=f"Basic {PROOF}".__eq__) as served:
        for name, login in (("good", LOGIN), ("bad", f"{USER}:{SIGNATURE}@"), ("none", "")):
            url = f"http://{login}{served.address}/video?pwd={SIGNATURE}"
            file = tmp_path / f"{name}.mcap"
            done = command("tunenet-record", "--camera", url, "-o", file, *flags)
            assert done.returncode == (name != "good")
            assert file.exists() is (name == "good")
            assert "shows in the list of processes" in done.stderr or name != "good"
            assert found_secrets(tmp_path, done.stdout, done.stderr) == []


def test_quick_texts_stay_quick():
    """Texts of strangers pass here: no pattern may take longer than their length is worth."""
    for text in ("a:/b:c" * 20_000 + "@", "(:" * 50_000 + "@x/", "?a=" * 40_000):
        assert without_secrets(text)
