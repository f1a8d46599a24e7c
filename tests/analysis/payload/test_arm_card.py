"""A card carries what was learnt of an arm to its next log, and refuses what is none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import (
    ARM,
    any_log,
    changed,
    circle_log,
    driver,
    of_all,
    renamed,
)
from tests.conftest import Command
from tunenet_logs.analysis.evaluation.worlds.arm import FULL, stranger_runs
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_card import ArmCard, arm_sha256, card_text, read_arm_card
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.analysis.payload.noise import NormalEquations
from tunenet_logs.analysis.payload.torque_fit import fit_payload
from tunenet_logs.analysis.payload.torque_model import arm_motion, arm_terms
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulators.arm.description import JACO_TOOL_LINK, JACO_URDF, Payload
from tunenet_logs.recorders.simulators.arm.known import known_arm
from tunenet_logs.terminal import Progress

DRIVER = driver(12)
JOINTS = tuple(f"joint_{number}" for number in range(1, 8))


@pytest.fixture(scope="module")
def learnt() -> NormalEquations:
    """Of a circle without a payload, by a real driver."""
    log = read_arm_log(circle_log(None, DRIVER), ARM)
    return fit_payload(ARM, arm_motion(log)).learnt


@pytest.fixture(scope="module")
def card(learnt: NormalEquations) -> ArmCard:
    runs = ({"log": "empty.mcap", "sha256": "5" * 64},)
    return ArmCard(arm_sha256(ARM), JOINTS, runs, arm_terms(ARM), learnt)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one arm, along other motions: held, empty, and held again, something else."""
    folder = tmp_path_factory.mktemp("card")
    second = DRIVER.another_run()
    runs = {
        "first": any_log(Payload(1.1), 6, DRIVER),
        "empty": any_log(None, 5, second),
        "next": circle_log(Payload(0.75), second.another_run()),
    }
    for name, episode in runs.items():
        path = folder / f"{name}.mcap"
        record_episode(episode, path, overwrite=False, progress=Progress(quiet=True))
    return folder


def test_a_card_is_as_good_as_the_tares_that_it_is_from():
    """Of a stranger's arm, with a card, and without one."""
    payloads = [(0.9, np.array([0.01, 0.0, 0.01])), (1.7, np.zeros(3)), None, None]
    runs = stranger_runs(JACO_URDF, JACO_TOOL_LINK, 700, FULL, payloads)
    held, other, *empty = (arm_motion(read_arm_log(run.episode, ARM)) for run in runs)
    alone = fit_payload(ARM, held).held
    carded = fit_payload(ARM, held, known=fit_payload(ARM, other, empty).learnt).held
    assert abs(carded.mass_kg - 0.9) < min(0.05, abs(alone.mass_kg - 0.9))
    assert np.ptp(carded.interval95) < 0.25


def test_a_card_is_read_as_it_was_written(card: ArmCard, tmp_path: Path):
    path = tmp_path / "arm.json"
    path.write_text(card_text(card))
    read = read_arm_card(path)
    assert (read.arm_sha256, read.joints, read.runs) == (card.arm_sha256, card.joints, card.runs)
    assert read.terms == card.terms
    assert np.array_equal(read.learnt.gradient, card.learnt.gradient)
    sizes = np.sqrt(np.diag(card.learnt.precision))
    off = np.abs(read.learnt.precision - card.learnt.precision)
    assert np.all(off <= 1e-9 * np.outer(sizes, sizes))
    assert len(path.read_bytes()) < 1_000_000


