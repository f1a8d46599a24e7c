"""`--print-completion`, in a real bash that completes words as it does for a user."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import COMMANDS, Command
from tunenet_logs.console import SHELLS

Offered = Callable[..., set[str]]


def completed(script: Path, words: list[str], folder: Path) -> set[str]:
    """What bash offers for the last word, as `complete` registered it for the first."""
    ask = """
source "$1"; shift
[[ $(complete -p "$1") =~ -F\\ ([^ ]+) ]] || exit 9
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
"${BASH_REMATCH[1]}" "$1" "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("needs bash")
    asked = [bash, "--norc", "-c", ask, "bash", script, *words]
    result = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return {line.strip() for line in result.stdout.splitlines()}


@pytest.fixture
def offered(command: Command, tmp_path: Path) -> Offered:
    """Complete words of a command in a folder with a log and a folder in it."""
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "drop one.mcap").touch()
    (folder / "drop.json").touch()
    (folder / "drops").mkdir()

    def complete(*words: str) -> set[str]:
        script = tmp_path / f"{words[0]}.bash"
        script.write_text(command(words[0], "--print-completion", "bash").stdout)
        return completed(script, list(words), folder)

    return complete


def test_an_option_is_completed(offered: Offered):
    assert offered("tunenet-tune", "--rev") == {"--review-only"}
    assert {"--tare", "--task", "--topic"} <= offered("tunenet-tune", "--t")


def test_a_choice_is_completed(offered: Offered):
    assert offered("tunenet-tune", "--review-only", "") == {"ok", "suspect", "rejected"}
    assert offered("tunenet-train", "pay") == {"payload"}
    assert "table-tennis" in offered("tunenet-tune", "--ball", "ta")
    assert "ur5e" in offered("tunenet-tune", "--arm", "ur")
    assert {"mujoco", "sdf"} <= offered("tunenet-export", "drop.json", "--to", "")


def test_files_and_folders_are_completed(offered: Offered):
    assert {"drop one.mcap", "drop.json"} <= offered("tunenet-tune", "dr")
    assert offered("tunenet-tune", "-o", "dr") == {"drops"}
    assert "drop.json" in offered("tunenet-tune", "drop.mcap", "--arm-card", "drop.")


def test_a_verb_and_what_follows_it_are_completed(offered: Offered):
    assert offered("tunenet-logs", "re") == {"recover"}
    assert "--json" in offered("tunenet-logs", "info", "--j")
    assert "drop.json" in offered("tunenet-logs", "check", "drop.")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_scripts_for_each_shell(command: Command, name: str):
    for shell in SHELLS:
        result = command(name, "--print-completion", shell)
        assert result.returncode == 0
        assert name in result.stdout
        assert "--print-completion" in result.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_bash_parses_every_script(command: Command, name: str):
    script = command(name, "--print-completion", "bash").stdout
    result = subprocess.run(["bash", "-n"], input=script, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")


def test_help_does_not_load_it():
    code = "import sys, tunenet_logs.analysis.cli.tune as t; t.build_parser().format_help(); "
    code += "print('shtab' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "False\n"
