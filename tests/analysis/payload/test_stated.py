"""What an owner states of the torques, and several runs of the empty gripper."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import (
    ARM,
    CLEAN,
    any_log,
    changed,
    circle_log,
    driver,
    renamed,
    with_values,
)
from tests.conftest import Command
from tunenet_logs.analysis.options import EffortSign, Gravity, TuneOptions
from tunenet_logs.analysis.record import read_record
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import circle_at
from tunenet_logs.recorders.simulators.arm.payload import held_efforts_nm
from tunenet_logs.terminal import Progress

HELD = Payload(0.75)
DRIVER = driver(12)
CONSTANTS = (11.0, 12.5, 9.0, 8.0, 6.5, 7.0, 5.0)


@pytest.fixture(scope="module")
def held() -> Episode:
    return circle_log(HELD, CLEAN)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A payload, and two runs of the empty gripper, by a real driver."""
    folder = tmp_path_factory.mktemp("tares")
    first = DRIVER.another_run()
    runs = {
        "held": circle_log(HELD, DRIVER),
        "empty": circle_log(None, first),
        "again": any_log(None, 5, first.another_run()),
    }
    for name, episode in runs.items():
        path = folder / f"{name}.mcap"
        record_episode(episode, path, overwrite=False, progress=Progress(quiet=True))
    return folder / "held.mcap", folder / "empty.mcap", folder / "again.mcap"


def in_amperes(constants) -> object:
    return with_values(lambda effort: effort / np.array(constants))


def mass(episode: Episode, **stated) -> float:
    tuning = tune_episode(episode, TuneOptions(method="fit", **stated))
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


def reason(episode: Episode, **stated) -> str:
    tuning = tune_episode(episode, TuneOptions(method="fit", **stated))
    assert tuning.verdict == "rejected"
    return tuning.reason or ""


def without_gravity(episode: Episode) -> Episode:
    stamps_ns = episode.signals["/joint_states.effort"].stamps_ns
    path = circle_at(stamps_ns.astype(np.float64) * 1e-9)
    return changed(episode, effort=with_values(lambda effort: effort - held_efforts_nm(ARM, path)))


@pytest.mark.parametrize("gravity", [None, "included", "compensated"])
@pytest.mark.parametrize("effort_sign", [None, "joint", "load"])
def test_what_is_stated_of_torques_is_all_that_is_tried(
    held: Episode, gravity: Gravity | None, effort_sign: EffortSign | None
):
    sign = -1 if effort_sign == "load" else 1
    episode = without_gravity(held) if gravity == "compensated" else held
    episode = changed(episode, effort=with_values(lambda effort: sign * effort))
    options = TuneOptions(gravity=gravity, effort_sign=effort_sign, method="fit")
    tuning = tune_episode(episode, options)
    assert tuning.estimate is not None
    assert float(tuning.estimate[0]) == pytest.approx(HELD.mass_kg, abs=2e-3)
    assert tuning.detection.fit.convention.sign == sign
    assert tuning.detection.fit.convention.has_gravity == (gravity != "compensated")
    assert len(tuning.detection.conventions) == 4 // (1 + (gravity is not None)) // (
        1 + (effort_sign is not None)
    )


def test_what_is_stated_goes_before_what_the_log_shows(held: Episode):
    options = TuneOptions(gravity="compensated", effort_sign="load", method="fit")
    tuning = tune_episode(held, options)
    assert tuning.verdict in ("suspect", "rejected")


@pytest.mark.parametrize("constants", [CONSTANTS, (9.5,)])
def test_efforts_in_amperes_are_torques_times_constants(held: Episode, constants):
    episode = changed(held, effort=in_amperes(constants))
    found = mass(episode, effort_unit="A", torque_constants=constants)
    assert found == pytest.approx(HELD.mass_kg, abs=2e-3)


@pytest.mark.parametrize("off", [0.85, 1.0, 1.15])
def test_a_mass_from_currents_is_no_surer_than_the_constants(off: float):
    """One laboratory's are all too high beside another's: the interval holds the truth."""
    held, empty = (
        changed(circle_log(*run), effort=in_amperes(CONSTANTS))
        for run in ((HELD, DRIVER), (None, DRIVER.another_run()))
    )
    constants = tuple(off * constant for constant in CONSTANTS)
    options = TuneOptions(effort_unit="A", torque_constants=constants, tares=(empty,), method="fit")
    tuning = tune_episode(held, options)
    low_kg, high_kg = tuning.detection.fit.held.interval95
    assert low_kg < HELD.mass_kg < high_kg
    assert 0.15 < (high_kg - low_kg) / 2 / HELD.mass_kg < 0.4
    if off == 1:
        assert tuning.estimate is not None
        assert tuning.estimate[0] == pytest.approx(HELD.mass_kg, abs=0.03)


