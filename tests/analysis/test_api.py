"""The Python API: it says what the commands say, and its page and notebook what it says."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, Literal

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import tunenet_logs as tn
from tests.analysis.answers import known
from tests.conftest import ROOT, Command
from tunenet_logs.analysis.cli.tune import build_parser
from tunenet_logs.console import options_in
from tunenet_logs.recorders.simulators.known import ENGINES

SAMPLES = ROOT / "sample_logs"
HELD, EMPTY = SAMPLES / "payload.mcap", SAMPLES / "payload_empty.mcap"


@cache
def tuned(name: str) -> tn.Tuning:
    """What is tuned from a sample, once; nobody changes it."""
    return tn.tune(SAMPLES / f"{name}.mcap", tares=[EMPTY] if name == "payload" else [])


# Options without a meaning for a function, and those that `tune_all` has by other names, or as
# they are; `csv` is the table that it returns.
_OF_THE_TERMINAL = {"help", "version", "debug", "quiet", "preview", "print_completion"}
_OF_THE_TERMINAL |= {"verbose", "json", "dry_run"}
_OF_MANY = {"logs", "output", "jobs", "overwrite", "resume", "ray", "no_review", "review_only"}


def test_every_option_of_the_command_has_its_name_and_a_notebook_completes_it():
    actions = {action.dest for action in build_parser()._actions}
    mine = set(options_in(tn.TuneOptions)) | {"engine", "save_arm_card", "csv"}
    assert actions - _OF_THE_TERMINAL - _OF_MANY == mine
    for function in (tn.tune, tn.tune_all):
        named = inspect.signature(function).parameters
        assert set(options_in(tn.TuneOptions)) <= set(named)
        assert named["start_s"].kind is inspect.Parameter.KEYWORD_ONLY
        assert named["iterations"].default == 5


def test_a_film_a_payload_and_impact_times_as_the_command_tunes_them(
    command: Command, tmp_path: Path
):
    times = tmp_path / "times.csv"
    times.write_text("t\n" + "\n".join(map(str, np.cumsum([0.0, 0.6, 0.45, 0.34, 0.25]))) + "\n")
    logs = [SAMPLES / "filmed.mcap", times]
    words = ("-o", "out", "--no-review")
    command("tunenet-tune", *logs, *words, cwd=tmp_path)
    command("tunenet-tune", HELD, "--tare", EMPTY, *words, cwd=tmp_path)
    tares: list[list[Path]] = [[], [], [EMPTY]]
    for log, runs in zip([*logs, HELD], tares, strict=True):
        written = json.loads((tmp_path / "out" / f"{log.stem}.json").read_text())
        tn.save_tuning(tn.tune(log, tares=runs), tmp_path / "mine.json", overwrite=True)
        mine = json.loads((tmp_path / "mine.json").read_text())
        for one in (written, mine):
            del one["seconds"], one["provenance"]["date"]
        assert mine == written


LOOP = """
import json, resource, sys
import tunenet_logs as tn

logs, out = sys.argv[1].split(","), sys.argv[2]
found, sizes = {}, []
for log in logs:
    record = tn.tune(log).record
    found[log] = [record.verdict, *record.estimates[0].interval95, record.estimates[0].value]
    sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
