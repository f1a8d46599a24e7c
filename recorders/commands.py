"""Console entry points, which run before anything else is imported."""

from tunenet_logs.starting import start


def record() -> int:
    """Start `tunenet-record`."""
    return start("tunenet-record", "recorders.cli")
