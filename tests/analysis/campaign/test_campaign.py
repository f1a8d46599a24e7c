"""What of a campaign's files belongs together, wherever they lie, and what is counted of it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.answers import known
from tests.analysis.campaign import campaigns
from tests.analysis.campaign.campaigns import MINUTE_NS, START_NS
from tests.conftest import Command, film
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
    overall_rates,
    read_tuned_drop,
    restitutions_by_ball,
    small_film,
    wilson95,
)
from tunenet_logs.analysis.record import Curves
from tunenet_logs.analysis.review.campaign import attempt_words, campaign_words
from tunenet_logs.errors import LogError
from tunenet_logs.images import decode_image
from tunenet_logs.outcomes import BOUNCE_SHOT, MAX_ATTEMPTS, Outcome
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import FilmOrder
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)


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


def names(attempt: Attempt) -> list[str]:
    """Of its drops."""
    return [one.name.removesuffix(".mcap") for one in attempt.drops]


def counted(found: tuple[Attempt, ...]) -> list[tuple[int, int, float | None]]:
    """Successes, shots, and the paper's rate: of all, after accepted drops, after rejected ones."""
    return [(one.successes, one.count, one.published) for one in overall_rates(found)]


@pytest.mark.parametrize(("successes", "count"), [(0, 1), (1, 1), (0, 10), (52, 60), (7, 38)])
def test_wilson_is_scipys(successes: int, count: int):
    from scipy.stats import binomtest  # dear to load

    ends = binomtest(successes, count).proportion_ci(method="wilson")
    assert wilson95(successes, count) == pytest.approx((ends.low, ends.high), abs=1e-12)


# ---- What is counted


def test_the_papers_rates_stand_beside_ours_and_balls_spread():
    shots = [
        outcome(
            k, drop_log=f"d{k}.mcap", success=k in (1, 2, 4, 5, 6), tuned_parameter=0.7 + k / 100
        )
        for k in range(1, 9)
    ]
    drops = [drop(f"d{k}", "ok" if k < 6 else "rejected") for k in range(1, 9)]
    found = attempts(shots, drops)
    assert counted(found) == [(5, 8, 0.62), (4, 5, 0.87), (1, 3, 0.18)]
    (ball,) = ball_rates(found)
    assert (ball.name, ball.successes, ball.count) == ("gel", 5, 8)
    other = outcome(4, "racquetball", tuned_parameter=0.8)
    gel, lone = restitutions_by_ball(attempts([*shots[:3], other], []))
    assert (gel.mean, gel.sd) == (pytest.approx(0.72), pytest.approx(0.01))
    assert gel.attempts == (1, 2, 3)
    assert np.isnan(lone.sd)


def test_a_doubtful_drop_that_was_used_counts_as_accepted_and_an_unknown_one_as_neither():
    shots = [outcome(1, drop_log="a.mcap"), outcome(2, drop_log="b.mcap", success=False)]
    found = attempts([*shots, outcome(3)], [drop("a", "suspect"), drop("b", "rejected")])
    assert counted(found) == [(2, 3, 0.62), (1, 1, 0.87), (0, 1, 0.18)]
    found = attempts([outcome(1), outcome(2, success=False)], [drop("d3", "rejected")])
    assert counted(found)[1:] == [(0, 0, 0.87), (0, 0, 0.18)]


def test_the_papers_rates_stand_beside_bounce_shots_alone():
    found = attempts([outcome(1), outcome(2, success=False), outcome(3, task="grasp")], [])
    first, _, _, grasp = counted(found)
    assert (first, grasp) == ((1, 2, 0.62), (1, 1, None))
    assert overall_rates(found)[3].name == "task grasp"
    assert [(one.name, one.count) for one in ball_rates(found)] == [("gel", 2), ("gel, grasp", 1)]
    assert counted(attempts([outcome(3, task="grasp")], [])) == [(1, 1, None)]


