"""A server of Python's own that runs beside a test."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import HTTPServer

# Whether it is to end; the default is half a second, which each test would wait.
_LOOKS_EACH_S = 0.01


@contextmanager
def beside(server: HTTPServer) -> Iterator[str]:
    """Serves, and is closed; its host and port."""
    threading.Thread(target=server.serve_forever, args=(_LOOKS_EACH_S,), daemon=True).start()
    try:
        yield f"127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
