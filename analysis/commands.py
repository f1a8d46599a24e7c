"""Where the commands of this package begin, before anything else is imported."""

from tunenet_logs.starting import start


def tune() -> int:
    """`tunenet-tune`."""
    return start("tunenet-tune", "analysis.cli.tune")


def review() -> int:
    """`tunenet-review`."""
    return start("tunenet-review", "analysis.cli.review")


def train() -> int:
    """`tunenet-train`."""
    return start("tunenet-train", "analysis.cli.train")


def plan() -> int:
    """`tunenet-plan`."""
    return start("tunenet-plan", "analysis.cli.plan")


def evaluate() -> int:
    """`tunenet-eval`."""
    return start("tunenet-eval", "analysis.evaluation.cli")


def export() -> int:
    """`tunenet-export`."""
    return start("tunenet-export", "analysis.cli.export")


def compare() -> int:
    """`tunenet-compare`."""
    return start("tunenet-compare", "analysis.cli.compare")


def report() -> int:
    """`tunenet-report`."""
    return start("tunenet-report", "analysis.cli.report")
