"""What holds for each of the ten commands: exit codes, streams that are not there, full disks."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from tests.conftest import BIN, ROOT, Command, files_no_larger_than
from tunenet_logs.analysis.api import save_tuning, tune

SAMPLE = ROOT / "sample_logs" / "bouncy.mcap"
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log, a table without a drop, and their tunings."""
    folder = tmp_path_factory.mktemp("bench")
    rows = "".join(f"{at / 100},1,2,3\n" for at in range(50))
    (folder / "flat.csv").write_text("t,x,y,z\n" + rows)
    shutil.copy(SAMPLE, folder / "drop.mcap")
    save_tuning(tune(SAMPLE), folder / "good.json")
    save_tuning(tune(folder / "flat.csv"), folder / "rejected.json")
    return folder


def contents(folder: Path) -> dict[Path, bytes]:
    return {one: one.read_bytes() if one.is_file() else b"" for one in folder.rglob("*")}


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0, "tunenet-tune drop.mcap -o OUT --no-review"),
        (0, "tunenet-logs info drop.mcap"),
        (0, "tunenet-logs check drop.mcap"),
        (0, "tunenet-logs recover drop.mcap -o OUT/a.mcap"),
        (0, "tunenet-logs import flat.csv -o OUT/a.mcap"),
        (0, "tunenet-export good.json --to json -o OUT/a.json"),
        (0, "tunenet-compare good.json --csv OUT/a.csv"),
        (1, "tunenet-tune flat.csv -o OUT --no-review"),
        (1, "tunenet-compare rejected.json"),
        (1, "tunenet-plan --restitution 0.01"),
    ],
)
def test_exit_codes_of_what_has_a_result(
    command: Command, bench: Path, tmp_path: Path, code: int, words: str
):
    result = command(*words.replace("OUT", str(tmp_path)).split(), cwd=bench)
    assert result.returncode == code, result.stderr
    assert result.stdout or code


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


@pytest.mark.parametrize("name", ["tunenet-tune", "tunenet-logs", "tunenet-compare"])
def test_results_are_written_where_nobody_listens(bench: Path, tmp_path: Path, name: str):
    """Standard input and output are closed, and standard error is a pipe that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)

    def close() -> None:
        os.close(0)
        os.close(1)

    words = words_of(name, tmp_path)
    try:
        done = subprocess.run(
            words, cwd=bench, stderr=writing, preexec_fn=close, timeout=120, check=False
        )
    finally:
        os.close(writing)
    assert done.returncode == 0
    assert WRITING[name][1] in {path.name for path in tmp_path.iterdir()}


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


@pytest.mark.parametrize("before", ["", "what was there"])
@pytest.mark.parametrize("name", [name for name, (_, file) in WRITING.items() if file])
def test_a_full_disk_leaves_what_was_there(
    command: Command, bench: Path, tmp_path: Path, name: str, before: str
):
    words, path = words_of(name, tmp_path)[1:], tmp_path / WRITING[name][1]
    if before:
        assert command(name, *words, cwd=bench).returncode == 0
        offers = name not in ("tunenet-review", "tunenet-plan")
        words += ["--overwrite"] * offers
    old = contents(tmp_path)
    with files_no_larger_than(100):
        done = command(name, *words, cwd=bench)
    assert done.returncode == 1
    (told,) = [one for one in done.stderr.splitlines() if "File too large" in one]
    assert path.name in told
    assert "; " in told
    assert contents(tmp_path) == old
