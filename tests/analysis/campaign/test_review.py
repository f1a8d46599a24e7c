"""The review of a campaign: whole, small, and at every stop the attempt under the cursor alone."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.campaign import campaigns
from tests.analysis.campaign.campaigns import MINUTE_NS, START_NS
from tests.analysis.films import short_film
from tests.analysis.review.stored import Stored, verified
from tests.conftest import ROOT, Command, Made, film
from tunenet_logs.analysis.campaign import Campaign, TunedDrop, campaign_of
from tunenet_logs.analysis.cli.review import main
from tunenet_logs.analysis.review.campaign import (
    ATTEMPT,
    FILM,
    WALL,
    Shown,
    Slot,
    slots_of,
    write_campaign,
)
from tunenet_logs.terminal import Progress

STATES = ("/ball", "/drop", "/restitution", "/shot")
STATE = "StateChange:state"
OBSERVED = ("/sheets/overlay/observed", "attempt", "Points2D:positions")
WORDS = ("/attempt", "attempt", "TextDocument:text")


@pytest.fixture(scope="module")
def review(tmp_path_factory: pytest.TempPathFactory, made: Made, command: Command) -> Stored:
    """Of three attempts: filmed, after a rejected drop, and given up.

    Whole and small; what the command printed has the rates beside the paper's.
    """
    folder = tmp_path_factory.mktemp("campaign")
    shutil.copy(short_film(made), folder / "drop_1.mcap")
    campaigns.tune(folder / "drop_1.mcap")
    campaigns.drop(folder / "drop_2a.mcap", is_bad=True)
    campaigns.drop(folder / "drop_2b.mcap", 0.72)
    campaigns.drop(folder / "drop_3.mcap", is_bad=True)
    campaigns.outcome(folder, 1, drop_log="drop_1.mcap", shot_height_m=0.62, miss_m=0.004)
    campaigns.outcome(folder, 2, drop_log="drop_2b.mcap", success=False, reason="rim", miss_m=-0.05)
    campaigns.outcome(folder, 3, "red gel", drop_log="drop_3.mcap", success=False)
    path = folder / "review.rrd"
    done = command("tunenet-review", folder, "-o", path, "--quiet", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    assert "1/3 = 33 % (95 %: 6 to 79 %)   paper 62 %" in done.stdout
    assert "1/2 = 50 % (95 %: 9 to 91 %)   paper 87 %" in done.stdout
    (mean,) = re.findall(r"restitution ([\d.]+) ±", done.stdout)
    assert float(mean) == pytest.approx(0.71, abs=0.005)
    verified(path)
    assert path.stat().st_size < 3_000_000
    assert not list(folder.glob("*.partial"))
    return Stored(path)


def rows(review: Stored, entity: str, timeline: str, component: str) -> list[tuple[int, list]]:
    """(time, value) of every row of a component on a timeline; [] where nothing is shown."""
    times, cells = review.entities[entity][component].timed[timeline]
    return [(at, cell.as_py() or []) for at, cell in zip(times.tolist(), cells, strict=True)]


def drawn(review: Stored, lane: str, timeline: str) -> list[str]:
    """What a lane says from each of its times on: the labels of its states; "" for none."""
    names, labels = (
        review.entities[lane][f"StateConfiguration:{name}"].static[0].as_py()
        for name in ("values", "labels")
    )
    called = dict(zip(names, labels, strict=True))
    told = rows(review, lane, timeline, STATE)
    states = [value[0] if value else "" for _, value in told]
    assert all(a != b for a, b in pairwise(filter(None, states)))  # Rerun would draw them as one
    return [called[state] if state else "" for state in states]


def test_the_lanes_say_what_happened(review: Stored):
    lanes = {lane: drawn(review, lane, "attempt")[:3] for lane in STATES}
    assert lanes["/ball"] == ["gel, 1", "gel, 2", "red gel, 3"]
    assert lanes["/drop"] == ["drop", "drop again", "rejected"]
    first, second, third = lanes["/restitution"]
    assert float(first) == pytest.approx(0.7, abs=0.01)
    assert float(second) == pytest.approx(0.72, abs=0.01)
    assert third == "not tuned"
    assert lanes["/shot"] == ["success", "failure", "given up"]
    played = drawn(review, "/drop", "film_s")
    assert played == ["drop", "rejected", "drop again", "rejected", ""]
    played = drawn(review, "/shot", "film_s")
    assert played == ["", "shot", "success", "", "shot", "failure", "", "given up", ""]
    assert len(rows(review, "/shot", "wall_clock", STATE)) == 3


def test_each_attempt_has_its_curves_and_its_words(review: Stored):
    curves = rows(review, *OBSERVED)
    assert [len(places) > 20 for _, places in curves] == [True, True, False]
    words = [text[0] for _, text in rows(review, *WORDS)]
    assert all(one in words[0] for one in ("**success**", "shot from 0.620 m"))
    assert all(one in words[1] for one in ("rejected drop drop_2a.mcap", "rim"))
    assert "given up without a shot" in words[2]


def reviewed(folder: Path) -> Stored:
    assert main([str(folder), "-o", str(folder / "a.rrd"), "--quiet"]) == 0
    return Stored(folder / "a.rrd")


def test_the_wall_clock_has_each_shot_and_one_without_a_drop_shows_no_others(tmp_path: Path):
    campaigns.drop_at(tmp_path / "drop_1.mcap", START_NS)
    for number in (1, 2, 3):
        said: dict[str, Any] = {"stamp_ns": START_NS + number * MINUTE_NS}
        campaigns.outcome(tmp_path, number, drop_log="drop_1.mcap" * (number < 3), **said)
    review = reviewed(tmp_path)
    for timeline in ("attempt", "film_s", "wall_clock"):
        (_, first), *_, (_, last) = rows(review, OBSERVED[0], timeline, OBSERVED[2])
        assert (bool(first), bool(last)) == (True, False)
    words = [text[0] for _, text in rows(review, WORDS[0], "wall_clock", WORDS[2])]
    assert len(words) == 3
    assert all(f"attempt {at}" in text for at, text in enumerate(words, 1))
    (begun, _), *_ = rows(review, "/drop", "wall_clock", STATE)
    before, (ended, _), *_ = rows(review, "/shot", "wall_clock", STATE)
    assert before == (begun, [])
    assert (ended - begun) * 1e-9 == pytest.approx(60, abs=1)


def test_a_log_that_cannot_be_read_is_named_and_is_no_attempt(command: Command, tmp_path: Path):
    broken, output = tmp_path / "broken.mcap", tmp_path / "a.rrd"
    broken.write_bytes(bytes(range(200)))
    words = ("tunenet-review", "--quiet", "--jobs", 1, "-o", output, broken)
    assert command(*words).returncode == 1
    told = command(*words, ROOT / "sample_logs" / "bouncy.mcap")
    assert told.returncode == 1
    assert f"{broken}: is not an MCAP log" in told.stderr
    assert "nothing kept: 1" in told.stderr
    assert "0.85" in told.stdout
    verified(output)


def test_a_shot_is_drawn_as_expected_beside_where_it_came_down(tmp_path: Path):
    campaigns.drop(tmp_path / "drop_1.mcap")
    (tmp_path / "rig.yaml").write_text("hoop: {forward_m: 0.45}\n")
    named = {"drop_log": "drop_1.mcap"}
    campaigns.outcome(tmp_path, 1, shot_height_m=0.335, miss_m=-0.02, success=False, **named)
    campaigns.outcome(tmp_path, 2, shot_height_m=1e9, **named)  # no height of a robot
    campaigns.outcome(tmp_path, 3, shot_height_m=0.3, task="another", **named)
    review = reviewed(tmp_path)
    expected = rows(review, "/sheets/shot/expected", "attempt", "LineStrips2D:strips")
    assert [len(strips) for _, strips in expected] == [3, 0, 0]
    down = rows(review, "/sheets/shot/happened", "attempt", "Points2D:positions")
    assert [len(places) for _, places in down] == [1, 0, 0]
    assert down[0][1][0] == pytest.approx([0.43, 0.1])  # short of the hoop; y points down
    # The likeliest path, drawn last, begins at its highest and comes down where it is told.
    path = np.array(expected[0][1][-1])
    assert path[0, 1] == pytest.approx(path[:, 1].min())
    crossed = np.flatnonzero((path[1:, 1] > 0.1) & (path[:-1, 1] <= 0.1))[-1]
    share = (0.1 - path[crossed, 1]) / (path[crossed + 1, 1] - path[crossed, 1])
    landed_m = path[crossed, 0] + share * (path[crossed + 1, 0] - path[crossed, 0]) - 0.45
    (words,) = rows(review, *WORDS)[0][1]
    (told,) = re.findall(r"expected: (\d+) mm (?:short of|beyond)", words)
    assert abs(1000 * abs(landed_m) - float(told)) < 2


def test_a_rig_that_cannot_be_read_draws_no_shot(command: Command, tmp_path: Path):
    campaigns.outcome(tmp_path, 1, shot_height_m=0.3, tuned_parameter=0.7)
    (tmp_path / "my_rig.yaml").write_text("hoop: {forward_m: far}\n")
    (tmp_path / "other.yaml").write_text("nothing: of a rig\n")
    words = ("tunenet-review", tmp_path, "-o", tmp_path / "a.rrd", "--quiet", "--jobs", 1)
    done = command(*words)
    assert done.returncode == 0
    assert "my_rig.yaml: hoop.forward_m far is not a number; no shot is drawn by it" in done.stderr
    assert "/sheets/shot/expected" not in Stored(tmp_path / "a.rrd").entities
    done = command(words[0], tmp_path / "my_rig.yaml", *words[1:], "--overwrite")
    assert done.returncode == 2
    assert "hoop.forward_m" in done.stderr


def test_outcomes_alone_are_a_campaign(command: Command, tmp_path: Path):
    (tmp_path / "today.csv").write_text("ball,success\nred gel,yes\nred gel,no\n/a b,yes\n")
    result = command("tunenet-review", "today.csv", "-o", "today.rrd", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "2/3 = 67 %" in result.stdout
    assert not result.stderr
    verified(tmp_path / "today.rrd")


def test_an_attempt_tells_slope_and_drag_and_leaves_out_samples_that_are_not_known(tmp_path: Path):
    path = campaigns.drop(tmp_path / "drop_1.mcap").with_suffix(".json")
    before = json.loads(path.read_text())["parameters"]
    slope = {"value": 0.06, "interval95": [0.03, 0.09], "unit": "1"}
    drag = {"value": 0.013, "interval95": None, "unit": "1/m"}
    both = {"restitution_slope": slope, "drag": drag}
    curves = {"start_ns": 0, "seconds": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]}
    curves["observed_m"] = [1.0, None, 0.5, 0.4, 0.2, 0.1]
    curves["simulated_m"] = [None, 1.0, 0.8, None, 0.5, 0.4]
    told = {"parameters": {"restitution": before["restitution"], **both}, "curves": curves}
    campaigns.told(path, **told)
    review = reviewed(tmp_path)
    ((_, (words,)),) = rows(review, *WORDS)
    assert "restitution slope 0.060 (95 %: 0.030 to 0.090)" in words
    assert "drag 0.013 1/m\n" in words
    ((_, dots),) = rows(review, *OBSERVED)
    simulated = ("/sheets/overlay/simulated", "attempt", "LineStrips2D:strips")
    ((_, strips),) = rows(review, *simulated)
    assert (len(dots), [len(stretch) for stretch in strips]) == (5, [2, 2])


def test_of_many_balls_the_charts_show_the_first_and_the_tables_all(tmp_path: Path):
    for number in range(20):
        campaigns.outcome(tmp_path, 1, f"ball {number}", tuned_parameter=0.6 + 0.01 * number)
    stored = reviewed(tmp_path)
    titles = [view.name for view in stored.views]
    for sheet, count in (("rates", 23), ("spreads", 20)):
        (labels,) = stored.entities[f"/sheets/{sheet}/labels"]["Points2D:labels"].static
        assert sum("ball " in label for label in labels.as_py()) <= 12
        assert any(f"(the first 12 of {count})" in title for title in titles)
    (words,) = stored.entities["/summary"]["TextDocument:text"].static
    assert all(f"| ball {number} |" in words.as_py()[0] for number in range(20))


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Filmed; filmed and rejected; not filmed; not filmed, then filmed; no drop; filmed."""
    folder = tmp_path_factory.mktemp("stops")
    films = [("drop_1", 1.4), ("drop_2", 0.45), ("drop_4b", 1.4), ("drop_6", 0.45)]
    for seed, (name, seconds) in enumerate(films):
        path = folder / f"{name}.mcap"
        film(path, restitution=0.7, height_m=1.0, seconds=seconds, hold_s=0.2, seed=seed)
        campaigns.tune(path)
    campaigns.drop(folder / "drop_3.mcap")
    campaigns.drop(folder / "drop_4a.mcap", is_bad=True)
    names = ["drop_1", "drop_2", "drop_3", "drop_4b", None, "drop_6"]
    for number, name in enumerate(names, 1):
        said = {} if name is None else {"drop_log": f"{name}.mcap"}
        campaigns.outcome(folder, number, success=name == "drop_1", **said)
    return campaign_of([folder], 1, Progress(quiet=True), pytest.fail)


