"""The numbers in each file, read back by its language's own parser, are those that were tuned."""

from __future__ import annotations

import ast
import json
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.analysis.export.tunings import ball_tuning, payload_tuning
from tests.conftest import Command
from tunenet_logs.analysis.export.registry import export_format, usual_suffix
from tunenet_logs.recorders.simulators.arm.description import (
    PAYLOAD_RADIUS_M,
    Payload,
    jaco,
    read_arm,
    solid_sphere,
)
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

MASS_KG, COM_M = 0.8, (0.01, -0.02, 0.03)
MOMENT_KG_M2 = 0.4 * MASS_KG * PAYLOAD_RADIUS_M**2


@pytest.fixture
def card(command: Command, tmp_path: Path):
    """Exports a tuning and gives the card back."""

    def make(tuning: Path, *words: object) -> dict[str, Any]:
        path = tmp_path / "card.json"
        result = command("tunenet-export", tuning, "--to", "json", "-o", path, *words)
        assert result.returncode == 0, result.stderr
        return json.loads(path.read_text())

    return make


@pytest.fixture
def ball_file(command: Command, tmp_path: Path):
    """Exports a ball of .7 at 2 m, radius 3 cm and 50 g; no engine runs."""

    def make(engine: str, monkeypatch: pytest.MonkeyPatch) -> Path:
        from tunenet_logs.analysis.export.registry import export_format

        monkeypatch.setattr(export_format(engine), "LIBRARY", None)
        tuning = ball_tuning(tmp_path / "a.json", 0.75, 0.05, 0.1, height_m=2.0, first=0.7)
        words = ("--radius", 0.03, "--mass", 0.05)
        result = command("tunenet-export", tuning, "--to", engine, *words)
        assert result.returncode == 0, result.stderr
        assert "not run" in result.stdout
        (path,) = (one for one in tmp_path.iterdir() if one.suffix not in (".json", ".urdf"))
        return path

    return make


@pytest.fixture
def payload_file(command: Command, tmp_path: Path):
    def make(engine: str) -> Path:
        tuning = payload_tuning(tmp_path / "a.json", MASS_KG, COM_M)
        result = command("tunenet-export", tuning, "--to", engine)
        assert result.returncode == 0, result.stderr
        return tmp_path / f"a{usual_suffix(export_format(engine))}"

    return make


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


def test_the_restitution_is_that_of_the_first_rebound_without_air(card, tmp_path: Path):
    made = card(ball_tuning(tmp_path / "a.json", 0.8, 0.06, 0.11, height_m=1.2, first=0.72))
    assert made["restitution"]["value"] == 0.72
    assert made["tuned"]["restitution"]["value"] == 0.8
    assert made["tuned"]["drag"]["interval95"] == pytest.approx([0.1, 0.12])
    assert made["ball"]["drop_height"] == {
        "value": pytest.approx(1.2),
        "source": "record",
        "unit": "m",
    }
    assert made["equivalent"]["all"]["restitution"] == pytest.approx(0.73)
    assert made["ball"]["friction"] is None


def test_without_equivalents_it_is_the_tuned_one(card, tmp_path: Path):
    made = card(ball_tuning(tmp_path / "a.json", 0.8))
    assert made["restitution"]["value"] == 0.8
    assert made["equivalent"] is None


@pytest.mark.parametrize("speed_m_s", [1.0, 3.0, 8.0])
def test_for_a_speed_it_is_the_tuned_laws(card, tmp_path: Path, speed_m_s: float):
    tuning = ball_tuning(tmp_path / "a.json", 0.8, 0.06, 0.11, height_m=1.2, first=0.72)
    made = card(tuning, "--speed", speed_m_s)
    first_m_s = math.sqrt(2 * GRAVITY_M_S2 * 1.2)
    assert made["restitution"]["value"] == pytest.approx(0.8 * (speed_m_s / first_m_s) ** -0.06)
    assert made["restitution"]["at_speed"] == {
        "value": speed_m_s,
        "source": "option",
        "unit": "m/s",
    }


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


def test_a_log_without_metres_falls_from_an_assumed_height(card, tmp_path: Path):
    bounce = {"restitution": 0.8, "interval95": None, "impact_speed": None}
    found = card(ball_tuning(tmp_path / "a.json", bounces=[bounce]))
    assert found["ball"]["drop_height"] == {"value": 1.0, "source": "assumed", "unit": "m"}
    assert found["law"]["at_speed_m_s"] is None


def test_pybullet(ball_file, monkeypatch: pytest.MonkeyPatch):
    path = ball_file("pybullet", monkeypatch)
    found = constants(path)
    assert (found["RESTITUTION"], found["RADIUS_M"]) == (0.7, 0.03)
    assert found["DROP_HEIGHT_M"] == pytest.approx(2.0)
    assert found["STEP_S"] == 1 / 960
    urdf = ET.fromstring(path.with_suffix(".urdf").read_text())
    assert number(urdf, "link/contact/restitution", "value") == 0.7


