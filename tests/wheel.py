"""The wheel of this tree, built in a copy, so that nothing is left in the tree itself."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "tunenet_logs"
LINKED = ("recorders", "analysis")
"""Folders at the top of the tree that are imported as parts of the package, by links in it."""
FOLDERS = (PACKAGE, *LINKED)


def module_path(path: Path) -> Path:
    """Where a file of one of the folders lies when installed, as its module is called."""
    inside = path.relative_to(ROOT)
    return PACKAGE / inside if inside.parts[0] in LINKED else inside


def built_wheel(folder: Path) -> Path:
    """Build it in this folder, without network: setuptools is installed."""
    compiled = shutil.ignore_patterns("__pycache__")
    for name in (*FOLDERS, "docs"):  # the links stay links, as in a clone
        shutil.copytree(ROOT / name, folder / "tree" / name, symlinks=True, ignore=compiled)
    for name in ("pyproject.toml", "README.md", "LICENSE", "THIRD_PARTY.md"):
        shutil.copy(ROOT / name, folder / "tree")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", folder]
    build.append(str(folder / "tree"))
    subprocess.run(build, check=True, capture_output=True, timeout=300)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install_wheel(folder: Path) -> None:
    """Build it and install it, without what it needs, into this folder; commands lie in `bin`."""
    folder.mkdir()
    built = folder.with_name(f"{folder.name}-built")
    wheel = built_wheel(built)
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--target", folder]
    subprocess.run([*pip, wheel], check=True, capture_output=True, timeout=300)
    shutil.rmtree(built)
