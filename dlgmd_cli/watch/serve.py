"""The page of `dlgmd live --serve`: the image with G on top, and the running curves."""

import asyncio
import base64
import errno
import hashlib
import ipaddress
import json
import logging
import os
import re
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import AsyncIterator
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dlgmd_cli import Rule
from dlgmd_cli.errors import DlgmdError, MissingExtraError, Once, ParameterError, argument
from dlgmd_cli.machine.threads import started_thread
from dlgmd_cli.parameters.facts import Json, finite
from dlgmd_cli.plots.heat import mark_centroid, tinted
from dlgmd_cli.video.live_source import LiveSource
from dlgmd_cli.watch.statistics import Statistics
from dlgmd_cli.watch.watch import BLIND_WORDS, Answer

try:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.datastructures import MutableHeaders
    from starlette.requests import Request
    from starlette.responses import HTMLResponse, PlainTextResponse, StreamingResponse
    from starlette.routing import Route
    from starlette.types import Message, Receive, Scope, Send

    from dlgmd_cli.watch.connections import Connections
except ImportError as error:
    raise MissingExtraError.of(argument("serve"), error.name) from None

_log = logging.getLogger(__name__)

# Duration (s) that the curves of the page show; periods (s) of images and of new rows.
_HISTORY_S = 30.0
_PICTURE_PERIOD_S, _EVENT_PERIOD_S = 1.0 / 15.0, 0.1
_JPEG_QUALITY = 80
# Size of a client's send buffer in bytes. A larger buffer would make shown images old.
_SEND_BUFFER = 1 << 17
# Maximum number of requests that are answered at once; further clients are told that the server is
# busy.
_MAX_REQUESTS = 48
_CLOSING_S = 0.4
_PICTURE = "/picture"
_HEADERS = {
    "Cache-Control": "no-store",
    "Connection": "close",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class PageServer:
    """Serves the page from its own thread; a context manager.

    The port is bound at once; requests are answered within the context. On other machines, the page
    opens only with the token that is part of `url`. At most 48 requests are answered at once, and
    further ones refused. Connections are bounded, see `Connections`.

    Parameters
    ----------
    host, port : str, int
        Address to listen at; port 0 means any free port.
    source : LiveSource
        The source, which provides images only while someone views them.
    statistics : Statistics
        The statistics of the session, which must get each answer before this page does.
    rule : Rule
        The alarm rule, whose threshold may change.

    Attributes
    ----------
    url : str
        Address of the page.

    Raises
    ------
    ParameterError
        If there is no such host.
    DlgmdError
        If the port cannot be used.
    """

    def __init__(
        self, host: str, port: int, source: LiveSource, statistics: Statistics, rule: Rule
    ) -> None:
        self._source, self._statistics, self._rule = source, statistics, rule
        self._socket = _listening(host, port)
        address, port = self._socket.getsockname()[:2]
        is_local = ipaddress.ip_address(address).is_loopback
        self._token = "" if is_local else secrets.token_urlsafe(16)
        name = host if is_local else _reachable(address, self._socket.family)
        name = f"[{name}]" if ":" in name else name
        self.url = f"http://{name}:{port}/" + (f"?token={self._token}" if self._token else "")
        self._names = {"localhost", "127.0.0.1", "[::1]", name.lower()}

        self._lock, self._is_closing = threading.Lock(), False
        self._rows: deque[tuple[float, str]] = deque()
        self._n_rows, self._n_requests, self._n_watching = 0, 0, 0
        self._newest: Answer | None = None
        self._put_s, self._reason = time.monotonic(), ""
        self._greatest_g = 0.0
        self._jpegs: dict[bool, tuple[Answer, bytes]] = {}

        self._page = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
        self._headers = {**_HEADERS, "Content-Security-Policy": _policy(self._page)}
        shown = {"/": self._show_page, _PICTURE: self._show_picture, "/events": self._show_events}
        self._app = Starlette(routes=[Route(path, show) for path, show in shown.items()])
        config = uvicorn.Config(
            self._guard,
            interface="asgi3",
            http="h11",
            ws="none",
            loop="asyncio",
            lifespan="off",
            timeout_graceful_shutdown=1,
            log_config=None,
            log_level="critical",
            access_log=False,
            proxy_headers=False,
            server_header=False,
        )
        self._server = uvicorn.Server(config)

    def __enter__(self) -> "PageServer":
        self._thread = started_thread(lambda: asyncio.run(self._serve()), "dlgmd-serve")
        return self

    def __exit__(self, *_: object) -> None:
        # The streams end by themselves; clients that do not read are not waited for.
        self._is_closing = self._server.should_exit = True
        self._thread.join(_CLOSING_S)

    async def _serve(self) -> None:
        """Serve until the end; errors of the event loop are logged once per message."""
        logged = Once()

        def log_once(_: object, context: dict[str, Any]) -> None:
            if logged.is_new(context["message"]):
                why = context.get("exception", "")
                message = context["message"].lower().rstrip(".")
                _log.warning("%s: %s (%s)", argument("serve"), message, why)

        asyncio.get_running_loop().set_exception_handler(log_once)
        await Connections(self._socket, self._server).serve()

    def put(self, answer: Answer) -> None:
        """Show an answer; returns at once."""
        self._reason = answer.reason
        if answer.frame is None:
            return
        with self._lock:
            self._rows.append((answer.frame.time_s, answer.to_json()))
            self._n_rows += 1
            while answer.frame.time_s - self._rows[0][0] > _HISTORY_S:
                self._rows.popleft()
        if answer.is_of_frame:
            self._newest, self._put_s = answer, time.monotonic()

    async def _guard(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request if its token or host is valid; count viewers, and add common headers."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        if refusal := self._refusal(Request(scope)):
            await PlainTextResponse(refusal, 403)(scope, receive, send_with_headers)
            return
        if self._n_requests >= _MAX_REQUESTS:
            await PlainTextResponse("Busy.", 503)(scope, receive, send_with_headers)
            return
        is_watching = scope["path"] == _PICTURE
        self._count(1, is_watching)
        try:
            await self._app(scope, receive, send_with_headers)
        finally:
            self._count(-1, -is_watching)

    def _refusal(self, request: Request) -> str:
        """The reason to refuse a request; empty for none."""
        if self._token:
            given = request.query_params.get("token", "").encode()
            is_known = secrets.compare_digest(given, self._token.encode())
            return "" if is_known else "Open the address that 'dlgmd live' printed, with its token."
        # A page of another site whose name resolves to this machine must not read the answers.
        name = re.sub(r":\d+$", "", request.headers.get("host", "")).lower()
        return "" if name in self._names else "This server does not answer to that name."

    def _count(self, n_more: int, n_watching: int) -> None:
        """Change the numbers of requests and of viewers; only the server's thread calls it."""
        self._n_requests += n_more
        self._n_watching += n_watching
        self._source.wants_pictures = self._n_watching > 0

    async def _show_page(self, _: Request) -> HTMLResponse:
        return HTMLResponse(self._page)

    async def _show_picture(self, request: Request) -> StreamingResponse:
        pictures = self._pictures(request.query_params.get("overlay") != "0")
        return StreamingResponse(pictures, media_type="multipart/x-mixed-replace; boundary=frame")

    async def _show_events(self, _: Request) -> StreamingResponse:
        return StreamingResponse(self._events(), media_type="text/event-stream")

    async def _pictures(self, has_overlay: bool) -> AsyncIterator[bytes]:
        """The newest image, repeatedly, as parts of a multipart message."""
        shown = None
        yield b"--frame\r\n"
        while not self._is_closing:
            answer = self._newest
            picture = None if answer is None or answer.frame is None else answer.frame.picture
            if answer is not shown and answer is not None and picture is not None:
                shown, jpeg = answer, self._jpeg(answer, picture, has_overlay)
                # A browser shows a part after receiving the next boundary.
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                yield head.encode() + jpeg + b"\r\n--frame\r\n"
            await asyncio.sleep(_PICTURE_PERIOD_S)

    def _jpeg(self, answer: Answer, image: np.ndarray, has_overlay: bool) -> bytes:
        """The image of an answer, encoded once for all viewers."""
        before = self._jpegs.get(has_overlay)
        if before is not None and before[0] is answer:
            return before[1]
        if has_overlay:
            detection, image = answer.detection, image.copy()
            g = None if detection.layers is None else detection.layers.g
            if g is not None:
                self._greatest_g = max(self._greatest_g, float(np.abs(g).max()))
                image = tinted(image, g, self._greatest_g)
            mark_centroid(image, detection.g_x, detection.g_y)
        _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))
        self._jpegs[has_overlay] = answer, data.tobytes()
        return self._jpegs[has_overlay][1]

    async def _events(self) -> AsyncIterator[str]:
        """State and new rows about ten times per second; the first event has the last seconds.

        The last state says that the stream has ended.
        """
        n_sent, is_last = 0, False
        while not is_last:
            is_last = self._is_closing
            with self._lock:
                n_new = min(self._n_rows - n_sent, len(self._rows))
                first, n_sent = len(self._rows) - n_new, self._n_rows
                rows = [row for _, row in islice(self._rows, first, None)]
            state = json.dumps({"ended": is_last, **self._state()})
            yield f'data: {{"rows": [{", ".join(rows)}], {state[1:]}\n\n'
            await asyncio.sleep(_EVENT_PERIOD_S)

    def _state(self) -> dict[str, Json]:
        """The numbers beside the curves; None where undefined."""
        now_s, statistics = time.monotonic(), self._statistics
        median, high = statistics.latency_ms(lately=True)
        numbers = {"fps": statistics.fps, "latency_ms": median, "latency_high_ms": high}
        return {
            "name": self._source.name,
            "rule": self._rule.to_dict(),
            "dropped": self._source.n_dropped,
            "busy": statistics.busy,
            "protects": statistics.protects and not self._reason,
            "alarms": statistics.n_alarms,
            "has_frames": self._newest is not None,
            "quiet_s": round(now_s - self._put_s, 1),
            "blind": BLIND_WORDS.get(self._reason, ""),
            **{k: finite(round(v, 1)) for k, v in numbers.items()},
        }


