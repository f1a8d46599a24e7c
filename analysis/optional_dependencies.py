"""Import optional libraries, which only training, reports and the experiments need."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from tunenet_logs.errors import UsageError


def needed(module: str, extra: str = "eval") -> ModuleType:
    """Import an optional library, or say how to install it.

    Args:
        module: Its name, with dots for a submodule ("sklearn.gaussian_process").
        extra: Of this project, which installs it.

    Raises:
        UsageError: It is not installed.
    """
    top = module.split(".", maxsplit=1)[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != top:
            raise  # it is there, and lacks something of its own
        raise UsageError(f"{top} is not installed; pip install 'tunenet-logs[{extra}]'") from error
