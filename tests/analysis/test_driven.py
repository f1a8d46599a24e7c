"""Commands and forces in a log change nothing of what is tuned from what was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.driven_logs import (
    NUMBERS,
    TRAJECTORY,
    WRENCH,
    numbers,
    point,
    trajectory,
    wrench,
    write_cdr,
)
from tunenet_logs.analysis.experiment import Claim, Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.experiment import PayloadExperiment
from tunenet_logs.analysis.registry import EXPERIMENTS, experiment_named, kinds_in
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import (
    DropOrder,
    PayloadOrder,
    simulate_drop,
    simulate_payload,
)

S = 10**9
SEVEN = tuple(f"joint_{number}" for number in range(1, 8))


@pytest.fixture
def drives(tmp_path: Path) -> Episode:
    """All that drives a robot: seven joints with torques that move, what looks like positions."""
    rng = np.random.default_rng(0)
    sent = [
        (
            "/a_plan",
            TRAJECTORY,
            index * S // 50,
            trajectory(0, SEVEN, point(1, *rng.normal(size=(3, 7)).tolist())),
        )
        for index in range(300)
    ]
    for index in range(300):
        at_ns = index * S // 50
        fall = 1.5 - 4.9 * (index % 25 / 50) ** 2
        sent.append(("/ball/pose_command", NUMBERS, at_ns, numbers(0, 0, fall)))
        sent.append(("/a_wrench", WRENCH, at_ns, wrench(0, (0, 0, fall), (0, 0, fall))))
    sent.append(("/ball/pose_command", NUMBERS, 7 * S, numbers(1e18)))
    sent.append(("/a_impact", TRAJECTORY, 0, trajectory(0, ["impact"], point(0, [1]))))
    return read_episode(write_cdr(tmp_path / "drives.mcap", sent))


def together(drives: Episode, episode: Episode) -> Episode:
    """One episode of both, the commands first."""
    topics = tuple(line for line in drives.warnings if line.startswith("/"))
    assert topics
    return replace(
        episode,
        signals={**drives.signals, **episode.signals},
        channels=(*drives.channels, *episode.channels),
        warnings=(*topics, *episode.warnings),
        losses=(*drives.losses, *episode.losses),
    )


def shown(tuning: Tuning) -> tuple:
    """What a tuning comes to."""
    values = None if tuning.trace is None else tuning.trace.estimate.tolist()
    assert tuning.episode is not None
    names = list(tuning.episode.signals)
    return tuning.verdict, tuning.reason, values, tuning.warnings, tuning.checks, names


def test_nothing_claims_commands_and_forces(drives: Episode):
    for topic in (None, "/a_plan", "/a_wrench", "/a_impact", "/ball/pose_command"):
        assert kinds_in(drives, topic) == ()
        for name in EXPERIMENTS:
            assert experiment_named(name).claim(drives, topic) is Claim.NONE


def test_a_log_of_commands_alone_is_refused_as_one_of_nothing(tmp_path: Path, drives: Episode):
    del drives
    tuning = tune_log(tmp_path / "drives.mcap", TuneOptions())
    nothing = replace(read_episode(tmp_path / "drives.mcap"), signals={})
    assert tuning.verdict == "rejected"
    assert tuning.reason == tune_episode(nothing, TuneOptions(), tmp_path / "drives.mcap").reason
    assert not any(line.startswith("/") for line in tuning.warnings)


def test_a_payload_is_found_in_what_was_measured(drives: Episode):
    order = PayloadOrder(mass_kg=0.6, is_driver=True)
    episode = replace(simulate_payload(order), info=replace(drives.info))
    both = together(drives, episode)
    options = TuneOptions()
    assert shown(tune_episode(both, options)) == shown(tune_episode(episode, options))
    for one in (both, episode):
        found = PayloadExperiment().detect(one, options, "default")
        assert found.topic == found.log.position.topic == "/joint_states"
    assert PayloadExperiment().claim(both, "/a_plan") is Claim.NONE


def test_a_drop_is_found_in_what_was_measured(drives: Episode):
    episode = replace(simulate_drop(DropOrder()), info=replace(drives.info))
    both = together(drives, episode)
    assert kinds_in(both, None) == kinds_in(episode, None) == ("drop",)
    assert shown(tune_episode(both, TuneOptions())) == shown(tune_episode(episode, TuneOptions()))


def test_a_commanded_effort_is_no_measured_one(drives: Episode):
    """An arm without torques stays one, whatever was commanded."""
    episode = simulate_payload(PayloadOrder(mass_kg=0.6))
    signals = {name: one for name, one in episode.signals.items() if "effort" not in name}
    silent = replace(episode, signals=signals, info=replace(drives.info))
    tuning = tune_episode(together(drives, silent), TuneOptions(task="payload"))
    assert tuning.verdict == "rejected"
    assert tuning.reason is not None
    assert tuning.reason.startswith("no joint torques in this log (there: /joint_states.position")
