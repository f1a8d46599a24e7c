"""A simulator's review: every view shows something, and the models move as they were seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.drop.test_review import verified
from tests.analysis.review.stored import Stored
from tests.analysis.review.test_no_view_is_empty import empty_views
from tests.analysis.sysid.pendulums import MODEL, START_NS, model_source, pendulum_episode, swing
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.review.tuning import write_review
from tunenet_logs.analysis.sysid.review import simulator_review_data
from tunenet_logs.analysis.sysid.source import GivenSimulator, ModelSource
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.base import Parameter


@dataclass(frozen=True)
class Spring:
    """A cart on a spring in closed form, seen in some columns; a soft one breaks after a time."""

    columns: int = 1
    breaks_s: float = 6.0
    engine = "spring"
    step_hz = 1000.0
    parameters = (
        Parameter("stiffness", "N/m", (0.0, 100.0), (0.0, 100.0), 30.0),
        Parameter("damping", "N·s/m", (0.0, 5.0), (0.0, 5.0), 2.0),
    )

    def rollout(self, values: Mapping[str, float]) -> Episode:
        seconds = np.arange(0.0, 6.0, 0.02)
        decay, stiffness = values["damping"] / 2, values["stiffness"]
        turns = np.sqrt(max(stiffness - decay**2, 1e-6))
        x = np.exp(-decay * seconds) * np.cos(turns * seconds)
        scaled = x[:, None] * np.arange(1, self.columns + 1)
        scaled[seconds > (6.0 if stiffness > 40 else self.breaks_s)] = np.nan
        names = tuple(f"x{number}" for number in range(self.columns))
        stamps = (START_NS + seconds * 1e9).astype(np.int64)
        signal = Signal("/cart/place", stamps, scaled, names, "m")
        return Episode(EpisodeInfo(truth=dict(values)), {signal.name: signal})

    def recorded(self) -> Episode:
        rolled = self.rollout({"stiffness": 47.0, "damping": 0.6})
        signal = rolled.signals["/cart/place"]
        noise = 0.01 * np.random.default_rng(0).standard_normal(signal.values.shape)
        return Episode(EpisodeInfo(), {signal.name: replace(signal, values=signal.values + noise)})


def reviewed(tuning: Tuning, folder: Path) -> Stored:
    path = folder / "a.rrd"
    write_review(tuning, record_of(tuning), path)
    verified(path)
    assert empty_views(path) == []
    return Stored(path)


def kinds(review: Stored) -> list[str]:
    return [view.kind for view in review.views]


def tabs(review: Stored) -> list[str]:
    named = dict.fromkeys(
        name for view in review.views for name in view.tabs if "(timeline" in name
    )
    return [name.partition(" (")[0] for name in named]


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Tuning:
    source = model_source(tmp_path_factory.mktemp("model"))
    return tune_episode(pendulum_episode(), TuneOptions(source=source))


def test_a_model_that_was_fitted(tuned: Tuning, tmp_path: Path):
    assert tuned.verdict == "ok", tuned.reason
    review = reviewed(tuned, tmp_path)
    assert tabs(review) == ["overlay", "residuals", "scrub", "held-out prediction"]
    assert kinds(review).count("3D") == 1
    scene = {name for name in review.entities if name.startswith("/scene/")}
    for name in ("observed", "simulated"):
        drawn = {one.rpartition("/")[2] for one in scene if one.startswith(f"/scene/{name}/")}
        assert drawn == {"body_1", "capsule", "ellipsoid", "mesh_0"}
    assert "/scene/fixed/body_0/planes/box" in scene


@pytest.mark.parametrize("name", ["observed", "simulated"])
def test_the_model_swings_as_the_pendulum_did(tuned: Tuning, tmp_path: Path, name: str):
    review = reviewed(tuned, tmp_path)
    body = review.entities[f"/scene/{name}/body_1"]
    times, cells = body["Transform3D:mat3x3"].timed["log_time_s"]
    turned = np.array([cell.as_py() for cell in cells]).reshape(-1, 3, 3).swapaxes(1, 2)
    # About -y: the bob hangs along -z, and swings towards +x by the angle.
    angles = np.arctan2(-turned[:, 0, 2], turned[:, 2, 2])
    seconds = times.astype(np.float64) * 1e-9
    known = seconds <= 3.99
    assert known.sum() > 100
    assert np.abs(angles[known] - swing(seconds[known])[:, 0]).max() < 0.06


def test_a_model_without_shapes_shows_where_its_masses_are(tmp_path: Path):
    source = model_source(tmp_path, has_shapes=False)
    review = reviewed(tune_episode(pendulum_episode(), TuneOptions(source=source)), tmp_path)
    drawn = {one for one in review.entities if one.startswith("/scene/observed/body_1/")}
    assert {one.rpartition("/")[2] for one in drawn} == {"ellipsoid", "capsule"}


def test_a_rejected_log_shows_what_was_observed(tmp_path: Path):
    options = TuneOptions(source=model_source(tmp_path))
    tuning = tune_episode(pendulum_episode(spoiled=2.0), options)
    assert tuning.verdict == "rejected"
    assert tuning.detection is not None
    review = reviewed(tuning, tmp_path)
    (cells,) = [
        component.timed["log_time_s"][1]
        for name, component in review.entities["/signal/0/as_observed"].items()
        if name.endswith("scalars")
    ]
    assert len(cells) == len(pendulum_episode().signals["/joint_states.position"].stamps_ns)


def test_a_method_without_a_fit_has_no_prediction(tmp_path: Path):
    options = TuneOptions(source=model_source(tmp_path), method="brent", iterations=3)
    review = reviewed(tune_episode(pendulum_episode(), options), tmp_path)
    assert tabs(review) == ["overlay", "residuals", "scrub"]


def test_an_object_has_no_scene(tmp_path: Path):
    simulator = Spring()
    options = TuneOptions(source=GivenSimulator(simulator))
    review = reviewed(tune_episode(simulator.recorded(), options), tmp_path)
    assert tabs(review) == ["overlay", "residuals", "scrub", "held-out prediction"]
    assert "3D" not in kinds(review)


def test_many_columns_have_a_tab_of_their_own_and_a_bound(tmp_path: Path):
    simulator = Spring(columns=19)
    options = TuneOptions(source=GivenSimulator(simulator))
    tuning = tune_episode(simulator.recorded(), options)
    data = simulator_review_data(tuning)
    assert (len(data.main), len(data.columns), data.left_out) == (4, 16, 3)
    varying = [one.observed.std() / one.noise for one in data.columns]
    assert varying == sorted(varying, reverse=True)
    review = reviewed(tuning, tmp_path)
    assert tabs(review)[1] == "other signals, 3 more are not drawn"


@pytest.mark.parametrize("breaks_s", [3.0, -1.0])
def test_guesses_that_diverge(tmp_path: Path, breaks_s: float):
    simulator = Spring(breaks_s=breaks_s)
    options = TuneOptions(source=GivenSimulator(simulator))
    reviewed(tune_episode(simulator.recorded(), options), tmp_path)


BALL = """
<mujoco>
  <option timestep="0.004"/>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body name="ball" pos="0 0 1"><freejoint/><geom type="sphere" size=".05" mass=".1"/></body>
  </worldbody>
