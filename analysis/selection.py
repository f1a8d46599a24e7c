"""The part of a recording that a user selects."""

from __future__ import annotations

from tunenet_logs.errors import NotFoundError


def check_start(start_s: float | None, length_s: float) -> None:
    """Refuse a part that begins where nothing was recorded any more.

    Args:
        start_s: where the part begins [s since the first sample]; None for there.
        length_s: from the first sample to the last.

    Raises:
        NotFoundError: it does; the message states the length.
    """
    if start_s is not None and start_s > length_s:
        raise NotFoundError(
            f"--start {start_s:g} is past the end: the recording is {length_s:.2f} s long"
        )
