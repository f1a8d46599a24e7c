"""tunenet-plan: the shot that forgives most, what it is told of the ball, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.drop.test_review import verified
from tests.conftest import Command
from tunenet_logs.analysis.planning import (
    _fitted,
    plan_shot,
    read_tuning,
    signed_gap_m,
    told_ball,
)
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.recorders.simulators.ball import SpeedLaw
from tunenet_logs.recorders.simulators.shot import Hoop, Release, ShotRig, passes, shoot

RIG = ShotRig()


@pytest.fixture(scope="module")
def plan(command: Command) -> Command:
    return partial(command, "tunenet-plan")


def tuning(bounces: list[tuple[float | None, float, float]], **changed: Any) -> str:
    """A tuning's JSON with bounces of (speed, restitution, half width of the interval)."""
    _, value, half = bounces[0]
    told = {
        "log": "drop.mcap",
        "task": "drop",
        "verdict": "ok",
        "reason": None,
        "parameters": {
            "restitution": {"value": value, "interval95": [value - half, value + half], "unit": "1"}
        },
        "bounces": [
            {"restitution": e, "interval95": [e - w, e + w], "impact_speed": v, "unit": "m/s"}
            for v, e, w in bounces
        ],
    }
    return json.dumps({**told, **changed})


@pytest.mark.parametrize(
    "restitution", [0.66, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.5, 0.85))]
)
def test_the_best_shot_passes_and_its_tolerances_are_true(restitution: float):
    best = plan_shot(RIG, told_ball(restitution)).best
    assert best is not None
    assert RIG.release.lowest_m <= best.height_m <= RIG.release.highest_m
    assert shoot(RIG, SpeedLaw(restitution), np.array([best.height_m])).is_through[0]
    assert best.miss_m < 0.01
    low, high = best.restitutions
    assert low < restitution < high
    off = np.array([low + 0.002, high - 0.002, low - 0.002, high + 0.002]) - restitution
    gaps = signed_gap_m(passes(RIG, SpeedLaw(restitution), np.full(4, best.height_m), off))
    assert (gaps[:2] > 0).all()
    assert (gaps[2:] < 0).all()
    low, high = best.heights_m
    heights = np.array([low + 0.001, high - 0.001, low - 0.001, high + 0.001])
    gaps = signed_gap_m(passes(RIG, SpeedLaw(restitution), heights, np.zeros(4)))
    assert (gaps[:2] > 0).all()
    assert (gaps[2:] < 0).all()


def room(gaps: np.ndarray, places: np.ndarray) -> float:
    """How far from 0 the nearest place is from which the ball does not pass."""
    return float(np.abs(places[gaps <= 0]).min())


def test_it_takes_the_shot_with_the_most_room():
    law, made = SpeedLaw(0.6), plan_shot(RIG, told_ball(0.6, sd=0.01), 40)
    assert made.best is not None
    shifts, lifts = np.arange(-0.1, 0.1, 0.002), np.arange(-0.1, 0.1, 0.001)
    margins = []
    for height in made.heights_m[made.clearance_m > 0].tolist():
        off = passes(RIG, law, np.full(len(shifts), height), shifts)
        higher = passes(RIG, law, height + lifts, np.zeros(len(lifts)))
        by_restitution = room(signed_gap_m(off), shifts) / 0.01
        by_height = room(signed_gap_m(higher), lifts) / RIG.release.height_sd_m
        margins.append(min(by_restitution, by_height))
    assert made.best.margin == pytest.approx(max(margins), abs=0.25)
    chosen = made.heights_m[made.clearance_m > 0].tolist().index(made.best.height_m)
    assert margins[chosen] > max(margins) - 0.25


