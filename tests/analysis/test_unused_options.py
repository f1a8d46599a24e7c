"""An option that changes nothing of a log says so; one that changes something does not."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_sample_logs import FOLDER

BIN = Path(sys.executable).parent

NOTHING = [
    ("dull", ("--height", "1"), "--height not used"),
    ("dull", ("--fps", "50"), "--fps not used"),
    ("dull", ("--torque-constants", "3"), "--torque-constants not used"),
    ("dull", ("--ball-diameter", "0.1"), "--ball-diameter not used"),
    ("dull", ("--roi", "0,0,9,9"), "--roi not used"),
    ("dull", ("--arm", "jaco6"), "--arm not used"),
    ("dull", ("--method", "fit", "--initial", "0.3"), "--initial not used"),
    ("filmed", ("--height", "1"), "--height not used"),
    ("filmed", ("--length-unit", "mm"), "--length-unit not used"),
    ("payload", ("--height", "1"), "--height not used"),
    ("payload", ("--length-unit", "mm"), "--length-unit not used"),
    ("payload", ("--ball", "golf"), "the ball's size and mass not used"),
]


def _tuned(log: Path, *words: str, folder: Path) -> dict:
    line = [BIN / "tunenet-tune", log, *words, "-o", folder, "--overwrite"]
    line += ["--json", "-", "--no-review", "--quiet"]
    done = subprocess.run(line, check=False, capture_output=True, text=True)
    assert done.stdout, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    folder = tmp_path_factory.mktemp("plain")
    names = {name for name, _, _ in NOTHING}
    return {name: _tuned(FOLDER / f"{name}.mcap", folder=folder) for name in names}


@pytest.mark.parametrize(("name", "words", "said"), NOTHING)
def test_what_changes_nothing_says_so(
    name: str, words: tuple[str, ...], said: str, plain: dict[str, dict], tmp_path: Path
) -> None:
    tuned = _tuned(FOLDER / f"{name}.mcap", *words, folder=tmp_path)
    assert tuned["parameters"] == plain[name]["parameters"]
    assert any(warning.startswith(said) for warning in tuned["warnings"])
    assert not any("not used" in warning for warning in plain[name]["warnings"])


@pytest.mark.parametrize("words", [("--ball", "table-tennis"), ("--length-unit", "mm")])
def test_what_changes_something_does_not(
    words: tuple[str, ...], plain: dict[str, dict], tmp_path: Path
) -> None:
    tuned = _tuned(FOLDER / "dull.mcap", *words, folder=tmp_path)
    assert tuned["parameters"] != plain["dull"]["parameters"]
    assert not any("not used" in warning for warning in tuned["warnings"])
