"""Small files beside logs, and what is no file: bounds, kinds, and JSON without its traps."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from tests.conftest import Command
from tunenet_logs.analysis.record import read_record
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import open_regular, open_regular_text, parse_json, read_small_file
from tunenet_logs.recorders.simulators.arm.description import read_urdf
from tunenet_logs.recorders.simulators.shot import read_rig


@pytest.mark.parametrize(
    "text",
    ["1e999", "NaN", "-Infinity", "9" * 5000, str(2**63), '{"a": 1, "a": 2}', "[" * 40 + "]" * 40,
     "[" * 100_000, '{"a":' * 5000, "", "{", '"\\',
     # A text of a million characters that does not end: at once, where its square took an hour.
     *('{"a": "' + atom * (1_000_000 // len(atom))
       for atom in ('\\"', '"', "\\\\", "\\", "[", '"a', "1"))],
    ids=lambda text: text[:12],
)  # fmt: skip
def test_no_json_of_ours(text: str):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (whatever json says)
        parse_json(text.encode())
    assert len(str(caught.value)) < 200


def test_brackets_in_strings_are_text():
    text = "[" * 100 + '\\"' + "{" * 100
    assert parse_json(f'["{text}", -9223372036854775808, 0.5]')[1:] == [-(2**63), 0.5]


@pytest.mark.parametrize(
    "text",
    ["[" * 2000, "{" * 2000, "gravity_m_s2: !!bool x", "a: &a 1\nb: &a 2", "a: *b", "x" * 30_000],
)
def test_a_rig_that_is_none_is_refused_before_it_costs_anything(tmp_path: Path, text: str):
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(UsageError, match=r"brackets|holds &|larger|no YAML"):
        read_rig(tmp_path / "rig.yaml")


@pytest.mark.parametrize("value", ["9" * 400, "1e999", '"' + "x" * 100_000 + '"'])
def test_a_record_with_a_number_that_is_none(tmp_path: Path, value: str):
    file = tmp_path / "a.json"
    file.write_text(f'{{"verdict": "ok", "parameters": null, "iterations": [{{"e": {value}}}]}}')
    with pytest.raises(LogError) as caught:
        read_record(file)
    assert len(str(caught.value)) < len(str(file)) + 300


def test_a_description_of_very_many_elements(tmp_path: Path):
    (tmp_path / "a.urdf").write_text("<robot>" + "<a>" * 900_000)
    with pytest.raises(UsageError, match="tags"):
        read_urdf(tmp_path / "a.urdf")


def test_a_file_and_a_link_to_it_are_read(tmp_path: Path):
    data = "Höhe\r\n".encode()
    (tmp_path / "a").write_bytes(data)
    (tmp_path / "link").symlink_to("a")
    for name in ("a", "link"):
        with open_regular(tmp_path / name) as file:
            assert file.read() == data
            assert os.get_blocking(file.fileno())
            assert not os.get_inheritable(file.fileno())
    with open_regular_text(tmp_path / "a", "utf-8") as text:
        assert text.read() == "Höhe\n"
    assert read_small_file(tmp_path / "a", len(data)) == data
    with pytest.raises(ValueError, match="larger than"):
        read_small_file(tmp_path / "a", len(data) - 1)


def test_what_is_no_regular_file_is_refused_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pipe, whole = tmp_path / "pipe", tmp_path / "whole"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for path in (pipe, tmp_path / "socket", Path("/dev/zero"), Path("/dev/tty")):
            with pytest.raises(LogError, match=f"^{path}: is no regular file"):
                open_regular(path)
    for place in (tmp_path, pipe):
        with pytest.raises((OSError, LogError), match=r"regular file|directory"):
            read_small_file(place, 4)
    whole.write_bytes(b"x")  # a pipe that takes a file's place is not waited for
    state = Path.stat
    monkeypatch.setattr(Path, "stat", lambda path, **_: state(whole if path == pipe else path))
    with pytest.raises(LogError, match="is no regular file"):
        open_regular(pipe)


def test_folders_and_circles_are_errors_of_the_system_and_what_states_no_size_is_empty(
    tmp_path: Path,
):
    (tmp_path / "circle").symlink_to("circle")
    for path in (tmp_path, tmp_path / "circle", tmp_path / "nothing"):
        before = len(list(Path("/proc/self/fd").iterdir()))
        with pytest.raises(OSError, match=str(path)):
            open_regular(path)
        assert len(list(Path("/proc/self/fd").iterdir())) == before
    (tmp_path / "empty").write_bytes(b"")
    for path in (tmp_path / "empty", Path("/proc/self/maps")):
        with open_regular(path) as file:
            assert file.read() == b""


@pytest.mark.skipif(not os.access("/proc/kmsg", os.R_OK), reason="may not read the kernel's log")
def test_the_kernels_log_is_no_log(process: Command):
    result = process("tunenet-logs", "info", "/proc/kmsg")
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "is empty" in result.stderr