@pytest.mark.parametrize(
    ("reach", "shots"),
    [((0.302, 0.318), 100), pytest.param((0.25, 0.312), 1000, marks=pytest.mark.slow)],
)
def test_heights_are_judged_beyond_the_reach(reach: tuple[float, float], shots: int):
    rig = replace(RIG, release=Release(*reach))
    best = plan_shot(rig, told_ball(0.74, sd=0.01), shots).best
    assert best is not None
    lifts = np.arange(-0.06, 0.06, 0.0005)
    gaps = signed_gap_m(passes(rig, SpeedLaw(0.74), best.height_m + lifts, np.zeros(len(lifts))))
    below, above = lifts[(gaps <= 0) & (lifts < 0)].max(), lifts[(gaps <= 0) & (lifts > 0)].min()
    assert best.heights_m[0] - best.height_m == pytest.approx(below, abs=0.002)
    assert best.heights_m[1] - best.height_m == pytest.approx(above, abs=0.002)
    assert best.margin > 3


def test_a_robot_that_keeps_heights_badly_takes_the_middle_of_those_that_pass():
    """Within a step of the heights that are tried; the margin is that of the nearer end."""
    rig = replace(RIG, release=Release(height_sd_m=0.01))
    best = plan_shot(rig, told_ball(0.6, sd=0.002), 61).best
    assert best is not None
    below, above = best.height_m - best.heights_m[0], best.heights_m[1] - best.height_m
    assert best.margin == pytest.approx(min(below, above) / 0.01)
    assert below == pytest.approx(above, abs=0.012)


@pytest.mark.slow
def test_in_a_wide_hoop_the_ends_are_the_balls_and_the_best_is_near_the_centre():
    rig = replace(RIG, hoop=Hoop(free_radius_m=0.3))
    best = plan_shot(rig, told_ball(0.6, sd=0.01), 40).best
    assert best is not None
    assert best.miss_m < 0.05
    shifts = np.arange(-0.6, 0.4, 0.004)
    heights = np.full(len(shifts), best.height_m)
    gaps = signed_gap_m(passes(rig, SpeedLaw(0.6), heights, shifts))
    off = shifts[gaps <= 0]
    low = off[off < 0].max(initial=-0.6)
    high = off[off > 0].min(initial=0.4)
    assert min(-low, high) > 0.2
    assert best.restitutions == pytest.approx((0.6 + low, 0.6 + high), abs=0.01)


def test_of_shots_that_cannot_fail_the_nearest_to_the_centre_is_best():
    rig = replace(RIG, hoop=Hoop(forward_m=1.5, free_radius_m=1.3, up_m=-0.4))
    made = plan_shot(rig, told_ball(0.6, sd=0.002), 20)
    assert made.best is not None
    assert made.best.restitutions[1] == 1.0
    assert made.best.miss_m == made.miss_m[made.clearance_m > 0].min()
    assert made.best.heights_m[1] > 0.85 + 1.0


def test_knowing_less_is_never_surer(tmp_path: Path):
    path = tmp_path / "tuning.json"
    known = []
    seen: list[list[tuple[float | None, float, float]]] = [
        [(3.2, 0.70, 0.004), (2.2, 0.72, 0.004), (1.6, 0.74, 0.004)],
        [(3.2, 0.70, 0.004)],
        [(None, 0.70, 0.004)],
    ]
    for bounces in seen:
        path.write_text(tuning(bounces))
        known.append(read_tuning(path))
    for speed in (1.7, 2.2, 3.0, 4.5):
        three, one, none = (ball.sd_at(speed) for ball in known)
        assert three < one < none
    assert known[2].sd_at(2.2) == pytest.approx(0.7 * 0.1 * np.log(2), rel=0.01)


def test_a_restitution_that_is_told_is_as_sure_as_it_is_told():
    assert told_ball(0.7).sd_at(2.2) == pytest.approx(0.01)
    assert told_ball(0.7, sd=0.03).sd_at(2.2) == pytest.approx(0.03)
    assert told_ball(0.7, sd=0.0).sd_at(2.2) > 0
    assert told_ball(0.0, sd=0.01).sd_at(2.2) == pytest.approx(0.01)


