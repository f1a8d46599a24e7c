"""What holds for each of the ten commands: exit codes, signals, streams that are not there."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import pytest

from tests.conftest import BIN, ROOT
from tunenet_logs.analysis.api import save_tuning, tune

SAMPLE = ROOT / "sample_logs" / "bouncy.mcap"
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
MAINS = {
    **{
        f"tunenet-{name}": f"tunenet_logs.analysis.cli.{name}"
        for name in ("tune", "train", "plan", "report")
    },
    **{
        f"tunenet-{name}": f"tunenet_logs.analysis.cli.{name}"
        for name in ("review", "export", "compare")
    },
    "tunenet-logs": "tunenet_logs.cli",
    "tunenet-record": "tunenet_logs.recorders.cli",
    "tunenet-eval": "tunenet_logs.analysis.evaluation.cli",
}
SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}

DISTURBED = """
import os, sys
def stop(event, details):
    if event == "import" and details[0] == "argparse" and not done:
        done.append(1)
        os.kill(os.getpid(), {number})
done = []
sys.addaudithook(stop)
sys.argv = ["x", "--help"]
from {module} import {function}
sys.exit({function}())
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tuning, one that was rejected, a table, and files that are nothing."""
    folder = tmp_path_factory.mktemp("bench")
    rows = "".join(f"{at / 100},1,2,3\n" for at in range(50))
    (folder / "flat.csv").write_text("t,x,y,z\n" + rows)
    save_tuning(tune(SAMPLE), folder / "good.json")
    save_tuning(tune(folder / "flat.csv"), folder / "rejected.json")
    for name in ("junk.mcap", "junk.json"):
        (folder / name).write_bytes(bytes(range(200)))
    (folder / "empty").mkdir()
    return folder


def test_all_ten_are_here():
    assert MAINS.keys() == SCRIPTS.keys()


CODES = [
    (0, "tunenet-tune LOG -o OUT --no-review"),
    (1, "tunenet-tune none.mcap -o OUT"),
    (1, "tunenet-tune junk.mcap -o OUT"),
    (1, "tunenet-tune flat.csv -o OUT --no-review"),
    (1, "tunenet-tune LOG -o flat.csv"),
    (2, "tunenet-tune LOG --seeds 3"),
    (2, "tunenet-tune LOG --iterations none"),
    (0, "tunenet-logs info LOG"),
    (1, "tunenet-logs info none.mcap"),
    (1, "tunenet-logs info junk.mcap"),
    (2, "tunenet-logs inform LOG"),
    (0, "tunenet-logs check LOG"),
    (1, "tunenet-logs check junk.mcap"),
    (0, "tunenet-logs recover LOG -o OUT/a.mcap"),
    (1, "tunenet-logs recover none.mcap -o OUT/a.mcap"),
    (0, "tunenet-logs import flat.csv -o OUT/a.mcap"),
    (1, "tunenet-logs import junk.mcap -o OUT/a.mcap"),
    (1, "tunenet-logs import flat.csv -o none/a.mcap"),
    (2, "tunenet-logs import flat.csv -o flat.csv"),
    (1, "tunenet-record --camera none.mp4 -o OUT/a.mcap"),
    (1, "tunenet-record --camera junk.mcap -o OUT/a.mcap"),
    (1, "tunenet-record --simulate drop -o none/a.mcap"),
    (2, "tunenet-record --simulate fall -o OUT/a.mcap"),
    (2, "tunenet-record --outcome success -o OUT"),
    (1, "tunenet-review none -o OUT/a.rrd"),
    (1, "tunenet-review empty -o OUT/a.rrd"),
    (1, "tunenet-review junk.json -o OUT/a.rrd"),
    (2, "tunenet-review good.json -o none/a.rrd"),
    (2, "tunenet-review good.json -o OUT/a.mcap"),
    (1, "tunenet-plan --restitution 0.01"),
    (1, "tunenet-plan none.json"),
    (1, "tunenet-plan rejected.json"),
    (1, "tunenet-plan junk.json"),
    (2, "tunenet-plan"),
    (2, "tunenet-plan --restitution 7"),
    (2, "tunenet-plan --restitution 0.7 -o none/a.json"),
    (0, "tunenet-export good.json --to json -o OUT/a.json"),
    (1, "tunenet-export none.json --to yaml"),
    (1, "tunenet-export rejected.json --to yaml"),
    (1, "tunenet-export junk.json --to yaml"),
    (2, "tunenet-export good.json --to fortran"),
    (2, "tunenet-export good.json --to yaml -o none/a.yaml"),
    (0, "tunenet-compare good.json --csv OUT/a.csv"),
    (1, "tunenet-compare none.json"),
    (1, "tunenet-compare empty"),
    (1, "tunenet-compare junk.json"),
    (1, "tunenet-compare rejected.json"),
    (2, "tunenet-compare good.json --csv none/a.csv"),
    (1, "tunenet-report none.json -o OUT/a.html"),
    (1, "tunenet-report empty -o OUT/a.html"),
    (1, "tunenet-report junk.json -o OUT/a.html"),
    (2, "tunenet-report good.json -o none/a.html"),
    (2, "tunenet-report"),
    (2, "tunenet-train fall"),
    (2, "tunenet-train drop --epochs 0"),
    (2, "tunenet-eval fall"),
    (2, "tunenet-eval drop --json none/a.json"),
    (2, "tunenet-eval drop --seeds 0"),
]


@pytest.mark.parametrize(("code", "line"), CODES)
def test_exit_codes(
    bench: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    code: int,
    line: str,
):
    monkeypatch.chdir(bench)
    name, *words = line.replace("LOG", str(SAMPLE)).replace("OUT", str(tmp_path)).split()
    assert import_module(MAINS[name]).main(words) == code
    told = [one for one in capfd.readouterr().err.splitlines() if one.startswith(name)]
    if code:
        assert told or code == 1
        assert not any("Traceback" in one for one in told)
    if code == 2:
        assert len(told) == 1
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_signal_ends_each_of_them_with_one_line(name: str, number: signal.Signals):
    module, function = SCRIPTS[name].split(":")
    code = DISTURBED.format(number=number, module=module, function=function)
    done = subprocess.run([sys.executable, "-c", code], **_CAUGHT, check=False)
    assert (done.returncode, done.stderr) == (128 + number, f"{name}: {SIGNALS[number]}\n")


_CAUGHT = {
    "capture_output": True,
    "text": True,
    "timeout": 60,
    "env": {**os.environ, "PYTHONPATH": str(ROOT)},
    "preexec_fn": lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
}

# What each of them writes, as shortly as it can.
WRITING = {
    "tunenet-tune": ("LOG -o OUT --no-review", "bouncy.json"),
    "tunenet-logs": ("import flat.csv -o OUT/a.mcap", "a.mcap"),
    "tunenet-record": ("--simulate drop -o OUT/a.mcap", "a.mcap"),
    "tunenet-review": ("good.json -o OUT/a.rrd", "a.rrd"),
    "tunenet-plan": ("--restitution 0.7 --json OUT/a.json", "a.json"),
    "tunenet-export": ("good.json --to yaml -o OUT/a.yaml", "a.yaml"),
    "tunenet-compare": ("good.json --csv OUT/a.csv", "a.csv"),
    "tunenet-report": ("good.json -o OUT/a.html", "a.html"),
    "tunenet-eval": ("--help", ""),
    "tunenet-train": ("--help", ""),
}


def words_of(name: str, out: Path) -> list[str]:
    text, _ = WRITING[name]
    return [str(BIN / name), *text.replace("LOG", str(SAMPLE)).replace("OUT", str(out)).split()]


# Of which the results are looked at; the streams of all ten are prepared in one place.
LISTENED_TO = ("tunenet-tune", "tunenet-logs", "tunenet-export", "tunenet-compare")


@pytest.mark.parametrize("name", SCRIPTS)
def test_results_are_written_where_nobody_listens(bench: Path, tmp_path: Path, name: str):
    """Standard input and output are closed, and standard error is a pipe that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)

    def close() -> None:
        os.close(0)
        os.close(1)

    words = words_of(name, tmp_path) if name in LISTENED_TO else [str(BIN / name), "--help"]
    try:
        done = subprocess.run(
            words, cwd=bench, stderr=writing, preexec_fn=close, timeout=120, check=False
        )
    finally:
        os.close(writing)
    assert done.returncode == 0
    assert {path.name for path in tmp_path.iterdir()} >= {
        WRITING[one][1] for one in LISTENED_TO if one == name
    }