@pytest.mark.parametrize("said", [{}, {"shot_height_m": 0.5}, {"miss_m": 0.2}])
def test_an_attempt_without_a_good_drop_or_a_measure_was_given_up(said: dict[str, Any]):
    shot = outcome(1, drop_log="d1.mcap", success=False, **said)
    (one,) = attempts([shot], [drop("d1", "rejected")])
    assert one.was_shot == bool(said)


def test_a_miss_says_its_side_and_the_median_of_an_even_count_is_its_middle(tmp_path: Path):
    for miss_m, words in (
        (-0.041, "41 mm from the centre, short of it"),
        (0.0085, "8 mm from the centre, beyond it"),
    ):
        (one,) = attempts([outcome(1, miss_m=miss_m)], [])
        assert words in attempt_words(one)
    for number, miss_m in enumerate((0.01, -0.02, 0.06, -0.1), 1):
        campaigns.outcome(tmp_path, number, miss_m=miss_m)
    words = campaign_words(campaign_of([tmp_path], 1, QUIET, pytest.fail))
    assert "4 measured: median 40 mm, largest 100 mm" in words


# ---- What belongs together


LAST = outcome(1, "gel", "elsewhere/d3.mcap", stamp_ns=START_NS + 9 * MINUTE_NS)
# Outcomes, drops, and the drops of each attempt, with the outcome's place where it has one.
TOGETHER = {
    "drops before the one that was used belong to it": (
        [outcome(1, drop_log="d1.mcap"), outcome(2, drop_log="d10.mcap")],
        [drop("d1"), drop("d2", "rejected"), drop("d10"), drop("d11")],
        [(["d1"], 0), (["d2", "d10"], 1), (["d11"], None)],
    ),
    "a wall clock goes before names": (
        [outcome(1, drop_log="z.mcap"), outcome(4, drop_log="b.mcap")],
        [
            drop("z", start_ns=START_NS),
            drop("a", "rejected", start_ns=START_NS + 2 * MINUTE_NS),
            drop("b", start_ns=START_NS + 3 * MINUTE_NS),
        ],
        [(["z"], 0), (["a", "b"], 1)],
    ),
    "a shot has the drop that it was planned with": (
        [outcome(number, drop_log="d1.mcap") for number in (1, 2, 3)],
        [drop("d0", "rejected"), drop("d1")],
        [(["d0", "d1"], 0), (["d1"], 1), (["d1"], 2)],
    ),
    "rejected drops stay with their attempt where balls alternate, and the last outcome counts": (
        [outcome(1, "foam", "d2.mcap"), replace(LAST, stamp_ns=START_NS, success=False), LAST],
        [
            drop("d1", "rejected", "gel"),
            drop("d2", "ok", "foam"),
            drop("d3", "ok", "gel"),
            drop("d4", "rejected", "foam"),
        ],
        [(["d2"], 0), (["d1", "d3"], 2), (["d4"], None)],
    ),
}


@pytest.mark.parametrize("name", TOGETHER)
def test_what_of_drops_and_outcomes_belongs_together(name: str):
    outcomes, drops, expected = TOGETHER[name]
    told: list[str] = []
    found = attempts(outcomes, drops, told)
    own = [None if one.outcome is None else outcomes.index(one.outcome) for one in found]
    assert list(zip([names(one) for one in found], own, strict=True)) == expected
    assert [one.number for one in found] == [1, 2, 3][: len(found)]
    if name.startswith("rejected drops"):
        assert found[2].ball == "foam"
    assert any("several outcomes" in line for line in told) == (LAST in outcomes)
    if name == "a shot has the drop that it was planned with":
        assert [one.value for one in found] == [0.7] * 3
        assert [count for _, count, _ in counted(found)] == [3, 3, 0]
        (spread,) = restitutions_by_ball(found)
        assert (spread.values, spread.attempts) == ((0.7,), (1,))


def test_a_drop_that_an_outcome_names_belongs_to_it_whatever_its_ball():
    told: list[str] = []
    (one,) = attempts([outcome(1, drop_log="d1.mcap")], [drop("d1", ball="Red Gel")], told)
    assert (one.value, one.ball) == (0.7, "gel")
    (line,) = told
    assert "d1.mcap" in line
    assert "Red Gel" in line


