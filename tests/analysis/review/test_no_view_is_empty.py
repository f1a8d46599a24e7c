"""Every view of every kind of review shows something at every stop that its tab is for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from tests.analysis.campaign import campaigns
from tests.analysis.drop.made import episode_of, impacts
from tests.analysis.payload.test_payload import record as record_payload
from tests.analysis.review.stored import Stored, empty_views, review_of
from tests.conftest import ROOT, film, real, record
from tunenet_logs.analysis.cli.plan import main as plan_main
from tunenet_logs.analysis.cli.review import main as review_main
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.review.ledger import write_overview
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload

SAMPLES, PLAIN = ROOT / "sample_logs", TuneOptions()
Make = Callable[[Path], Path]  # writes a review into a folder; its path


def tuned(name: str, verdict: str | None, tune: Callable[[Path], Tuning]) -> Make:
    """Make the review of what is tuned in a folder."""

    def make(folder: Path) -> Path:
        return review_of(tune(folder), folder, verdict)

    make.__name__ = name
    return make


def filmed(seconds: float) -> Callable[[Path], Tuning]:
    order = {"restitution": 0.7, "height_m": 1.0, "hold_s": 0.2, "seed": 5}
    return lambda folder: tune_log(film(folder / "a.mcap", seconds=seconds, **order), PLAIN)


def with_a_tare(folder: Path) -> Tuning:
    held = record_payload(folder / "held.mcap", mass_kg=0.6, is_driver=True)
    empty = record_payload(folder / "empty.mcap", is_empty=True, is_driver=True)
    return tune_log(held, TuneOptions(tares=(empty,)))


def of_noise(folder: Path) -> Tuning:
    (folder / "a.mcap").write_bytes(bytes(range(200)))
    return tune_log(folder / "a.mcap", PLAIN)


def planned(name: str, restitution: str, rig: str = "") -> Make:
    """Make the review of a plan."""

    def make(folder: Path) -> Path:
        (folder / "rig.yaml").write_text(rig)
        words = ["--restitution", restitution, "--rrd", str(folder / "a.rrd")]
        plan_main([*words, *(["--rig", str(folder / "rig.yaml")] if rig else [])])
        return folder / "a.rrd"

    make.__name__ = name
    return make


def overview(name: str, count: int, *, is_rejected: bool, has_estimates: bool = True) -> Make:
    """Make the review of a batch's ledger."""
    values = [None if is_rejected else 0.7 + 0.01 * k for k in range(count)]
    told: dict[str, list[Any]] = {
        "log": [f"drop_{k}.mcap" for k in range(count)],
        "verdict": ["rejected" if is_rejected else "ok"] * count,
        "reason": ["no bounce" if is_rejected else None] * count,
    }
    if has_estimates:
        told |= {
            "restitution": values,
            "restitution_low": [value and value - 0.01 for value in values],
            "restitution_high": [value and value + 0.01 for value in values],
            "fit_excess_percent": [None if is_rejected else 0.1] * count,
        }

    def make(folder: Path) -> Path:
        write_overview(told, folder / "a.rrd")
        return folder / "a.rrd"

    make.__name__ = name
    return make


def campaign_in(folder: Path) -> Path:
    path = folder / "a.rrd"
    assert review_main([str(folder), "-o", str(path), "--quiet", "--jobs", "1"]) == 0
    return path


def campaign_of_outcomes(folder: Path) -> Path:
    campaigns.outcome(folder, 1)
    campaigns.outcome(folder, 2, "red gel", success=False)
    return campaign_in(folder)


def campaign_of_drops(folder: Path) -> Path:
    for number in (1, 2):
        campaigns.drop(folder / f"drop_{number}.mcap", is_bad=True)
    return campaign_in(folder)


def campaign_of_everything(folder: Path) -> Path:
    """Filmed, filmed and rejected, not filmed, after a rejected drop, no drop at all; a rig."""
    (folder / "rig.yaml").write_text("")
    order = {"height_m": 1.0, "hold_s": 0.2, "seed": 5}
    film(folder / "drop_1.mcap", restitution=0.7, seconds=2.0, **order)
    film(folder / "drop_2.mcap", restitution=0.7, seconds=0.45, **order)
    campaigns.drop_at(folder / "drop_3.mcap", campaigns.START_NS + 3 * campaigns.MINUTE_NS)
    campaigns.drop(folder / "drop_4a.mcap", is_bad=True)
    campaigns.drop(folder / "drop_4b.mcap", 0.72)
    for number, drop in enumerate(["drop_1", "drop_2", "drop_3", "drop_4b", None], 1):
        said = {} if drop is None else {"drop_log": f"{drop}.mcap", "miss_m": 0.01 * number}
        said |= {"shot_height_m": 0.3} if number in (1, 3) else {}
        campaigns.outcome(folder, number, success=number % 2 == 1, **said)
    return campaign_in(folder)


