"""Look up by name what simulations take: common balls with their air drag, and physics engines."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib import import_module
from importlib.util import find_spec
from math import inf, isfinite, pi
from typing import TYPE_CHECKING, cast

from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from tunenet_logs.episode import EpisodeInfo
    from tunenet_logs.recorders.simulators.base import BallWorld, ContactSettings, Engine


AIR_KG_M3 = 1.2  # density of air at 20 degrees Celsius and sea level


@dataclass(frozen=True)
class Ball:
    """Known properties of a ball.

    Attributes:
        diameter_m: None if unknown.
        mass_kg: None if unknown.
        drag_coefficient: Cd at the speeds of a drop from a table's height.

    Raises:
        UsageError: a size or mass that no ball has, or one lighter than air.
    """

    diameter_m: float | None = None
    mass_kg: float | None = None
    drag_coefficient: float = 0.47

    def __post_init__(self) -> None:
        for what, value, unit in (
            ("diameter", self.diameter_m, " m"),
            ("mass", self.mass_kg, " kg"),
            ("drag coefficient", self.drag_coefficient, ""),
        ):
            if value is not None and not (isfinite(value) and value > 0):
                raise UsageError(f"a ball's {what} is over 0, not {value:g}{unit}")
        if None not in (self.diameter_m, self.mass_kg) and (self.density_kg_m3 or 0.0) <= AIR_KG_M3:
            raise UsageError(
                f"a ball of {self.diameter_m:g} m and {self.mass_kg:g} kg is lighter than the air "
                "in its place; give its diameter in m and its mass in kg"
            )

    @property
    def words(self) -> str:
        """Known size and mass, in words."""
        size = "" if self.diameter_m is None else f"{1000 * self.diameter_m:.3g} mm"
        mass = "" if self.mass_kg is None else f"{1000 * self.mass_kg:.3g} g"
        return ", ".join(known for known in (size, mass) if known) or "unknown"

    @property
    def density_kg_m3(self) -> float | None:
        """Mean density [kg/m³]; None where mass or size is unknown."""
        if self.diameter_m is None or self.mass_kg is None:
            return None
        return self.mass_kg / (pi / 6 * self.diameter_m**3)

    @property
    def is_denser_than_metal(self) -> bool:
        """Whether no ball is so dense: its mass is likely given in grams."""
        return (self.density_kg_m3 or 0.0) > 22_590.0  # osmium, the densest metal

    @property
    def drag_1_m(self) -> float | None:
        """Quadratic drag, deceleration over speed squared [1/m]; None where unknown."""
        if self.diameter_m is None or self.mass_kg is None:
            return None
        area_m2 = pi / 4 * self.diameter_m**2
        return AIR_KG_M3 * self.drag_coefficient * area_m2 / (2 * self.mass_kg)


UNKNOWN_BALL = Ball()  # any ball: nothing is known of it

# Size and mass: the middle of what the sport's rules allow. Cd: of a smooth sphere at the Reynolds
# numbers of a drop, 1e4 to 1e5 (Achenbach 1972), where nothing else is named.
BALLS: Mapping[str, Ball] = {
    # ITTF, law 2.3: 40 mm, 2.7 g.
    "table-tennis": Ball(0.040, 0.0027),
    # ITF, rule 3: 6.54 to 6.86 cm, 56.0 to 59.4 g. Cd .51 in flight (Cross and Lindsey 2013), .6 in
    # wind tunnels (Mehta, Alam and Subic 2008): the nap drags.
    "tennis": Ball(0.067, 0.0577, 0.55),
    # World Squash, appendix 7: 40.0 +- 0.5 mm, 24 +- 1 g.
    "squash": Ball(0.040, 0.024),
    # R&A and USGA, equipment rules: at least 42.67 mm, at most 45.93 g. Cd .5 below a Reynolds
    # number of 4e4, where its dimples do not help yet (Bearman and Harvey 1976).
    "golf": Ball(0.0427, 0.0459, 0.5),
    # USA Racquetball, rule 2.2: 2 1/4 in, 1.4 oz.
    "racquetball": Ball(0.0572, 0.0397),
    # FIBA, size 7: 75 to 77 cm around, 580 to 620 g.
    "basketball": Ball(0.242, 0.600),
}
"""Common balls by name."""


def ball_named(name: str) -> Ball:
    """Look up a ball of the table."""
    known = name.strip().lower().replace(" ", "-").replace("_", "-")
    if known not in BALLS:
        raise UsageError(f"no ball {name!r} is known; there is: {', '.join(BALLS)}")
    return BALLS[known]


def recorded_ball(info: EpisodeInfo) -> Ball:
    """Return the ball as a log specifies it; impossible values count as unknown."""
    known = BALLS.get(info.notes.get("ball", ""), UNKNOWN_BALL)
    said = {field: info.rig.get(f"ball_{field}", 0.0) for field in ("diameter_m", "mass_kg")}
    try:
        return replace(known, **{field: one for field, one in said.items() if 0 < one < inf})
    except UsageError:
        return UNKNOWN_BALL


def contradict(given: Ball, recorded: Ball) -> bool:
    """Return whether the user's and the log's diameter or mass differ by over a fifth."""
    # Balls of a kind differ by a few percent.
    pairs = ((given.diameter_m, recorded.diameter_m), (given.mass_kg, recorded.mass_kg))
    return any(user and log and max(user, log) > 1.2 * min(user, log) for user, log in pairs)


def completed(given: Ball, recorded: Ball) -> Ball:
    """Complete the user's ball by what only the log specifies: the user may know better."""
    if given == UNKNOWN_BALL:
        return recorded
    missing = {
        field: getattr(recorded, field)
        for field in ("diameter_m", "mass_kg")
        if getattr(given, field) is None
    }
    try:
        return replace(given, **missing)
    except UsageError:
        return given


