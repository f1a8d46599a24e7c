"""The package as it is installed: every file once, one name, a pin for each package.

A user's folders may be called as ours, beside the script and on the path: tried with the tree as it
is installed here, and with the wheel.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import tunenet_logs as tn
from tests.conftest import BIN, COMMANDS
from tests.wheel import FOLDERS, LINKED, PACKAGE, ROOT, module_path
from tunenet_logs.analysis import api

PINS = [Requirement(line) for line in (ROOT / "constraints.txt").read_text().splitlines()]
# What folders of a user may well be called; ours at the top of the tree are called so, too.
THEIRS = ("analysis", "recorders", "tests", "benchmarks")

SCRIPT = """
import sys
before = set(sys.modules)
import tunenet_logs as tn
print(*sorted(set(sys.modules) - before))
import analysis.own, recorders.own, tests.own, benchmarks.own

assert {analysis.own.WHOSE, recorders.own.WHOSE, tests.own.WHOSE, benchmarks.own.WHOSE} == {"user"}
public = {name: getattr(tn, name) for name in tn.__all__}
print(tn.__file__)
print(public["tune"].__module__, public["DropOrder"].__module__, public["Episode"].__module__)
"""


@pytest.fixture(params=["editable", "wheel"])
def site(request: pytest.FixtureRequest) -> Path:
    """The folder that holds what is imported."""
    return ROOT if request.param == "editable" else request.getfixturevalue("installed")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A user's project with folders of those names, which fail where they are imported."""
    for name in THEIRS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('the user's own')")
    return tmp_path


def run(project: Path, site: Path, *words: str | Path) -> str:
    """What a program prints that is started in the project, which is first on its path.

    This tree is not on it, nor where it is installed.
    """
    places = [str(project), *([] if site == ROOT else [str(site)])]
    done = subprocess.run(
        [str(word) for word in words], cwd=project, capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_script_beside_folders_of_the_same_names(site: Path, project: Path):
    """The import itself costs nothing: no NumPy, no `typing`, no module of ours but the first."""
    for name in THEIRS:
        (project / name / "__init__.py").write_text("")
        (project / name / "own.py").write_text('WHOSE = "user"\n')
    (project / "script.py").write_text(SCRIPT)
    loaded, place, modules = run(project, site, sys.executable, "script.py").splitlines()
    ours = [name for name in loaded.split() if name.partition(".")[0] == PACKAGE]
    assert ours == [PACKAGE]
    assert not {"numpy", "typing"} & set(loaded.split())
    assert Path(place) == site / PACKAGE / "__init__.py"
    assert modules.split() == [
        "tunenet_logs.analysis.api",
        "tunenet_logs.recorders.orders",
        "tunenet_logs.episode",
    ]


def test_nothing_of_the_users_is_imported(site: Path, project: Path):
    run(project, site, sys.executable, "-c", "import tunenet_logs as tn; tn.tune")
    for name in COMMANDS:
        program = (BIN if site == ROOT else site / "bin") / name
        assert name in run(project, site, program, "--help")


def test_commands_of_the_wheel_work(installed: Path, project: Path):
    for words, says in {
        "record --simulate drop --restitution 0.6 -o a.mcap": "a.mcap",
        "record --simulate drop --restitution 0.4 -o b.mcap": "b.mcap",
        "tune a.mcap b.mcap --jobs 2": "0.6000",
        "logs info a.mcap": "/ball/pose",
        "record --outcome success --ball gel --tuning a.json": "gel",
        "review . -o all.rrd --jobs 1": "1/1 = 100 %",
        "record --simulate payload --mass 0.5 -o c.mcap": "c.mcap",
        "logs info c.mcap": "/joint_states",
    }.items():
        name, *rest = words.split()
        assert says in run(project, installed, installed / "bin" / f"tunenet-{name}", *rest)
    assert (project / "a.rrd").exists()


def test_the_wheel_holds_every_file_once(installed: Path):
    wanted = {module_path(path) for name in FOLDERS for path in files(ROOT / name)}
    wanted |= {Path(PACKAGE, "docs", path.name) for path in (ROOT / "docs").glob("*.md")}
    held = {path.relative_to(installed) for path in files(installed)}
    about = {path for path in held if path.parts[0] == "bin" or path.parts[0].endswith("-info")}
    assert held - about == wanted


def files(folder: Path) -> list[Path]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return [path for path in found if "__pycache__" not in path.parts]


@pytest.mark.parametrize("name", LINKED)
def test_a_folder_is_linked_into_the_package(name: str):
    """Without links (core.symlinks=false) git leaves files: a wheel would lack a part."""
    link = ROOT / PACKAGE / name
    assert link.is_symlink(), f"{link} is no link: check the tree out with core.symlinks=true"
    assert str(link.readlink()) == f"../{name}"
    assert link.samefile(ROOT / name)


def test_the_public_names_are_those_of_the_api():
    """An imported module becomes a name of its package: none may hide one of these."""
    assert tn.__all__ == api.__all__
    assert all(getattr(tn, name) is getattr(api, name) for name in tn.__all__)
    assert set(tn.__all__) <= set(dir(tn))
    assert not {path.stem for path in (ROOT / PACKAGE).iterdir()} & set(tn.__all__)
    assert (ROOT / PACKAGE / "py.typed").is_file()
    with pytest.raises(AttributeError, match="no attribute 'tun'"):
        tn.tun  # type: ignore[attr-defined]  # noqa: B018


def test_a_class_is_the_same_by_every_way():
    assert tn.Tuning.__module__ == "tunenet_logs.analysis.experiment"
    assert pickle.loads(pickle.dumps(tn.Tuning)) is tn.Tuning
    assert not [name for name in sys.modules if name.partition(".")[0] in LINKED]


def test_each_line_of_the_constraints_pins_one_package():
    names = [canonicalize_name(pin.name) for pin in PINS]
    assert names == sorted(set(names))
    assert all(str(pin.specifier).startswith("==") for pin in PINS)


def test_all_that_we_ask_for_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    pins = {canonicalize_name(pin.name): pin for pin in PINS}
    for one in map(Requirement, asked):
        name = canonicalize_name(one.name)
        if name != "tunenet-logs":
            (pin,) = pins[name].specifier
            assert one.specifier.contains(pin.version), one
