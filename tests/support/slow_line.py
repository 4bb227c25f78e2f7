"""A TCP line to a server on this machine that can be slow, or dead without a word, as a network can."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

from tests.support.server import free_port


class Line:
    """Forwards connections to a port of the loopback, with a delay in each direction.

    Attributes:
        delay: seconds that each piece of data is late.
        port: to connect to.

    Args:
        target: port that it leads to.
    """

    def __init__(self, target: int) -> None:
        self.delay = 0.0
        self.port = free_port()
        self._target = target
        self._whole = threading.Event()
        self._whole.set()
        self._ended = False
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._listener = socket.create_server(("127.0.0.1", self.port))
        threading.Thread(target=self._accept, daemon=True).start()

    def split(self) -> None:
        """Nothing passes from now on, in both directions; nobody is told, and new connections get no answer."""
        self._whole.clear()

    def mend(self, *, forget: bool = True) -> None:
        """Let everything through again.

        Args:
            forget: connections that were open are gone, as where a router has forgotten them; else they go on, with
                all that was sent meanwhile.
        """
        if forget:
            pairs, self._pairs = self._pairs, []
            for pair in pairs:
                _close(*pair)
        self._whole.set()

    def close(self) -> None:
        """End it, and all connections."""
        self._ended = True
        _close(self._listener)
        self.mend()

    def _accept(self) -> None:
        while not self._ended:
            try:
                near = self._listener.accept()[0]
            except OSError:
                return
            threading.Thread(target=self._lead, args=(near,), daemon=True).start()

    def _lead(self, near: socket.socket) -> None:
        self._whole.wait()
        try:
            far = socket.create_connection(("127.0.0.1", self._target), timeout=10)
        except OSError:
            _close(near)
            return
        far.settimeout(None)
        self._pairs.append((near, far))
        for source, target in ((near, far), (far, near)):
            threading.Thread(target=self._forward, args=(source, target), daemon=True).start()

    def _forward(self, source: socket.socket, target: socket.socket) -> None:
        try:
            while data := source.recv(1 << 16):
                time.sleep(self.delay)
                self._whole.wait()
                target.sendall(data)
        except OSError:
            pass
        self._whole.wait()  # the end of a connection does not pass either
        _close(source, target)


def _close(*ends: socket.socket) -> None:
    for end in ends:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()
