"""What of a campaign's files belongs together, and what is counted of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.campaign import campaigns
from tests.analysis.campaign.campaigns import MINUTE_NS, START_NS
from tunenet_logs.analysis.campaign import (
    RATE_HZ,
    WIDTH_PX,
    Attempt,
    Material,
    TunedDrop,
    attempts_of,
    ball_rates,
    campaign_of,
    material_of,
    natural,
    overall_rates,
    read_tuned_drop,
    restitutions_by_ball,
    small_film,
    wilson95,
)
from tunenet_logs.analysis.record import Curves
from tunenet_logs.errors import LogError
from tunenet_logs.images import decode_image
from tunenet_logs.outcomes import BOUNCE_SHOT, Outcome
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)


def found_in(*places: Path) -> tuple[Attempt, ...]:
    told: list[str] = []
    attempts = attempts_of(material_of(places, told.append), told.append)
    assert not told
    return attempts


def drop(name: str, verdict: str = "ok", ball: str = "", start_ns: int = 0) -> TunedDrop:
    line = np.array([0.0, 1.0])
    return TunedDrop(
        log=Path(f"/c/{name}.mcap"),
        tuning=Path(f"/c/{name}.json"),
        name=f"{name}.mcap",
        ball=ball,
        verdict=verdict,  # type: ignore[arg-type]
        reason="",
        value=None if verdict == "rejected" else 0.7,
        interval95=None,
        overlay=Curves(start_ns, line, line, line),
    )


def outcome(number: int, ball: str = "gel", drop_log: str = "", **said: object) -> Outcome:
    values = {"stamp_ns": START_NS + number * MINUTE_NS, "success": True, **said}
    values = {"task": BOUNCE_SHOT, **values}
    return Outcome(ball=ball, attempt=number, drop_log=drop_log, **values)  # type: ignore[arg-type]


def attempts(
    outcomes: list[Outcome], drops: list[TunedDrop], told: list[str] | None = None
) -> tuple[Attempt, ...]:
    material = Material(tuple(outcomes), tuple(drops), (), (Path("/c"),))
    return attempts_of(material, (told if told is not None else []).append)


@pytest.mark.parametrize(("successes", "count"), [(0, 1), (1, 1), (0, 10), (52, 60), (7, 38)])
def test_wilson_is_scipys(successes: int, count: int):
    from scipy.stats import binomtest  # dear to load

    ends = binomtest(successes, count).proportion_ci(method="wilson")
    assert wilson95(successes, count) == pytest.approx((ends.low, ends.high), abs=1e-12)


def test_the_papers_rates_stand_beside_ours():
    good = [outcome(k, drop_log=f"d{k}.mcap", success=k != 3) for k in range(1, 6)]
    bad = [outcome(k, drop_log=f"d{k}.mcap", success=k == 6) for k in range(6, 9)]
    drops = [drop(f"d{k}", "ok" if k < 6 else "rejected") for k in range(1, 9)]
    every, accepted, rejected = overall_rates(attempts([*good, *bad], drops))
    assert (every.successes, every.count, every.published) == (5, 8, 0.62)
    assert (accepted.successes, accepted.count, accepted.published) == (4, 5, 0.87)
    assert (rejected.successes, rejected.count, rejected.published) == (1, 3, 0.18)
    (ball,) = ball_rates(attempts([*good, *bad], drops))
    assert (ball.name, ball.successes, ball.count) == ("gel", 5, 8)


def test_a_log_comes_back_from_its_tuning(tmp_path: Path):
    log = campaigns.drop(tmp_path / "drop.mcap", 0.7)
    found = read_tuned_drop(tmp_path / "drop.json")
    assert found is not None
    assert found.overlay is not None
    assert (found.log, found.name, found.state) == (log, "drop.mcap", "drop")
    assert found.value == pytest.approx(0.7, abs=0.001)
    ball = read_episode(log).signals["/ball/pose"]
    heights = np.interp(found.overlay.seconds, ball.seconds, ball.values[:, 2] - 0.05)
    assert np.abs(found.overlay.observed_m - heights).max() < 2e-4  # its figures are rounded
    assert np.abs(found.overlay.simulated_m - found.overlay.observed_m).max() < 1e-3
    assert len((tmp_path / "drop.json").read_bytes()) < 20_000
    assert read_tuned_drop(campaigns.drop(tmp_path / "bad.mcap", is_bad=True).with_suffix(".json"))


@pytest.mark.parametrize(
    "changes",
    [
        {"verdict": "perhaps"},
        {"parameters": [1]},
        {"parameters": {"restitution": {"value": "x", "interval95": None}}},
        {"curves": {"start_ns": 0, "seconds": [0, 1], "observed_m": [0], "simulated_m": [0, 1]}},
        {"curves": {"start_ns": 0, "seconds": [1, 0], "observed_m": [0, 0], "simulated_m": [0, 1]}},
        {"window": {"start_s": 1e999, "end_s": 1}},
        {"task": "payload"},
    ],
)
def test_what_is_no_tuning_of_a_drop_is_passed_over(tmp_path: Path, changes: dict):
    campaigns.drop(tmp_path / "drop.mcap")
    campaigns.told(tmp_path / "drop.json", **changes)
    assert read_tuned_drop(tmp_path / "drop.json") is None
    (tmp_path / "drop.json").write_text("[" * 100_000)
    assert read_tuned_drop(tmp_path / "drop.json") is None


def test_drops_before_the_one_that_was_used_belong_to_it():
    drops = [drop("drop_1"), drop("drop_2", "rejected"), drop("drop_10"), drop("drop_11")]
    outcomes = [outcome(1, drop_log="drop_1.mcap"), outcome(2, drop_log="drop_10.mcap")]
    first, second, third = attempts(outcomes, drops)
    assert [one.name for one in first.drops] == ["drop_1.mcap"]
    assert [one.name for one in second.drops] == ["drop_2.mcap", "drop_10.mcap"]
    assert second.outcome == outcomes[1]
    assert third.outcome is None
    assert [one.name for one in third.drops] == ["drop_11.mcap"]
    assert [one.number for one in (first, second, third)] == [1, 2, 3]


def test_a_wall_clock_goes_before_names():
    drops = [drop("z", start_ns=START_NS), drop("a", "rejected", start_ns=START_NS + 2 * MINUTE_NS)]
    drops.append(drop("b", start_ns=START_NS + 3 * MINUTE_NS))
    outcomes = [
        outcome(1, drop_log="z.mcap", stamp_ns=START_NS + MINUTE_NS),
        outcome(2, drop_log="b.mcap", stamp_ns=START_NS + 4 * MINUTE_NS),
    ]
    first, second = attempts(outcomes, drops)
    assert [one.name for one in first.drops] == ["z.mcap"]
    assert [one.name for one in second.drops] == ["a.mcap", "b.mcap"]


def test_another_balls_drop_is_no_attempt_of_this_one():
    drops = [drop("d1", ball="tennis"), drop("d2", ball="gel")]
    lone, shot = attempts([outcome(1, drop_log="elsewhere/d2.mcap")], drops)
    assert (lone.ball, lone.outcome) == ("tennis", None)
    assert [one.name for one in shot.drops] == ["d2.mcap"]


def test_the_last_outcome_of_an_attempt_counts():
    told: list[str] = []
    outcomes = [outcome(1, success=False), outcome(1, stamp_ns=START_NS + 9 * MINUTE_NS)]
    (one,) = attempts(outcomes, [], told)
    assert one.outcome is not None
    assert one.outcome.success
    assert "several outcomes" in told[0]


def test_restitutions_spread_by_ball():
    outcomes = [outcome(k, tuned_parameter=0.7 + k / 100) for k in (1, 2, 3)]
    outcomes.append(outcome(4, "racquetball", tuned_parameter=0.8))
    gel, other = restitutions_by_ball(attempts(outcomes, []))
    assert (gel.mean, gel.sd) == (pytest.approx(0.72), pytest.approx(0.01))
    assert gel.attempts == (1, 2, 3)
    assert np.isnan(other.sd)


def test_an_attempt_without_a_good_drop_was_given_up():
    bad = drop("d1", "rejected")
    given_up, shot = attempts(
        [
            outcome(1, drop_log="d1.mcap", success=False),
            outcome(2, drop_log="d2.mcap", success=False, shot_height_m=0.5),
        ],
        [bad, replace(bad, name="d2.mcap", log=Path("/c/d2.mcap"), tuning=None)],
    )
    assert not given_up.was_shot
    assert shot.was_shot


def test_names_sort_as_people_count():
    names = ["drop_10", "drop_9", "drop_1b", "drop_1a", "Drop", "drop"]
    assert sorted(names, key=natural) == ["Drop", "drop", "drop_1a", "drop_1b", "drop_9", "drop_10"]


def test_a_folder_is_sorted_through(tmp_path: Path):
    campaigns.drop(tmp_path / "drop_1.mcap")
    campaigns.outcome(tmp_path, 1, drop_log="drop_1.mcap")
    (tmp_path / "plan.json").write_text('{"best_height": 0.6}')
    (tmp_path / "notes.txt").write_text("windy\n")
    (attempt,) = found_in(tmp_path)
    assert attempt.outcome is not None
    assert [one.name for one in attempt.drops] == ["drop_1.mcap"]
    names = sorted(tmp_path.iterdir())
    assert found_in(*names, tmp_path)[0].outcome == attempt.outcome


def test_an_outcome_that_somebody_tuned_is_no_drop(tmp_path: Path):
    campaigns.tune(campaigns.outcome(tmp_path, 1))
    (attempt,) = found_in(tmp_path)
    assert not attempt.drops


def test_what_was_not_tuned_is_tuned(tmp_path: Path):
    campaigns.drop(tmp_path / "drop_1.mcap", 0.6)
    (tmp_path / "drop_1.json").unlink()
    campaign = campaign_of([tmp_path], 1, QUIET, pytest.fail)
    assert campaign.tuned_now == 1
    assert campaign.attempts[0].value == pytest.approx(0.6, abs=0.001)
    assert [one.name for one in tmp_path.iterdir()] == ["drop_1.mcap"]


def test_nothing_of_a_campaign_is_told(tmp_path: Path):
    with pytest.raises(LogError, match="no such file"):
        campaign_of([tmp_path / "none"], 1, QUIET, pytest.fail)
    with pytest.raises(LogError, match="holds no drop and no outcome"):
        campaign_of([tmp_path], 1, QUIET, pytest.fail)
    (tmp_path / "outcomes.csv").write_text("ball,success\ngel,perhaps\n")
    with pytest.raises(LogError, match="line 2, column 'success'"):
        campaign_of([tmp_path], 1, QUIET, pytest.fail)


def test_a_film_is_made_small(filmed_log: Path):
    film = small_film(filmed_log, None, None)
    assert film is not None
    assert max(film.size_px) == WIDTH_PX
    assert np.diff(film.seconds).min() > 0.9 / RATE_HZ
    assert film.seconds[-1] - film.seconds[0] == pytest.approx(3.3, abs=0.1)
    sizes = {decode_image(one, "jpeg").shape for one in film.pictures}
    assert sizes == {(film.size_px[1], film.size_px[0], 3)}
    strobe, still = (decode_image(one, "jpeg") for one in (film.strobe, film.pictures[0]))
    moved = np.abs(strobe.astype(int) - still.astype(int)).sum(axis=2) > 90
    assert np.count_nonzero(moved.any(axis=1)) > 20  # rows in which the ball was
    cut = small_film(filmed_log, film.start_ns, (0.5, 1.0))
    assert cut is not None
    assert (cut.seconds[0], cut.seconds[-1]) == (
        pytest.approx(0.5, abs=0.04),
        pytest.approx(1, abs=0.04),
    )


def test_a_drop_that_was_doubted_and_used_counts_as_accepted():
    shots = [outcome(1, drop_log="a.mcap"), outcome(2, drop_log="b.mcap", success=False)]
    drops = [drop("a", "suspect"), drop("b", "rejected")]
    _, accepted, rejected = overall_rates(attempts(shots, drops))
    assert (accepted.successes, accepted.count) == (1, 1)
    assert (rejected.successes, rejected.count) == (0, 1)


def test_shots_of_whose_drop_nothing_is_known_are_neither_accepted_nor_rejected():
    found = attempts([outcome(1), outcome(2, success=False)], [drop("d3", "rejected")])
    every, accepted, rejected = overall_rates(found)
    assert (every.successes, every.count) == (1, 2)
    assert (accepted.count, rejected.count) == (0, 0)