json.dump([found, sizes], open(out, "w"))
"""


def test_a_loop_over_logs_says_what_the_command_says_is_silent_and_keeps_nothing(
    command: Command, tmp_path: Path
):
    logs = [
        tn.save_episode(
            tn.simulate(tn.DropOrder(seed=seed, noise_m=0.001)), tmp_path / f"{seed}.mcap"
        )
        for seed in range(30)
    ]
    words = [sys.executable, "-c", LOOP, ",".join(map(str, logs)), "found.json"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    found, sizes_kib = json.loads((tmp_path / "found.json").read_text())
    command("tunenet-tune", *logs[:5], "-o", "out", "--no-review", cwd=tmp_path)
    for log in logs[:5]:
        written = json.loads((tmp_path / "out" / f"{log.stem}.json").read_text())
        known = written["parameters"]["restitution"]
        assert found[str(log)] == [written["verdict"], *known["interval95"], known["value"]]
    assert sizes_kib[-1] - sizes_kib[9] < 4000  # a log's samples would be as much


def test_values_are_a_table_with_a_row_for_each_component_and_of_a_rejected_log_none():
    light, held = tuned("light"), tuned("payload")
    table = light.record.to_frame()
    assert list(table.index) == ["restitution", "restitution_slope", "drag"]
    assert table.loc["restitution", "value"] == light.record.estimates[0].value
    assert (table.low < table.value).all()
    assert (table.value < table.high).all()
    assert list(table.unit) == ["1", "1", "1/m"]
    curves = known(light.record.motion.curves)
    assert list(curves.to_frame().columns) == ["observed_m", "simulated_m"]
    names = ["payload_mass", *(f"payload_com_{axis}" for axis in "xyz")]
    assert list(held.to_frame().index) == names
    missing = tn.tune("nowhere.mcap")
    assert (missing.verdict, missing.to_frame().empty) == ("rejected", True)
    assert missing.reason == "no such file; check its name and folder"


def test_arrays_of_ones_own_are_tuned_as_the_log_that_holds_them():
    positions = tn.read_episode(SAMPLES / "light.mcap").signals["/ball/pose"]
    units: tuple[tuple[Literal["m", ""], float], ...] = (("m", 1.0), ("", 3.281))
    for unit, scale in units:  # without a unit, any scale
        heights = positions.values[:, 2] * scale
        episode = tn.episode_of_positions(positions.seconds, heights, unit=unit)
        mine, theirs = (one.to_frame().value for one in (tn.tune(episode), tuned("light")))
        np.testing.assert_allclose(mine, theirs, rtol=1e-3)
    signals = tn.read_episode(HELD).signals
    parts = ("position", "velocity", "effort")
    position, velocity, effort = (signals[f"/joint_states.{part}"] for part in parts)
    episode = tn.episode_of_joints(
        position.seconds, position.columns, position.values, effort.values, velocity.values
    )
    mine = tn.tune(episode, tares=[EMPTY]).to_frame().value
    np.testing.assert_allclose(mine, tuned("payload").to_frame().value, rtol=1e-6)


@pytest.mark.parametrize(
    ("seconds", "heights", "says"),
    [
        ([0, 1], [1, 2, 3], "expected"),
        ([0, 0, 1], [1, 2, 3], "do not increase"),
        ([0, 1, 2], [1, np.nan, 3], "missing or not finite"),
        ([0, 1, 2e18], [1, 2, 3], "in seconds"),
    ],
)
def test_arrays_that_make_no_sense_are_refused(seconds: list, heights: list, says: str):
    with pytest.raises(tn.UsageError, match=says):
        tn.episode_of_positions(seconds, heights)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"iterations": 2.5}, "whole number from 1"),
        ({"method": "magic"}, "choose one of: tunenet"),
        ({"start_s": 3, "end_s": 2}, "not before"),
        ({"height_m": "1.2"}, "is not a number from 0.001 to 100 m"),
        ({"ball": "cricket"}, "there is: table-tennis"),
        ({"hsv": ((0, 0, 0), (9, 9, 9)), "ball_at": (1, 2, 3)}, "leave one out"),
        ({"effort_unit": "A"}, "add --torque-constants"),
        ({"tares": ["a.mcap", "a.mcap"]}, "named twice"),
        ({"urdf": "arm.urdf"}, "add --tool-link"),
        ({"columns": "nothing"}, "says no column"),
        ({"columns": "t=1,position=8:3"}, "position=8:3 names no joints; write position_1=COLUMN"),
        ({"columns": "t=1,effort=2:1001"}, "names no joints"),
        ({"columns": "position=2:4,position_3=9"}, "says twice what position_3 is"),
        ({"length_unit": "furlong"}, "is not known"),
        ({"torque_constants": [0.0]}, "are no numbers"),
        ({"bal": "golf"}, "no option 'bal'"),
        ({"engine": "havok"}, "no engine is named"),
    ],
)
def test_an_option_that_makes_no_sense_raises(options: dict[str, Any], says: str):
    with pytest.raises(tn.UsageError, match=says):
        tn.tune(SAMPLES / "dull.mcap", **options)


def test_a_doubtful_ball_warns_and_only_a_drop_is_filmed():
    with pytest.warns(UserWarning, match="denser than any metal"):
        tn.tune(SAMPLES / "dull.mcap", ball_diameter_m=0.04, ball_mass_kg=2.7)
    with pytest.raises(tn.UsageError, match="only a drop can be filmed"):
        tn.simulate(tn.PayloadOrder(), film=tn.FilmOrder())
    assert tn.simulate(tn.ShotOrder(seed=2)).info.kind == "bounce-shot"


@pytest.mark.parametrize("engine", ENGINES)
def test_the_engine_is_chosen_for_the_call_alone(engine: str):
    pytest.importorskip(engine)
    found = tn.tune(SAMPLES / "dull.mcap", engine=engine)
    assert str((found.record.simulator or {})["engine"]).startswith(engine)
    assert tn.tune(SAMPLES / "dull.mcap").record.simulator == tuned("dull").record.simulator


def test_results_are_kept_and_never_replace_anothers(tmp_path: Path):
    dull, bouncy = tuned("dull"), tuned("bouncy")
    kept = tn.save_tuning(dull, tmp_path / "a.json")
    assert tn.read_tuning(kept).estimates == dull.record.estimates
    tn.save_tuning(dull, kept)
    with pytest.raises(tn.LogError, match=r"is the tuning of dull.mcap, not of bouncy.mcap"):
        tn.save_tuning(bouncy, kept)
    seen = tn.review(dull, tmp_path / "a.rrd")
    tn.review(dull, seen)
    in_memory = tn.tune(tn.simulate(tn.DropOrder(seed=1)))
    for other, name in ((bouncy, "bouncy"), (in_memory, "episode")):
        with pytest.raises(tn.LogError, match=f"is the review of another log, not of {name}"):
            tn.review(other, seen)
    tn.save_tuning(in_memory, tmp_path / "b.json")
    with pytest.raises(tn.LogError, match="is the tuning of"):
        tn.save_tuning(dull, tmp_path / "b.json")
    with pytest.raises(tn.UsageError, match=r"name it a\.rrd"):
        tn.review(dull, tmp_path / "a.json")
    with pytest.raises(tn.LogError, match="could not be read"):
        tn.review(tn.tune("nowhere.mcap"), tmp_path / "c.rrd")
    (file,) = tn.export(dull, "mujoco", tmp_path / "ball.xml", speed_m_s=2.0)
    assert "<mujoco" in file.read_text()
    assert tn.export(dull, "mujoco", file) == (file,)
    with pytest.raises(tn.LogError, match=r"of dull.mcap, not of bouncy.mcap.*overwrite=True"):
        tn.export(bouncy, "mujoco", file)
    with pytest.raises(tn.UsageError, match="choose one of: pybullet"):
        tn.export(dull, "havok", tmp_path / "ball.xml")


def test_many_logs_are_a_table(tmp_path: Path):
    logs = [SAMPLES / "dull.mcap", SAMPLES / "bouncy.mcap"]
    table = tn.tune_all(logs, tmp_path, jobs=1, reviewed="none", method="fit")
    assert sorted(Path(log).name for log in table.log) == ["bouncy.mcap", "dull.mcap"]
    assert (table.verdict == "ok").all()
    assert not list(tmp_path.glob("dull.rrd"))
    again = tn.tune_all(logs, tmp_path, jobs=1, reviewed="none", method="fit", resume=True)
    assert list(again.tuned) == list(table.tuned)  # none was done again


def test_a_report_a_comparison_and_a_campaign(tmp_path: Path):
    for name in ("dull", "bouncy"):
        tn.save_tuning(tuned(name), tmp_path / f"{name}.json")
    words = {"figures": tmp_path / "figures", "kind": "png"}
    page, *figures = tn.report(tmp_path, tmp_path / "all.html", **words)  # type: ignore[arg-type]
    assert "dull.mcap" in page.read_text()
    assert figures
    assert all(figure.suffix == ".png" for figure in figures)
    with pytest.raises(tn.UsageError, match=r"of bouncy\.mcap, not of dull\.mcap"):
        tn.report(tmp_path / "dull.json", page)
    table = tn.compare([tmp_path / "dull.json", tmp_path / "bouncy.json"]).to_frame()
    values = table[table.parameter == "restitution"].set_index("log").value
    assert values["bouncy.mcap"] > values["dull.mcap"]
    campaign = tn.review_campaign(SAMPLES / "campaign", tmp_path / "c.rrd", jobs=1)
    assert campaign.attempts
    assert (tmp_path / "c.rrd").stat().st_size > 10_000


def test_the_page_is_made_of_the_docstrings_as_they_are():
    words = [sys.executable, "docs/make_api.py", "--check"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", tn.__all__)
def test_every_public_name_is_documented(name: str):
    heading, text = (ROOT / "docs" / "api.md").read_text().split(f"\n### {name}\n", 1)
    assert heading
    text = text.partition("\n### ")[0].partition("\n## ")[0]
    assert len(text.split()) > 3
    known = getattr(tn, name)
    if not isinstance(known, FunctionType):
        return
    assert f"\n{name}(" in text
    documented = set(re.findall(r"^ *\**(\w+): \S", inspect.getdoc(known) or "", re.MULTILINE))
    given = set(inspect.signature(known).parameters) - set(options_in(tn.TuneOptions))
    if len(given) > 2:
        assert given <= documented


def test_the_notebook_runs_and_shows_what_it_was_stored_with():
    path = ROOT / "docs" / "notebook.ipynb"
    stored, fresh = (nbformat.read(path, as_version=4) for _ in range(2))
    resources = {"metadata": {"path": str(path.parent)}}
    NotebookClient(fresh, timeout=300, kernel_name="python3", resources=resources).execute()

    def said(notebook: Any) -> list[str]:
        """What each cell of code puts out."""
        return [
            "".join(
                one.get("text", "") or one.get("data", {}).get("text/plain", "")
                for one in cell.outputs
            )
            for cell in notebook.cells
            if cell.cell_type == "code"
        ]

    assert [text[:40] for text in said(fresh)] == [text[:40] for text in said(stored)]
    assert said(fresh)[0].startswith("ok")
    assert "restitution" in said(fresh)[0]
    shown = [one for cell in fresh.cells for one in cell.get("outputs", [])]
    assert not [one.text for one in shown if one.get("name") == "stderr"]
    assert any("image/png" in one.get("data", {}) for one in shown)
