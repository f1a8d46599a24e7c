"""What holds for each of the ten commands: exit codes, what shells complete, full disks.

Refusals are in `test_refusals`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import BIN, COMMANDS, ROOT, Command, files_no_larger_than
from tunenet_logs.analysis.api import save_tuning, tune
from tunenet_logs.console import SHELLS

SAMPLE = ROOT / "sample_logs" / "bouncy.mcap"


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


# ---- What shells complete.

# As it was registered for a command by its script, in a real bash.
COMPLETE = """
source "$1"; shift
[[ $(complete -p "$1") =~ -F\\ ([^ ]+) ]] || exit 9
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
"${BASH_REMATCH[1]}" "$1" "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(
    ("line", "offered", "more"),
    [
        ("tunenet-tune --rev", "--review-only", False),
        ("tunenet-tune --t", "--tare --task --topic", True),
        # choices
        ("tunenet-tune --review-only ", "ok suspect rejected", False),
        ("tunenet-train pay", "payload", False),
        ("tunenet-tune --ball ta", "table-tennis", True),
        ("tunenet-tune --arm ur", "ur5e", True),
        ("tunenet-export drop.json --to ", "mujoco sdf", True),
        # files and folders
        ("tunenet-tune dr", "drop_1.mcap drop.json", True),
        ("tunenet-tune -o dr", "drops", False),
        ("tunenet-tune drop.mcap --arm-card drop.", "drop.json", True),
        # a verb and what follows it
        ("tunenet-logs re", "recover", False),
        ("tunenet-logs info --j", "--json", True),
        ("tunenet-logs check drop.", "drop.json", True),
    ],
)
def test_bash_completes(command: Command, tmp_path: Path, line: str, offered: str, more: bool):
    """The last word: with these, or with more."""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("needs bash")
    folder, script = tmp_path / "here", tmp_path / "script"
    (folder / "drops").mkdir(parents=True)
    for name in ("drop one.mcap", "drop.json"):
        (folder / name).touch()
    words = line.split(" ")
    script.write_text(command(words[0], "--print-completion", "bash").stdout)
    asked = [bash, "--norc", "-c", COMPLETE, "bash", script, *words]
    done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    found = {one.strip().replace("drop one", "drop_1") for one in done.stdout.splitlines()}
    assert set(offered.split()) <= found
    assert more or found == set(offered.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_each_shell_has_a_script(command: Command, name: str):
    for shell in SHELLS:
        done = command(name, "--print-completion", shell)
        assert done.returncode == 0
        assert name in done.stdout
        assert "--print-completion" in done.stdout
        if shell == "bash":
            parsed = subprocess.run(
                ["bash", "-n"], input=done.stdout, capture_output=True, text=True
            )
            assert (parsed.returncode, parsed.stderr) == (0, "")
