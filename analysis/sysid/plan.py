"""Show how a log would drive a model and be compared with it, before tuning."""

from __future__ import annotations

from pathlib import Path

from analysis.selection import Options
from analysis.sysid.source import part_of
from recorders.simulators.base import Parameter
from tunenet_logs.one_clock import on_one_clock
from tunenet_logs.reader import read_episode


def print_plan(log: Path, options: Options) -> None:
    """Print the plan, a line per signal and parameter.

    Raises:
        TuneNetError: The log cannot be read, or shows nothing of the model.
    """
    assert options.source is not None
    selection = options.selection
    parameters = options.source.parameters
    episode = on_one_clock(read_episode(log, selection.reading))
    connected = options.source.connect(part_of(episode, selection.start_s, selection.end_s))
    print(f"{log}: {connected.target.end_s:.2f} s of {options.source.name}")
    for words in connected.used:
        print(f"  {words}")
    for words in connected.unused:
        print(f"  not used: {words}")
    for words in connected.doubts:
        print(f"  doubtful: {words}")
    for one in parameters:
        low, high = one.training_range
        print(f"  tuned: {one.name} from {one.initial:g} in {low:g} to {high:g}{_unit(one)}")
    for one in connected.simulator.parameters[len(parameters) :]:
        print(f"  begins: {one.name} {one.initial:.4g} ± {one.prior_sd:.2g}{_unit(one)}")


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else f" {parameter.unit}"
