"""Small files beside logs: bounds, and JSON without its traps."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tunenet_logs.analysis.record import read_record
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import parse_json, read_small_file
from tunenet_logs.recorders.simulators.arm.description import read_urdf
from tunenet_logs.recorders.simulators.shot import read_rig


@pytest.mark.parametrize(
    "text",
    ["1e999", "NaN", "-Infinity", "9" * 5000, str(2**63), '{"a": 1, "a": 2}', "[" * 40 + "]" * 40,
     "[" * 100_000, '{"a":' * 5000, "", "{", '"\\']
)  # fmt: skip
def test_no_json_of_ours(text: str):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (whatever json says)
        parse_json(text.encode())
    assert len(str(caught.value)) < 200


def test_brackets_in_strings_are_text():
    text = "[" * 100 + '\\"' + "{" * 100
    assert parse_json(f'["{text}", -9223372036854775808, 0.5]')[1:] == [-(2**63), 0.5]


@pytest.mark.parametrize("atom", ['\\"', '"', "\\\\", "\\", "[", '"a', "1"])
def test_no_json_takes_the_square_of_its_length(atom: str):
    """A text of a million characters that does not end: at once, where its square took an hour."""
    with pytest.raises(ValueError):  # noqa: PT011 (whatever json says)
        parse_json('{"a": "' + atom * (1_000_000 // len(atom)))


def test_sizes_and_kinds(tmp_path: Path):
    file = tmp_path / "a"
    file.write_bytes(b"1234")
    assert read_small_file(file, 4) == b"1234"
    with pytest.raises(ValueError, match="larger than"):
        read_small_file(file, 3)
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path, tmp_path / "pipe"):
        with pytest.raises((OSError, LogError), match=r"regular file|directory"):
            read_small_file(place, 4)


@pytest.mark.parametrize(
    "text",
    ["[" * 2000, "{" * 2000, "gravity_m_s2: !!bool x", "a: &a 1\nb: &a 2", "a: *b", "x" * 30_000],
)
def test_a_rig_that_is_none_is_refused_before_it_costs_anything(tmp_path: Path, text: str):
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(UsageError, match=r"brackets|holds &|larger|no YAML"):
        read_rig(tmp_path / "rig.yaml")


@pytest.mark.parametrize("value", ["9" * 400, "1e999", '"' + "x" * 100_000 + '"'])
def test_a_record_with_a_number_that_is_none(tmp_path: Path, value: str):
    file = tmp_path / "a.json"
    file.write_text(f'{{"verdict": "ok", "parameters": null, "iterations": [{{"e": {value}}}]}}')
    with pytest.raises(LogError) as caught:
        read_record(file)
    assert len(str(caught.value)) < len(str(file)) + 300


def test_a_description_of_very_many_elements(tmp_path: Path):
    (tmp_path / "a.urdf").write_text("<robot>" + "<a>" * 900_000)
    with pytest.raises(UsageError, match="tags"):
        read_urdf(tmp_path / "a.urdf")