@pytest.fixture(scope="module")
def stored(played: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Stored:
    path = tmp_path_factory.mktemp("stops") / "a.rrd"
    write_campaign(played, path)
    return Stored(path)


def begins(timeline: str, slot: Slot, shown: Shown | None) -> int | None:
    """When a drop, or an attempt without one, begins on a timeline; None where it never does."""
    if timeline == ATTEMPT:
        return slot.attempt.number
    if timeline == WALL:
        return slot.drop_ns(shown)
    return round(1e9 * (slot.start_s if shown is None else shown.start_s))


# A timeline, a time on it, and whose turn it is then: the last that has begun.
Stop = tuple[str, int, Slot, TunedDrop | None]


def stops(played: Campaign, stored: Stored) -> Iterator[Stop]:
    every = [(slot, shown) for slot in slots_of(played.attempts) for shown in slot.drops or [None]]
    for timeline, times in stored.timelines.items():
        for time in times.tolist():
            begun = [
                (at, index)
                for index, (slot, shown) in enumerate(every)
                if (at := begins(timeline, slot, shown)) is not None and at <= time
            ]
            slot, shown = every[max(begun)[1]]
            yield timeline, time, slot, shown.drop if shown else None


def at(stored: Stored, entity: str, component: str, stop: Stop) -> list:
    return stored.entities[entity][component].at(stop[0], stop[1])


def test_no_film_of_another_drop_stays(played: Campaign, stored: Stored):
    drops = [drop for attempt in played.attempts for drop in attempt.drops]
    films = [drop.film for drop in drops if drop.film is not None]
    every = {picture for film in films for picture in (*film.pictures, film.strobe)}
    seen: set[str] = set()
    for stop in stops(played, stored):
        (blob,) = at(stored, "/film/picture", "EncodedImage:blob", stop)
        drop = stop[3]
        if drop is None or drop.film is None:
            assert bytes(blob) not in every, stop[:2]
        else:
            assert bytes(blob) in {*drop.film.pictures, drop.film.strobe}, stop[:2]
            seen.add(drop.name)
    assert seen == {"drop_1.mcap", "drop_2.mcap", "drop_4b.mcap", "drop_6.mcap"}


def test_curves_dots_and_words_are_of_the_attempt_under_the_cursor(
    played: Campaign, stored: Stored
):
    said: set[str] = set()
    seen: set[tuple[str, int]] = set()
    for stop in stops(played, stored):
        timeline, _, slot, drop = stop
        seen.add((timeline, slot.attempt.number))
        dots = at(stored, "/sheets/overlay/observed", "Points2D:positions", stop)
        words = at(stored, "/sheets/overlay/words", "Points2D:labels", stop)
        has_curve = drop is not None and drop.overlay is not None
        assert (bool(dots), bool(words)) == (has_curve, not has_curve), stop[:2]
        dot = at(stored, "/sheets/overlay/now", "Points2D:positions", stop)
        assert all(place in dots for place in dot), stop[:2]
        (text,) = at(stored, "/attempt", "TextDocument:text", stop)
        assert text.startswith(f"# {slot.attempt.number}: "), stop[:2]
        said |= set(words)
    assert said == {
        "no curve: this drop was rejected",
        "no drop was recorded for this attempt",
    }
    assert seen >= {(line, number) for line in (ATTEMPT, FILM) for number in range(1, 7)}
    assert {timeline for timeline, _ in seen} == {ATTEMPT, FILM, WALL}
    for tab in ("overview", "attempt", "tables"):
        titles = [view.name for view in stored.views if tab in view.tabs]
        assert any(title.startswith(f"{played.name}: ") for title in titles), tab
