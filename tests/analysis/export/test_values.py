"""The numbers in each file, read back by its language's own parser, are those that were tuned."""

from __future__ import annotations

import ast
import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.integrate import solve_ivp

from tests.analysis.records import ball_tuning, payload_tuning
from tests.conftest import Command
from tunenet_logs.analysis.export.drake import dissipation, restitution
from tunenet_logs.analysis.export.registry import export_format, usual_suffix
from tunenet_logs.recorders.simulators.arm.description import (
    PAYLOAD_RADIUS_M,
    Payload,
    jaco,
    read_arm,
)
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

MASS_KG, COM_M = 0.8, [0.01, -0.02, 0.03]
MOMENT_KG_M2 = 0.4 * MASS_KG * PAYLOAD_RADIUS_M**2
DRAKE = "{http://drake.mit.edu}"
Export = Callable[..., Path]


@pytest.fixture
def export(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Export:
    """Exports a tuning without running the engine; the file's path."""

    def make(engine: str, tuning: Path, *words: object) -> Path:
        monkeypatch.setattr(export_format(engine), "LIBRARY", None)
        result = command("tunenet-export", tuning, "--to", engine, *words)
        assert result.returncode == 0, result.stderr
        return tmp_path / f"a{usual_suffix(export_format(engine))}"

    return make


@pytest.fixture
def card(export: Export) -> Callable[..., dict[str, Any]]:
    return lambda *words: json.loads(export("json", *words).read_text())


def constants(path: Path) -> dict[str, Any]:
    """The names that a Python file sets at its top."""
    found: dict[str, Any] = {}
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                found[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return found


def number(element: ET.Element, path: str, attribute: str | None = None) -> float:
    found = element.find(path)
    assert found is not None, path
    return float((found.text if attribute is None else found.get(attribute)) or "nan")


def usd_values(path: Path) -> dict[str, list[float]]:
    """Numbers by the attribute's name."""
    found: dict[str, list[float]] = {}
    for line in path.read_text().split("\n"):
        if match := re.fullmatch(r"\s*(?:uniform )?[\w\[\]]+ ([\w:]+) = (.*)", line):
            found[match[1]] = [float(one) for one in re.findall(r"-?[\d.]+(?:e-?\d+)?", match[2])]
    return found


Read = Callable[[Path], dict[str, float]]


def python_ball(path: Path) -> dict[str, float]:
    names = {
        "RESTITUTION": "restitution",
        "RADIUS_M": "radius",
        "MASS_KG": "mass",
        "MOMENT_KG_M2": "moment",
        "DROP_HEIGHT_M": "height",
        "STEP_S": "step",
    }
    return {names[name]: one for name, one in constants(path).items() if name in names}


def pybullet_ball(path: Path) -> dict[str, float]:
    return urdf_ball(path.with_suffix(".urdf")) | python_ball(path)


def urdf_ball(path: Path) -> dict[str, float]:
    robot = ET.fromstring(path.read_text())
    moments = [number(robot, "link/inertial/inertia", name) for name in ("ixx", "iyy", "izz")]
    assert moments == moments[:1] * 3
    return {
        "restitution": number(robot, "link/contact/restitution", "value"),
        "radius": number(robot, "link/collision/geometry/sphere", "radius"),
        "mass": number(robot, "link/inertial/mass", "value"),
        "moment": moments[0],
    }


def sdf_ball(path: Path) -> dict[str, float]:
    root = ET.fromstring(path.read_text())
    models = {model.get("name"): model for model in root.iter("model")}
    bounce = "link/collision/surface/bounce"
    assert number(models["ground"], f"{bounce}/restitution_coefficient") == 1
    for model in models.values():
        assert 0 < number(model, f"{bounce}/threshold") < 0.1
    ball = models["ball"]
    radius = number(ball, "link/collision/geometry/sphere/radius")
    return {
        "restitution": number(ball, f"{bounce}/restitution_coefficient"),
        "radius": radius,
        "mass": number(ball, "link/inertial/mass"),
        "moment": number(ball, "link/inertial/inertia/ixx"),
        "height": float(ball.findtext("pose", "").split()[2]) - radius,
        "step": number(root, "world/physics/max_step_size"),
    }


def isaac_ball(path: Path) -> dict[str, float]:
    found = usd_values(path)
    step_s = 1 / found["physxScene:timeStepsPerSecond"][0]
    assert GRAVITY_M_S2 * step_s < found["physxScene:bounceThreshold"][0] < 0.1
    assert 'physxMaterial:restitutionCombineMode = "max"' in path.read_text()
    (moment,) = set(found["physics:diagonalInertia"])
    return {
        "restitution": found["physics:restitution"][0],
        "radius": found["radius"][0],
        "mass": found["physics:mass"][0],
        "moment": moment,
        "height": found["xformOp:translate"][2] - found["radius"][0],
    }


@pytest.mark.parametrize(
    ("engine", "read", "step_s", "words"),
    [
        ("pybullet", pybullet_ball, 1 / 960, ()),
        ("urdf", urdf_ball, None, ()),
        ("sdf", sdf_ball, 0.001, ()),
        ("isaac", isaac_ball, None, ()),
        ("newton", python_ball, 0.002, ("--step", 0.002)),
    ],
)
def test_a_balls_file(
    export: Export, tmp_path: Path, engine: str, read: Read, step_s: float | None, words: tuple
):
    """What stands for the first rebound without air, not the number of a ball that is slowed."""
    tuning = ball_tuning(tmp_path / "a.json", 0.75, 0.05, 0.1, height_m=2.0, first=0.7)
    found = read(export(engine, tuning, "--radius", 0.03, "--mass", 0.05, *words))
    wanted = {"restitution": 0.7, "radius": 0.03, "mass": 0.05, "moment": 0.4 * 0.05 * 0.03**2}
    wanted |= {"height": 2.0} if "height" in found else {}
    wanted |= {"step": step_s} if step_s else {}
    assert found == pytest.approx(wanted)


def sdf_payload(path: Path) -> tuple[float, list[float], float]:
    inertial = ET.fromstring(path.read_text()).find("model/link/inertial")
    assert inertial is not None
    com_m = list(map(float, inertial.findtext("pose", "").split()))[:3]
    return number(inertial, "mass"), com_m, number(inertial, "inertia/izz")


def usd_payload(path: Path) -> tuple[float, list[float], float]:
    found = usd_values(path)
    (moment,) = set(found["physics:diagonalInertia"])
    return found["physics:mass"][0], found["physics:centerOfMass"], moment


def python_payload(path: Path) -> tuple[float, list[float], float]:
    found = constants(path)
    return found["MASS_KG"], list(found["COM_M"]), found["INERTIA_KG_M2"][8]


def mujoco_payload(path: Path) -> tuple[float, list[float], float]:
    library: Any = mujoco
    body = library.MjModel.from_xml_path(str(path)).body("payload")
    return float(body.mass[0]), body.ipos.tolist(), float(body.inertia[2])


PAYLOADS: Mapping[str, Callable[[Path], tuple[float, list[float], float]]] = {
    "sdf": sdf_payload,
    "drake": sdf_payload,
    "isaac": usd_payload,
    "newton": python_payload,
    "mujoco": mujoco_payload,
}


@pytest.mark.parametrize("engine", PAYLOADS)
def test_a_payloads_file(export: Export, tmp_path: Path, engine: str):
    mass_kg, com_m, moment_kg_m2 = PAYLOADS[engine](
        export(engine, payload_tuning(tmp_path / "a.json", MASS_KG, tuple(COM_M)))  # type: ignore[arg-type]
    )
    assert (mass_kg, com_m) == (MASS_KG, pytest.approx(COM_M))
    assert moment_kg_m2 == pytest.approx(MOMENT_KG_M2)


def test_a_payloads_urdf_is_the_arms_own(export: Export, tmp_path: Path):
    """Copied into an arm's URDF, it is what the tuning's simulator carried."""
    robot = ET.fromstring(export("urdf", payload_tuning(tmp_path / "a.json")).read_text())
    link = robot.find("link")
    assert link is not None
    arm, payload = jaco(), Payload(MASS_KG, tuple(COM_M))  # type: ignore[arg-type]
    whole, own = ET.fromstring(arm.urdf()), ET.fromstring(arm.urdf(payload))
    joint = next(one for one in own.iter("joint") if one.get("name") == "payload_mount")
    whole.extend([link, joint])
    for name, tree in (("own", own), ("arm", whole)):
        (tmp_path / f"{name}.urdf").write_text(ET.tostring(tree, encoding="unicode"))
    ours, theirs = (
        read_arm(tmp_path / f"{name}.urdf", "payload").joints[-1].link for name in ("own", "arm")
    )
    assert theirs.mass_kg == ours.mass_kg
    assert theirs.com_m == pytest.approx(ours.com_m)
    assert theirs.inertia_kg_m2 == pytest.approx(ours.inertia_kg_m2)


def test_the_card_has_the_restitution_without_air_and_the_tuned_law(card, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "b.json", 0.8, 0.06, 0.11, height_m=1.2, first=0.72)
    made = card(tuning, "-o", tmp_path / "a.card.json")
    assert made["restitution"]["value"] == 0.72
    assert made["tuned"]["restitution"]["value"] == 0.8
    assert made["tuned"]["drag"]["interval95"] == pytest.approx([0.1, 0.12])
    height = {"value": pytest.approx(1.2), "source": "record", "unit": "m"}
    assert made["ball"]["drop_height"] == height
    assert made["equivalent"]["all"]["restitution"] == pytest.approx(0.73)
    assert made["ball"]["friction"] is None
    first_m_s = math.sqrt(2 * GRAVITY_M_S2 * 1.2)
    for speed_m_s in (1.0, 3.0, 8.0):
        told = card(tuning, "--speed", speed_m_s, "-o", tmp_path / "a.card.json", "--overwrite")
        law = 0.8 * (speed_m_s / first_m_s) ** -0.06
        assert told["restitution"]["value"] == pytest.approx(law)
        at_speed = {"value": speed_m_s, "source": "option", "unit": "m/s"}
        assert told["restitution"]["at_speed"] == at_speed


def test_what_a_log_does_not_tell_is_assumed_and_says_so(card, tmp_path: Path):
    bounce = {"restitution": 0.8, "interval95": None, "impact_speed": None}
    made = card(ball_tuning(tmp_path / "a.json", bounces=[bounce]))
    assert made["restitution"]["value"] == 0.8
    assert made["equivalent"] is None
    assert made["ball"]["drop_height"] == {"value": 1.0, "source": "assumed", "unit": "m"}
    assert made["law"]["at_speed_m_s"] is None
    held = card(payload_tuning(tmp_path / "a.json", com_m=None), "--overwrite")
    assert held["payload"]["com_m"] == [0, 0, 0]
    assert held["payload"]["inertia_kg_m2"]["ixx"] == pytest.approx(MOMENT_KG_M2)
    assert "payload_com" not in held["tuned"]
    assert any("cannot be separated" in note for note in held["notes"])


@pytest.mark.parametrize(
    ("words", "ball", "radius", "mass"),
    [
        ((), None, (0.02, "assumed"), (0.0335, "assumed")),
        ((), "tennis", (0.0335, "record"), (0.0577, "record")),
        (("--radius", 0.05), "tennis", (0.05, "option"), (0.0577, "record")),
        (("--mass", 0.1), None, (0.02, "assumed"), (0.1, "option")),
    ],
)
def test_size_and_mass_say_where_they_come_from(card, tmp_path: Path, words, ball, radius, mass):
    found = card(ball_tuning(tmp_path / "a.json", ball=ball), *words)["ball"]
    for name, (value, source) in (("radius", radius), ("mass", mass)):
        assert found[name]["value"] == pytest.approx(value)
        assert found[name]["source"] == source


def test_yaml_and_json_say_the_same(export: Export, card, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json", 0.8, 0.06, 0.11, first=0.72)
    text, made = export("yaml", tuning).read_text(), card(tuning)
    notes = made.pop("notes")
    assert YAML(typ="safe").load(text) == made
    assert all(f"# {note}".rstrip() in text for note in notes)


def simulated_restitution(damping_s_m: float, speed_m_s: float) -> float:
    """Of F = k x (1 + d x'), integrated; k over m is 1e6 /s²."""

    def slope(_: float, state: np.ndarray) -> list[float]:
        depth, speed = state
        return [speed, -1e6 * depth * (1 + damping_s_m * speed)]

    def is_out(_: float, state: np.ndarray) -> float:
        return state[0]

    is_out.terminal, is_out.direction = True, -1  # type: ignore[attr-defined]
    found = solve_ivp(slope, (0, 1), [0.0, speed_m_s], events=is_out, rtol=1e-9, atol=1e-12)
    return -found.y[1, -1] / speed_m_s


@pytest.mark.parametrize("wanted", [0.1, 0.3, 0.5, 0.75, 0.9, 0.99])
@pytest.mark.parametrize("speed_m_s", [0.5, 4.0])
def test_drakes_dissipation_gives_the_restitution(wanted: float, speed_m_s: float):
    """By the contact's own motion; at other speeds too, the formula is what happens."""
    damping_s_m = dissipation(wanted, speed_m_s)
    assert simulated_restitution(damping_s_m, speed_m_s) == pytest.approx(wanted, abs=1e-4)
    for factor in (0.5, 2.0):
        found = simulated_restitution(damping_s_m, factor * speed_m_s)
        assert restitution(damping_s_m, factor * speed_m_s) == pytest.approx(found, abs=1e-4)


@pytest.mark.parametrize("words", [(), ("--speed", 2.0)])
def test_drakes_file_has_the_restitution_at_its_speed(export: Export, tmp_path: Path, words):
    path = export("drake", ball_tuning(tmp_path / "a.json", 0.7, 0.05, height_m=1.0), *words)
    speed_m_s = words[1] if words else math.sqrt(2 * GRAVITY_M_S2)
    wanted = 0.7 * (speed_m_s / math.sqrt(2 * GRAVITY_M_S2)) ** -0.05
    root = ET.fromstring(path.read_text())
    values = [float(one.text or "nan") for one in root.iter(f"{DRAKE}hunt_crossley_dissipation")]
    assert len(values) == 2
    assert values[0] == values[1]
    assert simulated_restitution(values[0], speed_m_s) == pytest.approx(wanted, abs=1e-4)
    for factor in (0.5, 1.0, 2.0):
        assert f"{simulated_restitution(values[0], factor * speed_m_s):.3f}" in path.read_text()
