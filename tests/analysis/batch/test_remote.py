"""Logs that lie elsewhere: a real S3 server and a real web server, over loopback."""

from __future__ import annotations

import http.server
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from tests.analysis.batch.relay import CountingRelay
from tests.analysis.batch.test_ledger import ledger_of, write_drop
from tests.conftest import Command
from tunenet_logs.analysis.batch.ledger import ledger_file
from tunenet_logs.analysis.batch.logs import fetched, log_address
from tunenet_logs.errors import LogError

pytest.importorskip("moto.server")
pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for seed in range(3):
        write_drop(folder / f"drop{seed}.mcap", seed)
    (folder / "bad.mcap").write_bytes(b"none" * 100)
    return folder


@pytest.fixture(scope="module")
def s3(logs: Path) -> Iterator[CountingRelay]:
    """A bucket `lab` with the logs in `runs/`."""
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    relay = CountingRelay(server.get_host_and_port()[1])
    given = {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{relay.port}",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in given.items():
            patch.setenv(name, value)
        client = boto3.client("s3")
        client.create_bucket(Bucket="lab")
        for log in logs.iterdir():
            client.upload_file(str(log), "lab", f"runs/{log.name}")
        client.put_object(Bucket="lab", Key="runs/notes.md", Body=b"x")
        yield relay
    server.stop()


@pytest.mark.parametrize("named", ["s3://lab/runs/", "s3://lab/runs/*.mcap"])
def test_a_bucket_is_read_once(
    s3: CountingRelay, logs: Path, tmp_path: Path, command: Command, named: str
):
    out = tmp_path / "out"
    s3.passed = 0
    words = ("tunenet-tune", named, "-o", str(out), "--no-review", "--jobs", "1", "--resume")
    done = command(*words)
    size = sum(one.stat().st_size for one in logs.iterdir())
    assert size <= s3.passed < 1.1 * size + 4 * 4096  # answers have headers
    rows = {row["log"].rsplit("/", 1)[1]: row for row in ledger_of(out)}
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "bad.mcap": "rejected",
        **{f"drop{seed}.mcap": "ok" for seed in range(3)},
    }
    assert all(row["log"].startswith("s3://lab/runs/") for row in rows.values())
    assert "4 logs: 4 tuned" in done.stdout
    assert "4 logs: 0 tuned" in command(*words).stdout


@pytest.mark.usefixtures("s3")
def test_a_bucket_that_is_not_there_is_one_line(tmp_path: Path, command: Command):
    done = command("tunenet-tune", "s3://nobody/", "-o", str(tmp_path / "out"))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    done = command("tunenet-tune", "s3://lab/gone.mcap", "-o", str(tmp_path / "out"))
    assert done.returncode == 1
    assert "s3://lab/gone.mcap: cannot be read" in done.stderr


@pytest.fixture
def web(logs: Path) -> Iterator[str]:
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(logs)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


def test_a_web_server_is_read(web: str, tmp_path: Path, command: Command):
    out = tmp_path / "out"
    done = command("tunenet-tune", f"{web}/drop1.mcap", f"{web}/nothing.mcap", "-o", str(out))
    assert done.returncode == 1
    rows = ledger_of(out)
    assert {row["verdict"] for row in rows if row["log"].endswith("drop1.mcap")} == {"ok"}
    (gone,) = (row for row in rows if row["log"].endswith("nothing.mcap"))
    assert "cannot be read" in gone["error"]
    assert ledger_file(out).exists()


@pytest.fixture
def hostile() -> Iterator[str]:
    """A server that drips a byte at a time, and one whose answer unpacks to gigabytes."""

    class Hostile(http.server.BaseHTTPRequestHandler):
        def do_HEAD(self) -> None:
            self.answer()

        def do_GET(self) -> None:
            self.answer()
            pack = zlib.compressobj(9, zlib.DEFLATED, 31)
            with suppress(OSError):
                for _ in range(600 if "drip" in self.path else 4000):
                    is_slow = "drip" in self.path
                    self.wfile.write(b"x" if is_slow else pack.compress(bytes(1 << 20)))
                    time.sleep(0.1 * is_slow)

        def answer(self) -> None:
            self.send_response(200)
            if "unpacks" in self.path:
                self.send_header("Content-Encoding", "gzip")
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hostile)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("drip.mcap", "cannot be read (under 10000 bytes came in 1 s)"),
        ("unpacks.mcap", "unpacks to over 20 MB"),
    ],
)
def test_a_hostile_server_is_left(
    hostile: str, name: str, said: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("tunenet_logs.analysis.batch.logs._SILENT_S", 1)
    monkeypatch.setattr("tunenet_logs.analysis.batch.logs._UNTOLD_BYTES", 20_000_000)
    with pytest.raises(LogError) as caught, fetched(log_address(f"{hostile}/{name}")):
        pass
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("file:///etc/passwd", "no address that is read"),
        ("simplecache::s3://lab/a.mcap", "no address that is read"),
        ("ftp://host/a.mcap", "no address that is read"),
    ],
)
def test_other_addresses_are_refused(tmp_path: Path, command: Command, address: str, said: str):
    done = command("tunenet-tune", address, "-o", str(tmp_path))
    assert done.returncode == 2
    assert said in done.stderr


def test_results_of_remote_logs_need_a_place(command: Command):
    done = command("tunenet-tune", "s3://lab/a.mcap")
    assert done.returncode == 2
    assert "give -o DIR" in done.stderr
