"""Digest of all that decides a log's result, to tell whether two runs tune alike."""

from __future__ import annotations

import hashlib
import os
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from analysis.result_files import log_sha256
from analysis.selection import Options
from recorders.simulators.engines import ENGINE_VARIABLE
from tunenet_logs.episode import Episode

_DIGITS = 16


def options_digest(options: Options) -> str:
    """Hash the options, the contents of the files they name, the engine and our version."""
    known = hashlib.sha256()
    engine = os.environ.get(ENGINE_VARIABLE, "")
    known.update(f"{version('tunenet-logs')} {engine}\n".encode())
    _add(known, options)
    return known.hexdigest()[:_DIGITS]


def _add(known: Any, value: Any) -> None:
    if isinstance(value, Path):
        try:
            known.update(log_sha256(value).encode())
        except OSError:  # every log will be rejected for it
            known.update(str(value).encode(errors="replace"))
    elif isinstance(value, np.ndarray):
        known.update(f"{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, Episode):
        for field in fields(value):
            known.update(field.name.encode())
            _add(known, getattr(value, field.name))
    elif isinstance(value, tuple | list):
        known.update(f"({len(value)}".encode())
        for one in value:
            _add(known, one)
    elif isinstance(value, dict):
        for name in sorted(value):
            known.update(str(name).encode())
            _add(known, value[name])
    else:
        known.update(f"{value!r};".encode())
