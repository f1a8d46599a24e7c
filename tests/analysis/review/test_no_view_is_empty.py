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
from tests.analysis.drop.test_impact_times import episode_of, impacts
from tests.analysis.payload.test_payload import record as record_payload
from tests.analysis.review.stored import Stored
from tests.conftest import ROOT, film, real, record
from tunenet_logs.analysis.cli.plan import main as plan_main
from tunenet_logs.analysis.cli.review import main as review_main
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.review.tuning import write_overview, write_review
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload

Make = Callable[[Path], Path]  # writes a review into a folder; its path


def review_of(tuning: Tuning, folder: Path, verdict: str | None = None) -> Path:
    assert verdict in (None, tuning.verdict), tuning.reason
    write_review(tuning, record_of(tuning), folder / "a.rrd")
    return folder / "a.rrd"


def drop_from_positions(folder: Path) -> Path:
    path = record(folder / "a.mcap", restitution=0.85, height_m=1.5)
    return review_of(tune_log(path, TuneOptions()), folder, "ok")


def filmed_drop(folder: Path) -> Path:
    return review_of(tune_log(ROOT / "sample_logs" / "filmed.mcap", TuneOptions()), folder, "ok")


def impact_times(folder: Path) -> Path:
    return review_of(tune_episode(episode_of(impacts(7)), TuneOptions()), folder, "ok")


def payload_without_tare(folder: Path) -> Path:
    return review_of(tune_log(ROOT / "sample_logs" / "payload.mcap", TuneOptions()), folder)


def payload_with_tare(folder: Path) -> Path:
    held = record_payload(folder / "held.mcap", mass_kg=0.6, is_driver=True)
    empty = record_payload(folder / "empty.mcap", is_empty=True, is_driver=True)
    return review_of(tune_log(held, TuneOptions(tares=(empty,))), folder)


def positions_without_a_drop(folder: Path) -> Path:
    path = record(folder / "a.mcap", restitution=0.0, height_m=1.0)
    return review_of(tune_log(path, TuneOptions()), folder, "rejected")


def film_of_a_fall(folder: Path) -> Path:
    order = {"restitution": 0.7, "height_m": 1.0, "seconds": 0.45, "hold_s": 0.2, "seed": 5}
    return review_of(tune_log(film(folder / "a.mcap", **order), TuneOptions()), folder, "rejected")


def film_of_a_still_ball(folder: Path) -> Path:
    order = {"restitution": 0.7, "height_m": 1.0, "seconds": 0.15, "hold_s": 0.2, "seed": 5}
    return review_of(tune_log(film(folder / "a.mcap", **order), TuneOptions()), folder, "rejected")


def times_of_no_ball(folder: Path) -> Path:
    times_s = np.cumsum(np.random.default_rng(0).uniform(0.1, 0.6, 9))
    return review_of(tune_episode(episode_of(times_s), TuneOptions()), folder, "rejected")


def too_few_times(folder: Path) -> Path:
    return review_of(tune_episode(episode_of(impacts(2)), TuneOptions()), folder, "rejected")


def payload_on_a_path_that_the_preset_does_not_know(folder: Path) -> Path:
    episode = simulate_payload(PayloadOrder(mass_kg=0.5, path="random", seconds=6.0))
    return review_of(tune_episode(episode, TuneOptions(preset="paper")), folder, "rejected")


def payload_of_no_arm(folder: Path) -> Path:
    bag = real("ros1/jaco_names_recorded_by_rosbag.bag")
    return review_of(tune_log(bag, TuneOptions(task="payload")), folder, "rejected")


def file_that_is_no_log(folder: Path) -> Path:
    (folder / "a.mcap").write_bytes(bytes(range(200)))
    return review_of(tune_log(folder / "a.mcap", TuneOptions()), folder, "rejected")


