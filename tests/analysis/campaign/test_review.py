"""The review of a campaign: whole, small, and what happened on its timelines."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from tests.analysis.campaign import campaigns
from tests.analysis.campaign.campaigns import MINUTE_NS, START_NS
from tests.analysis.drop.test_review import contents, verified
from tests.analysis.review.stored import Stored
from tests.conftest import ROOT, Command, film
from tunenet_logs.analysis.campaign import TunedDrop
from tunenet_logs.analysis.cli.review import main
from tunenet_logs.analysis.record import Curves
from tunenet_logs.analysis.review.campaign import _CurveAxes, _curves
from tunenet_logs.images import decode_image

STATES = ("/ball", "/drop", "/restitution", "/shot")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three attempts: filmed, after a rejected drop, and given up."""
    folder = tmp_path_factory.mktemp("campaign")
    film(folder / "drop_1.mcap", restitution=0.7, height_m=1.0, seconds=2.0, hold_s=0.2, seed=5)
    campaigns.tune(folder / "drop_1.mcap")
    campaigns.drop(folder / "drop_2a.mcap", is_bad=True)
    campaigns.drop(folder / "drop_2b.mcap", 0.72)
    campaigns.drop(folder / "drop_3.mcap", is_bad=True)
    campaigns.outcome(folder, 1, drop_log="drop_1.mcap", shot_height_m=0.62, miss_m=0.004)
    campaigns.outcome(folder, 2, drop_log="drop_2b.mcap", success=False, reason="rim", miss_m=-0.05)
    campaigns.outcome(folder, 3, "red gel", drop_log="drop_3.mcap", success=False)
    return folder


Reviewed = tuple[Path, str]


