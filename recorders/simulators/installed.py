"""Look up an engine's installed version without importing it."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec


def named_version(module: str, *packages: str) -> str:
    """Return a module's name with its version, as a log states it: "mujoco 4.0.0".

    Args:
        module: as it is imported.
        packages: other distributions that provide it.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    if find_spec(module) is None:
        raise ModuleNotFoundError(f"{module} is not installed", name=module)
    for package in (module, *packages):
        try:
            return f"{module} {version(package)}"
        except PackageNotFoundError:
            continue
    return f"{module} of unknown version"
