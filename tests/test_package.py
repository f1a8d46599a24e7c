"""The built wheel, tried from a folder that has an `analysis/` of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.wheel import PACKAGES, ROOT, built_wheel


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    wheel = built_wheel(folder)
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", folder / "site", wheel], check=True, capture_output=True)
    return folder / "site"


def test_the_wheel_holds_every_file(installed: Path):
    wanted = {
        path.relative_to(ROOT)
        for name in PACKAGES
        for path in (ROOT / name).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert wanted == {one for one in wanted if (installed / one).is_file()}


def test_commands_of_the_wheel_work_where_the_user_has_an_analysis_folder(
    installed: Path, tmp_path: Path
):
    (tmp_path / "analysis").mkdir()
    (tmp_path / "analysis" / "__init__.py").write_text("raise RuntimeError('the user's own')")
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