# ---- What lies in folders


def test_a_log_comes_back_from_its_tuning(tmp_path: Path):
    log = campaigns.drop(tmp_path / "drop.mcap", 0.7)
    found = known(read_tuned_drop(tmp_path / "drop.json"))
    overlay = known(found.overlay)
    assert (found.log, found.name, found.state) == (log, "drop.mcap", "drop")
    assert found.value == pytest.approx(0.7, abs=0.001)
    ball = read_episode(log).signals["/ball/pose"]
    heights = np.interp(overlay.seconds, ball.seconds, ball.values[:, 2] - 0.05)
    assert np.abs(overlay.observed_m - heights).max() < 2e-4  # its figures are rounded
    assert np.abs(overlay.simulated_m - overlay.observed_m).max() < 1e-3
    assert len((tmp_path / "drop.json").read_bytes()) < 20_000
    assert read_tuned_drop(campaigns.drop(tmp_path / "bad.mcap", is_bad=True).with_suffix(".json"))


def test_what_is_no_tuning_of_a_drop_is_passed_over(tmp_path: Path):
    tuning = campaigns.drop(tmp_path / "drop.mcap").with_suffix(".json")
    known, heights = tuning.read_text(), {"observed_m": [0, 0], "simulated_m": [0, 1]}
    changes: list[dict[str, Any]] = [
        {"verdict": "perhaps"},
        {"parameters": [1]},
        {"parameters": {"restitution": {"value": "x", "interval95": None}}},
        {"curves": {"start_ns": 0, "seconds": [0, 1], **heights, "observed_m": [0]}},
        {"curves": {"start_ns": 0, "seconds": [1, 0], **heights}},
        {"window": {"start_s": 1e999, "end_s": 1}},
        {"task": "payload"},
    ]
    for text in (*(json.dumps({**json.loads(known), **one}) for one in changes), "[" * 100_000):
        tuning.write_text(text)
        assert read_tuned_drop(tuning) is None
    tuning.write_text(known)
    assert read_tuned_drop(tuning) is not None


def test_a_folder_of_much_is_sorted_through(tmp_path: Path):
    """Drops, tunings, outcomes, one of them tuned by somebody, notes and what is none of them."""
    campaigns.drop(tmp_path / "drop_1.mcap", 0.6)
    campaigns.tune(campaigns.outcome(tmp_path, 1, drop_log="drop_1.mcap"))
    (tmp_path / "plan.json").write_text('{"best_height": 0.6}')
    (tmp_path / "notes.txt").write_text("windy\n")
    for places in ([tmp_path], [*sorted(tmp_path.iterdir()), tmp_path]):
        material, told = sorted_through(*places)
        (attempt,) = attempts_of(material, told.append)
        assert attempt.outcome is not None
        assert ([one.name for one in attempt.drops], told) == (["drop_1.mcap"], [])
    (tmp_path / "drop_1.json").unlink()
    before = sorted(tmp_path.iterdir())
    campaign = campaign_of([tmp_path], 1, QUIET, pytest.fail)
    assert campaign.tuned_now == 1  # and nothing was written
    assert campaign.attempts[0].value == pytest.approx(0.6, abs=0.001)
    assert sorted(tmp_path.iterdir()) == before
    (tmp_path / "long.txt").write_text("x" * 2**21)
    material, told = sorted_through(tmp_path)
    assert len(material.outcomes) == len(told) == 1
    assert told[0].startswith(f"{tmp_path / 'long.txt'}: line 1 is too long")


def test_nothing_of_a_campaign_is_told(tmp_path: Path):
    with pytest.raises(LogError, match="no such file"):
        campaign_of([tmp_path / "none"], 1, QUIET, pytest.fail)
    with pytest.raises(LogError, match="holds no drop and no outcome"):
        campaign_of([tmp_path], 1, QUIET, pytest.fail)
    (tmp_path / "outcomes.csv").write_text("ball,success\ngel,perhaps\n")
    with pytest.raises(LogError, match="line 2, column 'success'"):
        campaign_of([tmp_path], 1, QUIET, pytest.fail)


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
    (tmp_path / "more").mkdir()
    logs.append(Path(shutil.copy(logs[0], tmp_path / "more" / "drop_1.mcap")))
    material, told = sorted_through(*logs, *tunings)
    assert [one.log for one in material.drops] == [logs[1]]  # the other may be of either
    assert material.untuned == (logs[0], logs[2])
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


