"""Comparisons: what is told apart is different, and what is not the same is never compared."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.records import HALF, drop_record, payload_record, rejected_record
from tests.conftest import Command
from tunenet_logs.analysis.compare import LEVEL, MAX_LOGS, PairTest, compare, told_apart
from tunenet_logs.analysis.experiment import record_of as tuned_record
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import Estimate, Record, to_json
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop

PAIRS = 4000  # simulated pairs: a rate of 5 % then has a standard deviation of .34 %


def pairs_of(records: list[Record], name: str = "restitution") -> tuple[PairTest, ...]:
    return next(
        one.tests
        for group in compare(records).groups
        for one in group.quantities
        if one.name == name
    )


def simulated(rng: np.random.Generator, truth: float, sd: float) -> Record:
    return drop_record(float(rng.normal(truth, sd)), sd)


@pytest.mark.parametrize(
    ("first_sd", "second_sd"),
    [(0.004, 0.002), pytest.param(0.0005, 0.01, marks=pytest.mark.slow)],
)
def test_equal_values_are_told_apart_in_five_percent(first_sd: float, second_sd: float):
    """And calibrated everywhere, not only there: their probabilities are even."""
    rng = np.random.default_rng(1)
    tests = [
        pairs_of([simulated(rng, 0.7, sd) for sd in (first_sd, second_sd)])[0] for _ in range(PAIRS)
    ]
    wrong = sum(test.differs for test in tests)
    assert wrong / PAIRS == pytest.approx(LEVEL, abs=0.0135)  # four standard deviations
    found = np.array([test.probability for test in tests], float)
    shares = np.histogram(found, bins=10, range=(0, 1))[0] / PAIRS
    assert shares == pytest.approx(np.full(10, 0.1), abs=0.02)


@pytest.mark.slow
def test_among_several_equal_logs_a_difference_is_seen_in_at_most_five_percent():
    rng = np.random.default_rng(2)
    count = 1500
    wrong = sum(
        any(test.differs for test in pairs_of([simulated(rng, 0.7, 0.002) for _ in range(5)]))
        for _ in range(count)
    )
    assert 0.015 < wrong / count < LEVEL + 0.02


@pytest.mark.slow
def test_different_values_are_told_apart_as_often_as_theory_says():
    rng = np.random.default_rng(4)
    found = sum(
        pairs_of([simulated(rng, truth, 0.002) for truth in (0.7, 0.708)])[0].differs
        for _ in range(PAIRS)
    )
    distance = 0.008 / (0.002 * math.sqrt(2))
    expected = 0.5 * math.erfc((HALF - distance) / math.sqrt(2))
    assert found / PAIRS == pytest.approx(expected, abs=0.03)


def test_tuned_drops_of_one_ball_agree_and_another_ball_stands_out():
    """From simulated logs of different heights to the verdict, with the intervals of real fits."""
    drops = [(0.7, 0.8), (0.7, 0.9), (0.7, 1.0), (0.7, 1.1), (0.72, 1.0)]
    records = []
    for seed, (restitution, height_m) in enumerate(drops):
        order = DropOrder(restitution=restitution, height_m=height_m, noise_m=0.001, seed=seed)
        records.append(tuned_record(tune_episode(simulate_drop(order), TuneOptions())))
    comparison = compare(records, ["a", "b", "c", "d", "other"])
    quantity = comparison.groups[0].quantities[0]
    assert told_apart(quantity, "other") == ["a", "b", "c", "d"]
    assert [told_apart(quantity, name) for name in "abcd"] == [["other"]] * 4


def test_the_interval_that_points_at_the_other_value_counts():
    """Zou and Donner 2008, eq. 3: of the larger value its lower part, of the smaller its upper."""
    low = drop_record(estimates=(Estimate("restitution", "1", 0.70, (0.60, 0.703)),), slope=None)
    high = drop_record(estimates=(Estimate("restitution", "1", 0.71, (0.706, 0.9)),))
    test = pairs_of([high, low])[0]
    assert test.difference == pytest.approx(0.01)
    assert test.interval95[0] == pytest.approx(0.01 - math.hypot(0.004, 0.003))
    assert test.interval95[1] == pytest.approx(0.01 + math.hypot(0.19, 0.10))
    assert test.probability == pytest.approx(math.erfc(2 * HALF / math.sqrt(2)), rel=1e-3)


def test_an_interval_that_physics_cuts_is_no_certainty():
    """A drag near 0 whose interval begins there: below it, nothing is known to be excluded."""
    drags = (0.0002, (0.0, 0.0036)), (0.0, (0.0, 0.00001))
    records = [
        drop_record(estimates=(Estimate("drag", "1/m", value, ends),)) for value, ends in drags
    ]
    assert (pairs_of(records, "drag")[0].probability or 0) > 0.5


def test_holms_correction():
    """Of three pairs the smallest probability counts three times, the next twice."""
    records = [drop_record(value, 0.001) for value in (0.700, 0.7033, 0.7036)]
    ordered = sorted(pairs_of(records), key=lambda one: one.probability or 0)
    raw = [float(one.probability or 0) for one in ordered]
    seconds = max(3 * raw[0], 2 * raw[1])
    assert [one.corrected for one in ordered] == pytest.approx(
        [3 * raw[0], seconds, max(seconds, raw[2])]
    )
    held = [payload_record(0.8, 0.01, (x_m, 0.0, 0.0), 0.001) for x_m in (0.0, 0.0026)]
    x = pairs_of(held, "payload_com_x")[0]  # the components are one family
    assert x.probability == pytest.approx(0.066, abs=0.002)
    assert x.corrected == pytest.approx(3 * (x.probability or 0))


def test_a_ball_that_bounces_better_when_slower_is_one_ball():
    """By its law both drops are the same; without it, the difference may be the speed's."""
    slow = 0.7 * (2.0 / 4.0) ** -0.06
    law: Any = {"slope": (0.06, 0.001)}
    fast = drop_record(0.7, 0.001, speed_m_s=4.0, slowest_m_s=1.5, **law)
    (test,) = pairs_of([fast, drop_record(slow, 0.001, speed_m_s=2.0, **law)])
    assert test.difference == pytest.approx(0, abs=1e-9)
    assert test.speed_m_s == 2.0
    assert not test.differs
    assert not test.caution
    (test,) = pairs_of([drop_record(0.7, speed_m_s=4.0), drop_record(slow, speed_m_s=2.0)])
    assert test.differs
    assert "may be the speed's" in test.caution
    (test,) = pairs_of([drop_record(0.7, speed_m_s=None), drop_record(slow)])
    assert "no impact speed" in test.caution
    far = drop_record(0.7, speed_m_s=4.0, **law), drop_record(slow, speed_m_s=2.0, **law)
    assert "no bounce of drop.mcap (1) is so slow" in pairs_of([*far])[0].caution