def test_a_tare_is_read_as_the_log_is(tmp_path: Path, command: Command):
    """Tables without a line of names, of an arm whose joints have none of their own."""
    names = [f"{what}_{joint}" for what in ("position", "effort") for joint in range(1, 8)]
    columns = ",".join(["t=1", *(f"{name}={number}" for number, name in enumerate(names, start=2))])
    for name, load in (("held", HELD), ("empty", None)):
        episode = circle_log(load, CLEAN)
        position, effort = (
            next(one for one in episode.signals.values() if one.unit == unit)
            for unit in ("rad", "N·m")
        )
        seconds = position.stamps_ns * 1e-9
        rows = np.column_stack([seconds, position.values, effort.values])
        np.savetxt(tmp_path / f"{name}.csv", rows, "%.9g", delimiter=",")
    done = command(
        "tunenet-tune", "held.csv", "--tare", "empty.csv", "--columns", columns, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "held.json").read_text())["parameters"]["payload_mass"]["value"]
    assert found == pytest.approx(HELD.mass_kg, abs=2e-3)


@pytest.mark.parametrize("count", [2, 6, 8])
def test_constants_that_do_not_fit_the_joints_are_counted(held: Episode, count: int):
    said = reason(held, effort_unit="A", torque_constants=(9.5,) * count)
    assert f"--torque-constants has {count} numbers, the arm 7 joints" in said


def test_a_table_of_currents_alone_needs_no_unit(command: Command, tmp_path: Path):
    rows = [f"{at / 50:.2f},{np.sin(at / 50):.6f},{at % 7}" for at in range(300)]
    table = tmp_path / "arm.csv"
    table.write_text("\n".join(["t,joint1_position (rad),joint1_current (A)", *rows]))
    words = ("--task", "payload", "--effort-unit", "A", "--torque-constants", "9.5")
    result = command("tunenet-tune", table, *words, "-o", tmp_path)
    assert result.returncode == 1
    assert "leave --effort-unit out" in result.stdout + result.stderr


def test_several_tares_and_what_is_stated_are_kept(command: Command, files, tmp_path: Path):
    held, *empty = files
    words = [word for tare in empty for word in ("--tare", tare)]
    stated = ("--gravity", "included", "--effort-sign", "joint", "--effort-unit", "N.m")
    result = command("tunenet-tune", held, *words, *stated, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "held.json").read_text())
    assert report["parameters"]["payload_mass"]["value"] == pytest.approx(0.75, abs=0.03)
    tares = report["provenance"]["tare"]
    assert [tare["log"] for tare in tares] == ["empty.mcap", "again.mcap"]
    assert [len(tare["sha256"]) for tare in tares] == [64, 64]
    options = report["provenance"]["options"]
    assert (options["gravity"], options["effort_sign"]) == ("included", "joint")
    assert options["effort_unit"] == "N·m"
    names = [check["name"] for check in report["checks"]]
    assert {"tare 1: no gaps", "tare 2: no gaps"} <= set(names)
    provenance = read_record(tmp_path / "held.json").provenance
    assert provenance is not None
    assert provenance.tares == tuple(tares)


def test_one_tare_is_one_in_the_record(command: Command, files, tmp_path: Path):
    result = command("tunenet-tune", files[0], "--tare", files[1], "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "held.json").read_text())
    assert report["provenance"]["tare"]["log"] == "empty.mcap"


def test_neither_the_log_nor_a_copy_of_a_tare_is_a_tare(files, tmp_path: Path):
    held, empty, _ = files
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(empty.read_bytes())
    for tares, said in (
        ((empty, copy), f"--tare {copy}: is a run that was named before"),
        ((held,), f"--tare {held}: held 0.75 kg"),
    ):
        tuning = tune_log(held, TuneOptions(tares=tares))
        assert tuning.verdict == "rejected"
        assert said in (tuning.reason or "")


def test_a_tare_with_other_joints_is_refused(held: Episode):
    def named(episode: Episode, joints: tuple[str, ...]) -> Episode:
        of = {one: lambda signal: renamed(signal, joints) for one in ("position", "effort")}
        return changed(episode, velocity=lambda signal: renamed(signal, joints), **of)

    numbers = range(1, 8)
    jaco, panda, plain = (
        tuple(f"{arm}{number}" for number in numbers)
        for arm in ("j2s7s300_joint_", "panda_joint", "joint")
    )
    empty, full = circle_log(None, replace(CLEAN, torque_noise_nm=0.01)), named(held, jaco)
    said = reason(full, tares=(named(empty, panda),))
    assert "its joint panda_joint1 is j2s7s300_joint_1 in the log" in said
    assert mass(full, tares=(named(empty, plain),)) == pytest.approx(HELD.mass_kg, abs=5e-3)
    said = reason(full, tares=(named(empty, tuple("abcdefg")),))
    assert "no joint of the log is" in said
