"""Sends a video over UDP at its own pace, again and again: `python streamer.py FILE URL`."""

import sys
import time
from fractions import Fraction

import av

TIMES = 100


def main(path, url):
    with av.open(url, "w", format="mpegts") as target:
        stream = None
        begin, sent = time.monotonic(), 0
        for _ in range(TIMES):
            with av.open(path) as source:
                for frame in source.decode(video=0):
                    if stream is None:
                        stream = target.add_stream("libx264", rate=30)
                        stream.width, stream.height = frame.width, frame.height
                        stream.pix_fmt = "yuv420p"
                        stream.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "15"}
                    frame.pts, frame.time_base = sent, Fraction(1, 30)
                    time.sleep(max(0.0, begin + sent / 30 - time.monotonic()))
                    target.mux(stream.encode(frame))
                    sent += 1


if __name__ == "__main__":
    main(*sys.argv[1:])
