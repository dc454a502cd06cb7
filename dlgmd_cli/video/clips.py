"""Clips of a few seconds around alarms: copied from the video where it allows that, or encoded."""

import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import OutputExistsError
from dlgmd_cli.machine import cancel
from dlgmd_cli.video.base import Unreadable, openable
from dlgmd_cli.video.luma import to_bgr
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.pyav import has_av, import_av, video_streams
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

BEFORE_S, AFTER_S = 2.0, 1.0
# A copy begins at a key frame, so much too early at most.
_MAX_EARLY_S = 1.0
# What is copied: these codecs, out of these containers, fit into an MP4 as they are.
_CODECS, _CONTAINERS = {"h264", "hevc", "av1", "vp9", "mpeg4"}, {"mp4", "matroska"}

Spans = Mapping[str, tuple[float, float]]


def clips_of(folder: Path, name: str) -> list[Path]:
    """The clips of an input's alarms in a folder, which need not exist."""
    ours = re.compile(rf"{re.escape(name)}-alarm\d+-\d+\.\d\ds\.mp4")
    paths = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in paths if ours.fullmatch(path.name))


def refuse_clips(folder: Path, name: str) -> None:
    """Raise OutputExistsError if the folder has clips of an input of this name."""
    if earlier := clips_of(folder, name):
        hint = "Add --overwrite to replace the clips of this name, or choose another --clips."
        raise OutputExistsError(str(earlier[0]), "already exists", hint)


def spans_of(name: str, onsets_s: Sequence[float]) -> dict[str, tuple[float, float]]:
    """The clips of alarms that begin at these times: from 2 s before to 1 s after.

    They are named after `name`, number and time: ``flight-alarm1-3.97s.mp4``.
    """
    spans = {}
    for number, onset_s in enumerate(onsets_s, 1):
        clip = f"{name}-alarm{number}-{max(onset_s, 0.0):.2f}s.mp4"
        spans[clip] = onset_s - BEFORE_S, onset_s + AFTER_S
    return spans


def make_clips(
    source: str, spans: Spans, folder: Path, of_images: Mapping[str, Any] | None = None
) -> None:
    """Make the clips of `spans_of` in a folder of their own.

    `source` is what `open_video` takes, and `of_images` are its options for images. A copy has
    the codec of the video, and begins up to 1 s earlier, at a key frame; all others are H.264, if
    PyAV is installed. Raises SourceError if the source cannot be decoded, OutputError and OSError.
    """
    rest = {clip: span for clip, span in spans.items() if not _copy(source, span, folder / clip)}
    if rest:
        _encode(source, rest, folder, of_images or {})


def _copy(source: str, span_s: tuple[float, float], target: Path) -> bool:
    """Copy the packets of a span; False, and no file, if that is not possible."""
    if not (has_av() and Path(source).is_file()):
        return False
    av = import_av()
    start_s, end_s = max(span_s[0], 0.0), span_s[1]
    try:
        with openable(Path(source).absolute()) as name, av.open(f"file:{name}") as video:
            stream: Any = video_streams(video)[0]
            is_fit = _CONTAINERS.intersection(video.format.name.split(","))
            if not is_fit or stream.codec_context.name not in _CODECS:
                return False
            first, tick_s = stream.start_time or 0, float(stream.time_base)
            video.seek(first + round(start_s / tick_s), stream=stream)
            packets = video.demux(stream)
            packet = next(packets)
            if not packet.is_keyframe or packet.dts is None:
                return False
            early_s = start_s - (packet.pts - first) * tick_s
            if not -tick_s <= early_s <= _MAX_EARLY_S:
                return False
            begin = packet.dts
            with av.open(str(target), "w", options={"movflags": "+faststart"}) as clip:
                track = clip.add_stream_from_template(stream)
                while packet is not None and packet.dts is not None:
                    # Later images in the order of decoding may be needed for earlier ones.
                    if (packet.dts - first) * tick_s >= end_s:
                        break
                    packet.pts, packet.dts = packet.pts - begin, packet.dts - begin
                    packet.stream = track
                    clip.mux(packet)
                    packet = next(packets, None)
        return True
    except (av.FFmpegError, Unreadable, StopIteration, ValueError):
        target.unlink(missing_ok=True)
        return False


def _encode(source: str, spans: Spans, folder: Path, of_images: Mapping[str, Any]) -> None:
    """Encode all spans in one pass through the source; OpenCV gives the colours."""
    waiting = sorted(spans.items(), key=lambda clip: clip[1])
    last_s = max(end_s for _, end_s in spans.values())
    with (
        ExitStack() as stack,
        open_video(source, end_s=last_s, decoder="opencv", **of_images) as video,
    ):
        width, height = (max(2, side - side % 2) for side in video.source_wh)
        fps, running = playable_fps(video.info.fps), []
        look: Any = {"codec": best_codec(), "is_colour": True, "option": "--clips"}
        for picture in video.pictures():
            cancel.check()
            while waiting and waiting[0][1][0] <= picture.time_s:
                name, (_, end_s) = waiting.pop(0)
                clip = stack.enter_context(ExitStack())
                writer = video_writer(folder / name, (height, width), fps, **look)
                running.append((end_s, clip, clip.enter_context(writer)))
            for end_s, clip, write in running[:]:
                if picture.time_s >= end_s:
                    clip.close()
                    running.remove((end_s, clip, write))
                else:
                    write(to_bgr(picture.image, (width, height), picture.levels))
