"""Entry points of the commands, free of heavy imports."""

from tunenet_logs.starting import start


def tune() -> int:
    """Start `tunenet-tune`."""
    return start("tunenet-tune", "analysis.cli.tune")


def review() -> int:
    """Start `tunenet-review`."""
    return start("tunenet-review", "analysis.cli.review")


def train() -> int:
    """Start `tunenet-train`."""
    return start("tunenet-train", "analysis.cli.train")


def plan() -> int:
    """Start `tunenet-plan`."""
    return start("tunenet-plan", "analysis.cli.plan")


def evaluate() -> int:
    """Start `tunenet-eval`."""
    return start("tunenet-eval", "analysis.evaluation.cli")


def export() -> int:
    """Start `tunenet-export`."""
    return start("tunenet-export", "analysis.cli.export")


def compare() -> int:
    """Start `tunenet-compare`."""
    return start("tunenet-compare", "analysis.cli.compare")


def report() -> int:
    """Start `tunenet-report`."""
    return start("tunenet-report", "analysis.cli.report")
