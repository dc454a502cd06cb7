"""What FFmpeg may do with a file that nobody vouches for: read it, and nothing beside it."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Those that hold moving pictures themselves. Left out are lists of other files and addresses:
# concat, hls, dash, sdp, vobsub, image2 and their kin.
FORMATS = (
    *("mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm", "avi", "mpegts", "mpeg", "mpegvideo", "ogg"),
    *("flv", "live_flv", "asf", "mxf", "gxf", "lxf", "nut", "ivf", "dv", "rm", "wtv", "swf", "nsv"),
    *("nuv", "pva", "r3d", "cine", "ser", "dhav", "ifv", "mpegtsraw", "yuv4mpegpipe"),
    *("h264", "hevc", "vvc", "evc", "h261", "h263", "m4v", "vc1", "vc1test", "av1", "obu"),
    *("dirac", "dnxhd", "cavsvideo", "avs2", "avs3", "mjpeg", "mjpeg_2000", "smjpeg", "mpjpeg"),
    *("gif", "apng", "jpegxl_anim", "png_pipe", "jpeg_pipe", "bmp_pipe", "tiff_pipe", "webp_pipe"),
)
OPTIONS = {
    "protocol_whitelist": "file",
    "format_whitelist": ",".join(FORMATS),
}

_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_lock = threading.Lock()


@contextmanager
def guarded() -> Iterator[None]:
    """While it lasts, OpenCV opens videos with `OPTIONS`, beside those that the user has set.

    The environment is the only way to tell OpenCV. It is as before afterwards, for a program that
    opens a camera by itself.
    """
    with _lock:
        before = os.environ.get(_VARIABLE)
        ours = "|".join(f"{key};{value}" for key, value in OPTIONS.items())
        os.environ[_VARIABLE] = f"{before}|{ours}" if before else ours
        try:
            yield
        finally:
            if before is None:
                del os.environ[_VARIABLE]
            else:
                os.environ[_VARIABLE] = before
