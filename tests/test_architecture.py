"""The direction of imports, no circles, and nothing heavy before it is needed."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("tunenet_logs", "recorders", "analysis")
ALLOWED = {
    "tunenet_logs": {"tunenet_logs"},
    "recorders": {"tunenet_logs", "recorders"},
    "analysis": {"tunenet_logs", "recorders", "analysis"},
}
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
# The folders, by name, whose modules may import a library at module level.
OWNERS = {"rerun": "review", "cyclonedds": "ros2", "matplotlib": "report", "jinja2": "report"}
# The one package that may import a physics engine at all, or speak its keywords.
ENGINE_FOLDERS = {name: f"recorders.simulators.{name}" for name in ("pybullet", "mujoco")}
# The room that writes files for engines: it speaks their words, and its file of an engine's name
# may import that engine in functions.
ENGINE_EXPORTS = "analysis.export."
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


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
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_imports_point_down():
    upward = [
        f"{name_of(path)} imports {name}"
        for path in FILES
        for node in ast.walk(tree_of(path))
        for name in imported(node)
        if name.split(".")[0] in PACKAGES
        and name.split(".")[0] not in ALLOWED[path.relative_to(ROOT).parts[0]]
    ]
    assert not upward, "\n".join(upward)


def test_heavy_libraries_are_imported_when_needed():
    """At module level only in the rooms that exist for one of them."""
    early = [
        f"{name_of(path)} imports {name} at module level"
        for path in FILES
        for name in module_level(tree_of(path))
        if (top := name.partition(".")[0]) in HEAVY and OWNERS.get(top) not in path.parts
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


@pytest.mark.parametrize(("library", "folder"), ENGINE_FOLDERS.items())
def test_a_physics_engine_is_known_in_its_folder_alone(library: str, folder: str):
    """Imports inside of functions count too: what is simulated is written for any engine."""
    inside = {path for path in FILES if name_of(path).startswith(folder)}
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
    evaluation = "analysis.evaluation"
    wrong = [
        f"{name_of(path)} imports {name}"
        for path in FILES
        for node in ast.walk(tree_of(path))
        for name in imported(node)
        if name.startswith(evaluation) and not name_of(path).startswith(evaluation)
    ]
    assert not wrong, "\n".join(wrong)


def test_no_module_imports_itself_through_others():
    modules = {name_of(path): path for path in FILES}
    edges = {
        name: {one for one in module_level(tree_of(path)) if one in modules}
        for name, path in modules.items()
    }
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
        "recorders.cli",
        "analysis.cli.tune",
        "analysis.cli.review",
        "analysis.cli.train",
        "analysis.cli.plan",
        "analysis.cli.export",
        "analysis.cli.compare",
        "analysis.cli.report",
        "analysis.evaluation.cli",
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
    code = "import sys, analysis.batch.run, analysis.tuning; print('torch' in sys.modules)"
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
