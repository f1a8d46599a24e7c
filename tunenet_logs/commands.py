"""Entry points of the commands, which run before anything else is imported."""

from __future__ import annotations

from functools import partial

from tunenet_logs.process import start

_ANALYSIS = "tunenet_logs.analysis"
tune = partial(start, "tunenet-tune", f"{_ANALYSIS}.cli.tune")
review = partial(start, "tunenet-review", f"{_ANALYSIS}.cli.review")
train = partial(start, "tunenet-train", f"{_ANALYSIS}.cli.train")
plan = partial(start, "tunenet-plan", f"{_ANALYSIS}.cli.plan")
evaluate = partial(start, "tunenet-eval", f"{_ANALYSIS}.evaluation.cli")
export = partial(start, "tunenet-export", f"{_ANALYSIS}.cli.export")
compare = partial(start, "tunenet-compare", f"{_ANALYSIS}.cli.compare")
report = partial(start, "tunenet-report", f"{_ANALYSIS}.cli.report")
record = partial(start, "tunenet-record", "tunenet_logs.recorders.cli")
logs = partial(start, "tunenet-logs", "tunenet_logs.cli")
