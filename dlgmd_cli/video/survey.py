"""A survey of an input: its properties after reading the whole input."""

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.frame import Flags, Image
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import opencv_threads
from dlgmd_cli.video import bags
from dlgmd_cli.video.base import DEFAULT_DECODER, Crop
from dlgmd_cli.video.content import crop_borders
from dlgmd_cli.video.images import NAME, pictures_at
from dlgmd_cli.video.luma import Region, to_grey_levels
from dlgmd_cli.video.opening import open_video

# Grey levels (of 255): the greatest change of a still pixel. Compression makes displays vary.
_STILL = 20
# Still pixels are looked for in 25 images or more, if half of all pixels vary by 32 grey levels.
_N_PICTURES, _MOVING = 25, 32
# A display: least size of a connected part in px, least and greatest share of the image.
_MIN_STILL_PX, _STILL_SHARES = 6, (0.0002, 0.4)
# Least gradient of a contour pixel, and the least share of contour pixels in a display.
_CONTOUR, _CONTOUR_SHARE = 40, 0.2


@dataclass(frozen=True)
class Survey:
    """Properties of an input that has been read to its end.

    `path` is as given; `width` and `height` are in px, and `frames` is the number of decoded
    frames. The last frame ends at `duration_s`, in seconds. `fps_stated` is the frame rate that the
    input states, `fps_true` the mean rate of its frames, `fps_range` the rates of the longest and
    the shortest interval, all None for images. `is_variable` says whether the rate varies; if not,
    `fps_true` is the rate between gaps. `repeats` is the number of duplicate frames, `gaps` the
    number of gaps with missing frames, after which models are reset.

    `codec` and `pixel_format` are FFmpeg's names; without PyAV, `pixel_format` is empty and `codec`
    is the FOURCC. `bits` is per sample. `is_interlaced` says whether frames consist of two fields.
    `turned_deg` is the angle by which the images are turned clockwise to be upright, as the file
    asks, and `is_mirrored` says whether left and right are then swapped. `width` and `height` are
    those of the upright images. Without PyAV, the four facts from `bits` on are None. `transfer` is
    FFmpeg's name of how levels become light, such as smpte2084 of HDR; empty if nothing states it.
    `damage` says where the input is damaged, `warnings` has other doubts about the input.

    `crop` is the image without its black borders; None if there are none. `still`, (H, W) bool,
    marks pixels of `crop` that never change while the others do; None if there are none.
    `topics` maps the topics of a ROS bag to the type and number of their messages.
    """

    path: str
    width: int
    height: int
    frames: int
    duration_s: float
    fps_stated: float | None
    fps_true: float | None
    fps_range: tuple[float, float] | None
    is_variable: bool
    repeats: int
    gaps: int
    codec: str
    pixel_format: str
    bits: int | None
    is_interlaced: bool | None
    turned_deg: int | None
    is_mirrored: bool | None
    transfer: str
    decoder: str
    damage: list[str]
    warnings: list[str]
    crop: Crop | None = None
    still: Flags | None = field(default=None, repr=False)
    topics: dict[str, str] = field(default_factory=dict)

    @property
    def still_share(self) -> float:
        """Share of the pixels that never change, 0..1."""
        return 0.0 if self.still is None else float(self.still.mean())

    @property
    def mask(self) -> Flags | None:
        """The pixels to hide, (H, W) bool of the whole image: borders and `still`; or None."""
        if self.still is None:
            return None
        hidden = np.ones((self.height, self.width), np.bool_)
        Region((self.width, self.height), self.crop).of(hidden)[:] = self.still
        return hidden


