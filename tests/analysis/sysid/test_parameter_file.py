"""What is tuned, from YAML files of strangers."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunenet_logs.analysis.sysid.source import listed_parameters
from tunenet_logs.errors import UsageError


def read(tmp_path: Path, text: str | bytes) -> tuple[str, ...]:
    path = tmp_path / "tuned.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return listed_parameters([str(path)])


def test_files_stand_in_their_place(tmp_path: Path):
    path = tmp_path / "tuned.yml"
    path.write_text("joint/elbow.damping: [0, 5]\nbody/tool.mass:\n'a b.c[0]': [-1.5, 1e-3]\n")
    found = listed_parameters(["delay/commands", str(path), "option.density=0:2"])
    assert found == (
        "delay/commands",
        "joint/elbow.damping=0.0:5.0",
        "body/tool.mass",
        "a b.c[0]=-1.5:0.001",
        "option.density=0:2",
    )


MERGED = "a: &a {x: 1}\n" + "".join(
    f"{new}: &{new}\n  <<: [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [0, 1]\nb: [*a, *a]\n",
        "? &a [x, x]\n: [0, 1]\n? [*a, *a]\n: [0, 1]\n",
        MERGED,
        "a: &a [*a, 1]\n",
        "? [[x]]\n: 1\n",
        "x: [0, 1" + "0" * 4000 + "]\n",
        'x: ["0", "5"]\n',
        "x: [false, true]\n",
        "x: [0, 1, 2]\n",
        "x: 5\n",
        "x: " + "[" * 30_000,
        "joint: {elbow: {damping: [0, 5]}}\n",
        "- joint/elbow.damping\n",
        "x: [0, 1]\nx: [0, 2]\n",
        "x: [0, 1]\n---\ny: [0, 1]\n",
        "!!python/object/apply:os.system ['ls']\n",
        "",
        "# nothing\n",
        "{a: [0, 1]\n",
        "x\0: 1\n",
        b"\xff\xfe\xff",
        "x: [0, 1]\n" * 1_000_000,
        "\n".join(f"a{number}: [0, 1]" for number in range(201)),
    ],
)
def test_what_is_no_list_of_addresses_is_one_line(tmp_path: Path, text: str | bytes):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, text)
    line = str(caught.value)
    assert "tuned.yaml" in line
    assert line.isprintable()
    assert len(line) < 500 + len(str(tmp_path))
    assert "joint/elbow.damping: [0, 5]" in (caught.value.remedy or "")


@pytest.mark.parametrize("name", ["gone.yaml", "folder.yaml"])
def test_what_is_no_file_is_one_line(tmp_path: Path, name: str):
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(UsageError, match="cannot be read"):
        listed_parameters([str(tmp_path / name)])
