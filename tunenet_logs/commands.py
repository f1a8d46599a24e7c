"""Entry points of this package's commands, which run before anything else is imported."""

from tunenet_logs.starting import start


def logs() -> int:
    """Run `tunenet-logs`."""
    return start("tunenet-logs", "tunenet_logs.cli")