def campaign_of_everything(folder: Path) -> Path:
    """Filmed, filmed and rejected, not filmed, after a rejected drop, no drop at all."""
    order = {"height_m": 1.0, "hold_s": 0.2, "seed": 5}
    film(folder / "drop_1.mcap", restitution=0.7, seconds=2.0, **order)
    film(folder / "drop_2.mcap", restitution=0.7, seconds=0.45, **order)
    campaigns.drop_at(folder / "drop_3.mcap", campaigns.START_NS + 3 * campaigns.MINUTE_NS)
    campaigns.drop(folder / "drop_4a.mcap", is_bad=True)
    campaigns.drop(folder / "drop_4b.mcap", 0.72)
    for number, drop in enumerate(["drop_1", "drop_2", "drop_3", "drop_4b", None], 1):
        said = {} if drop is None else {"drop_log": f"{drop}.mcap", "miss_m": 0.01 * number}
        campaigns.outcome(folder, number, success=number % 2 == 1, **said)
    return campaign_in(folder)


def campaign_of_outcomes(folder: Path) -> Path:
    campaigns.outcome(folder, 1)
    campaigns.outcome(folder, 2, "red gel", success=False)
    return campaign_in(folder)


def campaign_of_drops(folder: Path) -> Path:
    campaigns.drop(folder / "drop_1.mcap", is_bad=True)
    campaigns.drop(folder / "drop_2.mcap", is_bad=True)
    return campaign_in(folder)


def campaign_in(folder: Path) -> Path:
    path = folder / "a.rrd"
    assert review_main([str(folder), "-o", str(path), "--quiet", "--jobs", "1"]) == 0
    return path


def plan_of_a_shot(folder: Path) -> Path:
    return plan_in(folder, "0.7")


def plan_without_a_shot(folder: Path) -> Path:
    return plan_in(folder, "0.3")


def plan_of_a_hoop_that_is_too_high(folder: Path) -> Path:
    (folder / "rig.yaml").write_text("hoop: {up_m: 2.0}")
    return plan_in(folder, "0.7", "--rig", str(folder / "rig.yaml"))


def plan_in(folder: Path, restitution: str, *words: str) -> Path:
    plan_main(["--restitution", restitution, "--rrd", str(folder / "a.rrd"), *words])
    return folder / "a.rrd"


def ledger(count: int, *, is_rejected: bool = False) -> dict[str, list[Any]]:
    values = [None if is_rejected else 0.7 + 0.01 * k for k in range(count)]
    verdict = "rejected" if is_rejected else "ok"
    return {
        "log": [f"drop_{k}.mcap" for k in range(count)],
        "verdict": [verdict] * count,
        "reason": ["no bounce" if is_rejected else None] * count,
        "restitution": values,
        "restitution_low": [value and value - 0.01 for value in values],
        "restitution_high": [value and value + 0.01 for value in values],
        "fit_excess_percent": [None if is_rejected else 0.1] * count,
    }


def overview_of_a_batch(folder: Path) -> Path:
    write_overview(ledger(12), folder / "a.rrd")
    return folder / "a.rrd"


def overview_of_rejected_logs(folder: Path) -> Path:
    write_overview(ledger(3, is_rejected=True), folder / "a.rrd")
    return folder / "a.rrd"


def overview_without_estimates(folder: Path) -> Path:
    told = ledger(3, is_rejected=True)
    names = ("log", "verdict", "reason")
    write_overview({name: told[name] for name in names}, folder / "a.rrd")
    return folder / "a.rrd"


MAKERS: tuple[Make, ...] = (
    drop_from_positions,
    filmed_drop,
    impact_times,
    payload_without_tare,
    payload_with_tare,
    positions_without_a_drop,
    film_of_a_fall,
    film_of_a_still_ball,
    times_of_no_ball,
    too_few_times,
    payload_on_a_path_that_the_preset_does_not_know,
    payload_of_no_arm,
    file_that_is_no_log,
    campaign_of_everything,
    campaign_of_outcomes,
    campaign_of_drops,
    plan_of_a_shot,
    plan_without_a_shot,
    plan_of_a_hoop_that_is_too_high,
    overview_of_a_batch,
    overview_of_rejected_logs,
    overview_without_estimates,
)


