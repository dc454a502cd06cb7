"""The connections to the page's server: a bounded number, of which idle ones end."""

import asyncio
import socket
import time

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

# Maximum number of connections, and the largest share of the descriptors that the process may open:
# programs, recordings and links need theirs.
_MAX_CONNECTIONS, _SHARE = 60, 4
# A connection without a request, or whose client takes nothing, ends after `IDLE_S` seconds.
IDLE_S, _LOOK_S = 5.0, 0.5
# Pause (s) after each connection: a flood of connections must leave the processor to the model.
_PAUSE_S = 0.02


class Connections:
    """Accepts connections for a server.

    At the maximum number of connections, a new one takes the place of the one that has been idle
    for longest. Others wait in the system's queue, without a descriptor of this process.

    Parameters
    ----------
    listener : socket
        The listening socket, closed at the end.
    server : uvicorn.Server
        The server, which serves no socket of its own.
    """

    def __init__(self, listener: socket.socket, server: uvicorn.Server) -> None:
        self._listener, self._server = listener, server
        self._most = min(_MAX_CONNECTIONS, _max_descriptors() // _SHARE)
        # Connection -> since when it has been idle, and the bytes that its client has not taken.
        self._idle: dict[H11Protocol, tuple[float, int]] = {}

    async def serve(self) -> None:
        """Serve until the server ends."""
        self._listener.setblocking(False)
        tasks = [asyncio.create_task(self._accept()), asyncio.create_task(self._end_idle())]
        try:
            await self._server.serve([])
        finally:
            for task in tasks:
                task.cancel()
            self._listener.close()

    async def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        while not self._server.should_exit:
            try:
                client, _ = await loop.sock_accept(self._listener)
            except OSError as error:  # such as: no descriptor is left
                context = {"message": "Accepting failed.", "exception": error}
                loop.call_exception_handler(context)
                await asyncio.sleep(_LOOK_S)
                continue
            self._look()
            if len(self._idle) >= self._most:
                min(self._idle, key=lambda one: self._idle[one][0]).transport.abort()
            await loop.connect_accepted_socket(self._protocol, client)
            await asyncio.sleep(_PAUSE_S)

    def _protocol(self) -> asyncio.Protocol:
        state = self._server.server_state
        return H11Protocol(self._server.config, server_state=state, app_state={})

    async def _end_idle(self) -> None:
        while True:
            self._look()
            for one, (since_s, _) in self._idle.items():
                if time.monotonic() - since_s > IDLE_S:
                    one.transport.abort()
            await asyncio.sleep(_LOOK_S)

    def _look(self) -> None:
        """Find out since when each connection has been idle."""
        now_s, before = time.monotonic(), self._idle
        self._idle = {}
        for one in self._server.server_state.connections:
            if not isinstance(one, H11Protocol):
                continue
            since_s, n_before = before.get(one, (now_s, 0))
            n_bytes = one.transport.get_write_buffer_size()
            is_idle = one.cycle is None or (n_bytes > 0 and n_bytes == n_before)
            self._idle[one] = (since_s if is_idle else now_s), n_bytes


def _max_descriptors() -> int:
    """How many descriptors the process may open."""
    try:
        import resource
    except ImportError:  # Windows
        return 1 << 10
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return 1 << 20 if soft == resource.RLIM_INFINITY else soft
