"""The direction of imports, no circles, and nothing heavy before it is needed."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Container
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import MODULES
from tests.wheel import FOLDERS, LINKED, PACKAGE, ROOT, module_path

# By folder at the top of the tree: from which folders it may import.
ALLOWED = {
    "tunenet_logs": {"tunenet_logs"},
    "recorders": {"tunenet_logs", "recorders"},
    "analysis": {"tunenet_logs", "recorders", "analysis"},
}
# It names for type checkers what lies above it; when it runs it imports nothing.
FRONT_DOOR = f"{PACKAGE}/__init__.py"
HEAVY = {
    "aiohttp", "av", "cma", "cv2", "cyclonedds", "ezc3d", "fsspec", "google", "jinja2",
    "matplotlib", "mujoco", "newton", "optuna", "pandas", "pinocchio", "pyarrow", "pybullet",
    "pydrake", "python_calamine", "ray", "rerun", "sbi", "shtab", "sklearn", "sounddevice", "torch",
    "tqdm", "warp",
}  # fmt: skip
# The rooms, by name, folders or modules, that may import a library at module level.
OWNERS = {"rerun": "review", "cyclonedds": "ros2", "matplotlib": "report", "jinja2": "report"}
SIMULATORS = "tunenet_logs.recorders.simulators."
# The only modules that may import a physics engine at all,
ENGINE_MODULES = {
    "pybullet": (f"{SIMULATORS}pybullet",),
    "mujoco": (f"{SIMULATORS}mujoco", f"{SIMULATORS}model."),
}
# but for the file of an engine's name in the room that writes files for engines.
ENGINE_EXPORTS = "tunenet_logs.analysis.export."
# Each once, by its folder at the top of the tree: `rglob` does not follow links.
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module:
        return [node.module]
    return []


def module_level(tree: ast.Module) -> list[str]:
    """Imports that run when the module is imported, those under TYPE_CHECKING aside."""
    names: list[str] = []
    for node in tree.body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        names += (
            [name for inner in ast.walk(node) for name in imported(inner)]
            if not isinstance(node, ast.FunctionDef | ast.ClassDef)
            else []
        )
    return names


def name_of(path: Path) -> str:
    parts = module_path(path).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def folder_of(module: str) -> str | None:
    """In which folder at the top of the tree a module lies; None for others than ours.

    A part of the package is named by what follows its name, and its old name alone is wrong.
    """
    first, _, rest = module.partition(".")
    second = rest.partition(".")[0]
    assert first not in LINKED, f"{module} is called {PACKAGE}.{module}"
    return None if first != PACKAGE else second if second in LINKED else PACKAGE


@cache
def imports() -> list[tuple[Path, str]]:
    """All of them, those in functions and those for type checkers, too."""
    return [
        (path, name)
        for path in FILES
        for node in ast.walk(tree_of(path))
        for name in imported(node)
    ]


def test_imports_point_down():
    """And the product knows nothing of its evaluation."""
    evaluation = f"{PACKAGE}.analysis.evaluation"
    upward = [
        f"{name_of(path)} imports {name}"
        for path, name in imports()
        if (folder := folder_of(name)) is not None
        and path != ROOT / FRONT_DOOR
        and (
            folder not in ALLOWED[path.relative_to(ROOT).parts[0]]
            or (name.startswith(evaluation) and not name_of(path).startswith(evaluation))
        )
    ]
    assert not upward, "\n".join(upward)


def test_heavy_libraries_are_imported_when_needed():
    """At module level only in the rooms that exist for one of them."""
    early = [
        f"{name_of(path)} imports {name} at module level"
        for path in FILES
        for name in module_level(tree_of(path))
        if (top := name.partition(".")[0]) in HEAVY
        and OWNERS.get(top) not in path.with_suffix("").parts
    ]
    assert not early, "\n".join(early)


@pytest.mark.parametrize(("library", "modules"), ENGINE_MODULES.items())
def test_a_physics_engine_is_known_in_its_modules_alone(library: str, modules: tuple[str, ...]):
    """What is simulated is written for any engine."""
    wrong = [
        f"{name_of(path)} imports {name}"
        for path, name in imports()
        if name.partition(".")[0] == library
        and not name_of(path).startswith(modules)
        and name_of(path) != ENGINE_EXPORTS + library
    ]
    assert not wrong, "\n".join(wrong)


def needed(path: Path, modules: Container[str]) -> set[str]:
    """All modules of ours that a file names in imports: lazy ones and those for types, too."""
    found: set[str] = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in modules else node.module for name in whole}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name in modules}


def test_no_module_imports_itself_through_others():
    """All imports count, those in functions and those for type checkers, too."""
    modules = {name_of(path): path for path in FILES if path != ROOT / FRONT_DOOR}
    edges = {name: needed(path, modules) - {name} for name, path in modules.items()}
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join((*trail, name))
        if name not in done:
            for one in edges[name]:
                visit(one, (*trail, name))
            done.add(name)

    for name in modules:
        visit(name, ())


HELP = f"""
import sys, tomllib
from importlib import import_module
for module in {list(MODULES.values())}:
    import_module(module).build_parser().format_help()
heavy = {sorted(HEAVY | {"numpy", "rosbags", "mcap", "scipy"})}
print([name for name in heavy if name in sys.modules])
import tunenet_logs.analysis.batch.run, tunenet_logs.analysis.tuning
print("torch" in sys.modules)
"""


def test_help_loads_nothing_heavy_and_tuning_no_torch():
    words = [sys.executable, "-c", HELP]
    result = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert result.stdout.split("\n")[:2] == ["[]", "False"], result.stdout + result.stderr
