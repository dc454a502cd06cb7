"""The server of `dlgmd live --serve`: who is let in, what is sent, and that it ends."""

import gc
import http.client
import json
import socket
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from conftest import until

pytest.importorskip("starlette", reason="the page needs Starlette")
pytest.importorskip("uvicorn", reason="the page needs Uvicorn")

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Layers
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.live_source import LiveSource
from dlgmd_cli.watch.connections import IDLE_S
from dlgmd_cli.watch.serve import PageServer
from dlgmd_cli.watch.statistics import Statistics
from dlgmd_cli.watch.watch import Answer

pytestmark = pytest.mark.slow
PARAMS = DlgmdParameters()


@contextmanager
def served(host="127.0.0.1"):
    """A page that is served."""
    made_for = {"width_px": 240, "model_fps": 30.0}
    source = LiveSource("<b>camera</b>", lambda: iter(()), InputOptions(), **made_for)
    with PageServer(host, 0, source, Statistics(), rule_of(PARAMS)) as screen:
        yield screen, source


@pytest.fixture
def serve():
    """Serve a page until the end of the test: `serve(host)` -> screen, source."""
    with ExitStack() as screens:
        yield lambda *host: screens.enter_context(served(*host))


def answer(index=0, level=0.5, *, has_image=True, wh=(64, 48)):
    """An answer with some active cells in the upper left corner."""
    grey = np.full(wh[::-1], 128, np.uint8)
    g = np.zeros((24, 32), np.float32)
    g[:6, :8] = 1.0
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) if has_image else None
    found = Detection(
        *(1.0, 1.0, 1.0, 1.0, 1.0),
        layers=Layers(g=g) if has_image else None,
        g_x=-0.75,
        g_y=-0.75,
        mp_abs=level,
        spike=level >= PARAMS.t_mp,
        alarm=level > 0.9,
    )
    return Answer(Frame(index, index / 30, grey, picture=image), found, latency_ms=4.0)


@pytest.fixture
def ask():
    """Ask a server: `ask(url, path)` -> response, whose body is still to be read."""
    with ExitStack() as connections:

        def asking(url, path="/", query=None, **headers):
            parts = urlsplit(url)
            one = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
            connections.callback(one.close)
            query = parts.query if query is None else query
            one.request("GET", f"{path}?{query}", headers={"Connection": "close", **headers})
            return connections.enter_context(one.getresponse())

        yield asking


def next_event(response):
    """What the next event says."""
    while not (line := response.readline()).startswith(b"data: "):
        assert line, "the stream has ended"
    return json.loads(line[len(b"data: ") :])


def next_picture(response):
    """The next image of a stream, (H, W, 3)."""
    while not (line := response.readline()).startswith(b"Content-Length: "):
        assert line, "the stream has ended"
    assert response.readline() == b"\r\n"
    data = response.read(int(line.split()[1]))
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def test_this_machine_needs_no_token(serve, ask):
    screen, _ = serve()
    assert screen.url.startswith("http://127.0.0.1:") and "token" not in screen.url
    response = ask(screen.url)
    assert response.status == 200 and b"<canvas" in response.read()
    assert response.headers["Cache-Control"] == "no-store"
    policy = response.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'sha256-") and "unsafe" not in policy
    assert ask(screen.url, "/other").status == 404


@pytest.mark.parametrize("path", ["/", "/picture", "/events", "/other"])
def test_other_machines_need_the_token(serve, ask, path):
    screen, source = serve("0.0.0.0")
    assert len(urlsplit(screen.url).query) > 20
    url = screen.url.replace(urlsplit(screen.url).hostname, "127.0.0.1", 1)
    for query in ("", "token=", "token=%FF", urlsplit(url).query[:-1]):
        response = ask(url, path, query)
        assert response.status == 403 and b"its token" in response.read()
        assert response.headers["Cache-Control"] == "no-store"
    assert not source.wants_pictures
    assert ask(url, path).status == (404 if path == "/other" else 200)


def test_tokens_differ(serve):
    assert len({urlsplit(serve("0.0.0.0")[0].url).query for _ in range(3)}) == 3


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1", 200),
        ("LOCALHOST:8000", 200),
        ("[::1]:8000", 200),
        ("evil.example", 403),
        ("127.0.0.1.evil.example:8000", 403),
        ("", 403),
    ],
)
def test_other_names_are_refused(serve, ask, host, status):
    screen, _ = serve()
    assert ask(screen.url, "/events", Host=host).status == status


def test_pictures_are_asked_for_while_someone_looks(serve, ask):
    screen, source = serve()
    events = ask(screen.url, "/events")
    assert next_event(events)["rows"] == [] and not source.wants_pictures
    first, second = ask(screen.url, "/picture"), ask(screen.url, "/picture")
    until(lambda: source.wants_pictures)
    first.close()
    screen.put(answer())
    assert next_picture(second).shape == (48, 64, 3) and source.wants_pictures
    second.close()
    until(lambda: not source.wants_pictures)


def test_picture_has_the_active_cells(serve, ask):
    screen, _ = serve()
    tinted, plain = ask(screen.url, "/picture"), ask(screen.url, "/picture", "overlay=0")
    screen.put(answer(0, has_image=False))
    events = ask(screen.url, "/events")
    for _ in range(3):  # time for an image, if there were one
        next_event(events)
    screen.put(answer(1))
    _, green, red = next_picture(tinted)[1, 1].astype(int)
    assert red - green > 80
    assert np.ptp(next_picture(plain)[1, 1].astype(int)) < 10
    screen.put(answer(2, wh=(80, 60)))
    assert next_picture(tinted).shape == next_picture(plain).shape == (60, 80, 3)