@pytest.mark.parametrize("name", ["tunenet-logs", "tunenet-eval"])
def test_a_full_disk_behind_standard_output_is_said_once(bench: Path, tmp_path: Path, name: str):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            words_of(name, tmp_path), cwd=bench, stdout=full, stderr=subprocess.PIPE, text=True,
            timeout=120, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    told = f"{name}: standard output: No space left on device; give it a place that takes it\n"
    assert done.stderr == told
    assert [path.name for path in tmp_path.iterdir()] == [WRITING[name][1]] * bool(WRITING[name][1])


@contextmanager
def no_more_than(limit: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("before", ["", "what was there"])
@pytest.mark.parametrize("name", [name for name, (_, file) in WRITING.items() if file])
def test_a_full_disk_leaves_what_was_there(
    bench: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    before: str,
):
    monkeypatch.chdir(bench)
    words: Sequence[str] = words_of(name, tmp_path)[1:]
    main = import_module(MAINS[name]).main
    path = tmp_path / WRITING[name][1]
    if before:
        assert main(words) == 0
        offers = name not in ("tunenet-review", "tunenet-plan")
        words = [*words, *["--overwrite"] * offers]
        capsys.readouterr()
    old = {one: one.read_bytes() for one in tmp_path.iterdir()}
    with no_more_than(100):
        assert main(words) == 1
    (told,) = [one for one in capsys.readouterr().err.splitlines() if "File too large" in one]
    assert path.name in told
    assert "; " in told
    assert {one: one.read_bytes() for one in tmp_path.iterdir()} == old
