"""What is known of an input once it has been read, and what follows from it for a run."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli import cancel
from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.parameters import DEFAULT_WIDTH_PX, PRESETS, load_config
from dlgmd_cli.video.base import DEFAULT_DECODER, Crop, Unreadable, openable
from dlgmd_cli.video.frames import open_video, processed_size
from dlgmd_cli.video.images import pictures_at
from dlgmd_cli.video.luma import to_grey
from dlgmd_cli.video.prefetch import opencv_threads
from dlgmd_cli.video.pyav import Details, PyAVDecoder
from dlgmd_cli.video.reading import Picture
from dlgmd_cli.video.region import Region

Image = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

# Of 255. Compression leaves bars not quite black, and a display not quite still.
_BLACK, _STILL = 24, 20
# A row is lit if more of it than this share is.
_LIT_SHARE = 0.01
# So many pictures, which half of the pixels change by so much in, tell what never changes.
_N_PICTURES, _MOVING = 25, 32
# Specks of fewer pixels are no display. More than this share of the picture is no display either.
_MIN_STILL_PX, _STILL_SHARES = 6, (0.0002, 0.4)
# So much from one pixel to the next is a contour; a display has at least this share of them.
_CONTOUR, _CONTOUR_SHARE = 40, 0.2
# A crop leaves out bars that are at least so wide, and leaves so much of each side.
_MIN_BAR_PX, _MIN_LEFT = 2, 0.3
_SLOW_FPS = 20.0


@dataclass(frozen=True)
class Survey:
    """Facts about an input that has been read whole.

    Attributes
    ----------
    path : str
        As it was given.
    width, height : int
        Size of its pictures, in px.
    frames : int
        How many could be decoded.
    duration_s : float
        Until the end of the last one.
    fps_stated, fps_true : float or None
        Frames a second: what the input says, and how many there are. Pictures have no times.
    fps_range : (float, float) or None
        Those of the longest and of the shortest time between two frames.
    is_variable : bool
        Whether they follow each other in more than one rhythm.
    repeats : int
        Frames that repeat the one before.
    gaps : int
        How often frames are missing in between, so that models begin anew.
    codec, pixel_format : str
        FFmpeg's names; `pixel_format` is empty where PyAV is not installed, and `codec` is the
        FOURCC then.
    bits : int or None
        Of a sample.
    is_interlaced : bool or None
        Whether frames consist of two fields; None where PyAV is not installed.
    decoder : str
        What decoded it.
    damage, warnings : list of str
        Where it is damaged, and what else is doubtful.
    crop : Crop or None
        The pictures without black borders, if there are any.
    still : ndarray, bool, or None
        Pixels of that part that never change while the others do, (H, W); None for none.
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
    decoder: str
    damage: list[str]
    warnings: list[str]
    crop: Crop | None = None
    still: Flags | None = field(default=None, repr=False)

    @property
    def still_share(self) -> float:
        """The share of the pixels that never change."""
        return 0.0 if self.still is None else float(self.still.mean())

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON takes it, with the advice."""
        facts = {name: value for name, value in vars(self).items() if name != "still"}
        crop = None if self.crop is None else str(self.crop)
        return {**facts, "crop": crop, "still_share": self.still_share, "advice": advice(self)}


def survey(
    path: str | os.PathLike[str],
    *,
    decoder: str = DEFAULT_DECODER,
    input_fps: float | None = None,
    on_frame: Callable[[int], None] = lambda n_done: None,
) -> Survey:
    """Read all of an input once and say what it is.

    Parameters
    ----------
    path, decoder, input_fps
        See `open_video`.
    on_frame : callable, optional
        Called after each frame with the number of frames that are done.

    Raises
    ------
    SourceError, ParameterError, MissingExtraError
        As `open_video` does.
    Interrupted
        If the stop flag is set.
    """
    is_video = pictures_at(Path(path)) is None
    n_gaps, extremes = 0, Extremes()
    with open_video(path, decoder=decoder, input_fps=input_fps, repeats="skip") as video:
        details = _details(Path(path)) if is_video else None
        with opencv_threads(1):
            for picture in video.pictures():
                n_gaps += picture.after_gap
                if not picture.is_repeat:
                    extremes.take(picture)
                on_frame(picture.index + 1)
                cancel.check()
    info, done, stated, rhythm = video.info, video.progress, video.stated, video.progress.rhythm
    has_times = is_video and rhythm is not None
    return Survey(
        os.fspath(path),
        info.width,
        info.height,
        done.n_decoded,
        done.last_time_s + 1.0 / info.fps,
        stated.fps if is_video else None,
        rhythm.mean_fps if has_times and rhythm else None,
        (rhythm.least_fps, rhythm.most_fps) if has_times and rhythm else None,
        bool(has_times and rhythm and rhythm.varies),
        done.n_repeats or 0,
        n_gaps,
        details.codec if details else stated.codec,
        details.pixel_format if details else "",
        details.n_bits if details else None,
        details.is_interlaced if details else None if is_video else False,
        info.decoder,
        done.damage,
        [line for line in done.warnings if line not in done.damage],
        *extremes.proposal(),
    )


def _details(path: Path) -> Details | None:
    """How a file is encoded; None if PyAV is not installed or cannot open it."""
    try:
        with openable(path.absolute()) as name:
            decoder = PyAVDecoder(name)
    except (MissingExtraError, Unreadable):
        return None
    details = decoder.details()
    decoder.close()
    return details


class Extremes:
    """The darkest and the brightest that each pixel of the pictures taken was, in 0..255."""

    def __init__(self) -> None:
        self._n_taken = 0

    def take(self, picture: Picture) -> None:
        """Look at a picture of the same size as those before."""
        height, width = picture.image.shape[:2]
        grey = to_grey(picture.image, (width, height), picture.levels)
        if grey.dtype != np.uint8:
            grey = cv2.convertScaleAbs(grey, alpha=255.0)
        if not self._n_taken:
            self._darkest, self._brightest = grey.copy(), grey.copy()
        self._n_taken += 1
        cv2.min(self._darkest, grey, dst=self._darkest)
        cv2.max(self._brightest, grey, dst=self._brightest)

    def proposal(self) -> tuple[Crop | None, Flags | None]:
        """The part between black borders, and which of its pixels never change; None for none."""
        if not self._n_taken:
            return None, None
        crop = inside_borders(self._brightest)
        if self._n_taken < _N_PICTURES:
            return crop, None
        height, width = self._brightest.shape
        region = Region((width, height), crop)
        return crop, unchanging(region.of(self._darkest), region.of(self._brightest))


def inside_borders(brightest: Image) -> Crop | None:
    """The part of a picture, (H, W), between borders that are never brighter than black.

    None if there are no borders, or if little else is there.
    """
    lit, spans = brightest > _BLACK, []
    for axis in (0, 1):
        places = np.flatnonzero(lit.mean(axis=axis) > _LIT_SHARE)
        side = lit.shape[1 - axis]
        if not places.size:
            return None
        first, last = int(places[0]), int(places[-1]) + 1
        first = first if first >= _MIN_BAR_PX else 0
        last = last if side - last >= _MIN_BAR_PX else side
        if last - first < max(_MIN_LEFT * side, 1):
            return None
        spans.append((first, last))
    (left, right), (top, bottom) = spans
    crop = Crop(right - left, bottom - top, left, top)
    return None if (crop.height, crop.width) == brightest.shape else crop


def unchanging(darkest: Image, brightest: Image) -> Flags | None:
    """Where pixels stay the same while most others change, with a rim, (H, W); None for nowhere.

    Areas without a contour in them do not count: a clear sky shows no change either.
    """
    spread = cv2.subtract(brightest, darkest)
    usual = float(np.median(spread))
    if usual < _MOVING:  # a camera that stands still
        return None
    still = (spread <= min(_STILL, usual / 4)).astype(np.uint8)
    n_labels, labels, stats, _ = cv2.connectedComponentsWithStats(still, connectivity=8)
    contrast = cv2.morphologyEx(brightest, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    n_px = stats[:, cv2.CC_STAT_AREA]
    n_contour_px = np.bincount(labels[contrast > _CONTOUR], minlength=n_labels)
    is_kept = (n_px >= _MIN_STILL_PX) & (n_contour_px >= _CONTOUR_SHARE * n_px)
    is_kept[0] = False  # what is not still
    found = is_kept[labels].astype(np.uint8)
    least, most = _STILL_SHARES
    if not least <= found.mean() <= most:
        return None
    rim = 2 * max(1, spread.shape[1] // 400) + 1
    return cv2.dilate(found, np.ones((rim, rim), np.uint8)).astype(np.bool_)


def advice(facts: Survey) -> list[str]:
    """What follows from the facts for a run, a sentence each."""
    lines = [*_of_rate(facts), _of_size(facts)]
    if facts.is_interlaced:
        lines.append(
            "It is interlaced: the comb of the two fields looks like motion, and OpenCV may show "
            "the same picture throughout. Deinterlace it first, for example with 'ffmpeg -i INPUT "
            "-vf bwdif OUTPUT', or add --decoder pyav."
        )
    if facts.bits is not None and facts.bits > 8 and facts.decoder == DEFAULT_DECODER:
        lines.append(f"--decoder pyav keeps all {facts.bits} bits of a sample, opencv keeps 8.")
    if facts.damage:
        lines.append(
            "Do not trust the response near the damage: copy the file again, or run the part "
            "before it with --end."
        )
    if facts.crop is not None:
        lines.append(f"The borders are black: --crop {facts.crop} leaves them out.")
    if facts.still is not None:
        lines.append(
            f"{100 * facts.still_share:.2g} % of the pixels never change, as those of an on-screen "
            "display or of the vehicle itself: 'dlgmd info --write-mask mask.png' paints them "
            "black for --mask. Look at it before you use it."
        )
    return lines


def _of_rate(facts: Survey) -> list[str]:
    """What follows from the frame rate."""
    lines = []
    fps = facts.fps_true or facts.fps_stated
    model_fps = load_config(PRESETS[0]).model_fps
    if facts.fps_stated is None:
        lines.append("Nothing states the frame rate: give it with --input-fps.")
    if facts.is_variable:
        lines.append(
            "The frame rate varies, and the model counts frames, not seconds: record at a "
            "constant rate, or convert with 'ffmpeg -i INPUT -r 30 OUTPUT'."
        )
    stated = facts.fps_stated or 0.0
    every = max(1, math.ceil(stated / (1.1 * model_fps) - 1e-3))
    if every > 1:
        lines.append(
            f"At most {model_fps:g} frames a second are processed by default: one in {every} of "
            f"these. --fps all processes every frame."
        )
    n_new = facts.frames - facts.repeats
    rate = None if fps is None else fps * n_new / max(facts.frames, 1)
    if rate is not None and rate < _SLOW_FPS:
        lines.append(
            f"At {rate:.3g} pictures a second an approach looks {model_fps / rate:.2g} times as "
            f"fast as at the {model_fps:g} that the parameters are made for."
        )
    return lines


def _of_size(facts: Survey) -> str:
    """At what size the models see it."""
    source_wh = facts.crop[:2] if facts.crop else (facts.width, facts.height)

    def default(width_px: int) -> str:
        width, height = processed_size(*source_wh, width_px=width_px)
        return f"{width}x{height} px (--scale {width / source_wh[0]:.3g})"

    preset = PRESETS[0]
    return (
        f"The preset {preset} processes it at {default(load_config(preset).width_px)}, the "
        f"paper's sets at {default(DEFAULT_WIDTH_PX)}."
    )
