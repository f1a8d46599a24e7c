"""The wheel of this tree, built in a copy, so that nothing is left in the tree itself."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("tunenet_logs", "recorders", "analysis")


def built_wheel(folder: Path) -> Path:
    """Build it in this folder, without network: setuptools is installed."""
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / "tree" / name)
    for name in ("pyproject.toml", "README.md", "LICENSE", "THIRD_PARTY.md"):
        shutil.copy(ROOT / name, folder / "tree")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", folder]
    build.append(str(folder / "tree"))
    subprocess.run(build, check=True, capture_output=True, timeout=300)
    (wheel,) = folder.glob("*.whl")
    return wheel
