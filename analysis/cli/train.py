"""tunenet-train: simulate the data set, and train the network on it."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tunenet_logs.analysis.options import TuneOptions, jobs_option, ray_option
from tunenet_logs.analysis.registry import EXPERIMENTS, experiment_named, needed
from tunenet_logs.console import Parser, add_options, run, whole
from tunenet_logs.errors import UsageError, WeightsError, pip_install
from tunenet_logs.recorders.simulators.known import engine_option, in_engine
from tunenet_logs.terminal import Progress, one_line

_DESCRIPTION = f"""\
Simulate pairs of episodes on all cores, train the network on them, and write its
weights (safetensors, with what they are for inside). The weights that the package
ships were written by this command, with its defaults.

Needs the libraries of the extra 'train': {pip_install("train")}."""

_EXAMPLES = """\
  tunenet-train drop -o drop.safetensors
  tunenet-train drop-video -o film.safetensors       (a minute on two cores)
  tunenet-train payload -o payload.safetensors
  tunenet-train drop --preset paper-code --seed 3 -o paper-code-3.safetensors
  tunenet-train drop --ray 10.0.0.5:6379 -o drop.safetensors   (extra 'cluster')
  tunenet-tune drop.mcap --weights drop.safetensors"""

_HELD_OUT = 100  # fresh pairs, on which the error is measured


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser("tunenet-train", _DESCRIPTION, _EXAMPLES, failed="no weights were written")
    add = parser.add_argument
    add("task", choices=EXPERIMENTS, help="what to learn to tune")
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="weights to write (default: TASK-PRESET.safetensors here)",
    )
    add_options(TuneOptions, lambda _: parser, ["preset"])
    parser.set_defaults(preset="default")
    engine_option(parser)
    add(
        "--pairs",
        type=whole(10, 10_000_000),
        metavar="N",
        help="training pairs (default: 51200, payload 15360; paper's presets: 800, payload 1000)",
    )
    add(
        "--epochs",
        type=whole(1, 1_000_000),
        metavar="N",
        help="passes over them (default: 20, payload 40; paper's presets: 200, payload 1000)",
    )
    add(
        "--seed",
        type=whole(0, 2**32 - 1),
        default=0,
        metavar="N",
        help="for data and training (default: 0)",
    )
    jobs_option(parser, "processes that simulate")
    ray_option(parser, "simulate")
    add("--overwrite", action="store_true", help="replace existing weights")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-train`."""
    return run(build_parser(), in_engine(_train), argv)


def _train(arguments: argparse.Namespace) -> int:
    path = arguments.output or Path(f"{arguments.task}-{arguments.preset}.safetensors")
    if not path.parent.is_dir():
        raise WeightsError(f"{path.parent}: no such folder; create it, or choose another with -o")

    from tunenet_logs.analysis.tunenet.weights import save_model, weights_place

    if why := weights_place(path).why_not():
        raise WeightsError(why)
    if path.exists() and not arguments.overwrite:
        raise WeightsError(f"{path}: exists; choose another name with -o, or pass --overwrite")
    needed("torch", extra="train")  # loading it is start-up, not training

    from tunenet_logs.analysis.parallel import Cluster
    from tunenet_logs.analysis.tunenet.network import one_step_error, train
    from tunenet_logs.recorders.simulators.known import engine

    presets = experiment_named(arguments.task).presets
    if arguments.preset not in presets:
        known = ", ".join(presets)
        raise UsageError(f"{arguments.task} has no preset {arguments.preset!r}; there is: {known}")
    training = presets[arguments.preset].training
    if training is None:
        raise UsageError(f"{arguments.task} has no network under the preset {arguments.preset}")
    progress = Progress(quiet=arguments.quiet)
    start = time.perf_counter()
    here = arguments.ray is None
    workers = arguments.jobs if here else Cluster(arguments.ray, arguments.jobs)
    pairs = training.make_pairs(arguments.pairs, arguments.seed, workers, progress)
    simulated = time.perf_counter()
    recipe = training.recipe
    if arguments.epochs is not None:
        recipe = replace(recipe, epochs=arguments.epochs)
    model = train(training.network, pairs, recipe, arguments.seed, progress)
    trained = time.perf_counter()
    notes = {
        "seed": str(arguments.seed),
        "pairs": str(len(pairs.proposed)),
        "recipe": str(recipe),
        "engine": engine().name,
    }
    digest = save_model(path, model, training.purpose, notes)
    print(
        f"{one_line(path)}: {len(pairs.values)} rollouts by {notes['engine']} in "
        f"{simulated - start:.1f} s, "
        f"{len(pairs.proposed)} pairs x {recipe.epochs} epochs in {trained - simulated:.1f} s, "
        f"{trained - start:.1f} s in all; sha256 {digest}"
    )
    few = arguments.jobs if here else 1  # a cluster takes longer to begin
    held_out = training.make_pairs(_HELD_OUT, arguments.seed + 1_000_003, few, progress)
    error = one_step_error(model, held_out)
    print(f"one step on {_HELD_OUT} fresh pairs: mean absolute error {error:.5f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
