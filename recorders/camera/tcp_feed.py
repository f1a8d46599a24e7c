"""Read a camera that sends its video over plain TCP to whoever connects."""

from __future__ import annotations

from recorders.camera.address import host_and_port
from recorders.camera.connection import connect
from recorders.deadline import Deadline
from tunenet_logs.addresses import Address


class TcpFeed:
    """The bytes of one TCP connection.

    Args:
        deadline: of connecting and of all reads.

    Raises:
        UsageError: the address is not just host and port.
        CameraError: nothing answers there.
        TimeoutError: it does not answer in time.
    """

    def __init__(self, address: Address, deadline: Deadline) -> None:
        host, port = host_and_port(address)
        self._socket = connect(host, port, deadline, None)

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        data = bytearray(most)
        return bytes(data[: self._socket.recv_into(data)])

    def close(self) -> None:
        """See `ByteFeed`."""
        self._socket.close()