def test_the_law_of_a_ball_that_slows_much_is_found_from_few_bounces():
    """p = .22 is the most of any real ball: the prior must not hold it back."""
    law, speeds = SpeedLaw(0.68, 0.22, 4.0), np.array([4.0, 2.9, 2.2])
    ball = _fitted(np.column_stack([speeds, law.at(speeds), np.full(3, 0.008)]))
    assert ball.law.slope == pytest.approx(0.22, abs=0.03)


def test_a_tuning_gives_the_restitution_at_the_shots_own_speed(tmp_path: Path):
    law = SpeedLaw(0.72, 0.09, 4.0)
    speeds = [4.0, 2.9, 2.15, 1.6]
    path = tmp_path / "tuning.json"
    path.write_text(tuning([(v, float(law.at(np.array(v))), 0.004) for v in speeds]))
    ball = read_tuning(path)
    made = plan_shot(RIG, ball)
    assert made.best is not None
    assert made.best.impact_m_s < 2.7
    truth = float(law.at(np.array(made.best.impact_m_s)))
    assert made.best.restitution == pytest.approx(truth, abs=0.001)
    assert truth - 0.72 > 0.02
    assert not made.warnings
    assert made.best.restitution_sd < 0.004


def test_bounces_that_scatter_within_their_intervals_are_averaged():
    rng = np.random.default_rng(3)
    law, speeds = SpeedLaw(0.68, 0.07, 4.0), np.array([4.0, 2.8, 2.0, 1.45])
    off = []
    for _ in range(60):
        noisy = law.at(speeds) + rng.normal(0, 0.005, 4)
        ball = _fitted(np.column_stack([speeds, noisy, np.full(4, 0.005)]))
        off.append((ball.law.at(np.array(2.5)) - law.at(np.array(2.5))) / ball.sd_at(2.5))
    assert np.std(off) == pytest.approx(1.0, abs=0.3)
    assert abs(np.mean(off)) < 0.5


