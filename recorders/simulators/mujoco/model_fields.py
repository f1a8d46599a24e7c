"""Tunable fields of a MuJoCo model's elements, by kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

_Limits = tuple[float, float]

_MAX = 1e9  # of any value


@dataclass(frozen=True)
class ModelField:
    """A tunable quantity of one kind of element.

    Attributes:
        array: of the compiled model, by the element's number or that of its first degree of
            freedom.
        unit: of its values, in SI.
        least: smallest value that physics allows.
        size: values of one element; 1 for a scalar.
        by_dof: whether the array is by degree of freedom.
        usual: search range, if the model's value is in it; else a fifth to five times that.
        within: smallest and largest value by index, where they differ.
        laws: by index, the quantity's meaning above 0, and below, where these differ; empty where
            they do not.
    """

    array: str
    unit: str
    least: float = 0.0
    size: int = 1
    by_dof: bool = False
    usual: _Limits | None = None
    within: Mapping[int, tuple[float, float]] = field(
        default_factory=dict[int, tuple[float, float]]
    )
    laws: tuple[tuple[str, str], ...] = ()

    def bounds(self, index: int) -> _Limits:
        """Return the bounds of the value at an index."""
        return self.within.get(index, (max(self.least, -_MAX), _MAX))


_ANY = -math.inf

FIELDS: Mapping[str, Mapping[str, ModelField]] = {
    "joint": {
        "damping": ModelField("dof_damping", "N·m·s/rad", by_dof=True),
        "frictionloss": ModelField("dof_frictionloss", "N·m", by_dof=True),
        "armature": ModelField("dof_armature", "kg·m²", by_dof=True),
        "stiffness": ModelField("jnt_stiffness", "N·m/rad"),
        "springref": ModelField("qpos_spring", "rad", _ANY),
    },
    "body": {
        "mass": ModelField("body_mass", "kg", 1e-6),
        "ipos": ModelField("body_ipos", "m", _ANY, 3),
        "inertia": ModelField("body_inertia", "kg·m²", 1e-9, 3),
    },
    "geom": {
        "friction": ModelField("geom_friction", "1", 0.0, 3, usual=(0.0, 1.5)),
        "solref": ModelField(
            "geom_solref",
            "1",
            _ANY,
            2,
            laws=(("a time constant", "a stiffness"), ("a damping ratio", "a damping")),
        ),
        "solimp": ModelField(
            "geom_solimp",
            "1",
            0.0,
            5,
            within={0: (0.0, 1.0), 1: (0.0, 1.0), 3: (0.0, 1.0), 4: (1.0, 100.0)},
        ),
    },
    "actuator": {
        "kp": ModelField("actuator_gainprm", "1"),
        "kv": ModelField("actuator_biasprm", "1"),
        "gear": ModelField("actuator_gear", "1", _ANY, 6),
    },
    "tendon": {
        "damping": ModelField("tendon_damping", "N·s/m"),
        "frictionloss": ModelField("tendon_frictionloss", "N"),
        "stiffness": ModelField("tendon_stiffness", "N/m"),
    },
    "option": {
        "gravity": ModelField("gravity", "m/s²", _ANY, 3),
        "density": ModelField("density", "kg/m³"),
        "viscosity": ModelField("viscosity", "Pa·s"),
    },
}

# All that a parameter may change in a compiled model.
TUNED_ARRAYS = sorted(
    {
        f"opt.{one.array}" if kind == "option" else one.array
        for kind, fields in FIELDS.items()
        for one in fields.values()
    }
)

# Of a joint that slides, in place of those of one that turns.
SLIDING_UNITS = {
    "N·m·s/rad": "N·s/m",
    "N·m": "N",
    "kg·m²": "kg",
    "N·m/rad": "N/m",
    "rad": "m",
}