</mujoco>
"""


def places_of(body: str, places: Array, seconds: Array) -> Episode:
    noisy = places + 1e-3 * np.random.default_rng(0).standard_normal(places.shape)
    stamps = (START_NS + seconds * 1e9).astype(np.int64)
    signal = Signal(f"/{body}/pose", stamps, noisy, ("x", "y", "z"), "m")
    return Episode(EpisodeInfo(), {signal.name: signal})


def scene_of(tuning: Tuning, folder: Path) -> tuple[str, set[str]]:
    """Title and entities of the scene."""
    assert tuning.detection is not None, tuning.reason
    review = reviewed(tuning, folder)
    (scene,) = [view for view in review.views if view.kind == "3D"]
    return scene.name, set(scene.entities)


def test_a_free_body_is_where_it_was_seen(tmp_path: Path):
    (tmp_path / "ball.xml").write_text(BALL)
    source = ModelSource(tmp_path / "ball.xml", ("body/ball.mass=0.05:0.2",))
    seconds = np.arange(0.0, 0.4, 0.01)
    places = np.column_stack([0 * seconds, 0 * seconds, 1 - 9.81 * seconds**2 / 2])
    tuning = tune_episode(places_of("ball", places, seconds), TuneOptions(source=source))
    title, entities = scene_of(tuning, tmp_path)
    assert title == "white: as observed, the rest as simulated; warm: the tuned model"
    assert {"/scene/points/0", "/scene/observed/body_1/ellipsoid"} <= entities


def test_a_point_of_a_robot_is_a_dot(tmp_path: Path):
    tip, key = '<body name="tip" pos="0 0 -.4"/>', '<keyframe><key qpos="1.4"/></keyframe>'
    text = MODEL.format(floor="", shapes=tip).replace("</mujoco>", f"{key}</mujoco>")
    (tmp_path / "pendulum.xml").write_text(text)
    source = ModelSource(tmp_path / "pendulum.xml", ("joint/hinge.damping=0:.2",))
    seconds = np.arange(0.0, 4.0, 0.01)
    angles = swing(seconds)[:, 0]
    places = 0.4 * np.column_stack([np.sin(angles), 0 * angles, -np.cos(angles)])
    tuning = tune_episode(places_of("tip", places, seconds), TuneOptions(source=source))
    title, entities = scene_of(tuning, tmp_path)
    assert title == "the tuned model, dots: as observed"
    assert "/scene/points/0" in entities
    assert not any(one.startswith("/scene/observed") for one in entities)


def test_a_log_that_shows_nothing_of_it_has_no_curves_to_compare(tmp_path: Path):
    seen = pendulum_episode().signals["/joint_states.position"]
    other = replace(seen, columns=("wheel",))
    episode = Episode(EpisodeInfo(), {other.name: other})
    tuning = tune_episode(episode, TuneOptions(source=model_source(tmp_path)))
    assert tuning.detection is None
    assert "3D" not in kinds(reviewed(tuning, tmp_path))
