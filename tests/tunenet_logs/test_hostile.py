"""Files made to hurt are refused in a line, or read, soon, in little memory, within a budget."""

from __future__ import annotations

import json
import signal
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.conftest import BIN, ROOT
from tests.hostile import (
    BAG,
    HOSTILE,
    LAUNCHER,
    LONG_METADATA,
    Hostile,
    bag_connection,
    channels_of,
    chunk,
    db3_of,
    described,
    jpeg_of_scans,
    mcap,
    message,
    record,
    spent,
    write_pictures,
)
from tests.hostile_files import CLAIMED, EVERY, FILES, fragment_of_many, mp4_of_many
from tests.remedies import has_remedy
from tests.strangers import (
    Stranger,
    without_chunks,
    write_poses,
    write_poses_bag,
    write_poses_folder,
)
from tests.tunenet_logs import sandbox_functions as functions
from tunenet_logs import reader, video
from tunenet_logs.cli import main
from tunenet_logs.copying import check
from tunenet_logs.errors import LogError
from tunenet_logs.formats import base as budget
from tunenet_logs.formats import registry as ros2_folder
from tunenet_logs.formats.base import Loss, RawChannel, RawMessage, Record, one_by_one
from tunenet_logs.formats.columns import cells as lines
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.formats.registry import read_folder
from tunenet_logs.formats.rosbag1 import read_bag
from tunenet_logs.formats.rosbag2 import read_db3
from tunenet_logs.formats.sandbox import Sandbox, SandboxError
from tunenet_logs.media import Mp4Claims
from tunenet_logs.messages import POSE, encode, pose
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress

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
            result = json.loads(results[0].read_text())
            assert result["verdict"] == "rejected"
            assert has_remedy(result["reason"]), result["reason"]
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


# What a log costs is bounded by its size, in records, channels, places of damage and pixels.
SAMPLES = Stranger(0.7).samples()
DATA = encode(pose(0, "map", np.zeros(3)), POSE)


def write_mcap(path: Path) -> None:
    write_poses(path.with_name("packed"), *SAMPLES)
    without_chunks(path.with_name("packed"), path)


class Kind(NamedTuple):
    """A container: what reads it, and what writes many messages or channels of it."""

    read: Callable
    write: Callable[[Path], object]
    channels: Callable[[Path, int], object]


KINDS = {
    "mcap": Kind(read_mcap, write_mcap, lambda path, n: path.write_bytes(mcap(described(n)))),
    "bag": Kind(
        read_bag,
        lambda path: write_poses_bag(path, *SAMPLES),
        lambda path, n: path.write_bytes(BAG + b"".join(map(bag_connection, range(n)))),
    ),
    "db3": Kind(
        read_db3, lambda path: db3_of(path, 1, 5000, DATA), lambda path, n: db3_of(path, n, 1)
    ),
}
each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def read(container: Callable, path: Path, **more: object) -> tuple[list[Record], list[str]]:
    """Records, and what is lost."""
    losses: list[Loss] = []
    return list(container(path, losses, **more)), [one.what for one in losses]


def messages(records: list[Record]) -> int:
    return sum(isinstance(one, RawMessage) for one in one_by_one(records))


def of_bytes(path: Path, *records: bytes) -> tuple[int, list[Loss]]:
    path.write_bytes(mcap(*records))
    losses: list[Loss] = []
    return messages(list(read_mcap(path, losses))), losses


def test_zeros_are_said_once_and_what_follows_is_read(tmp_path: Path):
    said = described(1) + message(0, DATA)
    count, losses = of_bytes(tmp_path / "a", said, bytes(4096), said, bytes(100_000))
    assert count == 2
    zeros = [(one.at_byte, one.size) for one in losses if "zeros" in one.what]
    begin = len(mcap(said))
    assert zeros == [(begin, 4096), (begin + 4096 + len(said), 100_000)]
    inside = message(0, DATA) + bytes(5000) + message(0, DATA)
    count, losses = of_bytes(tmp_path / "a", described(1), chunk(b"", len(inside), inside))
    assert count == 2
    zeros = [one.what for one in losses if "zeros" in one.what]
    assert zeros == ["5000 bytes of a chunk are zeros"]


