"""Arm card: what runs of an arm identified of its own terms, as a prior for later logs of that arm.

Friction, offsets, links, tilt, encoder zeros, rotors and hoses are the arm's, independent of
payload and motion. The runs' information is linear and Gaussian about the estimate, so a precision
matrix and a vector hold all of it (`PayloadFit.learnt`).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tunenet_logs.analysis.payload.arm_log import check_joints
from tunenet_logs.analysis.payload.noise import NormalEquations
from tunenet_logs.analysis.payload.torque_model import arm_terms
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError, NotFoundError, UsageError
from tunenet_logs.files import parse_json, read_small_file
from tunenet_logs.recorders.simulators.arm.description import Arm
from tunenet_logs.terminal import one_line, short_name

_KIND, _VERSION = "tunenet-logs arm card", 1
# Of a file: that of an arm with as many joints as any may have, and half as much again.
MAX_CARD_BYTES = 16_000_000
# In a card, and in a name in it. An arm of 32 joints has 1026 terms.
_MAX_RUNS, _MAX_TERMS, _MAX_CHARACTERS = 1000, 1200, 500
_MAX = 1e15  # of a number: what the best sensor says of the largest arm in a day is less
_REMEDY = "give the file that tunenet-tune --save-arm-card wrote, or write it anew"


@dataclass(frozen=True, eq=False)
class ArmCard:
    """What runs of one arm identified of it."""

    arm_sha256: str  # of the arm's description, a URDF (`Arm.urdf`)
    joints: tuple[str, ...]  # names in its logs, from base to tool
    runs: tuple[Mapping[str, str], ...]  # "log" (a name) and "sha256" of each run that it is from
    terms: tuple[str, ...]  # names of the arm's own terms, of which there are K
    learnt: NormalEquations  # normal equations of these terms, shapes (K, K) and (K,)
    file: str = ""  # its name; "" if it was not read from a file

    @property
    def sha256s(self) -> frozenset[str]:
        """SHA-256 of its runs."""
        return frozenset(run["sha256"] for run in self.runs)

    def check_arm(self, arm: Arm, joints: tuple[str, ...]) -> None:
        """Refuse another arm than the card's, by description and joint names."""
        place = f"--arm-card {self.file}"
        if len(joints) != len(self.joints):
            raise NotFoundError(
                f"{place}: is of an arm with {len(self.joints)} joints, not {len(joints)}; give "
                "the card of this arm"
            )
        try:
            check_joints(self.joints, joints)
        except NotFoundError as error:
            raise NotFoundError(
                f"{place}: {error.what}", f"{error.remedy}, or give that arm's card"
            ) from error
        if arm_sha256(arm) != self.arm_sha256 or arm_terms(arm) != self.terms:
            raise NotFoundError(
                f"{place}: is of another arm, or of another description of it; give the card of "
                "this arm, or the --arm or --urdf that the card was made with"
            )

    def check_new(self, path: Path, sha256: str) -> None:
        """Refuse a run that the card is from already: it would count twice."""
        for run in self.runs:
            if sha256 and run["sha256"] == sha256:
                raise UsageError(
                    f"{path}: is in the card {self.file} already, as {run['log']}, and would count "
                    "twice; leave it out, or leave --arm-card out"
                )


def arm_sha256(arm: Arm) -> str:
    """Hash the arm's description; the tool frame is no part of it."""
    return hashlib.sha256(arm.urdf().encode()).hexdigest()


def card_text(card: ArmCard) -> str:
    """Format a card as JSON."""
    rows, columns = np.tril_indices(len(card.terms))
    fields = {
        "kind": _KIND,
        "version": _VERSION,
        "arm_sha256": card.arm_sha256,
        "joints": card.joints,
        "runs": [dict(run) for run in card.runs],
        "terms": card.terms,
        "precision": card.learnt.precision[rows, columns].tolist(),
        "gradient": card.learnt.gradient.tolist(),
    }
    lines = (f" {json.dumps(name)}: {json.dumps(value)}" for name, value in fields.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def read_arm_card(path: Path) -> ArmCard:
    """Read a card."""
    try:
        return card_in(read_small_file(path, MAX_CARD_BYTES), path.name)
    except LogError as error:
        raise UsageError(f"{error}; {_REMEDY}") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); {_REMEDY}") from error
    except ValueError as error:
        why = one_line(short_name(error, 200))
        raise UsageError(f"{path}: is no card of an arm ({why}); {_REMEDY}") from error


def card_in(data: bytes, file: str) -> ArmCard:
    """Parse a card from a file's bytes; `file` is its name."""
    fields = parse_json(data)
    if not isinstance(fields, dict) or fields.get("kind") != _KIND:
        raise ValueError("another JSON")
    if fields.get("version") != _VERSION:
        raise ValueError(f"version {short_name(fields.get('version'))}, not {_VERSION}")
    terms, joints = _texts(fields, "terms"), _texts(fields, "joints")
    if not joints or len(terms) > _MAX_TERMS:
        raise ValueError(f"{len(joints)} joints with {len(terms)} terms")
    count = len(terms)
    lower = _numbers(fields, "precision", count * (count + 1) // 2)
    precision = np.zeros((count, count))
    precision[np.tril_indices(count)] = lower
    precision += np.tril(precision, -1).T
    # Project a precision, shape (K, K), onto semidefinite matrices to undo rounding.
    diagonal = np.diag(precision)
    shown = diagonal > 0
    if diagonal.min() < 0 or np.any(precision[~shown]):
        raise ValueError("precision is no sum of squares")
    root = np.sqrt(np.where(shown, diagonal, 1.0))
    values, axes = np.linalg.eigh(precision / root[:, None] / root)
    if values[0] < -1e-6 * values[-1]:  # by the largest, where variances are 1
        raise ValueError("precision is no sum of squares")
    whole = np.outer(root * shown, root * shown) * ((axes * np.maximum(values, 0.0)) @ axes.T)
    learnt = NormalEquations(whole, _numbers(fields, "gradient", count))
    runs = fields.get("runs")
    if not isinstance(runs, list) or not 1 <= len(runs) <= _MAX_RUNS:
        raise ValueError(f"runs are no list of 1 to {_MAX_RUNS}")
    for run in runs:
        if not isinstance(run, dict) or run.keys() != {"log", "sha256"}:
            raise ValueError(f"{short_name(run)} is no run with log and sha256")
    told = tuple({name: _text(run[name]) for name in ("log", "sha256")} for run in runs)
    return ArmCard(_text(fields.get("arm_sha256")), joints, told, terms, learnt, file)


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > _MAX_CHARACTERS:
        raise ValueError(f"{short_name(value)} is no short text")
    return value


def _texts(fields: Mapping[str, Any], name: str) -> tuple[str, ...]:
    values = fields.get(name)
    if not isinstance(values, list):
        raise ValueError(f"{name} are no list")
    return tuple(map(_text, values))


def _numbers(fields: Mapping[str, Any], name: str, count: int) -> Array:
    """Shape (count,)."""
    values = fields.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise ValueError(f"{name} is no list of {count} numbers")
    for value in values:
        if type(value) not in (int, float) or not math.fabs(value) <= _MAX:
            raise ValueError(f"{short_name(value)} in {name} is no number up to {_MAX:g}")
    return np.array(values, dtype=np.float64)