def test_events_have_each_row_once(serve, ask):
    screen, _ = serve()
    for index in range(1000):
        screen.put(answer(index, level=np.nan if index == 999 else 0.95))
    events = ask(screen.url, "/events")
    state = next_event(events)
    # What came before, of the last half a minute.
    assert [row["frame"] for row in state["rows"]] == list(range(99, 1000))
    assert state["rows"][-2]["mp_abs"] == 0.95 and state["rows"][-2]["alarm"]
    assert state["rows"][-1]["mp_abs"] is None and state["fps"] is None
    assert state["name"] == "<b>camera</b>" and state["rule"] == rule_of(PARAMS).to_dict()
    screen.put(answer(1000))
    while not (rows := next_event(events)["rows"]):
        pass
    assert [row["frame"] for row in rows] == [1000]


def test_blindness_is_shown_until_it_is_over(serve, ask):
    screen, _ = serve()
    events = ask(screen.url, "/events")
    nothing = replace(answer(), frame=None, latency_ms=np.nan)
    screen.put(replace(nothing, event="blind", reason="lost"))
    until(lambda: "the source is lost" in next_event(events)["blind"])
    assert not next_event(events)["has_frames"] and not next_event(events)["protects"]
    screen.put(replace(nothing, event="blind", reason="unmeasured"))
    until(lambda: "cannot be measured" in next_event(events)["blind"])
    screen.put(replace(nothing, event="sees"))
    screen.put(answer())
    until(lambda: next_event(events)["has_frames"])
    state = next_event(events)
    assert state["blind"] == "" and state["protects"]
    until(lambda: next_event(events)["quiet_s"] > 0.2)
    screen.put(answer(1))
    until(lambda: next_event(events)["quiet_s"] < 0.2)


def test_it_ends_with_clients(serve, ask, capfd):
    screen, source = serve()
    events, picture = ask(screen.url, "/events"), ask(screen.url, "/picture")
    place = urlsplit(screen.url)
    idle = socket.create_connection((place.hostname, place.port))
    until(lambda: source.wants_pictures)
    for index in range(5):
        screen.put(answer(index))
        next_event(events), next_picture(picture)
    screen.__exit__()
    until(lambda: "dlgmd-serve" not in [one.name for one in threading.enumerate()])
    events.read()  # raises if the stream was only cut
    with idle:
        assert idle.recv(1) == b""
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((place.hostname, place.port))
    assert capfd.readouterr() == ("", "")


@pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")
def test_a_deaf_client_holds_nothing_up(capfd):
    noise = np.random.default_rng(1).integers(0, 255, (1500, 2000, 3), dtype=np.uint8)
    with served() as (screen, source), ExitStack() as stack:
        place, one = urlsplit(screen.url), answer()
        deaf = stack.enter_context(socket.create_connection((place.hostname, place.port)))
        deaf.sendall(b"GET /picture?overlay=0 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        until(lambda: source.wants_pictures)
        for _ in range(3):  # more than a connection takes at once
            screen.put(replace(one, frame=replace(one.frame, picture=noise)))
            time.sleep(0.2)
        screen.__exit__()
        until(lambda: "dlgmd-serve" not in [thread.name for thread in threading.enumerate()])
    assert not source.wants_pictures
    assert capfd.readouterr() == ("", "")
    del screen
    gc.collect()  # the connection was not closed, but left


def test_idle_connections_take_no_place_and_end(serve, ask):
    """Without a request, or with half of one."""
    screen, _ = serve()
    place = urlsplit(screen.url)
    with ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection((place.hostname, place.port)))]
        idle[0].sendall(b"GET / HTTP/1.1")
        began_s = time.monotonic()
        assert idle[0].recv(1) == b"" and time.monotonic() - began_s > 0.9 * IDLE_S
        for _ in range(70):
            idle.append(stack.enter_context(socket.create_connection((place.hostname, place.port))))
        assert ask(screen.url).status == 200


def test_requests_are_bounded(serve, ask):
    screen, _ = serve()
    open_ones = [ask(screen.url, "/events") for _ in range(48)]
    assert ask(screen.url).status == 503
    open_ones[0].close()
    until(lambda: ask(screen.url).status == 200)


def test_a_lack_of_descriptors_is_logged_once_and_survived(serve, ask, caplog):
    resource = pytest.importorskip("resource", reason="this system has no such limit")
    screen, _ = serve()
    until(lambda: ask(screen.url).status == 200)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    waiting = socket.socket()
    resource.setrlimit(resource.RLIMIT_NOFILE, (waiting.fileno(), hard))
    try:
        waiting.connect((urlsplit(screen.url).hostname, urlsplit(screen.url).port))
        until(lambda: caplog.messages)
        time.sleep(1.2)  # it tries again each half a second
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        waiting.close()
    assert ask(screen.url).status == 200
    assert caplog.messages == ["serve: accepting failed ([Errno 24] Too many open files)"]


def test_refusals_on_the_command_line(dlgmd, clips):
    def refused(place):
        return dlgmd("live", clips / "loom.avi", "--realtime", "--serve", place)

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        result = refused(port)
    assert result.exit_code == 1
    assert (
        f"--serve: port {port} of 127.0.0.1 cannot be used (address already in use). Choose "
        in (result.stderr)
    )
    result = refused("192.0.2.1:8000")
    assert result.exit_code == 1 and "Give an address of this machine" in result.stderr
    for place in ("70000", "-1", "host", "a:b:c", "a..b:8000"):
        result = refused(place)
        assert result.exit_code == 2 and "--serve: " in result.stderr, place


def test_an_ipv6_address_is_answered(serve, ask):
    try:
        screen, _ = serve("::1")
    except DlgmdError:
        pytest.skip("this machine has no IPv6")
    assert screen.url.startswith("http://[::1]:") and ask(screen.url, "/").status == 200