def survey(
    path: str | os.PathLike[str],
    *,
    decoder: str = DEFAULT_DECODER,
    input_fps: float | None = None,
    topic: str | None = None,
    on_frame: Callable[[int], None] = lambda n_done: None,
) -> Survey:
    """Read an input to its end and report its properties.

    `path`, `decoder`, `input_fps` and `topic` are those of `open_video`, whose errors pass through.
    Without `topic`, the first topic with images is read.
    `on_frame` is called after each frame with the number of frames done. Raises Interrupted if the
    stop flag is set.
    """
    n_gaps, topics = 0, dict[str, str]()
    extremes: tuple[Image, Image] | None = None
    if is_bag := Path(path).exists() and bags.is_bag(Path(path)):
        with closing(bags.BagDecoder(Path(path), topic, any_topic=True)) as bag:
            topic, topics = bag.topic, bag.topics
    with open_video(path, decoder=decoder, input_fps=input_fps, topic=topic, repeats=None) as video:
        is_video = not (is_bag or video.info.decoder == NAME) and pictures_at(Path(path)) is None
        with opencv_threads(1):
            for picture in video.pictures():
                n_gaps += picture.after_gap
                if not picture.is_repeat:
                    grey = to_grey_levels(picture.image, video.info.levels)
                    darkest, brightest = extremes or (grey, grey)
                    extremes = cv2.min(darkest, grey), cv2.max(brightest, grey)
                on_frame(picture.index + 1)
                cancel.check()
    info, done = video.info, video.progress
    rates = done.frame_rates if is_bag or info.fps_stated is not None else None
    crop, still = (None, None) if extremes is None else _proposal(*extremes, done.n_new)
    return Survey(
        path=os.fspath(path),
        width=info.width,
        height=info.height,
        frames=done.n_decoded,
        duration_s=done.last_time_s + 1.0 / info.fps,
        fps_stated=info.fps_stated,
        fps_true=rates.mean_fps if rates else None,
        fps_range=(rates.min_fps, rates.max_fps) if rates else None,
        is_variable=rates is not None and rates.varies,
        repeats=done.n_equal if done.n_repeats is None else done.n_repeats,
        gaps=n_gaps,
        codec=info.codec,
        pixel_format=info.pixel_format,
        bits=info.bits,
        is_interlaced=info.is_interlaced or (None if is_video and info.bits is None else False),
        turned_deg=info.turned_deg if is_video else 0,
        is_mirrored=info.is_mirrored if is_video else False,
        transfer=info.transfer,
        decoder=info.decoder,
        damage=done.damage,
        warnings=[line for line in done.warnings if line not in done.damage],
        crop=crop,
        still=still,
        topics=topics,
    )


def _proposal(
    darkest: Image, brightest: Image, n_pictures: int
) -> tuple[Crop | None, Flags | None]:
    """The crop inside black borders and its still pixels, each None if there are none.

    `darkest` and `brightest` have the extreme levels of each pixel over all images.
    """
    crop = crop_borders(brightest)
    if n_pictures < _N_PICTURES:
        return crop, None
    height, width = brightest.shape
    region = Region((width, height), crop)
    return crop, static_pixels(region.of(darkest), region.of(brightest))


def static_pixels(darkest: Image, brightest: Image) -> Flags | None:
    """Pixels, (H, W), that stay the same while most others change; None if there are none.

    Areas without contours are left out: a clear sky does not change either. The remaining areas are
    dilated a little.
    """
    spread = cv2.subtract(brightest, darkest)
    usual = float(np.median(spread))
    if usual < _MOVING:  # the camera does not move
        return None
    still = (spread <= min(_STILL, usual / 4)).astype(np.uint8)
    n_labels, labels, stats, _ = cv2.connectedComponentsWithStats(still, connectivity=8)
    contrast = cv2.morphologyEx(brightest, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    n_px = stats[:, cv2.CC_STAT_AREA]
    n_contour_px = np.bincount(labels[contrast > _CONTOUR], minlength=n_labels)
    is_kept = (n_px >= _MIN_STILL_PX) & (n_contour_px >= _CONTOUR_SHARE * n_px)
    is_kept[0] = False  # label 0 marks the pixels that do change
    kept = is_kept[labels].astype(np.uint8)
    least, most = _STILL_SHARES
    if not least <= kept.mean() <= most:
        return None
    rim = 2 * max(1, spread.shape[1] // 400) + 1
    return cv2.dilate(kept, np.ones((rim, rim), np.uint8)).astype(np.bool_)
