"""Viewers that open a log itself draw what moves in it; readers take none of that for data."""

import pytest
from mcap.reader import make_reader
from rerun.chunk import McapReader

from tunenet_logs.copying import import_log
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.cli import main as record


def drawn(path):
    """Return the names of the components that Rerun's own importer makes, by entity."""
    found = {}
    for chunk in McapReader(str(path)).stream():
        names = {field.name for field in chunk.to_record_batch().schema}
        found.setdefault(str(chunk.entity_path), set()).update(names)
    return found


@pytest.mark.parametrize(
    ("kind", "seen", "signals"),
    [
        (
            "drop",
            {
                "/ball/pose/height_m": "Scalars:scalars",
                "/ball/pose/surface": "Points3D:positions",
                "/table": "Points3D:positions",
                "/tf": "Transform3D:translation",
            },
            ["/ball/pose"],
        ),
        (
            "bounce-shot",
            {
                "/ball/pose/position_m": "Scalars:scalars",
                "/ball/pose/surface": "Points3D:positions",
            },
            ["/ball/pose"],
        ),
        (
            "payload",
            {
                "/joint_states/effort": "Scalars:scalars",
                "/robot_description": "TextDocument:text",
                "/tf": "Transform3D:quaternion",
            },
            ["/joint_states.position", "/joint_states.velocity", "/joint_states.effort"],
        ),
    ],
)
def test_a_viewer_draws_a_log_as_it_is(tmp_path, kind, seen, signals):
    log = tmp_path / "log.mcap"
    assert record(["--simulate", kind, "-o", str(log), "--quiet"]) == 0
    entities = drawn(log)
    for entity, component in seen.items():
        assert component in entities[entity], entity
    episode = read_episode(log)
    assert list(episode.signals) == signals
    assert not episode.warnings
    assert [one.topic for one in episode.channels] == [signals[0].partition(".")[0]]
    counts = episode.info.counts
    assert counts["captured"] == counts["written"] == len(episode.signals[signals[0]].stamps_ns)
    with log.open("rb") as file:
        names = [one.name for one in make_reader(file).iter_metadata()]
    assert len(names) == len(set(names))  # viewers warn of records that share a name
    copy = import_log(log, tmp_path / "copy.mcap")
    assert copy.messages == counts["written"]
    assert not copy.left_out
