"""The errors that users see: each names the file or value, what is wrong, and the remedy."""


class TuneNetError(Exception):
    """Root of every error this project raises on purpose; shown as one line, without traceback."""

    exit_code = 1


class UsageError(TuneNetError):
    """A value that was asked for makes no sense (exit code 2)."""

    exit_code = 2


class LogError(TuneNetError):
    """A log that cannot be read or written."""


class CameraError(TuneNetError):
    """A camera or video that cannot be recorded."""


class CameraAwayError(CameraError):
    """A network camera that is not there, or not yet: asked again, it may be."""


class TopicError(TuneNetError):
    """A live topic that cannot be recorded."""


class WeightsError(TuneNetError):
    """Network weights that are damaged, or meant for something else."""


class NotFoundError(TuneNetError):
    """A recording that does not show the experiment; the message is the reason to report."""
