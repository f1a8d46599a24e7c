"""Libraries that only training, reports and the experiments need."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from tunenet_logs.errors import UsageError


def needed(module: str, extra: str = "eval") -> ModuleType:
    """An optional library, imported.

    Args:
        module: its name, with dots where a part of it is meant ("sklearn.gaussian_process").
        extra: of this project, which brings it.

    Raises:
        UsageError: it is not installed; says how to install it.
    """
    top = module.split(".", maxsplit=1)[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != top:
            raise  # it is there, and lacks something of its own
        raise UsageError(f"{top} is not installed; pip install 'tunenet-logs[{extra}]'") from error