@pytest.mark.slow
@pytest.mark.parametrize("correlation", [-0.95, 0.0, 0.95])
def test_at_another_speed_equal_balls_are_told_apart_in_at_most_five_percent(correlation: float):
    """Whatever the correlation of restitution and slope, which no record has."""
    rng = np.random.default_rng(5)
    sds = np.array([0.002, 0.01])
    covariance = np.outer(sds, sds) * np.array([[1, correlation], [correlation, 1]])
    slow, wrong, count = 0.7 * (2.0 / 4.0) ** -0.05, 0, 2000
    for _ in range(count):
        value, slope = rng.multivariate_normal([0.7, 0.05], covariance)
        fast = drop_record(float(value), 0.002, slope=(float(slope), 0.01), slowest_m_s=1.0)
        other = drop_record(float(rng.normal(slow, 0.002)), 0.002, speed_m_s=2.0)
        wrong += pairs_of([fast, other])[0].differs
    assert wrong / count < LEVEL + 0.015


def test_the_restitution_holds_at_its_own_impact():
    """A record may show bounces before it."""
    record = drop_record(0.7, speed_m_s=5.0, slowest_m_s=3.0, window={"impact_s": 1.5})
    frame = compare([record]).to_frame()
    assert frame["impact_speed_m_s"].tolist() == [3.0]


def test_what_means_something_else_is_never_compared():
    paper = {"preset": "paper", "engine": "pybullet 3.2.7"}
    records = [
        drop_record(0.5),
        drop_record(0.9, simulator=paper, physical=False),
        drop_record(0.2, simulator={**paper, "engine": "mujoco 4"}, physical=False),
        payload_record(0.8, 0.05, (0.0, 0.0, 0.1), 0.01),
        drop_record(estimates=(Estimate("restitution", "m", 0.1, (0.09, 0.11)),)),
    ]
    comparison = compare(records)
    assert not any(one.tests for group in comparison.groups for one in group.quantities)
    titles = [group.title for group in comparison.groups]
    assert titles == [
        "drop, default",
        "drop, paper, numbers of pybullet 3.2.7",
        "drop, paper, numbers of mujoco 4",
        "payload, default",
    ]


def test_values_without_an_interval_and_one_recording_twice_are_not_compared():
    assert not pairs_of([drop_record(0.5, None), drop_record(0.9)])
    (twice,) = pairs_of([drop_record(0.5, sha256="ab"), drop_record(0.9, sha256="ab")])
    assert (twice.probability, twice.differs) == (None, False)
    assert twice.caution == "the same recording: not compared"


def test_the_frame_has_a_row_for_each_value_and_each_log_without_one():
    records = [drop_record(0.5, slope=(0.05, 0.01)), drop_record(0.9), rejected_record("no ball")]
    frame = compare(records, ["a", "b", "c"]).to_frame()
    assert frame["log"].tolist() == ["a", "b", "a", "c"]
    assert frame["parameter"].tolist()[:3] == ["restitution", "restitution", "restitution_slope"]
    assert frame["differs_from"].tolist()[:2] == ["b", "a"]
    assert frame["reason"].tolist()[3] == "no ball"
    assert frame["low"].tolist()[0] == pytest.approx(0.5 - HALF * 0.001)
    pairs = compare(records, ["a", "b", "c"]).pairs_frame()
    assert pairs[["first", "second", "differs"]].to_numpy().tolist() == [["a", "b", True]]


