"""`tunenet-logs info --json` and `check --json`: the promised keys, of any log, as strict JSON."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from tests.conftest import ROOT, Command, real
from tests.strangers import write_poses
from tunenet_logs.files import json_line

# A topic that ends lines, clears terminals, turns text around and closes JSON's quotes.
HOSTILE = '/a"b\\\n\x1b[2J\u202e\u2028{}'


def strict(text: str) -> list[dict[str, Any]]:
    """Objects, one a line, of JSON as its standard has it."""

    def refuse(word: str) -> NoReturn:
        raise ValueError(word)

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def promised_keys(verb: str) -> set[str]:
    """The keys that docs/logs.md has in its table of a verb."""
    text = (ROOT / "docs" / "logs.md").read_text()
    section = text.split(f"`{verb} --json`:", 1)[1].split("\n\n", 2)[1]
    return {
        key for row in section.splitlines() for key in re.findall(r"`(\w+)`", row.split("|")[1])
    }


def test_info_tells_a_script_what_it_tells_a_person(command: Command, drop_log: Path):
    [found] = strict(command("tunenet-logs", "info", drop_log, "--json").stdout)
    assert found["log"] == str(drop_log)
    assert found["error"] is None
    assert found["bytes"] == drop_log.stat().st_size
    assert (found["kind"], found["truth"]["restitution"]) == ("drop", 0.7)
    [channel] = found["channels"]
    assert (channel["topic"], channel["messages"], channel["used"]) == ("/ball/pose", 400, True)
    assert channel["rate_hz"] == pytest.approx(60)
    assert found["duration_s"] == pytest.approx(399 / 60)


def test_gaps_are_counted_and_measured(command: Command, tmp_path: Path):
    stamps_ns = np.arange(100) * 10_000_000
    stamps_ns[50:] += 2 * 10**9
    write_poses(tmp_path / "gap.mcap", stamps_ns, np.zeros((100, 3)))
    [found] = strict(command("tunenet-logs", "info", tmp_path / "gap.mcap", "--json").stdout)
    [channel] = found["channels"]
    assert channel["gaps"] == 1
    assert channel["longest_gap_s"] == pytest.approx(2.01)


def test_check_tells_damage_with_the_exit_code(command: Command, drop_log: Path, tmp_path: Path):
    (tmp_path / "cut.mcap").write_bytes(drop_log.read_bytes()[:-500])
    result = command("tunenet-logs", "check", drop_log, tmp_path / "cut.mcap", "--json")
    whole, cut = strict(result.stdout)
    assert result.returncode == 1
    assert (whole["whole"], whole["damage"], whole["messages"]) == (True, [], 400)
    assert cut["whole"] is False
    assert cut["damage"]


@pytest.mark.parametrize("verb", ["info", "check"])
def test_the_keys_are_those_of_the_document(
    command: Command, drop_log: Path, tmp_path: Path, verb: str
):
    """Those of a log that cannot be read, too: a script needs no second way."""
    (tmp_path / "no.mcap").write_text("no log")
    result = command("tunenet-logs", verb, drop_log, tmp_path / "no.mcap", "--json")
    read, unread = strict(result.stdout)
    assert result.returncode == 1
    assert set(read) == set(unread) == promised_keys(verb)
    assert unread["error"] in result.stderr
    assert {key for key, value in unread.items() if value is not None} <= {"log", "error", "whole"}


def test_names_that_attack_are_data(command: Command, tmp_path: Path):
    path = tmp_path / os.fsdecode(b"\xff\x1b[31m\n.mcap")
    write_poses(path, np.arange(10) * 10**7, np.zeros((10, 3)), topic=HOSTILE)
    for verb in ("info", "check"):
        text = command("tunenet-logs", verb, path, "--json").stdout
        assert text.isascii()
        assert text.removesuffix("\n").isprintable()
        [found] = strict(text)
        assert os.fsencode(found["log"]) == os.fsencode(path)
        if verb == "info":
            assert found["channels"][0]["topic"] == HOSTILE


def test_no_number_is_nan():
    line = json_line({"a": float("nan"), "b": [np.float64("inf"), np.int64(3)], "c": {"d": -0.5}})
    assert strict(line) == [{"a": None, "b": [None, 3], "c": {"d": -0.5}}]


@pytest.mark.parametrize(
    "name",
    [
        *("ros1/jaco2_6dof_bsd3.bag", "ros1/jaco2_no_effort.bag", "labs/markers_analogs.c3d"),
        *("labs/tracker_multi_data.txt", "mcap_rosbag2/cdr_test_cdr_test_0.mcap"),
        *("mcap_conformance/NoData.mcap", "labs/lerobot_episode.parquet"),
    ],
)
def test_files_of_strangers_give_the_promised_keys(command: Command, name: str):
    for verb in ("info", "check"):
        [found] = strict(command("tunenet-logs", verb, real(name), "--json").stdout)
        assert set(found) == promised_keys(verb)