def test_without_speeds_it_says_so(tmp_path: Path):
    path = tmp_path / "tuning.json"
    path.write_text(tuning([(None, 0.7, 0.004), (None, 0.72, 0.004)]))
    ball = read_tuning(path)
    assert ball.law.slope == 0
    assert ball.law.restitution == 0.7
    assert "knows no impact speeds" in ball.remarks[0]


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("{", LogError, "is no JSON"),
        ("[]", LogError, "is no tuning"),
        ('{"verdict": "ok", "parameters": null}', LogError, "holds no restitution"),
        (tuning([(3.0, 0.7, 0.01)], task="payload"), LogError, "tuning of a payload"),
        (tuning([(3.0, 1.7, 0.01)]), LogError, "restitution 1.7 is not a number from 0 to 1"),
        (tuning([(-3.0, 0.7, 0.01)]), LogError, "impact_speed -3.0"),
        (tuning([(3.0, float("nan"), 0.01)]), LogError, "NaN is no number"),
        (
            tuning([(3.0, 0.7, 0.01)], verdict="rejected", reason="stays in view: 20 %"),
            NotFoundError,
            "rejected (stays in view: 20 %); drop the ball again",
        ),
    ],
)
def test_what_is_no_good_tuning_is_refused(
    plan: Command, tmp_path: Path, text: str, kind: type, said: str
):
    path = tmp_path / "tuning.json"
    path.write_text(text)
    with pytest.raises(kind) as error:
        read_tuning(path)
    assert said in str(error.value)
    assert str(path) in str(error.value)
    result = plan(path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1


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


def test_where_no_height_scores_it_warns_and_says_so(plan: Command):
    result = plan("--restitution", 0.3)
    assert result.returncode == 1
    assert "no height from 0.25 to 0.85 m scores" in result.stderr
    assert "move the hoop" in result.stderr


def test_a_hoop_that_the_ball_never_comes_down_to_is_told(plan: Command, tmp_path: Path):
    path = tmp_path / "rig.yaml"
    path.write_text("hoop: {up_m: 2.0}")
    result = plan("--restitution", 0.7, "--rig", path, "--rrd", tmp_path / "plan.rrd")
    assert result.returncode == 1
    assert "come down through the hoop's height (hoop.up_m 2)" in result.stderr
    assert "nan" not in result.stdout + result.stderr
    assert (tmp_path / "plan.rrd").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("own.json", "--json", "own.json"), "own.json: is the tuning too; give --json another"),
        (("own.json", "--json", "link.json"), "link.json: is the tuning too"),
        (("own.json", "--json", "sub/../own.json"), "is the tuning too"),
        (("own.rrd", "--rrd", "own.rrd"), "own.rrd: is the tuning too; give --rrd another"),
        (("own.json", "--rig", "own.yaml", "--json", "own.yaml"), "own.yaml: is --rig too"),
        (("own.json", "--json", "x.rrd", "--rrd", "x.rrd"), "x.rrd: is --json too"),
        (("own.json", "--json", "x.rrd", "--rrd", "sub/../x.rrd"), "x.rrd: is --json too"),
    ],
)
def test_no_output_replaces_an_input(
    plan: Command, tmp_path: Path, words: tuple[str, ...], said: str
):
    (tmp_path / "sub").mkdir()
    for name in ("own.json", "own.rrd"):
        (tmp_path / name).write_text(tuning([(3.0, 0.7, 0.004), (2.1, 0.72, 0.004)]))
    (tmp_path / "own.yaml").write_text("hoop: {forward_m: 0.45}")
    (tmp_path / "link.json").symlink_to("own.json")
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    result = plan(*words, cwd=tmp_path)
    assert result.returncode == 2
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "which ball?"),
        (("a.json", "--restitution", 0.5), "leave one out"),
        (("a.json", "--slope", 0.1), "--slope is for --restitution"),
        (("a.json", "--restitution-sd", 0.1), "--restitution-sd is for --restitution"),
        (("--restitution", 2), "is not a number from 0 to 1"),
        (("--restitution", 0.7, "--rig", "none.yaml"), "none.yaml: cannot be read"),
        (("--restitution", 0.7, "--rrd", "x.txt"), "Rerun opens .rrd"),
        (("--restitution", 0.7, "--json", "/none/x.json"), "no such folder"),
    ],
)
def test_wrong_usage_is_one_line(plan: Command, words: tuple[object, ...], said: str):
    result = plan(*words)
    assert result.returncode == 2
    assert said in result.stderr
    assert result.stderr.count("\n") == 1


def test_the_rig_can_be_had_edited_and_given_back(plan: Command, tmp_path: Path):
    path = tmp_path / "rig.yaml"
    assert plan("--save-rig", path).returncode == 0
    assert plan("--save-rig", path).returncode == 2  # it may be edited by now
    first = plan("--restitution", 0.6, "--shots", 20)
    again = plan("--restitution", 0.6, "--rig", path, "--shots", 20)
    assert again.stdout == first.stdout
    path.write_text(path.read_text().replace("forward_m: 0.45", "forward_m: 0.50"))
    moved = plan("--restitution", 0.6, "--rig", path, "--shots", 20)
    assert moved.returncode == 0
    assert moved.stdout != first.stdout


def tuned(
    path: Path,
    slope: tuple[float, float] | None = None,
    drag: tuple[float, float] | None = None,
    **changed: Any,
) -> Path:
    """A tuning's JSON of e = .7 at 4 m/s with slope and drag, each with a half width."""
    told = json.loads(tuning([(4.0, 0.7, 0.004), (2.8, 0.75, 0.2)], **changed))
    for name, known in (("restitution_slope", slope), ("drag", drag)):
        if known is not None:
            value, half = known
            ends = [value - half, value + half] if half else None
            told["parameters"][name] = {"value": value, "interval95": ends, "unit": "1"}
    path.write_text(json.dumps(told))
    return path