def test_equal_names_are_numbered_and_never_clash():
    records = [drop_record(log="a"), drop_record(log="a"), drop_record(log="a (2)")]
    assert compare(records).labels == ("a (1)", "a (3)", "a (2)")
    with pytest.raises(UsageError, match="2 names"):
        compare(records, ["a", "b"])
    with pytest.raises(UsageError, match=f"at most {MAX_LOGS}"):
        compare([drop_record()] * (MAX_LOGS + 1))
    assert compare([]).to_frame().empty


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two balls that differ, one of them suspect, and a log without a drop."""
    records = {
        "red": drop_record(0.7, log="red.mcap"),
        "blue": drop_record(0.8, log="blue.mcap", verdict="suspect", reason="may slide"),
        "none": rejected_record("no bounce is seen", log="none.mcap"),
    }
    (tmp_path / "tuned").mkdir()
    for name, record in records.items():
        (tmp_path / "tuned" / f"{name}.json").write_text(to_json(record))
    (tmp_path / "tuned" / "other.json").write_text("[1, 2]")
    return tmp_path / "tuned"


def test_the_command_names_values_differences_suspects_and_rejected_logs(
    folder: Path, tmp_path: Path, command: Command
):
    path = tmp_path / "balls.csv"
    done = command("tunenet-compare", folder, "--csv", path)
    assert done.returncode == 0, done.stderr
    for words in (
        "red.mcap   ok       0.7000 (0.6980 to 0.7020)",
        "0.8000 (0.7980 to 0.8020) (suspect)",
        "restitution: they differ",
        "none.mcap  rejected  no bounce is seen",
        "Holm",
    ):
        assert words in done.stdout
    test = next(line for line in done.stdout.splitlines() if line.startswith("restitution  "))
    differs = ["+0.1000", "0.0972 to 0.1028", "4.00", "p < 0.0001", "differs"]
    assert re.split("  +", test)[2:] == differs
    values = {row["log"]: row["value"] for row in csv.DictReader(path.open())}
    assert values == {"red.mcap": "0.7", "blue.mcap": "0.8", "none.mcap": ""}
    (pair,) = csv.DictReader((tmp_path / "balls_pairs.csv").open())
    assert (pair["first"], pair["second"], pair["differs"]) == ("blue.mcap", "red.mcap", "True")
    assert command("tunenet-compare", folder / "none.json").returncode == 1
    (tmp_path / "after").mkdir()
    (tmp_path / "after" / "red.json").write_text(to_json(drop_record(0.75, log="red.mcap")))
    done = command("tunenet-compare", folder / "red.json", tmp_path / "after" / "red.json")
    assert "red.mcap (tuned/red)" in done.stdout
    assert "red.mcap (after/red)" in done.stdout


OUTPUTS = [
    ("tunenet-compare", "--csv", "out.csv"),
    ("tunenet-compare", "--html", "out.html"),
    ("tunenet-report", "-o", "out.html"),
]


@pytest.mark.parametrize(("name", "option", "output"), OUTPUTS)
def test_what_is_of_the_same_logs_alone_is_replaced_unasked(
    folder: Path, tmp_path: Path, command: Command, name: str, option: str, output: str
):
    path = tmp_path / output
    for _ in range(2):
        assert command(name, folder, option, path).returncode == 0
    fewer = command(name, folder / "red.json", option, path)
    assert fewer.returncode == 2
    assert "of blue.mcap, none.mcap, not of red.mcap; pass --overwrite" in fewer.stderr
    assert command(name, folder / "red.json", option, path, "--overwrite").returncode == 0
    assert command(name, folder, option, path).returncode == 0
    assert not list(tmp_path.glob("*.partial"))


def test_figures_for_a_paper(folder: Path, tmp_path: Path, command: Command):
    figures, path = tmp_path / "figures", folder / "red.json"
    heights_m = [1.0, 0.0, 0.5]
    curves = {"start_ns": 0, "seconds": [0.0, 0.5, 1.0]}
    curves |= {"observed_m": heights_m, "simulated_m": heights_m}
    path.write_text(json.dumps({**json.loads(path.read_text()), "curves": curves}))
    done = command("tunenet-report", path, "--pdf", figures, "--png", tmp_path / "one.png")
    assert done.returncode == 0, done.stderr
    assert {one.name for one in figures.iterdir()} == {"red_curves.pdf"}
    data = (figures / "red_curves.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    assert b"/Type3" not in data, "journals refuse fonts of type 3"
    width_pt = float(data.split(b"/MediaBox [ 0 0 ")[1].split(b" ")[0])
    assert width_pt == pytest.approx(3.4 * 72, abs=1)
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    assert command("tunenet-report", path, "--pdf", figures).returncode == 0
    other = command("tunenet-report", folder / "blue.json", "--pdf", figures / "red_curves.pdf")
    assert other.returncode == 2
