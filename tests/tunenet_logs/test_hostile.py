"""Files made to hurt are refused in a line, or read, soon and in little memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import BIN, ROOT
from tests.hostile import HOSTILE, LAUNCHER, Hostile, spent
from tests.hostile_files import CLAIMED, EVERY, FILES, fragment_of_many, mp4_of_many
from tunenet_logs.errors import LogError
from tunenet_logs.media import Mp4Claims

MAX_KIB = 400 * 2**10  # that a file adds to the one process in which many are met
COMMANDS = ("check", "tune")
QUICK = [
    (name, command)
    for name, one in EVERY.items()
    for command, codes in zip(COMMANDS, one.codes, strict=True)
    if one.is_quick and codes
]
# Each file with what it is given to: logs to all that read one, other files to what they are for.
EACH = [
    *((name, command) for name in HOSTILE for command in ("info", "check", "recover", "tune")),
    *(
        (name, command)
        for name, one in FILES.items()
        for command, codes in zip(COMMANDS, one.codes, strict=True)
        if codes
    ),
]
# Commands on files in one process, each with what it adds to the memory, at its peak; CPU with
# that of its children.
READER = """
import io, json, resource, sys
from contextlib import redirect_stderr, redirect_stdout
from tunenet_logs.analysis.cli.tune import main as tune
from tunenet_logs.cli import main as logs

def cpu_s():
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)

def memory_kib(what):
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(what))

for line in sys.stdin:
    name, command, path, out = json.loads(line)
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")  # the peak begins again
    began_kib = memory_kib("VmRSS")
    printed, before = io.StringIO(), cpu_s()
    with redirect_stdout(printed), redirect_stderr(printed):
        code = logs(["check", path]) if command == "check" else tune([path, "-o", out])
    told = {"code": code, "added_kib": memory_kib("VmHWM") - began_kib}
    told |= {"cpu_s": cpu_s() - before, "said": printed.getvalue()}
    print(json.dumps([name, command, told]), flush=True)
"""


@pytest.fixture(scope="module")
def met(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], dict[str, Any]]:
    """What each command said of each file."""
    lines = []
    for name, command in QUICK:
        folder = tmp_path_factory.getbasetemp() / "hostile" / name
        path = folder / EVERY[name].file
        if not path.exists():
            folder.mkdir(parents=True)
            EVERY[name].write(folder)
        lines.append(json.dumps([name, command, str(path), str(folder / "out")]))
    done = subprocess.run(
        [sys.executable, "-c", LAUNCHER, sys.executable, "-c", READER],
        input="\n".join(lines), cwd=ROOT, stdout=subprocess.PIPE, text=True, timeout=500,
    )  # fmt: skip
    lines = done.stdout.splitlines()
    return {(name, command): told for name, command, told in map(json.loads, lines)}


def assert_harmless(name: str, one: Hostile, command: str, told: Any, out: Path) -> None:
    assert "Traceback" not in told["said"]
    assert told["said"].count("\n") < 250
    assert told["code"] in one.codes[COMMANDS.index(command)], told["said"]
    assert one.says in told["said"]
    assert told["cpu_s"] < one.cpu_s
    if name in FILES and command == "tune":
        if results := list(out.glob("*.json")):
            assert json.loads(results[0].read_text())["verdict"] == "rejected"
        else:
            assert told["said"].startswith("tunenet-tune: ")
            assert told["said"].count("\n") == 1


@pytest.mark.parametrize(("name", "command"), QUICK)
def test_a_hostile_file_is_harmless(met: dict, name: str, command: str, tmp_path_factory):
    assert (name, command) in met, f"the process ended at {list(met)[-1:]} or behind it"
    out = tmp_path_factory.getbasetemp() / "hostile" / name / "out"
    assert_harmless(name, EVERY[name], command, met[name, command], out)
    assert met[name, command]["added_kib"] < MAX_KIB


@pytest.mark.slow
@pytest.mark.parametrize(("name", "command"), EACH)
def test_so_it_is_in_a_process_of_its_own(tmp_path: Path, name: str, command: str):
    one = EVERY[name]
    is_judged = command in COMMANDS and bool(one.codes[COMMANDS.index(command)])
    path, out = one.write(tmp_path), tmp_path / "out"
    program = "tunenet-tune" if command == "tune" else "tunenet-logs"
    words = {"tune": [], "recover": [command, "-o", "saved.mcap"]}.get(command, [command])
    more = ["-o", str(out)] if command == "tune" else []
    told = spent([str(BIN / program), *words, str(path), *more], tmp_path)
    assert told.peak_kib < one.peak_kib
    if is_judged:
        assert_harmless(name, one, command, told._asdict(), out)
    else:
        assert "Traceback" not in told.said
        assert told.code in (0, 1), told.said
        assert told.cpu_s < one.cpu_s


@pytest.mark.parametrize("name", ["mp4_of_many_pictures", "fragment_of_many_pictures"])
def test_a_recording_of_a_film_that_claims_far_too_much_is_refused(tmp_path: Path, name: str):
    path = FILES[name].write(tmp_path)
    told = spent([str(BIN / "tunenet-record"), "--camera", path.name], tmp_path)
    assert told.code == 1
    assert told.peak_kib < FILES[name].peak_kib  # each took 1 to 3 GB
    claim = f"claims {CLAIMED} samples in {path.stat().st_size} bytes; cut the drop out of it"
    assert claim in told.said
    assert told.said.count("\n") == 1
    assert [one for one in tmp_path.iterdir() if one.suffix == ".mcap"] == []


@pytest.mark.parametrize("bomb", [mp4_of_many(CLAIMED), fragment_of_many(CLAIMED)])
def test_a_claim_is_seen_wherever_a_read_cuts_it(bomb: bytes):
    for cut in range(len(bomb)):
        claims = Mp4Claims(len(bomb))
        with pytest.raises(LogError, match=f"claims {CLAIMED} samples"):
            deque(map(claims.check, (bomb[:cut], bomb[cut:])), 0)
    Mp4Claims().check(mp4_of_many(5_000_000))
    Mp4Claims(16 * CLAIMED).check(mp4_of_many(CLAIMED))  # what its size is worth


@pytest.mark.parametrize("name", ["far_apart", "impossible_rate"])
def test_an_import_holds_few_sounds(tmp_path: Path, name: str):
    path = FILES[name].write(tmp_path)
    told = spent([str(BIN / "tunenet-logs"), "import", path.name, "-o", "out.mcap"], tmp_path)
    assert told.peak_kib < 700_000
    if name == "far_apart":
        assert told.code == 0, told.said
        assert "left out: /mic7: the log has more sound than an import takes" in told.said
    else:
        assert told.code == 1
        assert told.said.count("\n") == 1
        assert "it claims 2.14748e+09 samples a second" in told.said
