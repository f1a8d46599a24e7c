"""A relay before a server of this machine that counts what the server sends."""

from __future__ import annotations

import socket
import threading


class CountingRelay:
    """Passes a server's answers on, and counts their bytes."""

    def __init__(self, port: int) -> None:
        self.passed = 0
        self._to = port
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            client, _ = self._socket.accept()
            server = socket.create_connection(("127.0.0.1", self._to))
            for source, target, counts in ((client, server, False), (server, client, True)):
                threading.Thread(
                    target=self._pass, args=(source, target, counts), daemon=True
                ).start()

    def _pass(self, source: socket.socket, target: socket.socket, counts: bool) -> None:
        try:
            while data := source.recv(65536):
                self.passed += len(data) if counts else 0
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)
        except OSError:
            pass
