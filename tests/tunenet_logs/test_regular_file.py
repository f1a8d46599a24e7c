"""What is no regular file is refused before anything is read: real pipes, sockets and devices."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from tests.conftest import Command
from tunenet_logs.errors import LogError
from tunenet_logs.files import open_regular, open_regular_text


def test_a_file_and_a_link_to_it_are_read(tmp_path: Path):
    (tmp_path / "a").write_bytes("Höhe\r\n".encode())
    (tmp_path / "link").symlink_to("a")
    for name in ("a", "link"):
        with open_regular(tmp_path / name) as file:
            assert file.read() == "Höhe\r\n".encode()
            assert os.get_blocking(file.fileno())
            assert not os.get_inheritable(file.fileno())
    with open_regular_text(tmp_path / "a", "utf-8") as text:
        assert text.read() == "Höhe\n"


def test_a_pipe_a_socket_and_a_device_are_refused(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for path in (tmp_path / "pipe", tmp_path / "socket", Path("/dev/zero"), Path("/dev/tty")):
            with pytest.raises(LogError, match=f"^{path}: is no regular file"):
                open_regular(path)


def test_a_pipe_that_takes_a_files_place_does_not_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    whole, pipe = tmp_path / "whole", tmp_path / "pipe"
    whole.write_bytes(b"x")
    os.mkfifo(pipe)
    state = Path.stat
    monkeypatch.setattr(Path, "stat", lambda path, **_: state(whole if path == pipe else path))
    with pytest.raises(LogError, match="is no regular file"):
        open_regular(pipe)


def test_folders_and_circles_are_errors_of_the_system(tmp_path: Path):
    (tmp_path / "circle").symlink_to("circle")
    for path in (tmp_path, tmp_path / "circle", tmp_path / "nothing"):
        before = len(list(Path("/proc/self/fd").iterdir()))
        with pytest.raises(OSError, match=str(path)):
            open_regular(path)
        assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_file_that_states_no_size_is_empty(tmp_path: Path):
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
