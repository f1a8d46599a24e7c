"""No document shows a command that does not exist, or that does not work as it is shown.

`make docs-check` runs the slow ones too, all as their console scripts, in a clean copy of the tree.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.docs.commands import (
    DOCUMENTS,
    NOT_RUN,
    OTHER_OPTIONS,
    SLOW,
    VIEWER,
    Block,
    Shown,
    begins_a_command,
    blocks,
    options,
    other_fences,
    reason,
)
from tests.docs.parsing import (
    all_options,
    beginning,
    extras,
    module_options,
    refusal,
    run_in_process,
    script_of,
    scripts,
)
from tests.docs.stand_ins import SAMPLES, stand_in
from tests.wheel import ROOT

BLOCKS = [block for document in DOCUMENTS for block in blocks(document)]


COMMANDS = [command for block in BLOCKS for command in block.commands]


_BIN = Path(sys.executable).parent


# What a parser says of a command that stands between words and leaves out what follows.
_INCOMPLETE = ("required", "expected one argument")


_VERBS = {"info", "check", "recover", "import"}  # of `tunenet-logs`, named between words


Run = Callable[[Sequence[str], Path], subprocess.CompletedProcess[str]]


def is_ours(command: Shown) -> bool:
    return beginning(command.words) is not None


def is_a_mention(command: Shown) -> bool:
    """Whether it stands for many commands, or is the name of one."""
    return len(command.words) == 1 or command.is_a_pattern or command.words[-1] in _VERBS


def is_run(command: Shown, *, slow: bool) -> bool:
    if not is_ours(command) or is_a_mention(command):
        return False
    if reason(NOT_RUN, command.text) or _is_fragment(command):
        return False
    return slow or not reason(SLOW, command.text)


def _is_fragment(command: Shown) -> bool:
    """Whether it is between words and leaves out what every reader would add."""
    return command.inline and any(word in (refusal(command.words) or "") for word in _INCOMPLETE)


def _filled(words: Sequence[str]) -> list[str]:
    """A command with a number for each word in capitals, which may stand for one."""
    kept = [word for word in words if word.strip(".[]")]
    return ["1" if re.fullmatch("[A-Z][A-Z_]+", word) else word for word in kept]


def _shown(found: Sequence[str]) -> str:
    return "\n".join(["", *found])


def test_every_command_is_recognised():
    unknown = [
        f"{one.place}: {one.text}"
        for one in COMMANDS
        if not is_ours(one) and not reason({**NOT_RUN, **VIEWER}, one.text)
    ]
    assert not unknown, _shown(unknown)


def test_the_parser_of_each_command_takes_its_arguments():
    wrong = [
        f"{one.place}: {one.text}\n    {said}"
        for one in COMMANDS
        if is_ours(one) and len(one.words) > 1
        and (said := refusal(_filled(one.words)))
        and not (one.inline and any(word in said for word in _INCOMPLETE))
    ]  # fmt: skip
    assert not wrong, _shown(wrong)


def test_what_does_not_exist_is_told():
    for line in (
        "tunenet-tune drop.mcap --colour red",
        "tunenet-record --simulate drop --bounce 3",
        "tunenet-logs mend drop.mcap",
        "python -m tests.bench.lab units --sed 3",
    ):
        assert refusal(line.split()), line
    with pytest.raises(AssertionError, match=r"no module tests\.bench\.nothing"):
        refusal(["python", "-m", "tests.bench.nothing"])


def test_every_option_that_is_named_exists():
    """Those in comments and between words, too."""
    wrong = []
    for document in DOCUMENTS:
        known = {*all_options(), *OTHER_OPTIONS}
        modules = {
            one.words[2]
            for block in blocks(document)
            for one in block.commands
            if one.words[1:2] == ("-m",) and is_ours(one)
        }
        known = known.union(*map(module_options, modules))
        named = {one for one in options(document.read_text()) if one.startswith("--")}
        wrong += [f"{document.relative_to(ROOT)}: {one}" for one in sorted(named - known)]
    assert not wrong, _shown(wrong)


def test_every_target_of_make_exists():
    targets = {
        word
        for one in COMMANDS
        if one.words[0] == "make"
        for word in one.words[1:]
        if "=" not in word
    }
    assert {"demo", "test"} <= targets
    dry = subprocess.run(["make", "-n", *targets], cwd=ROOT, capture_output=True, text=True)
    assert dry.returncode == 0, dry.stderr


def test_pip_takes_what_it_is_given():
    from pip._internal.commands import create_command

    shown = [one for one in COMMANDS if "pip" in {Path(word).name for word in one.words[:3]}]
    assert shown
    for one in shown:
        if one.is_a_pattern:
            continue
        verb, *arguments = one.words[[Path(word).name for word in one.words].index("pip") + 1 :]
        create_command(verb).parse_args(arguments)
        for word in arguments:
            if word.startswith((".[", "tunenet-logs[")):
                named = set(word.partition("[")[2].rstrip("]").split(","))
                assert named <= extras(), one.place


def test_every_extra_is_described():
    text = (ROOT / "docs" / "install.md").read_text()
    assert {one for one in extras() if f"`{one}`" in text} == extras()


def test_commands_stand_in_blocks_of_the_shell():
    """Where they are looked for."""
    elsewhere = [
        f"{document.relative_to(ROOT)}: {line}"
        for document in DOCUMENTS
        for _, text in other_fences(document)
        for line in text.splitlines()
        if begins_a_command(line)
    ]
    assert not elsewhere, _shown(elsewhere)


def test_every_exception_is_needed():
    for pattern in (*NOT_RUN, *SLOW, *VIEWER):
        assert any(reason({pattern: ""}, one.text) == "" for one in COMMANDS), pattern
    named = set().union(*(options(document.read_text()) for document in DOCUMENTS))
    assert set(OTHER_OPTIONS) <= named - all_options()


def _some(*, slow: bool) -> list[Block]:
    return [block for block in BLOCKS if any(is_run(one, slow=slow) for one in block.commands)]


def _follow(block: Block, folder: Path, run: Run, *, slow: bool) -> None:
    """Run a block's commands in their order, as a reader who has the recordings."""
    shutil.copytree(SAMPLES, folder / "sample_logs")
    skipped = False
    for command in block.commands:
        if is_run(command, slow=slow):
            stand_in(command.words, folder)
            result = run(command.words, folder)
            said = f"{command.place}: {command.text}\n{result.stdout}{result.stderr}"
            assert result.returncode == command.exit_code, said
        elif reason(VIEWER, command.text) and not command.is_a_pattern:
            there = (folder / command.words[1]).is_file()
            assert there or skipped or command.inline, f"{command.place}: {command.text}: no file"
        elif command.words[0] == "mkdir":
            (folder / command.words[1]).mkdir()
        elif command.words[0] == "printf":
            *words, arrow, name = command.words
            assert arrow == ">"
            with (folder / name).open("w") as file:
                subprocess.run(words, stdout=file, check=True)
        else:
            skipped |= bool(reason(SLOW, command.text))


@pytest.mark.parametrize("block", _some(slow=False), ids=lambda block: block.place)
def test_what_a_document_shows_works(block: Block, tmp_path: Path):
    _follow(block, tmp_path, run_in_process, slow=False)


def _first_words(script: str) -> list[str]:
    """A console script; as Python makes one, where it was not there when the rest was installed."""
    if (_BIN / script).exists():
        return [str(_BIN / script)]
    module, _, name = scripts()[script].partition(":")
    return [sys.executable, "-c", f"import sys; from {module} import {name}; sys.exit({name}())"]


@pytest.mark.docs
@pytest.mark.parametrize("block", _some(slow=True), ids=lambda block: block.place)
def test_what_a_document_shows_works_as_a_user_runs_it(block: Block, tmp_path: Path):
    def run(words: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
        script = script_of(words[0])
        first = _first_words(script) if script else [sys.executable]
        return subprocess.run(
            [*first, *words[1:]],
            cwd=folder if script else ROOT,
            capture_output=True,
            text=True,
            timeout=1800,
        )

    _follow(block, tmp_path, run, slow=True)