# ---- Physics engines: selected by name

# Modules by the engine's name, which is its library's too; each has what `Engine` names, and is
# imported when needed. The first that is installed is the default.
ENGINES = {
    "pybullet": "tunenet_logs.recorders.simulators.pybullet",
    "mujoco": "tunenet_logs.recorders.simulators.mujoco",
}

# Environment variable: the engine that `simulated_by` chose, for this process and its children.
ENGINE_VARIABLE = "TUNENET_ENGINE"


def engine(name: str | None = None) -> Engine:
    """Import an engine when first needed."""
    wanted = name or os.environ.get(ENGINE_VARIABLE)
    if wanted is not None and wanted not in ENGINES:
        raise UsageError(f"no engine is named {wanted!r}; there is: {', '.join(ENGINES)}")
    for known in ENGINES if wanted is None else (wanted,):
        try:
            return cast("Engine", import_module(ENGINES[known]))
        except ModuleNotFoundError as error:
            if error.name != known:
                raise
    raise UsageError(
        f"{wanted or 'an engine'} is not installed; pip install {wanted or 'mujoco'} (PyBullet has "
        "wheels for CPython 3.11 on Linux x86-64 alone, MuJoCo for all)"
    )


@lru_cache(maxsize=4)
def ball_world(simulates: Engine, radius_m: float, contact: ContactSettings) -> BallWorld:
    """Return a ball over a plane in an engine; the last few worlds are cached.

    A world costs more than many rollouts, and nothing of one remains in the next.
    """
    return simulates.ball_world(radius_m, contact)


@contextmanager
def simulated_by(name: str | None) -> Iterator[None]:
    """Choose the engine within a block, also for processes started in it; None keeps the choice."""
    before = os.environ.get(ENGINE_VARIABLE)
    if name is not None:
        engine(name)
        os.environ[ENGINE_VARIABLE] = name
    try:
        yield
    finally:
        os.environ.pop(ENGINE_VARIABLE, None)
        if before is not None:
            os.environ[ENGINE_VARIABLE] = before


@cache
def named_version(module: str, *packages: str) -> str:
    """Return a module's name with its version, as a log states it: "mujoco 4.0.0"."""
    from importlib.metadata import PackageNotFoundError, version

    if find_spec(module) is None:
        raise ModuleNotFoundError(f"{module} is not installed", name=module)
    for package in (module, *packages):
        try:
            return f"{module} {version(package)}"
        except PackageNotFoundError:
            continue
    return f"{module} of unknown version"


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
