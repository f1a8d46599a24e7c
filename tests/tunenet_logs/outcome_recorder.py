"""A recorder of outcomes that may be killed at any moment.

`python -m tests.tunenet_logs.outcome_recorder FOLDER` writes outcomes into FOLDER until it is
killed, and says on stdout how many are written.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tunenet_logs.outcomes import Outcome, write_outcome

NOTE = "what was seen of it, at some length, " * 20


def outcome_of(number: int) -> Outcome:
    """The number-th outcome."""
    return Outcome(
        task="bounce-shot",
        ball="red gel",
        attempt=number,
        success=number % 3 == 0,
        stamp_ns=1_800_000_000_000_000_000 + number * 1_000_003,
        shot_height_m=0.5 + number / 1000,
        miss_m=number / 1e4,
        note=NOTE[:number],
    )


def main() -> None:
    """Write until killed."""
    number = 0
    while True:
        number += 1
        write_outcome(Path(sys.argv[1]), outcome_of(number))
        print(number, flush=True)


if __name__ == "__main__":
    main()