@pytest.mark.parametrize(
    ("field", "change", "says"),
    [
        ("kind", lambda _: "ball", "another JSON"),
        ("version", lambda _: 2, "version 2"),
        ("joints", lambda _: [], "0 joints"),
        ("joints", lambda _: [1] * 7, "1 is no short text"),
        ("terms", lambda terms: terms[:-1], "precision is no list of"),
        ("terms", lambda terms: terms * 9, "7 joints with"),
        ("terms", lambda _: None, "terms are no list"),
        ("precision", lambda values: values[:-1], "precision is no list of"),
        ("precision", lambda values: [-1.0, *values[1:]], "no sum of squares"),
        ("precision", lambda values: [values[0], 1e14, *values[2:]], "sum of squares"),
        ("precision", lambda values: [True, *values[1:]], "True in precision"),
        ("gradient", lambda values: [1e200, *values[1:]], "1e+200 in gradient"),
        ("gradient", lambda values: [[], *values[1:]], "[] in gradient"),
        ("gradient", None, "gradient is no list"),
        ("runs", lambda _: [], "runs are no list of 1"),
        ("runs", lambda _: [{"log": "a"}], "is no run"),
        ("arm_sha256", lambda _: 5, "5 is no short text"),
    ],
)
def test_what_is_no_card_is_one_line(card: ArmCard, tmp_path: Path, field: str, change, says: str):
    fields = json.loads(card_text(card))
    value = fields.pop(field)
    if change:
        fields[field] = change(value)
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(fields))
    with pytest.raises(UsageError) as caught:
        read_arm_card(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: is no card of an arm (")
    assert says in said
    assert "--save-arm-card" in said
    assert "\n" not in said
    assert len(said) < 400 + len(str(path))


def test_what_is_no_file_of_a_card_is_refused(tmp_path: Path):
    path = tmp_path / "arm.json"
    for text in ("", "[]", "{", '{"precision": NaN}', "[" * 99, '"\\ud800"'):
        path.write_text(text)
        with pytest.raises(UsageError, match="is no card of an arm"):
            read_arm_card(path)
    with pytest.raises(UsageError, match="No such file"):
        read_arm_card(tmp_path / "none.json")
    with pytest.raises(UsageError, match="save-arm-card"):
        read_arm_card(tmp_path)
    with path.open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(UsageError, match="larger than 16 MB"):
        read_arm_card(path)


def test_a_card_without_sense_makes_no_answer_that_looks_sound(card: ArmCard):
    wild = NormalEquations(np.zeros_like(card.learnt.precision), np.full(len(card.terms), 1e15))
    options = TuneOptions(arm_card=replace(card, learnt=wild), task="payload")
    tuning = tune_episode(circle_log(Payload(0.5), DRIVER), options)
    assert tuning.verdict in ("suspect", "rejected")


def test_a_card_of_another_arm_is_refused(card: ArmCard):
    episode = circle_log(Payload(0.5), DRIVER)

    def reason(**other) -> str:
        known = replace(card, file="arm.json", **other)
        tuning = tune_episode(episode, TuneOptions(arm_card=known, task="payload"))
        assert tuning.verdict == "rejected"
        return tuning.reason or ""

    said = reason(arm_sha256=arm_sha256(known_arm("jaco7").arm()))
    assert said.startswith("--arm-card arm.json: is of another arm, or of another description")
    assert "with 6 joints, not 7" in reason(joints=JOINTS[:6])
    jaco = tuple(f"j2s7s300_{joint}" for joint in JOINTS)
    panda = tuple(f"panda_{joint}" for joint in JOINTS)
    episode = changed(episode, **of_all(lambda signal: renamed(signal, jaco)))
    assert "its joint panda_joint_1 is j2s7s300_joint_1 in the log" in reason(joints=panda)


def test_a_card_takes_the_place_of_a_tare(command: Command, files: Path, tmp_path: Path):
    first = (files / "first.mcap", "--tare", files / "empty.mcap", "-o", tmp_path)
    saved = tmp_path / "arm.json"
    result = command("tunenet-tune", *first, "--save-arm-card", saved)
    assert result.returncode == 0, result.stderr
    assert [run["log"] for run in read_arm_card(saved).runs] == ["first.mcap", "empty.mcap"]

    later = tmp_path / "both.json"
    words = ("--arm-card", saved, "--save-arm-card", later)
    result = command("tunenet-tune", files / "next.mcap", *words, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    assert len(read_arm_card(later).runs) == 3
    report = json.loads((tmp_path / "next.json").read_text())
    assert report["parameters"]["payload_mass"]["value"] == pytest.approx(0.75, abs=0.06)
    named = {"file": "arm.json", "logs": ["first.mcap", "empty.mcap"]}
    assert report["provenance"]["options"]["arm_card"] == named

    again = command("tunenet-tune", files / "next.mcap", "--arm-card", later, "-o", tmp_path)
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert "is in the card both.json already, as next.mcap" in again.stderr
    tared = ("--arm-card", later, "--tare", files / "empty.mcap", "-o", tmp_path)
    again = command("tunenet-tune", files / "other.mcap", *tared)
    assert "empty.mcap: is in the card both.json already" in again.stderr


def test_a_card_replaces_only_its_own(command: Command, files: Path, card: ArmCard, tmp_path: Path):
    log, there = files / "next.mcap", tmp_path / "arm.json"
    words = ("tunenet-tune", log, "-o", tmp_path, "--save-arm-card", there)
    there.write_text(card_text(card))
    result = command(*words)
    assert result.returncode == 1
    assert "exists, and is the card of " in result.stderr
    assert there.read_text() == card_text(card)
    assert command(*words, "--overwrite").returncode == 0
    assert command(*words).returncode == 0
    there.write_text("my notes")
    result = command(*words, "--overwrite")
    assert "exists, and is no card that tunenet-logs wrote" in result.stderr
    assert there.read_text() == "my notes"


def test_a_card_is_no_balls(command: Command, drop_log: Path, tmp_path: Path, card: ArmCard):
    known = tmp_path / "arm.json"
    known.write_text(card_text(card))
    words = ("--arm-card", known, "--save-arm-card", tmp_path / "new.json", "-o", tmp_path)
    result = command("tunenet-tune", drop_log, *words)
    assert result.returncode == 1
    assert "--arm-card not used: this is a drop" in result.stderr
    assert "shows no payload, and so no arm" in result.stderr
    assert not (tmp_path / "new.json").exists()