def test_slope_and_drag_are_those_that_were_tuned(tmp_path: Path):
    """What the single bounces say beside them is not asked."""
    ball = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.02), (0.05, 0.01)))
    assert ball.law == SpeedLaw(0.7, 0.08, 4.0)
    assert ball.slope_source == "tuned"
    assert ball.slope_sd == pytest.approx(0.02 / 1.96, rel=1e-3)
    assert (ball.drag_1_m, ball.drag_sd_1_m) == pytest.approx((0.05, 0.01 / 1.96), rel=1e-3)
    assert ball.sd_at(4.0) == pytest.approx(0.004 / 1.96, rel=1e-3)
    lower = ball.law.at(np.array(2.0)) * np.log(2) * 0.02 / 1.96
    assert ball.sd_at(2.0) == pytest.approx(np.hypot(lower, 0.00204 * 2**0.08), rel=0.01)
    made = plan_shot(RIG, ball)
    assert made.rig.ball.air_drag_1_m == 0.05
    assert made.best is not None
    assert made.best.restitution > 0.7
    light = replace(RIG, ball=replace(RIG.ball, drag_1_m=0.05))
    heights = np.array([made.best.height_m])
    assert passes(light, ball.law, heights, np.zeros(1)).offset_m[0, 0] == pytest.approx(
        made.offset_m[made.best.index, 0], abs=1e-6
    )


def test_what_has_no_interval_is_taken_as_unsure(tmp_path: Path):
    ball = read_tuning(tuned(tmp_path / "a.json", (0.08, 0), (0.2, 0)))
    assert ball.slope_sd == pytest.approx(0.1)
    assert ball.drag_sd_1_m == pytest.approx(0.1)


def test_a_tuning_without_slope_and_drag_has_the_rigs_drag_and_the_bounces_slope(tmp_path: Path):
    ball = read_tuning(tuned(tmp_path / "a.json"))
    assert ball.slope_source == "bounces"
    assert ball.drag_1_m is None
    made = plan_shot(RIG, ball, 20)
    assert made.rig == RIG
    ball = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.02), (0.05, 0.01), physical=False))
    assert (ball.slope_source, ball.drag_1_m) == ("bounces", None)


def test_the_ends_of_the_drag_are_true_and_count(tmp_path: Path):
    sure = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.01), (0.15, 0.002)))
    unsure = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.01), (0.15, 0.25)))
    best, loose = plan_shot(RIG, sure).best, plan_shot(RIG, unsure)
    assert best is not None
    assert best.drags_1_m is not None
    low, high = best.drags_1_m
    assert 0 < low < 0.15 < high
    drags = np.array([low + 0.003, high - 0.003, low - 0.003, high + 0.003])
    flights = passes(RIG, sure.law, np.full(4, best.height_m), np.zeros(4), drags)
    gaps = signed_gap_m(flights)
    assert (gaps[:2] > 0).all()
    assert (gaps[2:] < 0).all()
    assert loose.best is not None
    assert loose.best.margin < best.margin
    assert "a drag of 0.15 ± 0.13 /m" in loose.warnings[0]


def test_the_plan_says_where_slope_and_drag_are_from(plan: Command, tmp_path: Path):
    path = tuned(tmp_path / "a.json", (0.08, 0.02), (0.05, 0.01))
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


def test_a_rig_that_contradicts_the_tuning_is_told(plan: Command, tmp_path: Path):
    path = tuned(tmp_path / "a.json", (0.08, 0.02), (0.1, 0.01))
    rig = tmp_path / "rig.yaml"
    rig.write_text("ball: {mass_kg: 0.04}")
    result = plan(path, "--rig", rig, "--shots", 10)
    assert "by the rig's ball the drag is 0.0199 /m, tuned is 0.1 ± 0.0051 /m" in result.stderr
    rig.write_text("ball: {drag_1_m: 0.1}")
    assert not plan(path, "--rig", rig, "--shots", 10).stderr
    path = tuned(tmp_path / "a.json", (0.08, 0.02), (0.1, 0.01), ball="table-tennis")
    assert (
        "that of the tuning a table-tennis ball of 40 mm, 2.7 g" in plan(path, "--shots", 10).stderr
    )