def test_urdf(command: Command, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json", 0.7)
    words = ("--radius", 0.03, "--mass", 0.05, "-o", tmp_path / "b.urdf")
    assert command("tunenet-export", tuning, "--to", "urdf", *words).returncode == 0
    robot = ET.fromstring((tmp_path / "b.urdf").read_text())
    assert number(robot, "link/contact/restitution", "value") == 0.7
    assert number(robot, "link/collision/geometry/sphere", "radius") == 0.03
    assert number(robot, "link/inertial/mass", "value") == 0.05
    for name in ("ixx", "iyy", "izz"):
        moment = number(robot, "link/inertial/inertia", name)
        assert moment == pytest.approx(0.4 * 0.05 * 0.03**2)


def test_sdf(ball_file, monkeypatch: pytest.MonkeyPatch):
    root = ET.fromstring(ball_file("sdf", monkeypatch).read_text())
    bounce = "link/collision/surface/bounce"
    models = {model.get("name"): model for model in root.iter("model")}
    assert number(models["ball"], f"{bounce}/restitution_coefficient") == 0.7
    assert number(models["ground"], f"{bounce}/restitution_coefficient") == 1
    assert 0 < number(models["ball"], f"{bounce}/threshold") < 0.1
    assert 0 < number(models["ground"], f"{bounce}/threshold") < 0.1
    assert number(models["ball"], "link/collision/geometry/sphere/radius") == 0.03
    assert number(models["ball"], "link/inertial/mass") == 0.05
    assert float(models["ball"].findtext("pose", "").split()[2]) == pytest.approx(2.03)
    assert number(root, "world/physics/max_step_size") == 0.001


def usd_values(path: Path) -> dict[str, list[float]]:
    """Numbers by the attribute's name."""
    found: dict[str, list[float]] = {}
    for line in path.read_text().split("\n"):
        if match := re.fullmatch(r"\s*(?:uniform )?[\w\[\]]+ ([\w:]+) = (.*)", line):
            found[match[1]] = [float(one) for one in re.findall(r"-?[\d.]+(?:e-?\d+)?", match[2])]
    return found


def test_isaac(ball_file, monkeypatch: pytest.MonkeyPatch):
    path = ball_file("isaac", monkeypatch)
    found = usd_values(path)
    assert found["physics:restitution"] == [0.7]
    assert found["radius"] == [0.03]
    assert found["physics:mass"] == [0.05]
    assert found["physics:diagonalInertia"] == pytest.approx([0.4 * 0.05 * 0.03**2] * 3)
    assert found["xformOp:translate"] == pytest.approx([0, 0, 2.03])
    step_s = 1 / found["physxScene:timeStepsPerSecond"][0]
    assert GRAVITY_M_S2 * step_s < found["physxScene:bounceThreshold"][0] < 0.1
    assert 'physxMaterial:restitutionCombineMode = "max"' in path.read_text()


def test_yaml_and_json_say_the_same(command: Command, card, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json", 0.8, 0.06, 0.11, first=0.72)
    path = tmp_path / "card.yaml"
    assert command("tunenet-export", tuning, "--to", "yaml", "-o", path).returncode == 0
    made = card(tuning)
    notes = made.pop("notes")
    assert YAML(typ="safe").load(path.read_text()) == made
    assert all(f"# {note}".rstrip() in path.read_text() for note in notes)


def test_a_payloads_urdf_is_the_arms_own(payload_file, tmp_path: Path):
    """Copied into an arm's URDF, it is what the tuning's simulator carried."""
    robot = ET.fromstring(payload_file("urdf").read_text())
    link = robot.find("link")
    assert link is not None
    arm, payload = jaco(), Payload(MASS_KG, COM_M)
    whole = ET.fromstring(arm.urdf())
    own = ET.fromstring(arm.urdf(payload))
    joint = next(one for one in own.iter("joint") if one.get("name") == "payload_mount")
    whole.append(link)
    whole.append(joint)
    (tmp_path / "arm.urdf").write_text(ET.tostring(whole, encoding="unicode"))
    (tmp_path / "own.urdf").write_text(ET.tostring(own, encoding="unicode"))
    ours, theirs = (read_arm(tmp_path / name, "payload") for name in ("own.urdf", "arm.urdf"))
    assert theirs.joints[-1].link.mass_kg == ours.joints[-1].link.mass_kg
    assert theirs.joints[-1].link.com_m == pytest.approx(ours.joints[-1].link.com_m)
    assert theirs.joints[-1].link.inertia_kg_m2 == pytest.approx(ours.joints[-1].link.inertia_kg_m2)


def test_a_payload_in_sdf(payload_file):
    inertial = ET.fromstring(payload_file("sdf").read_text()).find("model/link/inertial")
    assert inertial is not None
    assert number(inertial, "mass") == MASS_KG
    assert tuple(map(float, inertial.findtext("pose", "").split()))[:3] == COM_M
    assert number(inertial, "inertia/izz") == pytest.approx(MOMENT_KG_M2)


def test_a_payload_in_usd(payload_file):
    found = usd_values(payload_file("isaac"))
    assert found["physics:mass"] == [MASS_KG]
    assert found["physics:centerOfMass"] == list(COM_M)
    assert found["physics:diagonalInertia"] == pytest.approx([MOMENT_KG_M2] * 3)


def test_a_payload_whose_centre_is_not_told_is_at_the_tool(card, tmp_path: Path):
    made = card(payload_tuning(tmp_path / "a.json", com_m=None))
    assert made["payload"]["com_m"] == [0, 0, 0]
    assert "payload_com" not in made["tuned"]
    assert any("cannot be separated" in note for note in made["notes"])
    weight = solid_sphere(0.8, PAYLOAD_RADIUS_M)
    assert made["payload"]["inertia_kg_m2"]["ixx"] == weight.inertia_kg_m2[0]
