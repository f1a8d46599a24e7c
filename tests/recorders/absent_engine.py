"""An engine whose library is not there."""

from tunenet_logs.recorders.simulators.known import named_version

name = named_version("absent")
