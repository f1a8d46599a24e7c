"""Advise which motion excites a parameter that is unidentifiable from a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tunenet_logs.terminal import listed

_FEW = 3

# By the field's name.
_MOTIONS: Mapping[str, str] = {
    "damping": "move it at several speeds, the fastest ones too",
    "frictionloss": "move it slowly and reverse often",
    "armature": "change its speed fast, as in short swings",
    "stiffness": "move it far to both sides",
    "springref": "let it come to rest with nothing driving it",
    "mass": "lift it and swing it, with the torques or commands recorded",
    "ipos": "turn it about several axes",
    "inertia": "turn it fast about several axes",
    "friction": "let it slide further, or push it along",
    "solref": "let it hit the ground from several heights",
    "solimp": "let it hit the ground from several heights",
    "kp": "command steps as well as slow motions",
    "kv": "command steps as well as slow motions",
    "gear": "command large and small motions",
    "gravity": "hold it in several positions, with the torques recorded",
    "density": "move it fast",
    "viscosity": "move it at several speeds",
    "delay": "command steps and fast changes",
}


def excitation(name: str, partners: Sequence[str]) -> str:
    """Return what to record to make a parameter identifiable, apart from its partners."""
    field = name.partition("/")[0] if name.startswith("delay/") else name.rpartition(".")[2]
    field = field.partition("[")[0]
    motion = _MOTIONS.get(field, "record a motion that it changes")
    if partners:
        return (
            f"measure one of {listed([name, *partners], _FEW)} and leave it out of the tuning, or "
            f"record what drives it; {motion}"
        )
    return motion
