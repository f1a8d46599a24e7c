"""Write the sample logs of machines and their owners' models again.

`python -m analysis.evaluation.sysid.samples` writes `sample_logs/models`, the same bytes each time.
"""

from __future__ import annotations

from pathlib import Path

from analysis.api import save_episode
from analysis.evaluation.sysid.targets import MACHINES

SEEDS = {"pendulum": 3, "arm": 5, "block": 2}


def write_samples(folder: Path) -> None:
    """Write a log, a model and what is tuned of it, for each machine."""
    folder.mkdir(parents=True, exist_ok=True)
    for machine in MACHINES:
        log = machine.log(SEEDS[machine.name], 1.0)
        save_episode(log.episode, folder / f"{machine.name}.mcap", overwrite=True)
        (folder / f"{machine.name}.xml").write_text(log.model)
        lines = [_line(text) for text in log.tune]
        (folder / f"{machine.name}.yaml").write_text("".join(lines))


def _line(text: str) -> str:
    address, _, ends = text.partition("=")
    low, _, high = ends.partition(":")
    return f"{address}: [{low}, {high}]\n"


if __name__ == "__main__":
    write_samples(Path("sample_logs/models"))
