"""One name is imported: a user's folders may be called as ours, beside the script and on the path.

Tried with the tree as it is installed here, and with the wheel.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import tunenet_logs as tn
from tests.conftest import BIN, COMMANDS
from tests.wheel import LINKED, PACKAGE, ROOT
from tunenet_logs.analysis import api

THEIRS = ("analysis", "recorders", "tests", "benchmarks")
"""What folders of a user may well be called; ours at the top of the tree are called so, too."""


_SCRIPT = """
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
    """A user's project whose folders are called as ours at the top of the tree."""
    for name in THEIRS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
        (tmp_path / name / "own.py").write_text('WHOSE = "user"\n')
    return tmp_path


def environment(project: Path, site: Path) -> dict[str, str]:
    """With the project first on the path; this tree is not on it, nor where it is installed."""
    installed = [] if site == ROOT else [str(site)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(project), *installed])}


def run(project: Path, site: Path, *words: str | Path) -> str:
    """What a program prints that is started in the project."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=project,
        env=environment(project, site),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_script_beside_folders_of_the_same_names(site: Path, project: Path):
    """The import itself costs nothing: no NumPy, no `typing`, no module of ours but the first."""
    (project / "script.py").write_text(_SCRIPT)
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
    for name in THEIRS:
        (project / name / "__init__.py").write_text("raise RuntimeError('the user's own')")
    run(project, site, sys.executable, "-c", "import tunenet_logs as tn; tn.tune")
    for name in COMMANDS:
        program = (BIN if site == ROOT else site / "bin") / name
        assert name in run(project, site, program, "--help")


def test_the_public_names_are_those_of_the_api():
    assert tn.__all__ == api.__all__
    assert all(getattr(tn, name) is getattr(api, name) for name in tn.__all__)
    assert set(tn.__all__) <= set(dir(tn))
    with pytest.raises(AttributeError, match="no attribute 'tun'"):
        tn.tun  # type: ignore[attr-defined]  # noqa: B018


def test_no_module_hides_a_public_name():
    """An imported module becomes a name of its package."""
    modules = {path.stem for path in (ROOT / PACKAGE).iterdir()}
    assert not modules & set(tn.__all__)
    assert (ROOT / PACKAGE / "py.typed").is_file()


def test_a_class_is_the_same_by_every_way():
    assert tn.Tuning.__module__ == "tunenet_logs.analysis.experiment"
    assert pickle.loads(pickle.dumps(tn.Tuning)) is tn.Tuning
    assert not [name for name in sys.modules if name.partition(".")[0] in LINKED]


@pytest.mark.parametrize("name", LINKED)
def test_a_folder_is_linked_into_the_package(name: str):
    """Without links (core.symlinks=false) git leaves files: a wheel would lack a part."""
    link = ROOT / PACKAGE / name
    assert link.is_symlink(), f"{link} is no link: check the tree out with core.symlinks=true"
    assert str(link.readlink()) == f"../{name}"
    assert link.samefile(ROOT / name)
