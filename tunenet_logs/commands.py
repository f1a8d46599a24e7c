"""Where the commands of this package begin, before anything else is imported."""

from tunenet_logs.starting import start


def logs() -> int:
    """`tunenet-logs`."""
    return start("tunenet-logs", "tunenet_logs.cli")
