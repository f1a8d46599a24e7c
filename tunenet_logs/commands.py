"""Entry points of the commands, which run before anything else is imported."""

from __future__ import annotations

import sys
from functools import partial

from tunenet_logs.process import start

_ANALYSIS = "tunenet_logs.analysis"
# Each command's module, and what it does, by its verb after `tunenet`.
VERBS = {
    "record": ("tunenet_logs.recorders.cli", "a drop, an arm or a simulator to an MCAP log"),
    "tune": (f"{_ANALYSIS}.cli.tune", "find the parameters that make a simulator move like a log"),
    "review": (
        f"{_ANALYSIS}.cli.review",
        "a campaign's drops, tunings and outcomes on a timeline",
    ),
    "logs": ("tunenet_logs.cli", "look into logs, check, recover and import them"),
    "export": (f"{_ANALYSIS}.cli.export", "a tuned ball, payload or model as a file"),
    "report": (f"{_ANALYSIS}.cli.report", "tunings as one page, and their curves as CSV"),
    "compare": (f"{_ANALYSIS}.cli.compare", "tunings side by side"),
    "plan": (f"{_ANALYSIS}.cli.plan", "a bounce shot with a tuned ball"),
    "train": (f"{_ANALYSIS}.cli.train", "a network on simulated pairs"),
    "eval": (f"{_ANALYSIS}.evaluation.cli", "the tables of the documents"),
    "docs": ("tunenet_logs.manual", "the documents: a list, a page, or a search"),
}


def _start(verb: str) -> int:
    return start(f"tunenet-{verb}", VERBS[verb][0])


record, tune, review, logs, export, report, compare, plan, train, evaluate, _ = (
    partial(_start, verb) for verb in VERBS
)


def umbrella() -> int:
    """Run `tunenet VERB ...`, which is `tunenet-VERB ...`; list the verbs without one."""
    verb = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if verb in VERBS:
        del sys.argv[1]
        return _start(verb)
    if verb == "--version":
        from tunenet_logs import __version__

        print(f"tunenet {__version__}")
        return 0
    if verb in ("-h", "--help"):
        print("usage: tunenet COMMAND ..., which is tunenet-COMMAND ...\n")
        print("\n".join(f"  {name:9}{does}" for name, (_, does) in VERBS.items()))
        print("\nexamples:\n  tunenet tune drop.mcap\n  tunenet record --camera")
        print("\ntunenet COMMAND --help tells more")
        return 0
    from difflib import get_close_matches

    known = get_close_matches(verb, VERBS, 1)
    meant = f"; did you mean {known[0]}?" if known else ""
    print(f"tunenet: {verb[:40]!a} is no command{meant} (see tunenet --help)", file=sys.stderr)
    return 2
