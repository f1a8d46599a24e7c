"""The built wheel, tried from a folder that has an `analysis/` of its own."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from tests.wheel import FOLDERS, ROOT, module_path


def test_the_wheel_holds_every_file_once(installed: Path):
    wanted = {
        module_path(path)
        for name in FOLDERS
        for path in (ROOT / name).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    held = {
        path.relative_to(installed)
        for path in installed.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    about = {path for path in held if path.parts[0] == "bin" or path.parts[0].endswith("-info")}
    assert held - about == wanted


def test_commands_of_the_wheel_work_where_the_user_has_folders_called_as_ours(
    installed: Path, tmp_path: Path
):
    for folder in ("analysis", "recorders", "tests", "benchmarks"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").write_text("raise RuntimeError('the user's own')")
    environment = {**os.environ, "PYTHONPATH": str(installed)}

    def run(name: str, *arguments: str) -> str:
        words = [str(installed / "bin" / name), *arguments]
        result = subprocess.run(
            words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
        )
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    run("tunenet-record", "--simulate", "drop", "--restitution", "0.6", "-o", "a.mcap")
    run("tunenet-record", "--simulate", "drop", "--restitution", "0.4", "-o", "b.mcap")
    assert "0.6000" in run("tunenet-tune", "a.mcap", "b.mcap", "--jobs", "2")
    assert (tmp_path / "a.rrd").exists()
    assert "/ball/pose" in run("tunenet-logs", "info", "a.mcap")
    run("tunenet-record", "--outcome", "success", "--ball", "gel", "--tuning", "a.json")
    assert "1/1 = 100 %" in run("tunenet-review", ".", "-o", "all.rrd", "--jobs", "1")
    run("tunenet-record", "--simulate", "payload", "--mass", "0.5", "-o", "c.mcap")
    assert "/joint_states" in run("tunenet-logs", "info", "c.mcap")
