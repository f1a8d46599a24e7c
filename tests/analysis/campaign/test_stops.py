"""At every stop of every timeline a campaign's review shows the attempt under the cursor alone."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.analysis.campaign import campaigns
from tests.analysis.review.stored import Stored
from tests.conftest import film
from tunenet_logs.analysis.campaign import Campaign, TunedDrop, campaign_of
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


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
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
def stored(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Stored:
    path = tmp_path_factory.mktemp("stops") / "a.rrd"
    write_campaign(campaign, path)
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


def stops(campaign: Campaign, stored: Stored) -> Iterator[Stop]:
    every = [
        (slot, shown) for slot in slots_of(campaign.attempts) for shown in slot.drops or [None]
    ]
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


def test_every_attempt_has_stops_on_the_timelines_that_play_it(campaign: Campaign, stored: Stored):
    seen = {(timeline, slot.attempt.number) for timeline, _, slot, _ in stops(campaign, stored)}
    assert {number for timeline, number in seen if timeline == ATTEMPT} == set(range(1, 7))
    assert {number for timeline, number in seen if timeline == FILM} == set(range(1, 7))
    assert {timeline for timeline, _ in seen} == {ATTEMPT, FILM, WALL}


def test_no_film_of_another_drop_stays(campaign: Campaign, stored: Stored):
    drops = [drop for attempt in campaign.attempts for drop in attempt.drops]
    films = [drop.film for drop in drops if drop.film is not None]
    every = {picture for film in films for picture in (*film.pictures, film.strobe)}
    seen: set[str] = set()
    for stop in stops(campaign, stored):
        (blob,) = at(stored, "/film/picture", "EncodedImage:blob", stop)
        drop = stop[3]
        if drop is None or drop.film is None:
            assert bytes(blob) not in every, stop[:2]
        else:
            assert bytes(blob) in {*drop.film.pictures, drop.film.strobe}, stop[:2]
            seen.add(drop.name)
    assert seen == {"drop_1.mcap", "drop_2.mcap", "drop_4b.mcap", "drop_6.mcap"}


def test_a_drop_has_its_curve_or_words_why_not(campaign: Campaign, stored: Stored):
    said: set[str] = set()
    for stop in stops(campaign, stored):
        dots = at(stored, "/sheets/overlay/observed", "Points2D:positions", stop)
        words = at(stored, "/sheets/overlay/words", "Points2D:labels", stop)
        has_curve = stop[3] is not None and stop[3].overlay is not None
        assert (bool(dots), bool(words)) == (has_curve, not has_curve), stop[:2]
        said |= set(words)
    assert said == {
        "no curve: this drop was rejected",
        "no drop was recorded for this attempt",
    }


def test_the_dot_runs_along_the_curve_of_its_own_drop(campaign: Campaign, stored: Stored):
    for stop in stops(campaign, stored):
        dot = at(stored, "/sheets/overlay/now", "Points2D:positions", stop)
        dots = at(stored, "/sheets/overlay/observed", "Points2D:positions", stop)
        assert all(place in dots for place in dot), stop[:2]


def test_its_words_are_of_the_attempt(campaign: Campaign, stored: Stored):
    for stop in stops(campaign, stored):
        (text,) = at(stored, "/attempt", "TextDocument:text", stop)
        assert text.startswith(f"# {stop[2].attempt.number}: "), stop[:2]


def test_the_campaign_is_named_in_the_titles(campaign: Campaign, stored: Stored):
    for tab in ("overview", "attempt", "tables"):
        titles = [view.name for view in stored.views if tab in view.tabs]
        assert any(title.startswith(f"{campaign.name}: ") for title in titles), tab