@each_kind
def test_records_and_channels_are_bounded_far_above_an_honest_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Kind
):
    path = tmp_path / "a"
    kind.write(path)
    whole = budget.Budget(path.stat().st_size)
    every, losses = read(kind.read, path, budget=whole)
    assert 0 < whole.spent_records < whole.file_bytes / 15  # and a fourth of it is free
    assert not any("stopped" in one for one in losses)
    monkeypatch.setattr(budget, "_FREE_RECORDS", 450)
    monkeypatch.setattr(budget, "_BYTES_A_RECORD", 10**9)
    some, losses = read(kind.read, path)
    assert 0 < messages(some) < messages(every)
    (why,) = [one for one in losses if "stopped" in one]
    assert "far more records" in why
    assert "left out" in why
    monkeypatch.undo()
    monkeypatch.setattr(budget, "MAX_CHANNELS", 20)
    for count in (20, 21):
        kind.channels(tmp_path / f"{count}", count)
        records, losses = read(kind.read, tmp_path / f"{count}")
        channels = sum(isinstance(one, RawChannel) for one in records)
        assert channels == 20 or (count == 21 and channels < 20)
        assert any("over 20 channels" in one for one in losses) == (count == 21)


def test_damaged_places_are_kept_within_the_budget_and_the_first_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    path = tmp_path / "a.mcap"
    _, losses = of_bytes(path, record(3) * 200_000)
    most = (250_000 + path.stat().st_size / 4) / budget.DAMAGE_RECORDS
    assert 1000 < len(losses) <= most + 2
    path.write_bytes(mcap(described(1), message(0, DATA), record(3) * 500))
    assert main(["check", str(path)]) == 1
    said = capsys.readouterr().out
    assert said.count("  damage: ") == 101
    assert "  damage: and 401 more\n" in said


def test_metadata_and_definitions_beyond_any_log_are_not_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "a").write_bytes(LONG_METADATA)
    assert any("over 20000 parts" in one for one in read(read_mcap, tmp_path / "a")[1])
    monkeypatch.setattr(budget, "_MAX_DEFINITION_BYTES", 10_000)
    (tmp_path / "a").write_bytes(channels_of(20, b"a/msg/T", b"cdr", [b"float64 x\n" * 100] * 20))
    assert any("10000 bytes of definitions" in one for one in read(read_mcap, tmp_path / "a")[1])


