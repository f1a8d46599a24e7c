"""A simulator's review: every view shows something, and the models move as they were seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.review.stored import Stored, reviewed
from tests.analysis.sysid.pendulums import START_NS, model_source, pendulum_episode, swing
from tests.analysis.sysid.test_own_simulator import TRUTH, Spring
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.sysid.review import simulator_review_data
from tunenet_logs.analysis.sysid.source import GivenSimulator, ModelSource
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.base import Parameter


class Cart(Spring):
    """Seen in some columns; a soft spring, as the first guess is, breaks after a time."""

    parameters = (
        Parameter("stiffness", "N/m", (0.0, 100.0), (0.0, 100.0), 30.0),
        Parameter("damping", "N·s/m", (0.0, 5.0), (0.0, 5.0), 2.0),
    )

    def __init__(self, columns: int = 1, breaks_s: float = 6.0) -> None:
        self.columns, self.breaks_s = columns, breaks_s

    def rollout(self, values: Mapping[str, float]) -> Episode:
        whole = super().rollout({**TRUTH, **values, "stiffness": max(values["stiffness"], 20.0)})
        cart = whole.signals["/cart"]
        seen = cart.values[:, :1] * np.arange(1, self.columns + 1)
        if values["stiffness"] < 35:
            seen[cart.seconds > self.breaks_s] = np.nan
        names = tuple(f"x{number}" for number in range(self.columns))
        return replace(whole, signals={"/cart": replace(cart, values=seen, columns=names)})

    def tuned(self) -> Tuning:
        """To a log of it with noise."""
        truth = self.rollout(TRUTH).signals["/cart"]
        noise = 0.01 * np.random.default_rng(0).standard_normal(truth.values.shape)
        log = Episode(EpisodeInfo(), {"/cart": replace(truth, values=truth.values + noise)})
        return tune_episode(log, TuneOptions(source=GivenSimulator(self)))


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


@pytest.fixture(scope="module")
def review(tuned: Tuning, tmp_path_factory: pytest.TempPathFactory) -> Stored:
    return reviewed(tuned, tmp_path_factory.mktemp("review"))


def test_a_model_that_was_fitted(tuned: Tuning, review: Stored):
    assert tuned.verdict == "ok", tuned.reason
    assert tabs(review) == ["overlay", "residuals", "scrub", "held-out prediction"]
    assert kinds(review).count("3D") == 1
    scene = {name for name in review.entities if name.startswith("/scene/")}
    for name in ("observed", "simulated"):
        drawn = {one.rpartition("/")[2] for one in scene if one.startswith(f"/scene/{name}/")}
        assert drawn == {"body_1", "capsule", "ellipsoid", "mesh_0"}
    assert "/scene/fixed/body_0/planes/box" in scene


@pytest.mark.parametrize("name", ["observed", "simulated"])
def test_the_model_swings_as_the_pendulum_did(review: Stored, name: str):
    seconds, cells = review.series(f"/scene/{name}/body_1", "Transform3D:mat3x3")
    turned = cells.reshape(-1, 3, 3).swapaxes(1, 2)
    # About -y: the bob hangs along -z, and swings towards +x by the angle.
    angles = np.arctan2(-turned[:, 0, 2], turned[:, 2, 2])
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


def test_what_a_joint_was_asked_for_is_drawn(tmp_path: Path):
    servo = '<actuator><position joint="hinge" kp="0.001"/></actuator></mujoco>'
    path = model_source(tmp_path).path
    path.write_text(path.read_text().replace("</mujoco>", servo))
    episode = pendulum_episode()
    stamps_ns = episode.signals["/joint_states.position"].stamps_ns[::40]
    values = np.arange(len(stamps_ns), dtype=float)[:, None] * 0.1
    asked = Signal("commands.position", stamps_ns, values, ("hinge",), "rad", drives=True)
    episode = replace(episode, signals={**episode.signals, asked.name: asked})
    source = ModelSource(path, ("joint/hinge.damping=0:.2",))
    tuning = tune_episode(episode, TuneOptions(source=source, method="brent", iterations=2))
    data = simulator_review_data(tuning)
    shown = {column.name: column for column in data.columns}
    commanded = shown["position hinge"].commanded
    assert commanded is not None
    places = np.searchsorted(asked.seconds, shown["position hinge"].seconds, side="right") - 1
    np.testing.assert_allclose(commanded, values[places, 0])
    assert shown["velocity hinge"].commanded is None
    names = reviewed(tuning, tmp_path).entities
    assert any(one.endswith("/commanded") for one in names)


def test_an_object_has_no_scene(tmp_path: Path):
    review = reviewed(Cart().tuned(), tmp_path)
    assert tabs(review) == ["overlay", "residuals", "scrub", "held-out prediction"]
    assert "3D" not in kinds(review)


def test_many_columns_have_a_tab_of_their_own_and_a_bound(tmp_path: Path):
    tuning = Cart(columns=19).tuned()
    data = simulator_review_data(tuning)
    assert (len(data.main), len(data.columns), len(data.every)) == (4, 16, 19)
    varying = [one.observed.std() / one.noise for one in data.columns]
    assert varying == sorted(varying, reverse=True)
    review = reviewed(tuning, tmp_path)
    assert tabs(review)[1] == "other signals, 3 more are not drawn"
    assert sum(one.startswith("/compared/") for one in review.entities) == 12


def test_pages_get_what_was_compared_the_worst_first(tuned: Tuning, review: Stored):
    assert tuned.trace is not None
    assert tuned.trace.fit is not None
    fit = tuned.trace.fit.detail
    position = fit.target.which == 0
    (entity,) = [
        name
        for name, known in review.entities.items()
        if name.startswith("/compared/")
        and [cell.as_py() for cell in known["name"].static] == [["position hinge"]]
    ]
    seconds, curves = review.series(entity)
    observed, given, simulated, predicted = curves.T
    assert seconds == pytest.approx(np.arange(0.0, 4.0, 0.01), abs=1e-6)
    assert observed == pytest.approx(fit.target.values[position])
    assert given == pytest.approx(fit.first[position])
    assert simulated == pytest.approx(fit.simulated[position])
    later = seconds >= 2.4
    assert np.isfinite(predicted[later]).all()
    assert np.isnan(predicted[~later]).all()
    assert np.abs(predicted[later] - swing(seconds[later])[:, 0]).max() < 0.01
    about = {key: review.entities[entity][key].static[0].as_py() for key in ("noise", "held_out_s")}
    assert about["noise"] == [pytest.approx(0.01, rel=0.1)]
    assert about["held_out_s"] == [pytest.approx(2.4, abs=0.011)]


@pytest.mark.parametrize("breaks_s", [3.0, -1.0])
def test_guesses_that_diverge(tmp_path: Path, breaks_s: float):
    reviewed(Cart(breaks_s=breaks_s).tuned(), tmp_path)


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
    assert title == "white: seen in part; warm: tuned"
    assert {"/scene/points/0", "/scene/observed/body_1/ellipsoid"} <= entities


def test_a_log_that_shows_nothing_of_it_has_no_curves_to_compare(tmp_path: Path):
    seen = pendulum_episode().signals["/joint_states.position"]
    other = replace(seen, columns=("wheel",))
    episode = Episode(EpisodeInfo(), {other.name: other})
    tuning = tune_episode(episode, TuneOptions(source=model_source(tmp_path)))
    assert tuning.detection is None
    assert "3D" not in kinds(reviewed(tuning, tmp_path))
