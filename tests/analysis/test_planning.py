"""tunenet-plan: the shot that forgives most, what it is told of the ball, and what it warns of."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.answers import known
from tests.analysis.records import drop_record
from tests.analysis.review.stored import verified
from tests.conftest import Command
from tunenet_logs.analysis.planning import (
    KnownBall,
    expected_shot,
    plan_shot,
    read_tuning,
    signed_gap_m,
    told_ball,
)
from tunenet_logs.analysis.record import Estimate, Rebound, to_json
from tunenet_logs.recorders.simulators.ball import SpeedLaw
from tunenet_logs.recorders.simulators.shot import Hoop, Release, ShotRig, passes, shoot

RIG = ShotRig()
ENDS = np.array([1, -1, -1, 1])  # of a range, low and high: a step inside, and a step outside


@pytest.fixture(scope="module")
def plan(command: Command) -> Command:
    return partial(command, "tunenet-plan")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "tuning.json"


Bounces = list[tuple[float | None, float, float]]
TWO: Bounces = [(4.0, 0.7, 0.004), (2.8, 0.75, 0.2)]


def write_tuning(
    path: Path,
    bounces: Bounces = TWO,
    slope: tuple[float, float] | None = None,
    drag: tuple[float, float] | None = None,
    **changed: Any,
) -> Path:
    """A tuning's JSON.

    Args:
        bounces: (speed, restitution, half width of its interval) of each.
        slope: with half its width; 0 for no interval.
        drag: likewise.
    """
    numbers = {"restitution": bounces[0][1:], "restitution_slope": slope, "drag": drag}
    told = {
        "estimates": tuple(
            Estimate(name, "1", one[0], around(*one)) for name, one in numbers.items() if one
        ),
        "rebounds": tuple(
            Rebound(0.5 + k, value, around(value, half), speed)
            for k, (speed, value, half) in enumerate(bounces)
        ),
    }
    path.write_text(to_json(drop_record(**(told | changed))))
    return path


def around(value: float, half: float) -> tuple[float, float] | None:
    return (value - half, value + half) if half else None


def gaps_m(rig: ShotRig, restitution: float, heights_m: np.ndarray, off: np.ndarray) -> np.ndarray:
    """By how much a ball passes, at heights and with restitutions that are off by so much."""
    return signed_gap_m(passes(rig, SpeedLaw(restitution), heights_m, off))


@pytest.mark.parametrize(
    "restitution", [0.66, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.5, 0.85))]
)
def test_the_best_shot_passes_and_its_tolerances_are_true(restitution: float):
    best = known(plan_shot(RIG, told_ball(restitution)).best)
    assert RIG.release.lowest_m <= best.height_m <= RIG.release.highest_m
    assert shoot(RIG, SpeedLaw(restitution), np.array([best.height_m])).is_through[0]
    assert best.miss_m < 0.01
    assert best.restitutions[0] < restitution < best.restitutions[1]
    off = np.array(2 * best.restitutions) + 0.002 * ENDS - restitution
    gaps = gaps_m(RIG, restitution, np.full(4, best.height_m), off)
    assert (gaps > 0).tolist() == [True, True, False, False]
    gaps = gaps_m(RIG, restitution, np.array(2 * best.heights_m) + 0.001 * ENDS, np.zeros(4))
    assert (gaps > 0).tolist() == [True, True, False, False]


def test_it_takes_the_shot_with_the_most_room():
    made = plan_shot(RIG, told_ball(0.6, sd=0.01), 40)
    best = known(made.best)
    shifts, lifts = np.arange(-0.1, 0.1, 0.002), np.arange(-0.1, 0.1, 0.001)
    heights = made.heights_m[made.clearance_m > 0].tolist()
    margins = []
    for height in heights:
        fails = gaps_m(RIG, 0.6, np.full(len(shifts), height), shifts) <= 0
        falls = gaps_m(RIG, 0.6, height + lifts, np.zeros(len(lifts))) <= 0
        by_height = np.abs(lifts[falls]).min() / RIG.release.height_sd_m
        margins.append(min(np.abs(shifts[fails]).min() / 0.01, by_height))
    assert best.margin == pytest.approx(max(margins), abs=0.25)
    assert margins[heights.index(best.height_m)] > max(margins) - 0.25


@pytest.mark.parametrize(
    ("reach", "shots"),
    [((0.302, 0.318), 100), pytest.param((0.25, 0.312), 1000, marks=pytest.mark.slow)],
)
def test_heights_are_judged_beyond_the_reach(reach: tuple[float, float], shots: int):
    rig = replace(RIG, release=Release(*reach))
    best = known(plan_shot(rig, told_ball(0.74, sd=0.01), shots).best)
    lifts = np.arange(-0.06, 0.06, 0.0005)
    fails = gaps_m(rig, 0.74, best.height_m + lifts, np.zeros(len(lifts))) <= 0
    nearest = lifts[fails & (lifts < 0)].max(), lifts[fails & (lifts > 0)].min()
    assert np.array(best.heights_m) - best.height_m == pytest.approx(nearest, abs=0.002)
    assert best.margin > 3


def test_the_shot_that_was_planned_is_expected_where_the_plan_says():
    ball = told_ball(0.74, 0.08, 0.004, 0.03)
    planned = plan_shot(RIG, ball)
    assert planned.best is not None
    shot = expected_shot(RIG, ball, planned.best.height_m)
    assert abs(shot.offset_m[0]) == pytest.approx(planned.best.miss_m, abs=1e-4)
    assert shot.is_through
    least, greatest = shot.offset_m[1:].tolist()
    assert least < shot.offset_m[0] < greatest
    # As far apart as rebounds of 1.96 standard deviations less and more.
    sd = ball.sd_at(planned.best.impact_m_s)
    ends = [told_ball(0.74 + side * 1.96 * sd, 0.08, 0.004, 0.03) for side in (-1, 1)]
    far = [expected_shot(RIG, one, planned.best.height_m).offset_m[0] for one in ends]
    assert [least, greatest] == pytest.approx(far, abs=1e-3)


def test_a_robot_that_keeps_heights_badly_takes_the_middle_of_those_that_pass():
    """Within a step of the heights that are tried; the margin is that of the nearer end."""
    rig = replace(RIG, release=Release(height_sd_m=0.01))
    best = known(plan_shot(rig, told_ball(0.6, sd=0.002), 61).best)
    below, above = best.height_m - best.heights_m[0], best.heights_m[1] - best.height_m
    assert best.margin == pytest.approx(min(below, above) / 0.01)
    assert below == pytest.approx(above, abs=0.012)


def test_of_shots_that_cannot_fail_the_nearest_to_the_centre_is_best():
    rig = replace(RIG, hoop=Hoop(forward_m=1.5, free_radius_m=1.3, up_m=-0.4))
    made = plan_shot(rig, told_ball(0.6, sd=0.002), 20)
    best = known(made.best)
    assert best.restitutions[1] == 1.0
    assert best.miss_m == made.miss_m[made.clearance_m > 0].min()
    assert best.heights_m[1] > 0.85 + 1.0


# ---- What is known of the ball


def test_knowing_less_is_never_surer(path: Path):
    seen: tuple[Bounces, ...] = (
        [(3.2, 0.70, 0.004), (2.2, 0.72, 0.004), (1.6, 0.74, 0.004)],
        [(3.2, 0.70, 0.004)],
        [(None, 0.70, 0.004)],
    )
    known = [read_tuning(write_tuning(path, bounces)) for bounces in seen]
    for speed in (1.7, 2.2, 3.0, 4.5):
        three, one, none = (ball.sd_at(speed) for ball in known)
        assert three < one < none
    assert known[2].sd_at(2.2) == pytest.approx(0.7 * 0.1 * np.log(2), rel=0.01)
    assert "knows no impact speeds" in known[2].remarks[0]
    assert (known[2].law.restitution, known[2].law.slope) == (0.7, 0)


def test_a_restitution_that_is_told_is_as_sure_as_it_is_told():
    assert told_ball(0.7).sd_at(2.2) == pytest.approx(0.01)
    assert told_ball(0.7, sd=0.03).sd_at(2.2) == pytest.approx(0.03)
    assert told_ball(0.7, sd=0.0).sd_at(2.2) > 0
    assert told_ball(0.0, sd=0.01).sd_at(2.2) == pytest.approx(0.01)


def of_law(path: Path, law: SpeedLaw, speeds: np.ndarray, half: float, off: Any = 0.0) -> KnownBall:
    """The ball of a tuning that tells its bounces."""
    rows = np.column_stack([speeds, law.at(speeds) + off]).tolist()
    return read_tuning(write_tuning(path, [(speed, value, half) for speed, value in rows]))


def test_the_law_of_a_ball_that_slows_much_is_found_from_few_bounces(path: Path):
    """p = .22 is the most of any real ball: the prior must not hold it back."""
    ball = of_law(path, SpeedLaw(0.68, 0.22, 4.0), np.array([4.0, 2.9, 2.2]), 0.0157)
    assert ball.law.slope == pytest.approx(0.22, abs=0.03)


def test_a_tuning_gives_the_restitution_at_the_shots_own_speed(path: Path):
    law = SpeedLaw(0.72, 0.09, 4.0)
    made = plan_shot(RIG, of_law(path, law, np.array([4.0, 2.9, 2.15, 1.6]), 0.004))
    best = known(made.best)
    assert best.impact_m_s < 2.7
    truth = float(law.at(np.array(best.impact_m_s)))
    assert best.restitution == pytest.approx(truth, abs=0.001)
    assert truth - 0.72 > 0.02
    assert not made.warnings
    assert best.restitution_sd < 0.004


def test_bounces_that_scatter_within_their_intervals_are_averaged(path: Path):
    rng = np.random.default_rng(3)
    law, speeds, at = SpeedLaw(0.68, 0.07, 4.0), np.array([4.0, 2.8, 2.0, 1.45]), np.array(2.5)
    off = []
    for _ in range(60):
        ball = of_law(path, law, speeds, 1.96 * 0.005, rng.normal(0, 0.005, 4))
        off.append((ball.law.at(at) - law.at(at)) / ball.sd_at(2.5))
    assert np.std(off) == pytest.approx(1.0, abs=0.3)
    assert abs(np.mean(off)) < 0.5


def test_slope_and_drag_are_those_that_were_tuned(path: Path):
    """What the single bounces say beside them is not asked."""
    ball = read_tuning(write_tuning(path, slope=(0.08, 0.02), drag=(0.05, 0.01)))
    assert ball.law == SpeedLaw(0.7, 0.08, 4.0)
    assert ball.slope_source == "tuned"
    assert ball.slope_sd == pytest.approx(0.02 / 1.96, rel=1e-3)
    assert (ball.drag_1_m, ball.drag_sd_1_m) == pytest.approx((0.05, 0.01 / 1.96), rel=1e-3)
    assert ball.sd_at(4.0) == pytest.approx(0.004 / 1.96, rel=1e-3)
    lower = ball.law.at(np.array(2.0)) * np.log(2) * 0.02 / 1.96
    assert ball.sd_at(2.0) == pytest.approx(np.hypot(lower, 0.00204 * 2**0.08), rel=0.01)
    made = plan_shot(RIG, ball)
    assert made.rig.ball.air_drag_1_m == 0.05
    best = known(made.best)
    assert best.restitution > 0.7
    light = replace(RIG, ball=replace(RIG.ball, drag_1_m=0.05))
    flown = passes(light, ball.law, np.array([best.height_m]), np.zeros(1))
    assert flown.offset_m[0, 0] == pytest.approx(made.offset_m[best.index, 0], abs=1e-6)


def test_what_has_no_interval_is_unsure_and_what_is_not_tuned_is_the_bounces_and_the_rigs(
    path: Path,
):
    ball = read_tuning(write_tuning(path, slope=(0.08, 0), drag=(0.2, 0)))
    assert (ball.slope_sd, ball.drag_sd_1_m) == pytest.approx((0.1, 0.1))
    ball = read_tuning(write_tuning(path))
    assert (ball.slope_source, ball.drag_1_m) == ("bounces", None)
    assert plan_shot(RIG, ball, 20).rig == RIG
    words = {"slope": (0.08, 0.02), "drag": (0.05, 0.01), "physical": False}
    ball = read_tuning(write_tuning(path, **words))  # type: ignore[arg-type]
    assert (ball.slope_source, ball.drag_1_m) == ("bounces", None)


def test_the_ends_of_the_drag_are_true_and_count(path: Path):
    sure, unsure = (
        read_tuning(write_tuning(path, slope=(0.08, 0.01), drag=(0.15, half)))
        for half in (0.002, 0.25)
    )
    best, loose = known(plan_shot(RIG, sure).best), plan_shot(RIG, unsure)
    low, high = known(best.drags_1_m)
    assert 0 < low < 0.15 < high
    drags = np.array([low, high, low, high]) + 0.003 * ENDS
    gaps = signed_gap_m(passes(RIG, sure.law, np.full(4, best.height_m), np.zeros(4), drags))
    assert (gaps > 0).tolist() == [True, True, False, False]
    assert known(loose.best).margin < best.margin
    assert "a drag of 0.15 ± 0.13 /m" in loose.warnings[0]


# ---- The command


def test_the_command_from_a_log_to_a_recording(
    command: Command, plan: Command, drop_log: Path, tmp_path: Path
):
    tuned = command("tunenet-tune", drop_log)
    assert tuned.returncode == 0, tuned.stderr
    words = ("--json", tmp_path / "plan.json", "--rrd", tmp_path / "plan.rrd")
    result = plan(drop_log.with_suffix(".json"), *words)
    assert result.returncode == 0, result.stderr
    assert "<- best" in result.stdout
    told = json.loads((tmp_path / "plan.json").read_text())
    assert len(told["shots"]) == 100
    assert told["best"]["restitution"] == pytest.approx(0.7, abs=0.002)
    low, high = told["best"]["tolerance"]["restitution"]
    assert low < 0.7 < high
    assert any(one["passes"] for one in told["shots"])
    verified(tmp_path / "plan.rrd")
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize(
    ("restitution", "rig", "says"),
    [
        (0.3, "{}", ("no height from 0.25 to 0.85 m scores", "move the hoop")),
        (0.7, "hoop: {up_m: 2.0}", ("come down through the hoop's height (hoop.up_m 2)",)),
    ],
)
def test_where_no_height_scores_it_warns_and_says_so(
    plan: Command, tmp_path: Path, restitution: float, rig: str, says: tuple[str, ...]
):
    (tmp_path / "rig.yaml").write_text(rig)
    words = ("--rig", tmp_path / "rig.yaml", "--rrd", tmp_path / "plan.rrd")
    result = plan("--restitution", restitution, *words)
    assert result.returncode == 1
    assert all(one in result.stderr for one in says)
    assert "nan" not in result.stdout + result.stderr
    assert (tmp_path / "plan.rrd").exists()


def test_the_rig_can_be_had_edited_and_given_back(plan: Command, tmp_path: Path):
    path, words = tmp_path / "rig.yaml", ("--restitution", 0.6, "--shots", 20)
    assert plan("--save-rig", path).returncode == 0
    assert plan("--save-rig", path).returncode == 2  # it may be edited by now
    assert plan(*words, "--rig", path).stdout == plan(*words).stdout
    path.write_text(path.read_text().replace("forward_m: 0.45", "forward_m: 0.50"))
    moved = plan(*words, "--rig", path)
    assert moved.returncode == 0
    assert moved.stdout != plan(*words).stdout


def test_the_plan_says_where_slope_and_drag_are_from(plan: Command, path: Path, tmp_path: Path):
    write_tuning(path, slope=(0.08, 0.02), drag=(0.05, 0.01))
    result = plan(path, "--json", tmp_path / "plan.json", "--shots", 20)
    assert result.returncode == 0, result.stderr
    assert "slope 0.080 ± 0.010 of 0.7000 at 4.00 m/s (tuned)" in result.stdout
    assert "drag 0.0500 ± 0.0051 /m (tuned)" in result.stdout
    assert not result.stderr  # nobody told the built-in rig
    told = json.loads((tmp_path / "plan.json").read_text())
    assert told["ball"]["slope_from"] == told["ball"]["drag_from"] == "tuned"
    assert told["ball"]["drag"] == 0.05
    low, high = told["best"]["tolerance"]["drag"]
    assert low < 0.05 < high
    result = plan("--restitution", 0.7, "--shots", 10)
    assert "drag 0.0199 /m (the rig's ball: 60 mm, 40 g)" in result.stdout
    result = plan("--restitution", 0.7, "--drag", 0.03, "--slope", 0.1, "--shots", 10)
    assert "drag 0.0300 /m (told)" in result.stdout
    assert "slope 0.100 of 0.7000 at 3.00 m/s (as told)" in result.stdout


def test_a_rig_that_contradicts_the_tuning_is_told(plan: Command, path: Path, tmp_path: Path):
    write_tuning(path, slope=(0.08, 0.02), drag=(0.1, 0.01))
    rig = tmp_path / "rig.yaml"
    rig.write_text("ball: {mass_kg: 0.04}")
    told = plan(path, "--rig", rig, "--shots", 10).stderr
    assert "by the rig's ball the drag is 0.0199 /m, tuned is 0.1 ± 0.0051 /m" in told
    rig.write_text("ball: {drag_1_m: 0.1}")
    assert not plan(path, "--rig", rig, "--shots", 10).stderr
    write_tuning(path, slope=(0.08, 0.02), drag=(0.1, 0.01), ball="table-tennis")
    told = plan(path, "--shots", 10).stderr
    assert "that of the tuning a table-tennis ball of 40 mm, 2.7 g" in told
