"""What a review calls its parameters, and where they stand when their names are long."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import result_words, said_names
from tunenet_logs.analysis.record import Estimate, Record
from tunenet_logs.analysis.tuning import tune_log


def test_an_address_keeps_its_marks_and_loses_its_kind():
    names = {
        "restitution_slope": "restitution slope",
        "joint/shoulder_pan.damping": "shoulder_pan.damping",
        "body/ns/left_arm.ipos[0]": "ns/left_arm.ipos[0]",
        "option.gravity[2]": "option.gravity[2]",
        "delay/commands": "delay/commands",
    }
    assert said_names(names) == names


def test_names_stay_apart():
    names = ["joint/belt.damping", "tendon/belt.damping", "joint/a.damping"]
    assert list(said_names(names).values()) == [*names[:2], "a.damping"]


def named(record: Record, names: list[str]) -> Record:
    """The record with other parameters, an estimate and five iterations of each."""
    estimates = tuple(Estimate(name, "N·m", 0.1, (0.0, 0.2)) for name in names)
    iterations = tuple(dict.fromkeys(names, 0.1 * k) for k in range(8))
    return replace(record, estimates=estimates, iterations=iterations, is_fitted=True)


def test_long_names_stand_in_a_list_and_leave_room_for_the_result(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions(method="fit"))
    record = record_of(tuning)
    short = result_words(named(record, ["joint/a.damping"]), "default", None)
    assert "| a.damping [N·m] | 0.1000 | 0.0000 to 0.2000 |" in short
    assert "| k | 3 | 4 | 5 | 6 | refined |" in short
    names = ["joint/shoulder_pan_joint.frictionloss", f"joint/{'x' * 50}.damping"]
    long = result_words(named(record, names), "default", None)
    assert "- shoulder_pan_joint.frictionloss [N·m]: 0.1000, 95 %: 0.0000 to 0.2000" in long
    assert "| k | 5 | 6 | refined |" in long
    assert "| shoulder_pan_joint.frictionloss | 0.5000 | 0.6000 | 0.7000 |" in long
    cells = [line.split(" | ")[0] for line in long.splitlines() if line.startswith("| ")]
    assert max(map(len, cells)) <= 2 + 32
