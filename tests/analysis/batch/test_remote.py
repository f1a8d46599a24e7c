"""Logs and workers elsewhere: a real S3 server, web server and Ray cluster, over loopback."""

from __future__ import annotations

import http.server
import os
import signal
import subprocess
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path

import pytest

from tests.analysis.batch.relay import CountingRelay
from tests.analysis.batch.test_ledger import ledger_of, verdicts_of, write_drop
from tests.conftest import BIN, Command
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


HOSTILE = ("/drip.mcap", "/unpacks.mcap")


class Web(http.server.SimpleHTTPRequestHandler):
    """The logs' folder; one file drips a byte at a time, the answer of one unpacks to gigabytes."""

    def do_HEAD(self) -> None:
        if self.path in HOSTILE:
            self.answer()
        else:
            super().do_HEAD()

    def do_GET(self) -> None:
        if self.path not in HOSTILE:
            super().do_GET()
            return
        self.answer()
        is_slow, pack = "drip" in self.path, zlib.compressobj(9, zlib.DEFLATED, 31)
        with suppress(OSError):
            for _ in range(600 if is_slow else 4000):
                self.wfile.write(b"x" if is_slow else pack.compress(bytes(1 << 20)))
                time.sleep(0.1 * is_slow)

    def answer(self) -> None:
        self.send_response(200)
        if "unpacks" in self.path:
            self.send_header("Content-Encoding", "gzip")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture
def web(logs: Path) -> Iterator[str]:
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Web, directory=str(logs)))
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


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("drip.mcap", "cannot be read (under 10000 bytes came in 1 s)"),
        ("unpacks.mcap", "unpacks to over 20 MB"),
    ],
)
def test_a_hostile_server_is_left(web: str, name: str, said: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.analysis.batch.logs._SILENT_S", 1)
    monkeypatch.setattr("tunenet_logs.analysis.batch.logs._UNTOLD_BYTES", 20_000_000)
    with pytest.raises(LogError) as caught, fetched(log_address(f"{web}/{name}")):
        pass
    assert said in str(caught.value)


_OURS = "TUNENET_TEST_RAY"  # a variable that marks what the command starts


def is_loopback(text: str) -> bool:
    """Whether an address is of this machine alone."""
    address = ip_address(text)
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


_COUNT = 12  # logs that a cluster tunes


@pytest.fixture(scope="module")
def many_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for seed in range(_COUNT - 1):
        write_drop(folder / f"drop{seed:02}.mcap", seed)
    (folder / "bad.mcap").write_bytes(b"none" * 100)
    return folder


def test_logs_of_a_worker_that_dies_are_done_again(many_logs: Path, tmp_path: Path):
    """By a Ray of this machine alone, of which nothing is left."""
    pytest.importorskip("ray")
    out = tmp_path / "out"
    words = [str(BIN / "tunenet-tune"), str(many_logs), "-o", str(out), "--no-review"]
    with subprocess.Popen(
        [*words, "--jobs", "2", "--ray"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, _OURS: str(out)},
    ) as driver:
        killed, deadline = None, time.monotonic() + 180
        while driver.poll() is None and killed is None and time.monotonic() < deadline:
            journal = out / "ledger.jsonl"
            if journal.exists() and journal.read_bytes().count(b"\n") >= 2:
                killed = _an_actor(out)
            time.sleep(0.01)
        assert killed is not None, driver.communicate(timeout=180)
        addresses = _listening(_processes(out))
        os.kill(killed, signal.SIGKILL)
        printed, said = driver.communicate(timeout=180)
    assert driver.returncode == 1, said
    rows = ledger_of(out)
    assert len({row["log"] for row in rows}) == len(rows) == _COUNT
    assert verdicts_of(rows) == {"ok": _COUNT - 1, "rejected": 1}
    assert f"{_COUNT} logs: {_COUNT} tuned" in printed
    assert addresses
    assert all(map(is_loopback, addresses)), addresses
    while _processes(out):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _processes(out: Path) -> list[Path]:
    """Those that the command started, and itself."""
    found: list[Path] = []
    for folder in Path("/proc").iterdir():
        with suppress(OSError):
            if folder.name.isdecimal() and os.fsencode(f"{_OURS}={out}") in (
                folder / "environ"
            ).read_bytes().split(b"\0"):
                found.append(folder)
    return found


def _listening(processes: list[Path]) -> set[str]:
    """The addresses at which processes listen."""
    sockets: set[str] = set()
    for process in processes:
        with suppress(OSError):
            for one in (process / "fd").iterdir():
                with suppress(OSError):
                    sockets.add(str(one.readlink()))
    found: set[str] = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and f"socket:[{words[9]}]" in sockets:
                data = bytes.fromhex(words[1].partition(":")[0])
                parts = [data[at : at + 4][::-1] for at in range(0, len(data), 4)]
                found.add(str(ip_address(b"".join(parts))))
    return found


def _an_actor(out: Path) -> int | None:
    """A process of the cluster that tunes."""
    for folder in _processes(out):
        with suppress(OSError):
            if b"ray::MapWorker" in (folder / "cmdline").read_bytes():
                return int(folder.name)
    return None


@pytest.mark.parametrize("address", ["127.0.0.1:1", "drop.mcap"])
def test_an_address_without_a_cluster_is_one_line(
    logs: Path, tmp_path: Path, command: Command, address: str
):
    pytest.importorskip("ray")
    done = command("tunenet-tune", logs, "-o", tmp_path / "out", "--ray", address)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
