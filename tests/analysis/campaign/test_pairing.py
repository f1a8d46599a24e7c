"""Drops, tunings and outcomes that lie apart, disagree, or are told in several places."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.campaign import campaigns
from tests.analysis.campaign.test_campaign import QUIET, attempts, drop, outcome
from tests.conftest import Command, film
from tunenet_logs.analysis.campaign import (
    Material,
    attempts_of,
    ball_rates,
    campaign_of,
    material_of,
    overall_rates,
    restitutions_by_ball,
    small_film,
)
from tunenet_logs.analysis.evaluation.studies.bounce_shot import draw_trials, outcome_of
from tunenet_logs.analysis.evaluation.worlds.ball import HiddenBall, take_shot
from tunenet_logs.analysis.review.campaign import attempt_words, campaign_words
from tunenet_logs.errors import LogError
from tunenet_logs.outcomes import MAX_ATTEMPTS, write_outcome
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import FilmOrder
from tunenet_logs.recorders.simulators.shot import ShotRig

TRACK = "t,x,y,z\n"


def sorted_through(*places: Path) -> tuple[Material, list[str]]:
    told: list[str] = []
    return material_of(places, told.append), told


def apart(folder: Path, *names: str) -> tuple[list[Path], list[Path]]:
    """Logs in one folder, their tunings in another."""
    (folder / "drops").mkdir()
    (folder / "tuned").mkdir()
    logs = [campaigns.drop(folder / "drops" / f"{name}.mcap") for name in names]
    tunings = [
        Path(shutil.move(one.with_suffix(".json"), folder / "tuned" / f"{one.stem}.json"))
        for one in logs
    ]
    return logs, tunings


def test_tunings_in_another_folder_are_of_the_logs_of_their_name(tmp_path: Path):
    logs, tunings = apart(tmp_path, "drop_1", "drop_2")
    campaign = campaign_of([*logs, *tunings], 1, QUIET, pytest.fail)
    assert campaign.tuned_now == 0
    drops = [one for attempt in campaign.attempts for one in attempt.drops]
    assert [(one.log, one.tuning) for one in drops] == list(zip(logs, tunings, strict=True))


def test_a_tuning_that_may_be_of_several_logs_is_left_out(tmp_path: Path):
    logs, tunings = apart(tmp_path, "drop_1")
    (tmp_path / "more").mkdir()
    logs.append(Path(shutil.copy(logs[0], tmp_path / "more" / "drop_1.mcap")))
    material, told = sorted_through(*logs, *tunings)
    assert (material.drops, material.untuned) == ((), tuple(logs))
    assert len(told) == 1
    assert "2 logs are called drop_1.mcap" in told[0]


def test_of_several_tunings_of_a_log_one_counts(tmp_path: Path):
    log = campaigns.drop(tmp_path / "drop_1.mcap")
    for name in ("a", "b"):
        shutil.copy(tmp_path / "drop_1.json", tmp_path / f"{name}.json")
    material, told = sorted_through(tmp_path)
    assert [one.tuning for one in material.drops] == [tmp_path / "drop_1.json"]
    assert told == [f"{log}: has 3 tunings; {tmp_path / 'drop_1.json'} counts"]
    campaigns.outcome(tmp_path, 1, tuning="b.json")
    material, _ = sorted_through(tmp_path)
    assert [one.tuning for one in material.drops] == [tmp_path / "b.json"]


def test_the_files_of_a_bag_that_was_tuned_are_not_tuned_again(tmp_path: Path):
    campaigns.drop(tmp_path / "drop_1.mcap")
    campaigns.told(tmp_path / "drop_1.json", log="bag")
    (tmp_path / "bag").mkdir()
    (tmp_path / "drop_1.mcap").rename(tmp_path / "bag" / "bag_0.mcap")
    material, told = sorted_through(tmp_path)
    assert [one.log for one in material.drops] == [tmp_path / "bag"]
    assert (material.untuned, told) == ((), [])


@pytest.mark.parametrize("name", ["", "..", "elsewhere/.."])
def test_a_tuning_of_no_log_hides_none(tmp_path: Path, name: str):
    folder = tmp_path / "campaign"
    folder.mkdir()
    log = campaigns.drop(folder / "drop_1.mcap")
    campaigns.told(folder / "drop_1.json", log=name)
    material, _ = sorted_through(folder)
    assert [one.log for one in material.drops] == [None]
    assert material.untuned == (log,)


def test_a_drop_that_an_outcome_names_belongs_to_it_whatever_its_ball():
    told: list[str] = []
    (one,) = attempts([outcome(1, drop_log="d1.mcap")], [drop("d1", ball="Red Gel")], told)
    assert one.value == 0.7
    assert one.ball == "gel"
    assert len(told) == 1
    assert "d1.mcap" in told[0]
    assert "Red Gel" in told[0]


def test_tables_without_numbers_do_not_erase_each_other(tmp_path: Path):
    (tmp_path / "morning.csv").write_text("ball,success\ngel,yes\ngel,no\nfoam,no\n")
    (tmp_path / "noon.csv").write_text("ball,success\ngel,no\ngel,yes\n")
    material, told = sorted_through(tmp_path)
    assert [one.attempt for one in material.outcomes if one.ball == "gel"] == [1, 2, 3, 4]
    assert (len(attempts_of(material, told.append)), told) == (5, [])


def test_a_table_beside_recorded_outcomes_keeps_both(tmp_path: Path):
    for number in (1, 2, 4):
        campaigns.outcome(tmp_path, number)
    (tmp_path / "a.csv").write_text("ball,success\ngel,yes\ngel,no\n")
    material, told = sorted_through(tmp_path)
    assert sorted(one.attempt for one in material.outcomes) == [1, 2, 3, 4, 5]
    (tmp_path / "b.csv").write_text("ball,success,attempt\ngel,no,2\n")
    assert len(attempts_of(sorted_through(tmp_path)[0], told.append)) == 5
    assert len(told) == 1
    assert told[0].startswith("gel, attempt 2: has several outcomes")


def test_no_number_is_left(tmp_path: Path):
    campaigns.outcome(tmp_path, MAX_ATTEMPTS)
    table = f"ball,success,attempt\ngel,yes,{MAX_ATTEMPTS - 1}\ngel,no,\n"
    (tmp_path / "a.csv").write_text(table)
    with pytest.raises(LogError, match="write their numbers down"):
        material_of([tmp_path], pytest.fail)


def test_a_trial_that_the_experiment_gives_up_keeps_its_drops(tmp_path: Path):
    trial = draw_trials(1)[0]
    names = [f"drop_001_{number}" for number in (1, 2, 3, 4)]
    ball = trial.ball.name
    given_up = outcome_of(trial, None, None, f"{names[-1]}.mcap")
    write_outcome(tmp_path, given_up)
    following = outcome(2, ball, drop_log="drop_002_1.mcap")
    drops = [drop(name, "rejected", ball) for name in names]
    first, second = attempts([given_up, following], [*drops, drop("drop_002_1", ball=ball)])
    assert [one.name for one in first.drops] == [f"{name}.mcap" for name in names]
    assert not first.was_shot
    assert [one.name for one in second.drops] == ["drop_002_1.mcap"]


def test_every_shot_that_was_planned_with_a_drop_has_it():
    outcomes = [outcome(number, drop_log="d1.mcap") for number in (1, 2, 3)]
    found = attempts(outcomes, [drop("d0", "rejected"), drop("d1")])
    assert [one.outcome for one in found] == outcomes
    assert [len(one.drops) for one in found] == [2, 1, 1]
    assert [one.value for one in found] == [0.7] * 3
    _, accepted, rejected = overall_rates(found)
    assert (accepted.count, rejected.count) == (3, 0)
    (spread,) = restitutions_by_ball(found)
    assert (spread.values, spread.attempts) == ((0.7,), (1,))


def test_rejected_drops_stay_with_their_attempt_where_balls_alternate():
    drops = [
        drop("d1", "rejected", "gel"),
        drop("d2", "ok", "foam"),
        drop("d3", "ok", "gel"),
        drop("d4", "rejected", "foam"),
    ]
    outcomes = [outcome(1, "foam", "d2.mcap"), outcome(1, "gel", "d3.mcap")]
    foam, gel, lone = attempts(outcomes, drops)
    assert [one.name for one in foam.drops] == ["d2.mcap"]
    assert [one.name for one in gel.drops] == ["d1.mcap", "d3.mcap"]
    assert ([one.name for one in lone.drops], lone.outcome) == (["d4.mcap"], None)


def test_what_is_no_table_does_not_end_the_review(tmp_path: Path):
    campaigns.outcome(tmp_path, 1)
    (tmp_path / "notes.txt").write_text("x" * 2**21)
    material, told = sorted_through(tmp_path)
    assert len(material.outcomes) == 1
    assert len(told) == 1
    assert told[0].startswith(f"{tmp_path / 'notes.txt'}: line 1 is too long")


def test_a_table_of_positions_is_a_drop_where_it_is_named(tmp_path: Path):
    log = campaigns.drop(tmp_path / "drop.mcap", 0.6)
    ball = read_episode(log).signals["/ball/pose"]
    rows = np.column_stack([ball.seconds, ball.values[:, :3]])
    table = tmp_path / "track.csv"
    table.write_text(TRACK + "\n".join(",".join(map(str, row)) for row in rows.tolist()))
    campaign = campaign_of([table], 1, QUIET, pytest.fail)
    assert campaign.tuned_now == 1
    assert campaign.attempts[0].value == pytest.approx(0.6, abs=0.005)
    material, _ = sorted_through(tmp_path)
    assert not material.untuned


def test_an_arms_log_is_no_drop_that_was_tuned(command: Command, tmp_path: Path):
    words = ("--simulate", "payload", "--mass", 0.6, "--quiet", "-o", tmp_path / "p.mcap")
    assert command("tunenet-record", *words).returncode == 0
    campaigns.outcome(tmp_path, 1)
    campaign = campaign_of([tmp_path], 1, QUIET, pytest.fail)
    assert (campaign.tuned_now, campaign.unread, len(campaign.attempts)) == (0, 0, 1)


def test_a_miss_that_was_measured_was_a_shot():
    said = {"success": False, "miss_m": 0.2}
    (one,) = attempts([outcome(1, drop_log="d.mcap", **said)], [drop("d", "rejected")])
    assert one.was_shot


def test_the_papers_rates_stand_beside_bounce_shots_alone():
    found = attempts([outcome(1), outcome(2, success=False), outcome(3, task="grasp")], [])
    every, _, _, grasp = overall_rates(found)
    assert (every.successes, every.count, every.published) == (1, 2, 0.62)
    assert (grasp.name, grasp.count, grasp.published) == ("task grasp", 1, None)
    assert [(one.name, one.count) for one in ball_rates(found)] == [("gel", 2), ("gel, grasp", 1)]
    (alone,) = overall_rates(attempts([outcome(3, task="grasp")], []))
    assert alone.published is None


def test_the_median_of_an_even_count_is_its_middle(tmp_path: Path):
    for number, miss_m in enumerate((0.01, -0.02, 0.06, -0.1), 1):
        campaigns.outcome(tmp_path, number, miss_m=miss_m)
    words = campaign_words(campaign_of([tmp_path], 1, QUIET, pytest.fail))
    assert "4 measured: median 40 mm, largest 100 mm" in words


@pytest.mark.parametrize(
    ("miss_m", "words"),
    [
        (-0.041, "41 mm from the centre, short of it"),
        (0.0085, "8 mm from the centre, beyond it"),
    ],
)
def test_a_miss_says_its_side(miss_m: float, words: str):
    (one,) = attempts([outcome(1, miss_m=miss_m)], [])
    assert words in attempt_words(one)


def test_the_experiments_miss_has_the_sign_of_its_side():
    rig, ball = ShotRig(), HiddenBall("ball", 0.68, 0.0)
    misses = [
        take_shot(ball, rig, height_m, np.random.default_rng(0), errs=False).miss_m or 0.0
        for height_m in (0.25, 0.85)
    ]
    assert misses == pytest.approx([-0.102, 0.456], abs=0.001)


@pytest.mark.parametrize("rate_hz", [240.0, 100.0, 50.0, 25.0])
def test_a_small_film_has_at_most_thirty_a_second(tmp_path: Path, rate_hz: float):
    drop = {"restitution": 0.7, "height_m": 0.8, "seconds": 1.2, "rate_hz": rate_hz, "seed": 1}
    log = film(tmp_path / "fast.mcap", FilmOrder(size_px=(80, 60)), **drop)
    small = small_film(log, None, None)
    assert small is not None
    span_s = small.seconds[-1] - small.seconds[0]
    assert len(small.seconds) - 1 <= 30 * span_s + 0.5
    assert len(small.seconds) > min(rate_hz, 30) * span_s * 0.8