def test_tables_beside_each_other_and_recorded_outcomes_keep_all(tmp_path: Path):
    for number in (1, 2, 4):
        campaigns.outcome(tmp_path, number)
    (tmp_path / "a.csv").write_text("ball,success\ngel,yes\ngel,no\nfoam,no\n")
    (tmp_path / "noon.csv").write_text("ball,success\ngel,no\ngel,yes\n")
    material, told = sorted_through(tmp_path)
    numbers = sorted(one.attempt for one in material.outcomes if one.ball == "gel")
    assert numbers == [1, 2, 3, 4, 5, 6, 7]
    assert (len(attempts_of(material, told.append)), told) == (8, [])
    (tmp_path / "b.csv").write_text("ball,success,attempt\ngel,no,2\n")
    assert len(attempts_of(sorted_through(tmp_path)[0], told.append)) == 8
    assert len(told) == 1
    assert told[0].startswith("gel, attempt 2: has several outcomes")
    campaigns.outcome(tmp_path, MAX_ATTEMPTS)
    rows = f"ball,success,attempt\ngel,yes,{MAX_ATTEMPTS - 1}\ngel,no,\n"
    (tmp_path / "c.csv").write_text(rows)
    with pytest.raises(LogError, match="write their numbers down"):  # none is left
        material_of([tmp_path], pytest.fail)


def test_a_table_of_positions_is_a_drop_where_it_is_named(tmp_path: Path):
    log = campaigns.drop(tmp_path / "drop.mcap", 0.6)
    ball = read_episode(log).signals["/ball/pose"]
    rows = np.column_stack([ball.seconds, ball.values[:, :3]])
    table = tmp_path / "track.csv"
    table.write_text("t,x,y,z\n" + "\n".join(",".join(map(str, row)) for row in rows.tolist()))
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


def test_a_film_is_made_small(filmed_log: Path):
    film = known(small_film(filmed_log, None, None))
    assert max(film.size_px) == WIDTH_PX
    assert film.seconds[-1] - film.seconds[0] == pytest.approx(3.3, abs=0.1)
    sizes = {decode_image(one, "jpeg").shape for one in film.pictures}
    assert sizes == {(film.size_px[1], film.size_px[0], 3)}
    strobe, still = (decode_image(one, "jpeg") for one in (film.strobe, film.pictures[0]))
    moved = np.abs(strobe.astype(int) - still.astype(int)).sum(axis=2) > 90
    assert np.count_nonzero(moved.any(axis=1)) > 20  # rows in which the ball was
    cut = known(small_film(filmed_log, film.start_ns, (0.5, 1.0)))
    ends_s = (cut.seconds[0], cut.seconds[-1])
    assert ends_s == (pytest.approx(0.5, abs=0.04), pytest.approx(1, abs=0.04))


@pytest.mark.parametrize(
    "rate_hz", [240.0, 25.0, *(pytest.param(one, marks=pytest.mark.slow) for one in (100.0, 50.0))]
)
def test_a_small_film_has_at_most_thirty_a_second(tmp_path: Path, rate_hz: float):
    drop = {"restitution": 0.7, "height_m": 0.8, "seconds": 1.2, "rate_hz": rate_hz, "seed": 1}
    log = film(tmp_path / "fast.mcap", FilmOrder(size_px=(80, 60)), **drop)
    small = known(small_film(log, None, None))
    assert np.diff(small.seconds).min() > 0.89 / RATE_HZ
    span_s = small.seconds[-1] - small.seconds[0]
    assert len(small.seconds) - 1 <= 30 * span_s + 0.5
    assert len(small.seconds) > min(rate_hz, 30) * span_s * 0.8
