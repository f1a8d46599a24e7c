"""Where the commands of this package begin, before anything else is imported."""

from tunenet_logs.starting import start


def record() -> int:
    """`tunenet-record`."""
    return start("tunenet-record", "recorders.cli")