@pytest.fixture(scope="module")
def reviewed(campaign: Path, command: Command) -> Reviewed:
    """The review, and what the command printed."""
    path = campaign / "review.rrd"
    done = command("tunenet-review", campaign, "-o", path, "--quiet", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    return path, done.stdout


@pytest.fixture(scope="module")
def review(reviewed: Reviewed) -> Path:
    return reviewed[0]


def rows(path: Path, entity: str, timeline: str, component: str) -> list[tuple]:
    """(time, value) of every row of an entity on a timeline."""
    found: list[tuple] = []
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == entity and timeline in chunk.timeline_names:
            batch = chunk.to_record_batch().to_pydict()
            name = next((one for one in batch if one.endswith(f":{component}")), None)
            if name is not None:
                found += zip(batch[timeline], batch[name], strict=True)
    return sorted(found, key=lambda one: one[0])


def test_it_is_whole_and_small(review: Path):
    verified(review)
    assert review.stat().st_size < 3_000_000
    assert [one.name for one in review.parent.glob("*.partial")] == []


def drawn(path: Path, lane: str, timeline: str) -> list[str]:
    """What a lane says from each of its times on: the labels of its states; "" for none."""
    labels: dict[str, str] = {}
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == lane and chunk.is_static:
            batch = chunk.to_record_batch().to_pydict()
            fields = [batch[f"StateConfiguration:{name}"][0] for name in ("values", "labels")]
            labels = dict(zip(*fields, strict=True))
    states = [value[0] if value else "" for _, value in rows(path, lane, timeline, "state")]
    assert all(a != b for a, b in pairwise(filter(None, states)))  # Rerun would draw them as one
    return [labels[state] if state else "" for state in states]


def test_the_lanes_say_what_happened(review: Path):
    lanes = {lane: drawn(review, lane, "attempt")[:3] for lane in STATES}
    assert lanes["/ball"] == ["gel, 1", "gel, 2", "red gel, 3"]
    assert lanes["/drop"] == ["drop", "drop again", "rejected drop"]
    first, second, third = lanes["/restitution"]
    assert float(first) == pytest.approx(0.7, abs=0.01)
    assert float(second) == pytest.approx(0.72, abs=0.01)
    assert third == "not tuned"
    assert lanes["/shot"] == ["success", "failure", "given up"]
    played = drawn(review, "/drop", "film_s")
    assert played == ["drop", "rejected drop", "drop again", "rejected drop", ""]
    played = drawn(review, "/shot", "film_s")
    assert played == ["", "shot", "success", "", "shot", "failure", "", "given up", ""]
    times = rows(review, "/shot", "wall_clock", "state")
    assert len(times) == 3


def test_each_attempt_has_its_curves_and_its_words(review: Path):
    observed = rows(review, "/sheets/overlay/observed", "attempt", "positions")
    assert [len(places or ()) > 20 for _, places in observed] == [True, True, False]
    words = [text[0] for _, text in rows(review, "/attempt", "attempt", "text")]
    assert "**success**" in words[0]
    assert "shot from 0.620 m" in words[0]
    assert "rejected drop drop_2a.mcap" in words[1]
    assert "rim" in words[1]
    assert "given up without a shot" in words[2]


def test_its_video_is_small_and_slow(review: Path):
    pictures = rows(review, "/film/picture", "film_s", "blob")
    pictures = [
        one for one, is_film in zip(pictures, filmed(review, "film_s"), strict=True) if is_film
    ]
    decoded = [decode_image(bytes(blob[0]), "jpeg") for _, blob in pictures]
    assert len(decoded) > 40
    assert {max(one.shape) for one in decoded} == {160}
    at_s = np.unique([time.total_seconds() for time, _ in pictures])
    assert np.diff(at_s).min() > 0.9 / 30


def shown(path: Path, entity: str, timeline: str, component: str) -> list[bool]:
    """Whether something is to be seen, row by row."""
    return [bool(value) for _, value in rows(path, entity, timeline, component)]


def filmed(path: Path, timeline: str) -> list[bool]:
    """Whether a picture of a drop is to be seen, row by row; a blank one is nearly black."""
    pictures = [bytes(blob[0]) for _, blob in rows(path, "/film/picture", timeline, "blob")]
    return [bool(np.median(decode_image(one, "jpeg")) > 30) for one in pictures]


def test_no_attempt_shows_the_pictures_of_another(review: Path):
    assert filmed(review, "attempt") == [True, False, False]
    assert filmed(review, "wall_clock") == [True, False, False]
    played = filmed(review, "film_s")
    assert played[-3:] == [False] * 3  # two drops of the second attempt, one of the third
    assert all(played[:-3])
    dots = shown(review, "/sheets/overlay/now", "film_s", "positions")
    assert not dots[-1]


VIEWS = {
    **dict.fromkeys(STATES, "state"),
    "/sheets/overlay/observed": "positions",
    "/sheets/overlay/simulated": "strips",
    "/film/picture": "blob",
    "/attempt": "text",
}


def test_each_view_has_data_on_every_timeline_from_its_beginning(review: Path):
    timelines = {name for chunk in RrdReader(review).stream() for name in chunk.timeline_names}
    assert timelines == {"attempt", "film_s", "wall_clock"}
    for timeline in timelines:
        begins = {
            entity: rows(review, entity, timeline, component)[0][0]
            for entity, component in VIEWS.items()
        }
        assert len(set(begins.values())) == 1, (timeline, begins)


def test_an_outcome_without_a_drop_shows_no_others(tmp_path: Path):
    campaigns.drop_at(tmp_path / "drop_1.mcap", START_NS)
    campaigns.outcome(tmp_path, 1, drop_log="drop_1.mcap", stamp_ns=START_NS + MINUTE_NS)
    campaigns.outcome(tmp_path, 2, stamp_ns=START_NS + 2 * MINUTE_NS)
    assert main([str(tmp_path), "-o", str(tmp_path / "a.rrd"), "--quiet"]) == 0
    for timeline in ("attempt", "film_s", "wall_clock"):
        curves = shown(tmp_path / "a.rrd", "/sheets/overlay/observed", timeline, "positions")
        assert curves == [True, False]
    assert len(rows(tmp_path / "a.rrd", "/attempt", "wall_clock", "text")) == 2


def test_two_shots_with_one_drop_are_both_on_the_wall_clock(tmp_path: Path):
    campaigns.drop_at(tmp_path / "drop_1.mcap", START_NS)
    for number in (1, 2):
        stamp_ns = START_NS + number * MINUTE_NS
        campaigns.outcome(tmp_path, number, drop_log="drop_1.mcap", stamp_ns=stamp_ns)
    assert main([str(tmp_path), "-o", str(tmp_path / "a.rrd"), "--quiet"]) == 0
    words = rows(tmp_path / "a.rrd", "/attempt", "wall_clock", "text")
    assert ["attempt 1" in words[0][1][0], "attempt 2" in words[1][1][0]] == [True, True]


def test_the_tables_hold_the_rates(reviewed: Reviewed):
    review, said = reviewed
    assert {"static"} <= contents(review)["/summary"]
    assert "1/3 = 33 % (95 %: 6 to 79 %)   paper 62 %" in said
    assert "1/2 = 50 % (95 %: 9 to 91 %)   paper 87 %" in said
    assert "restitution 0.71" in said


def test_the_wall_clock_is_there_where_stamps_are(tmp_path: Path):
    campaigns.drop_at(tmp_path / "drop_1.mcap", START_NS)
    campaigns.outcome(tmp_path, 1, drop_log="drop_1.mcap", stamp_ns=START_NS + MINUTE_NS)
    assert main([str(tmp_path), "-o", str(tmp_path / "a.rrd"), "--quiet"]) == 0
    ((begun, _),) = rows(tmp_path / "a.rrd", "/drop", "wall_clock", "state")
    before, (ended, _) = rows(tmp_path / "a.rrd", "/shot", "wall_clock", "state")
    assert before == (begun, [])
    assert (ended - begun).total_seconds() == pytest.approx(60, abs=1)


def test_outcomes_alone_are_a_campaign(command: Command, tmp_path: Path):
    (tmp_path / "today.csv").write_text("ball,success\nred gel,yes\nred gel,no\n/a b,yes\n")
    result = command("tunenet-review", "today.csv", "-o", "today.rrd", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "2/3 = 67 %" in result.stdout
    assert not result.stderr
    verified(tmp_path / "today.rrd")


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("none", "-o", "a.rrd"), 1, "none: no such file"),
        ((".", "-o", "a.rrd"), 1, "holds no drop and no outcome"),
        ((".", "-o", "a.mcap"), 2, "name it a.rrd"),
        ((".", "-o", "none/a.rrd"), 2, "none: no such folder"),
        ((".",), 2, "-o"),
    ],
)
def test_wrong_words_are_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    words: tuple,
    code: int,
    told: str,
):
    monkeypatch.chdir(tmp_path)
    assert main(list(words)) == code
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_log_that_cannot_be_read_is_named_and_is_no_attempt(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(bytes(range(200)))
    output = tmp_path / "a.rrd"
    words = ["--quiet", "--jobs", "1", "-o", str(output), str(broken)]
    assert main(words) == 1
    assert main([*words, str(ROOT / "sample_logs" / "bouncy.mcap")]) == 1
    told = capsys.readouterr()
    assert f"{broken}: is not an MCAP log" in told.err
    assert "nothing kept: 1" in told.err
    assert "0.85" in told.out
    verified(output)


def test_an_attempt_tells_the_slope_and_drag_that_were_tuned(tmp_path: Path):
    path = campaigns.drop(tmp_path / "drop_1.mcap").with_suffix(".json")
    before = json.loads(path.read_text())["parameters"]
    slope = {"value": 0.06, "interval95": [0.03, 0.09], "unit": "1"}
    drag = {"value": 0.013, "interval95": None, "unit": "1/m"}
    both = {"restitution_slope": slope, "drag": drag}
    campaigns.told(path, parameters={"restitution": before["restitution"], **both})
    assert main([str(tmp_path), "-o", str(tmp_path / "a.rrd"), "--quiet"]) == 0
    words = rows(tmp_path / "a.rrd", "/attempt", "attempt", "text")[0][1][0]
    assert "restitution slope 0.060 (95 %: 0.030 to 0.090)" in words
    assert "drag 0.013 1/m\n" in words


def test_samples_that_are_not_known_are_left_out_of_the_curves():
    observed = np.array([1.0, np.nan, 0.5, 0.4, 0.2, 0.1])
    simulated = np.array([np.nan, 1.0, 0.8, np.nan, 0.5, 0.4])
    overlay = Curves(0, np.arange(6.0), observed, simulated)
    drop = TunedDrop(None, None, "a", "gel", "ok", "", 0.7, None, overlay)
    axes = _CurveAxes(5.0, 1.0)
    seen, line = _curves(drop, axes)
    assert len(seen) == 5
    assert [len(stretch) for stretch in line] == [2, 2]


def test_of_many_balls_the_charts_show_the_first_and_the_tables_all(tmp_path: Path):
    for number in range(20):
        campaigns.outcome(tmp_path, 1, f"ball {number}", tuned_parameter=0.6 + 0.01 * number)
    assert main([str(tmp_path), "-o", str(tmp_path / "a.rrd"), "--quiet"]) == 0
    stored = Stored(tmp_path / "a.rrd")
    titles = [view.name for view in stored.views]
    for sheet, count in (("rates", 23), ("spreads", 20)):
        (labels,) = stored.entities[f"/sheets/{sheet}/labels"]["Points2D:labels"].static
        assert sum("ball " in label for label in labels.as_py()) <= 12
        assert any(f"(the first 12 of {count})" in title for title in titles)
    (words,) = stored.entities["/summary"]["TextDocument:text"].static
    assert all(f"| ball {number} |" in words.as_py()[0] for number in range(20))
