"""Orientations and frames of what has a position, in every encoding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.driven_logs import (
    DRIVEN_WRITERS,
    POSE,
    START_NS,
    TF,
    WRENCH,
    Sent,
    pose,
    transform,
    wrench,
)
from tunenet_logs.copying import import_log
from tunenet_logs.reader import read_episode
from tunenet_logs.signals import PositionRows

STEP_NS, COUNT = 10_000_000, 20
ANGLES = np.linspace(0.0, 1.0, COUNT)
TURNS = np.column_stack([np.zeros((COUNT, 2)), np.sin(ANGLES / 2), np.cos(ANGLES / 2)])


def sent(turns: Any = TURNS) -> list[Sent]:
    """A pose, a transform and a wrench at each of some moments."""
    found: list[Sent] = []
    for number, turn in enumerate(turns):
        at_ns = number * STEP_NS
        stamp_ns = START_NS + at_ns
        moved = transform(stamp_ns, (1, 2, number), turn, "base", "tool")
        found += [
            ("/mocap", POSE, at_ns, pose(stamp_ns, (number, 0, 0), turn, "room")),
            ("/tf", TF, at_ns, {"transforms": [moved]}),
            ("/ft", WRENCH, at_ns, wrench(stamp_ns, (1, 2, 3), (4, 5, 6), "flange")),
        ]
    return found


@pytest.mark.parametrize("name", DRIVEN_WRITERS)
def test_orientations_and_frames_are_read(name: str, tmp_path: Path):
    signals = read_episode(DRIVEN_WRITERS[name](tmp_path / name, sent())).signals
    frames = {one.name: one.frame for one in signals.values()}
    assert frames == {
        "/mocap": "room",
        "/mocap.orientation": "room",
        "/tf.tool": "base",
        "/tf.tool.orientation": "base",
        "/ft.force": "flange",
        "/ft.torque": "flange",
    }
    for label in ("/mocap.orientation", "/tf.tool.orientation"):
        assert signals[label].columns == ("x", "y", "z", "w")
        np.testing.assert_allclose(signals[label].values, TURNS, atol=1e-15)
        assert not signals[label].is_position


@pytest.mark.parametrize("turn", [(0, 0, 0, 1), (0, 0, 0, 0), (np.nan,) * 4, (3, 4, 0, 0)])
def test_what_is_no_rotation_is_no_signal(turn: Any, tmp_path: Path):
    path = DRIVEN_WRITERS["cdr.mcap"](tmp_path / "a.mcap", sent([turn] * COUNT))
    assert not [name for name in read_episode(path).signals if "orientation" in name]


def test_a_topic_that_changes_its_frame_stays_one_and_has_none():
    rows = PositionRows("/ball")
    for number in range(COUNT):
        rows.add(0, [(5 + number * STEP_NS, "", "ab"[number // 10], 0.0, 0.0, 1.0 * number)])
    (ball,), notes = rows.signals()
    assert (len(ball.stamps_ns), ball.frame) == (COUNT, "")
    assert not notes


def test_an_import_keeps_them_and_says_what_it_leaves_out(tmp_path: Path):
    path = DRIVEN_WRITERS["one.bag"](tmp_path / "one.bag", sent())
    imported = import_log(path, tmp_path / "one.mcap")
    first, again = read_episode(path), read_episode(tmp_path / "one.mcap")
    assert [one for one in imported.left_out if one.startswith("/ft: a command or a force")]
    for old, new in (("/mocap", "/mocap"), ("/tf.tool", "/tf/tool")):
        for label in ("", ".orientation"):
            one, other = first.signals[old + label], again.signals[new + label]
            assert np.array_equal(one.values, other.values)
            assert one.frame == other.frame