def empty_views(path: Path) -> list[str]:
    """Views that show nothing, with where that is."""
    review = Stored(path)
    return [
        f"{view.name!r} at {timeline} {time}"
        for view in review.views
        for timeline, time in review.stops(view) or [("", 0)]
        if not review.has_data(view, timeline, time)
    ]


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_every_view_has_data_at_every_stop(make: Make, tmp_path: Path):
    path = make(tmp_path)
    assert len(Stored(path).views) > 1
    assert empty_views(path) == []


def written(path: Path, view: Any, log: Callable[[rr.RecordingStream], None]) -> Path:
    """A small recording of two times, with one view."""
    stream = rr.RecordingStream("tunenet test of empty views")
    memory = stream.memory_recording()
    log(stream)
    stream.send_columns(
        "other",
        indexes=[rr.TimeColumn("t", sequence=[1, 9])],
        columns=rr.TextDocument.columns(text=["a", "b"]),
    )
    stream.send_blueprint(rrb.Blueprint(rrb.Tabs(rrb.Vertical(view, name="tab")), auto_views=False))
    stream.flush()
    path.write_bytes(memory.drain_as_bytes())
    return path


def timed(entity: str, times: list[int], columns: Any) -> Callable[[rr.RecordingStream], None]:
    indexes = [rr.TimeColumn("t", sequence=times)]
    return lambda stream: stream.send_columns(entity, indexes=indexes, columns=columns)


POINTS = rr.Points2D.columns(positions=[[0, 0]])
PICTURE = rr.EncodedImage.columns(blob=[b"\xff\xd8"], media_type=["image/jpeg"])
VALUES = rr.Scalars.columns(scalars=[5.0, 6.0])


@pytest.mark.parametrize(
    ("view", "log", "empty_at"),
    [
        (rrb.Spatial2DView(origin="/a"), timed("a/dots", [1], POINTS), []),
        (rrb.Spatial2DView(origin="/a"), timed("a/dots", [9], POINTS), [1]),
        (rrb.Spatial2DView(origin="/b"), timed("a/dots", [1], POINTS), [1, 9]),
        (rrb.Spatial2DView(origin="/a"), timed("a/grid", [1], POINTS), [1, 9]),
        (
            rrb.Spatial2DView(origin="/a"),
            timed("a/dots", [1, 9], rr.Points2D.columns(positions=[[0, 0]]).partition([1, 0])),
            [9],
        ),
        (
            rrb.Spatial2DView(origin="/", contents=["+ /a/**", "- /a/dots"]),
            timed("a/dots", [1], POINTS),
            [1, 9],
        ),
        (rrb.TimeSeriesView(origin="/a"), timed("a", [1, 9], VALUES), []),
        (
            rrb.TimeSeriesView(origin="/a", axis_y=rrb.ScalarAxis(range=(0.0, 1.0))),
            timed("a", [1, 9], VALUES),
            [1, 9],
        ),
        (rrb.TextDocumentView(origin="/a"), timed("b", [1, 9], VALUES), [1, 9]),
    ],
)
def test_the_law_finds_what_is_empty(tmp_path: Path, view: Any, log: Any, empty_at: list[int]):
    found = empty_views(written(tmp_path / "a.rrd", view, log))
    assert [int(one.split()[-1]) for one in found] == empty_at


def test_a_view_of_pictures_needs_one_at_every_stop(tmp_path: Path):
    def log(stream: rr.RecordingStream) -> None:
        stream.log("a/path", rr.Points2D([[0, 0]]), static=True)
        timed("a/picture", [9], PICTURE)(stream)

    view = rrb.Spatial2DView(origin="/a")
    assert empty_views(written(tmp_path / "a.rrd", view, log)) == ["'' at t 1"]