def _listening(host: str, port: int) -> socket.socket:
    try:
        family, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):  # UnicodeError: an invalid name
        why = f"the host {host!r} cannot be found"
        raise ParameterError(argument("serve"), why, "Give an address of this machine.") from None
    try:
        listener = socket.create_server(place[:2], family=family)
    except OSError as error:
        code = error.errno or 0
        why = f"port {port} of {host} cannot be used ({os.strerror(code).lower()})"
        hint = {
            errno.EADDRINUSE: f"Choose another port, such as {port % 65535 + 1}.",
            errno.EACCES: "Choose a port from 1024 on.",
        }.get(code, "Give an address of this machine.")
        raise DlgmdError(argument("serve"), why, hint) from None
    # The connections inherit the size of the send buffer.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
    return listener


def _reachable(address: str, family: int) -> str:
    """The address at which other machines reach a listening address, or this machine's name."""
    if not ipaddress.ip_address(address).is_unspecified:
        return address
    outside = "192.0.2.1" if family == socket.AF_INET else "2001:db8::1"
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((outside, 9))  # sends nothing: only the route is looked up
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


def _policy(page: str) -> str:
    """The content security policy: the page may run its own script and contact this server."""
    sources = {}
    for tag in ("script", "style"):
        (text,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        sources[tag] = f"'sha256-{digest}'"
    return (
        f"default-src 'none'; script-src {sources['script']}; style-src {sources['style']}; "
        "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
