"""Videos from strangers: no file makes FFmpeg open another file or an address."""

import os
import shutil
import socket

import cv2
import pytest

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.video.base import FFMPEG_OPTIONS
from dlgmd_cli.video.opencv_decoder import guarded
from dlgmd_cli.video.opening import open_video

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    [
        *("http://127.0.0.1:9/x.mp4", "rtsp://127.0.0.1:9/x", "tcp://127.0.0.1:9", "pipe:0"),
        *("file:{}", "concat:{}|{}", "subfile,,start,0,end,0,,:{}", "crypto:{}", "async:{}"),
        *("data:video/mp4;base64,AAAA", "cache:{}", "lavfi:testsrc", "0"),
    ],
)
def test_an_address_is_no_file(clips, decoder, name):
    why = "there is no such file|are not read"
    with pytest.raises((SourceError, ParameterError), match=why):
        open_video(name.format(*[clips / "loom.avi"] * 2), decoder=decoder)


def hls(address):
    return f"#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\n{address}\n#EXT-X-ENDLIST\n"


LISTS = {
    "concat.mp4": "ffconcat version 1.0\nfile victim.avi\n",
    "concat-http.mp4": "ffconcat version 1.0\nfile {http}\n",
    "hls.m3u8": hls("victim.ts"),
    "hls-http.m3u8": hls("{http}"),
    "hls-key.m3u8": hls("victim.ts").replace("#EXTINF", '#EXT-X-KEY:METHOD=AES-128,URI="{http}"'),
    "dash.mpd": '<?xml version="1.0"?><MPD><Period><AdaptationSet><Representation id="1">'
    "<BaseURL>{http}</BaseURL></Representation></AdaptationSet></Period></MPD>",
    "x.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\n"
    "m=video {port} RTP/AVP 96\na=rtpmap:96 H264/90000\n",
}


@pytest.fixture
def listener():
    """A server that must not be called."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        yield server
        with pytest.raises(BlockingIOError):
            server.accept()


@pytest.mark.parametrize("name", LISTS)
def test_what_a_file_names_is_not_opened(tmp_path, clips, decoder, listener, name):
    for victim in ("victim.avi", "victim.ts"):
        shutil.copy(clips / "loom.avi", tmp_path / victim)
    port = listener.getsockname()[1]
    text = LISTS[name].format(http=f"http://127.0.0.1:{port}/x.ts", port=port)
    # Behind an empty line it is no list that this program knows: FFmpeg has to be kept from it.
    for start in ("", "\n"):
        (tmp_path / name).write_text(start + text)
        with pytest.raises(SourceError):
            open_video(tmp_path / name, decoder=decoder)


def test_ffmpeg_itself_refuses_lists(tmp_path, clips, monkeypatch, decoder):
    monkeypatch.setattr("dlgmd_cli.video.opening.PLAYLISTS", ())
    shutil.copy(clips / "loom.avi", tmp_path / "victim.avi")
    (tmp_path / "x.mp4").write_text("ffconcat version 1.0\nfile victim.avi\n")
    unguarded = cv2.VideoCapture(str(tmp_path / "x.mp4"), cv2.CAP_FFMPEG)
    assert unguarded.grab()  # else this test proves nothing
    with pytest.raises(SourceError, match="no frame could be decoded"):
        open_video(tmp_path / "x.mp4", decoder=decoder)


@pytest.mark.parametrize("before", [None, "hwaccel;none"])
def test_the_environment_is_as_it_was(monkeypatch, before):
    variable = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
    if before is None:
        monkeypatch.delenv(variable, raising=False)
    else:
        monkeypatch.setenv(variable, before)
    with pytest.raises(KeyError), guarded():
        options = os.environ[variable].split("|")
        assert options[-2:] == [f"{key};{value}" for key, value in FFMPEG_OPTIONS.items()]
        assert options[:-2] == ([before] if before else [])
        raise KeyError
    assert os.environ.get(variable) == before
