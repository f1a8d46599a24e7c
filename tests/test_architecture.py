"""The direction of imports, no circles, and nothing heavy before it is needed."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Container
from functools import cache
from pathlib import Path

import pytest

from tests.wheel import FOLDERS, LINKED, PACKAGE, ROOT, module_path

ALLOWED = {
    "tunenet_logs": {"tunenet_logs"},
    "recorders": {"tunenet_logs", "recorders"},
    "analysis": {"tunenet_logs", "recorders", "analysis"},
}
"""By folder at the top of the tree: from which folders it may import."""
FRONT_DOOR = f"{PACKAGE}/__init__.py"
"""It names for type checkers what lies above it; when it runs it imports nothing."""
HEAVY = {"torch", "pybullet", "rerun", "cv2", "av", "pinocchio", "pandas", "tqdm", "google"}
HEAVY |= {"mujoco", "pydrake", "newton", "warp"}
HEAVY |= {
    "cma",
    "optuna",
    "sklearn",
    "matplotlib",
    "jinja2",
    "cyclonedds",
    "sbi",
    "ezc3d",
    "aiohttp",
    "fsspec",
    "pyarrow",
    "python_calamine",
    "shtab",
    "ray",
    "sounddevice",
}
OWNERS = {"rerun": "review", "cyclonedds": "ros2", "matplotlib": "report", "jinja2": "report"}
"""The rooms, by name, folders or modules, that may import a library at module level."""
SIMULATORS = "tunenet_logs.recorders.simulators."
ENGINE_MODULES = {
    "pybullet": (f"{SIMULATORS}pybullet",),
    "mujoco": (f"{SIMULATORS}mujoco", f"{SIMULATORS}model."),
}
"""The only modules that may import a physics engine at all, or speak its keywords."""
ENGINE_EXPORTS = "tunenet_logs.analysis.export."
"""The room that writes files for engines: it speaks their words, and its file of an engine's name
may import that engine in functions."""
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
"""Each once, by its folder at the top of the tree: `rglob` does not follow links."""


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


def test_imports_point_down():
    upward = [
        f"{name_of(path)} imports {name}"
        for path in FILES
        for node in ast.walk(tree_of(path))
        for name in imported(node)
        if (folder := folder_of(name)) is not None
        and folder not in ALLOWED[path.relative_to(ROOT).parts[0]]
        and path != ROOT / FRONT_DOOR
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


def keywords(tree: ast.Module) -> set[str]:
    """Words in camel case that are an argument's name in a call, or stand as a text."""
    words = {
        word
        for node in ast.walk(tree)
        for word in (getattr(node, "arg", None), getattr(node, "value", None))
        if isinstance(node, ast.keyword | ast.Constant) and isinstance(word, str)
    }
    return {word for word in words if re.fullmatch("[a-z]+[A-Z][A-Za-z]+", word)}


@pytest.mark.parametrize(("library", "modules"), ENGINE_MODULES.items())
def test_a_physics_engine_is_known_in_its_modules_alone(library: str, modules: tuple[str, ...]):
    """Imports inside of functions count too: what is simulated is written for any engine."""
    inside = {path for path in FILES if name_of(path).startswith(modules)}
    spoken: set[str] = set()
    if library == "pybullet":  # MuJoCo's keywords are words of the field: mass, axis
        spoken = spoken.union(*(keywords(tree_of(path)) for path in inside))
        assert {"physicsClientId", "contactSlop"} <= spoken
    wrong = [
        f"{name_of(path)} imports {name}"
        for path in FILES
        for node in ast.walk(tree_of(path))
        for name in imported(node)
        if name.partition(".")[0] == library
        and path not in inside
        and name_of(path) != ENGINE_EXPORTS + library
    ] + [
        f"{name_of(path)} names {word}"
        for path in FILES
        if path not in inside and not name_of(path).startswith(ENGINE_EXPORTS)
        for word in spoken & set(re.findall(r"\w+", path.read_text()))
    ]
    assert not wrong, "\n".join(wrong)


def test_the_product_knows_nothing_of_its_evaluation():
    evaluation = "tunenet_logs.analysis.evaluation"
    wrong = [
        f"{name_of(path)} imports {name}"
        for path in FILES
        for node in ast.walk(tree_of(path))
        for name in imported(node)
        if name.startswith(evaluation) and not name_of(path).startswith(evaluation)
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


@pytest.mark.parametrize(
    "module",
    [
        "tunenet_logs.cli",
        "tunenet_logs.recorders.cli",
        "tunenet_logs.analysis.cli.tune",
        "tunenet_logs.analysis.cli.review",
        "tunenet_logs.analysis.cli.train",
        "tunenet_logs.analysis.cli.plan",
        "tunenet_logs.analysis.cli.export",
        "tunenet_logs.analysis.cli.compare",
        "tunenet_logs.analysis.cli.report",
        "tunenet_logs.analysis.evaluation.cli",
    ],
)
def test_help_loads_nothing_heavy(module: str):
    code = (
        f"import sys; from {module} import build_parser; build_parser().format_help(); "
        f"print(sorted({HEAVY | {'numpy', 'rosbags', 'mcap', 'scipy'}} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_tuning_never_loads_torch():
    code = (
        "import sys, tunenet_logs.analysis.batch.run, tunenet_logs.analysis.tuning; "
        "print('torch' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "False", result.stderr


def test_a_class_name_has_one_meaning():
    places: dict[str, list[str]] = {}
    for path in FILES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name_of(path))
    twice = [f"{name}: {', '.join(found)}" for name, found in places.items() if len(found) > 1]
    assert not twice, "\n".join(twice)
