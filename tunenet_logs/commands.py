"""Entry points of the commands, which run before anything else is imported."""

from __future__ import annotations

from tunenet_logs.process import start


def tune() -> int:
    """Start `tunenet-tune`."""
    return start("tunenet-tune", "tunenet_logs.analysis.cli.tune")


def review() -> int:
    """Start `tunenet-review`."""
    return start("tunenet-review", "tunenet_logs.analysis.cli.review")


def train() -> int:
    """Start `tunenet-train`."""
    return start("tunenet-train", "tunenet_logs.analysis.cli.train")


def plan() -> int:
    """Start `tunenet-plan`."""
    return start("tunenet-plan", "tunenet_logs.analysis.cli.plan")


def evaluate() -> int:
    """Start `tunenet-eval`."""
    return start("tunenet-eval", "tunenet_logs.analysis.evaluation.cli")


def export() -> int:
    """Start `tunenet-export`."""
    return start("tunenet-export", "tunenet_logs.analysis.cli.export")


def compare() -> int:
    """Start `tunenet-compare`."""
    return start("tunenet-compare", "tunenet_logs.analysis.cli.compare")


def report() -> int:
    """Start `tunenet-report`."""
    return start("tunenet-report", "tunenet_logs.analysis.cli.report")


def record() -> int:
    """Start `tunenet-record`."""
    return start("tunenet-record", "tunenet_logs.recorders.cli")


def logs() -> int:
    """Run `tunenet-logs`."""
    return start("tunenet-logs", "tunenet_logs.cli")
