"""tunenet-compare and tunenet-report as commands: what they print, write, and never replace."""

from __future__ import annotations

import csv
import re
from importlib import import_module
from pathlib import Path

import pytest

from tests.analysis.records import drop_record, rejected_record
from tests.conftest import Command
from tunenet_logs.analysis.record import to_json


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two balls that differ, one of them suspect, and a log without a drop."""
    records = {
        "red": drop_record(0.7, log="red.mcap"),
        "blue": drop_record(0.8, log="blue.mcap", verdict="suspect", reason="may slide"),
        "none": rejected_record("no bounce is seen", log="none.mcap"),
    }
    (tmp_path / "tuned").mkdir()
    for name, record in records.items():
        (tmp_path / "tuned" / f"{name}.json").write_text(to_json(record))
    (tmp_path / "tuned" / "other.json").write_text("[1, 2]")
    return tmp_path / "tuned"


def test_the_table_names_values_differences_suspects_and_rejected_logs(
    folder: Path, command: Command
):
    done = command("tunenet-compare", folder)
    assert done.returncode == 0, done.stderr
    assert "red.mcap   ok       0.7000 (0.6980 to 0.7020)" in done.stdout
    assert "0.8000 (0.7980 to 0.8020) (suspect)" in done.stdout
    assert "restitution: they differ" in done.stdout
    test = next(line for line in done.stdout.splitlines() if line.startswith("restitution  "))
    differs = ["+0.1000", "0.0972 to 0.1028", "4.00", "p < 0.0001", "differs"]
    assert re.split("  +", test)[2:] == differs
    assert "none.mcap  rejected  no bounce is seen" in done.stdout
    assert "Holm" in done.stdout
    alone = command("tunenet-compare", folder / "none.json")
    assert alone.returncode == 1


def test_equal_logs_of_two_folders_are_told_apart_by_their_folders(
    folder: Path, tmp_path: Path, command: Command
):
    (tmp_path / "after").mkdir()
    (tmp_path / "after" / "red.json").write_text(to_json(drop_record(0.75, log="red.mcap")))
    done = command("tunenet-compare", folder / "red.json", tmp_path / "after" / "red.json")
    assert "red.mcap (tuned/red)" in done.stdout
    assert "red.mcap (after/red)" in done.stdout


def test_the_tables_in_text_have_all_values_and_tests(
    folder: Path, tmp_path: Path, command: Command
):
    path = tmp_path / "balls.csv"
    assert command("tunenet-compare", folder, "--csv", path).returncode == 0
    rows = list(csv.DictReader(path.open()))
    assert {row["log"]: row["value"] for row in rows} == {
        "red.mcap": "0.7",
        "blue.mcap": "0.8",
        "none.mcap": "",
    }
    pairs = list(csv.DictReader((tmp_path / "balls_pairs.csv").open()))
    assert [(row["first"], row["second"], row["differs"]) for row in pairs] == [
        ("blue.mcap", "red.mcap", "True")
    ]


OUTPUTS = [
    ("tunenet-compare", "--csv", "out.csv"),
    ("tunenet-compare", "--html", "out.html"),
    ("tunenet-report", "-o", "out.html"),
]


@pytest.mark.parametrize(("name", "option", "output"), OUTPUTS)
def test_what_is_ours_and_of_the_same_logs_alone_is_replaced_unasked(
    folder: Path, tmp_path: Path, command: Command, name: str, option: str, output: str
):
    path = tmp_path / output
    assert command(name, folder, option, path).returncode == 0
    assert command(name, folder, option, path).returncode == 0
    fewer = command(name, folder / "red.json", option, path)
    assert fewer.returncode == 2
    assert "of blue.mcap, none.mcap, not of red.mcap; pass --overwrite" in fewer.stderr
    assert command(name, folder / "red.json", option, path, "--overwrite").returncode == 0
    assert command(name, folder, option, path).returncode == 0
    path.write_text("t,z\n0,1\n")
    foreign = command(name, folder, option, path, "--overwrite")
    assert foreign.returncode == 2
    assert "that tunenet-logs wrote" in foreign.stderr
    assert path.read_text() == "t,z\n0,1\n"
    assert not list(tmp_path.glob("*.partial"))


def test_nothing_replaces_what_is_read(folder: Path, command: Command):
    for name, option in (("tunenet-compare", "--csv"), ("tunenet-report", "-o")):
        done = command(name, folder, option, folder / "red.json", "--overwrite")
        assert done.returncode == 2
    page = folder / "page.html"
    page.symlink_to(folder / "red.json")
    done = command("tunenet-report", folder / "red.json", "-o", page, "--overwrite")
    assert done.returncode == 2
    assert "one of the files that are read" in done.stderr


def test_figures_for_a_paper(folder: Path, tmp_path: Path, command: Command):
    figures = tmp_path / "figures"
    curves = {
        "start_ns": 0,
        "seconds": [0.0, 0.5, 1.0],
        "observed_m": [1.0, 0.0, 0.5],
        "simulated_m": [1.0, 0.0, 0.5],
    }
    path = folder / "red.json"
    text = path.read_text().rstrip().removesuffix("}")
    path.write_text(text + f', "curves": {curves}}}'.replace("'", '"'))
    done = command("tunenet-report", path, "--pdf", figures, "--png", tmp_path / "one.png")
    assert done.returncode == 0, done.stderr
    assert {one.name for one in figures.iterdir()} == {"red_curves.pdf"}
    data = (figures / "red_curves.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    assert b"/Type3" not in data, "journals refuse fonts of type 3"
    width_pt = float(data.split(b"/MediaBox [ 0 0 ")[1].split(b" ")[0])
    assert width_pt == pytest.approx(3.4 * 72, abs=1)
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    assert command("tunenet-report", path, "--pdf", figures).returncode == 0
    other = command("tunenet-report", folder / "blue.json", "--pdf", figures / "red_curves.pdf")
    assert other.returncode == 2
    assert command("tunenet-report", path, "--pdf", tmp_path / "figure.svg").returncode == 2


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("tunenet-report", "red.json"), "say what to write"),
        (("tunenet-report", "red.json", "-o", "page.txt"), "ends .html"),
        (("tunenet-report", "nowhere.json", "-o", "a.html"), "no such file"),
        (("tunenet-report", "other.json", "-o", "a.html"), "is no tuning"),
        (("tunenet-compare", "nowhere.json"), "no such file"),
        (("tunenet-compare", "red.json", "--csv", "no/where.csv"), "no such folder"),
    ],
)
def test_wrong_use_is_one_line(folder: Path, command: Command, words: tuple[str, ...], why: str):
    done = command(*words, cwd=folder)
    assert done.returncode in (1, 2)
    assert why in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "option"), [("tunenet-report", "-o"), ("tunenet-compare", "--html")]
)
def test_without_the_extra_one_line_names_it(
    folder: Path, command: Command, monkeypatch: pytest.MonkeyPatch, name: str, option: str
):
    def missing(module: str) -> object:
        if module == "matplotlib":
            raise ModuleNotFoundError(f"No module named {module!r}", name=module)
        return import_module(module)

    monkeypatch.setattr("tunenet_logs.analysis.registry.import_module", missing)
    done = command(name, folder, option, folder / "a.html")
    assert done.returncode == 2
    assert "pip install 'tunenet-logs[report]'" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
