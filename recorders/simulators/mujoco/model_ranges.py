"""Choose a parameter's search range: the user's, or one about the model's value."""

from __future__ import annotations

import math

from recorders.simulators.base import Parameter
from recorders.simulators.mujoco.model_fields import ModelField
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

Limits = tuple[float, float]

_MIN = 1e-9  # of a value whose sign is a law: 0 belongs to neither


def told_range(text: str, low: str, high: str) -> Limits:
    """Parse the user's range.

    Raises:
        UsageError: its ends are no numbers, or not in their order; `text` stands first.
    """
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = math.nan, math.nan
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and ends[0] < ends[1]):
        raise UsageError(f"--tune {short_name(text)}: the range is no LOW:HIGH", "such as =0:5")
    return ends


def usual_range(text: str, field: ModelField, now: float, bounds: Limits) -> Limits:
    """Choose a search range by the model's value `now`.

    Raises:
        UsageError: the value implies no range; `text` stands first.
    """
    if field.usual is not None and field.usual[0] <= now <= field.usual[1]:
        return field.usual
    if not now or not bounds[0] <= now <= bounds[1]:
        raise UsageError(
            f"--tune {short_name(text)}: is {now:g} in the model, which tells no range",
            "add it, such as =0:1",
        )
    ends = (now / 5, now * 5) if now > 0 else (now * 5, now / 5)
    return (max(ends[0], bounds[0]), min(ends[1], bounds[1]))


def one_sided(text: str, laws: tuple[str, str], span: Limits, bounds: Limits) -> Limits:
    """Restrict bounds to the range's side of 0, where the sign selects the law.

    Args:
        text: as the user wrote it.
        laws: the quantity's meaning above 0, and below.
        span: the range.
        bounds: of the value on both sides.

    Raises:
        UsageError: the range reaches 0.
    """
    if span[0] > 0:
        return (_MIN, bounds[1])
    if span[1] < 0:
        return (bounds[0], -_MIN)
    raise UsageError(
        f"--tune {short_name(text)}: above 0 it is {laws[0]}, below 0 {laws[1]}: two laws",
        "choose a range that ends before 0",
    )


def check_inside(text: str, parameter: Parameter) -> None:
    """Check that a search range is within physical bounds.

    Raises:
        UsageError: it reaches beyond them; `text` stands first.
    """
    (low, high), (least, most) = parameter.training_range, parameter.bounds
    if low < least or high > most:
        raise UsageError(
            f"--tune {short_name(text)}: no {parameter.name} is below {least:g} or over {most:g}",
            "choose a range inside",
        )