NOT_KNOWN = PayloadOrder(mass_kg=0.5, path="random", seconds=6.0)
NO_ARM = "ros1/jaco_names_recorded_by_rosbag.bag"
NO_BALL_S = np.cumsum(np.random.default_rng(0).uniform(0.1, 0.6, 9))

MAKERS: tuple[Make, ...] = (
    tuned("drop_from_positions", "ok",
          lambda to: tune_log(record(to / "a.mcap", restitution=0.85, height_m=1.5), PLAIN)),
    tuned("filmed_drop", "ok", lambda _: tune_log(SAMPLES / "filmed.mcap", PLAIN)),
    tuned("impact_times", "ok", lambda _: tune_episode(episode_of(impacts(7)), PLAIN)),
    tuned("payload_without_tare", None, lambda _: tune_log(SAMPLES / "payload.mcap", PLAIN)),
    tuned("payload_with_tare", None, with_a_tare),
    tuned("positions_without_a_drop", "rejected",
          lambda to: tune_log(record(to / "a.mcap", restitution=0.0, height_m=1.0), PLAIN)),
    tuned("film_of_a_fall", "rejected", filmed(0.45)),
    tuned("film_of_a_still_ball", "rejected", filmed(0.15)),
    tuned("times_of_no_ball", "rejected", lambda _: tune_episode(episode_of(NO_BALL_S), PLAIN)),
    tuned("too_few_times", "rejected", lambda _: tune_episode(episode_of(impacts(2)), PLAIN)),
    tuned("payload_on_a_path_that_the_preset_does_not_know", "rejected",
          lambda _: tune_episode(simulate_payload(NOT_KNOWN), TuneOptions(preset="paper"))),
    tuned("payload_of_no_arm", "rejected",
          lambda _: tune_log(real(NO_ARM), TuneOptions(task="payload"))),
    tuned("file_that_is_no_log", "rejected", of_noise),
    campaign_of_everything,
    campaign_of_outcomes,
    campaign_of_drops,
    planned("plan_of_a_shot", "0.7"),
    planned("plan_without_a_shot", "0.3"),
    planned("plan_of_a_hoop_that_is_too_high", "0.7", "hoop: {up_m: 2.0}"),
    overview("overview_of_a_batch", 12, is_rejected=False),
    overview("overview_of_rejected_logs", 3, is_rejected=True),
    overview("overview_without_estimates", 3, is_rejected=True, has_estimates=False),
)  # fmt: skip


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_every_view_has_data_at_every_stop(make: Make, tmp_path: Path):
    path = make(tmp_path)
    review = Stored(path)
    assert len(review.views) > 1
    assert review.shown_twice == []
    assert empty_views(path) == []


POINTS = rr.Points2D.columns(positions=[[0, 0]])
PICTURE = rr.EncodedImage.columns(blob=[b"\xff\xd8"], media_type=["image/jpeg"])
VALUES = rr.Scalars.columns(scalars=[5.0])
LOW = rrb.ScalarAxis(range=(0.0, 1.0))


@pytest.mark.parametrize(
    ("view", "entity", "time", "columns", "empty_at"),
    [
        (rrb.Spatial2DView(origin="/a"), "a/dots", 1, POINTS, []),
        (rrb.Spatial2DView(origin="/a"), "a/dots", 9, POINTS, [1]),
        (rrb.Spatial2DView(origin="/b"), "a/dots", 1, POINTS, [1, 9]),
        (rrb.Spatial2DView(origin="/a"), "a/grid", 1, POINTS, [1, 9]),
        (rrb.Spatial2DView(contents=["/a/**", "- /a/dots"]), "a/dots", 1, POINTS, [1, 9]),
        (rrb.Spatial2DView(origin="/c"), "c/picture", 9, PICTURE, [1]),  # beside a path
        (rrb.TimeSeriesView(origin="/a"), "a", 1, VALUES, []),
        (rrb.TimeSeriesView(origin="/a", axis_y=LOW), "a", 1, VALUES, [1, 9]),
        (rrb.TextDocumentView(origin="/a"), "b", 1, VALUES, [1, 9]),
    ],
)
def test_the_law_finds_what_is_empty(
    tmp_path: Path, view: Any, entity: str, time: int, columns: Any, empty_at: list[int]
):
    stream = rr.RecordingStream("tunenet test of empty views")
    memory = stream.memory_recording()
    stream.log("c/path", rr.Points2D([[0, 0]]), static=True)
    stream.send_columns(entity, [rr.TimeColumn("t", sequence=[time])], columns)
    notes = rr.TextDocument.columns(text=["a", "b"])
    stream.send_columns("other", [rr.TimeColumn("t", sequence=[1, 9])], notes)
    stream.send_blueprint(rrb.Blueprint(rrb.Tabs(rrb.Vertical(view, name="tab")), auto_views=False))
    stream.flush()
    (tmp_path / "a.rrd").write_bytes(memory.drain_as_bytes())
    found = empty_views(tmp_path / "a.rrd")
    assert [int(one.split()[-1]) for one in found] == empty_at
