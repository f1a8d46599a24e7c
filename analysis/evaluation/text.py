"""Format errors, seeds and rows for the tables of all experiments."""

from __future__ import annotations

from collections.abc import Sequence

NEGLIGIBLE = 1e-9  # an error below this is rounding of float64, and is written as none
_FOUR_DIGITS_FROM = 0.00095
# Of the fourth and the fifth decimal place: what would not keep two digits is written otherwise
# (0.000949 rounds to .00095, 0.0000949 to 9.5e-5).
_SCIENTIFIC_BELOW = 0.000095


def short(error: float) -> str:
    """Format an error in at most 6 characters: four decimals, or two digits if it is less."""
    if error < NEGLIGIBLE:
        return "<1e-9"
    if error < _SCIENTIFIC_BELOW:
        return f"{error:.1e}".replace("e-0", "e-")
    return f"{error:.{4 if error >= _FOUR_DIGITS_FROM else 5}f}".removeprefix("0")


def short_or_dash(error: float | None) -> str:
    """Format by `short`; a dash where there is none."""
    return "-" if error is None else short(error)


def seeds_in_words(seeds: Sequence[int]) -> str:
    """Describe seeds, as "seed 1" or "seeds 1 to 3"."""
    return f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"


def table_line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Left-align columns to these widths [characters]; widths beyond the cells are not used."""
    fitted = [cell.ljust(width) for cell, width in zip(cells, widths, strict=False)]
    return "".join(fitted).rstrip()
