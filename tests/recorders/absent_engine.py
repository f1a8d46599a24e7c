"""An engine whose library is not there."""

from recorders.simulators.installed import named_version

name = named_version("absent")
