"""The `--engine` option of all commands that simulate."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from recorders.simulators.engines import ENGINES, simulated_by


def engine_option(group: argparse._ActionsContainer) -> argparse.Action:
    """Add `--engine`; None where it is not given."""
    return group.add_argument(
        "--engine",
        choices=ENGINES,
        help="physics engine that simulates (default: pybullet where it is installed, else mujoco)",
    )


def in_engine(body: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    """Wrap a command's body to simulate with the engine of `--engine`."""

    def chosen(arguments: argparse.Namespace) -> int:
        with simulated_by(arguments.engine):
            return body(arguments)

    return chosen