def test_files_of_a_folder_share_one_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "bag"
    write_poses_folder(folder, *SAMPLES)
    (first,) = folder.glob("*.db3")
    first.rename(folder / "bag_0.db3")
    (folder / "bag_1.db3").write_bytes((folder / "bag_0.db3").read_bytes())
    every, _ = read(read_folder, folder)
    monkeypatch.setattr(budget, "_FREE_RECORDS", messages(every) * 3 // 4)
    monkeypatch.setattr(budget, "_BYTES_A_RECORD", 10**9)
    losses: list[Loss] = []
    assert messages(every) / 2 < messages(list(read_folder(folder, losses))) < messages(every)
    assert [one.file for one in losses if "stopped" in one.what] == ["bag_1.db3"]
    monkeypatch.setattr(ros2_folder, "_MAX_PARTS", 1)
    with pytest.raises(LogError, match="over 1 files"):
        read(read_folder, folder)


def test_pictures_are_paid_for_by_the_bytes_of_their_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    one, two = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for path, topics in ((one, 1), (two, 2)):
        write_pictures(path, jpeg_of_scans(1, side_px=200), count=20, topics=topics)
    assert len(list(read_episode(one).frames())) == 20
    monkeypatch.setattr(reader, "_FREE_PIXELS", 400_000)
    monkeypatch.setattr(reader, "_PIXELS_A_BYTE", 0)
    frames = read_episode(one).frames()
    assert [next(frames).size_px() for _ in range(10)] == [(200, 200)] * 10
    with pytest.raises(LogError, match="far more pixels"):
        next(frames)
    damage = [line for line in check(two, Progress(quiet=True)).damage if "/eye" in line]
    assert len(damage) == 2
    assert all("reading ends after 5 of 10" in line for line in damage)


def test_cameras_of_many_messages_are_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.mcap"
    write_pictures(path, jpeg_of_scans(1, side_px=64), count=40, topics=20, others=100)
    assert len(read_episode(path).picture_topics) == 20
    monkeypatch.setattr(reader, "_FREE_MESSAGES", 1000)
    episode = read_episode(path)
    assert len(episode.picture_topics) == 8
    assert any("12 channels were left out" in line for line in episode.warnings)


def test_a_film_of_far_more_pixels_than_its_bytes_pay_for_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "a.gif"
    head = b"GIF89a" + struct.pack("<HHBBB", 100, 100, 0x80, 0, 0) + bytes(6)
    frame = b"\x21\xf9\x04\0\4\0\0\0\x2c" + struct.pack("<HHHHB", 0, 0, 1, 1, 0)
    path.write_bytes(head + (frame + b"\2\2\x44\1\0") * 50 + b"\x3b")
    assert len(list(read_episode(path).frames())) == 50
    monkeypatch.setattr(video, "FREE_VIDEO_PIXELS", 10_000)
    monkeypatch.setattr(video, "VIDEO_PIXELS_A_BYTE", 1)
    with pytest.raises(LogError, match="far more pixels than a film of its size"):
        read_episode(path)


def test_empty_lines_are_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.csv"
    path.write_text("t,z\n" + "\n" * 2000 + "1,2\n")
    monkeypatch.setattr(lines, "_MAX_LINES", 1000)
    with pytest.raises(LogError, match="over 1000 lines"):
        read_episode(path)


# The sandbox: what comes back, and what comes of a child that crashes, loops or eats memory.
TOO_MUCH = "it is damaged, or takes more memory or time than any log"


@pytest.mark.parametrize(
    ("function", "arguments", "limits", "says"),
    [
        (functions.refuses, (), {}, {"kind": "refused", "remedy": "take one of steel"}),
        (functions.raises, (), {}, {"kind": "damaged", "raised": "KeyError"}),
        *((functions.killed, (number,), {}, {"kind": "crash", "code": -number})
          for number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT)),
        (functions.objects, (), {}, {"kind": "crash"}),  # nothing is unpickled
        (functions.eats, (), {"memory_bytes": 100 * 2**20}, {"kind": "memory"}),
        (functions.loops, (), {"cpu_s": 1}, {"kind": "time"}),
        (functions.sleeps, (), {"wall_s": 1}, {"kind": "time"}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)  # fmt: skip
def test_a_child_that_fails_is_one_error(
    function: Callable[..., Any], arguments: tuple, limits: dict[str, Any], says: dict[str, Any]
):
    begun_s = time.monotonic()
    with Sandbox(**limits) as sandbox, pytest.raises(SandboxError) as caught:
        list(sandbox.answers(function, *arguments))
    assert not sandbox.is_running
    error, words = caught.value, str(caught.value)
    assert "\n" not in words
    assert {name: getattr(error, name) for name in says} == says
    assert time.monotonic() - begun_s < 20
    if function is functions.killed:
        assert words == TOO_MUCH
    if says["kind"] == "memory":
        assert words == "it claims more memory than any log needs"
    if says["kind"] == "damaged":
        assert words.startswith("it is damaged (")
    if says["kind"] == "refused":
        assert words == "it is of wood"
