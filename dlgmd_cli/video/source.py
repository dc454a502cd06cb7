"""Sources of frames: choice of frames by time, warnings about damage, reading ahead."""

import copy
import math
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, argument, counted
from dlgmd_cli.frame import Frame, Image, small_wh
from dlgmd_cli.machine import cancel
from dlgmd_cli.reduction import Reducer
from dlgmd_cli.stream.continuity import Continuity
from dlgmd_cli.video.base import DECODERS, SourceInfo, Unreadable
from dlgmd_cli.video.content import BlindSpans, Surround
from dlgmd_cli.video.damage import PAUSE, Loss, lost_frames, missing_frames
from dlgmd_cli.video.given_times import GivenTimes
from dlgmd_cli.video.luma import Decoder, Region, grey_at_sizes, to_bgr
from dlgmd_cli.video.pyav_decoder import import_av
from dlgmd_cli.video.timestamps import FrameClock, FrameRates, frame_rates

ItemT = TypeVar("ItemT")
# Duplicates are reported from this number on, if they exceed this share of all frames; equal images
# that are kept are reported if runs of them are more than this share.
_MANY_REPEATS, _MANY_REPEATS_SHARE, _MANY_RUNS_SHARE = 5, 0.05, 0.2
# Samples of 16 bits that fit into this number of bits are far below white; their range is narrow
# if it is so many times less than that of their bits.
_FEW_BITS, _NARROW = 14, 8


@dataclass(frozen=True)
class Picture:
    """A decoded image: uint8 or uint16, (H, W) grey or (H, W, 3) BGR.

    Its levels are in `Video.info`. See `Frame` for `is_repeat` and `after_gap`.
    """

    index: int
    time_s: float
    image: Image
    is_repeat: bool
    after_gap: bool


@dataclass
class ReadProgress:
    """How far an input has been read, and what went wrong.

    `n_new` counts the new images that were yielded. `n_repeats` counts all duplicates of a previous
    frame; None if duplicates were not looked for. The other facts are known after the last frame.
    `n_equal` counts the decoded images that equal the one before.
    `damage` says where frames are missing or cannot be decoded; `blind` is not empty if all images
    are black or the same; `warnings` repeats both. `blind_s` gives the first and last time, in
    seconds, of each black or frozen span. `is_whole` says whether the whole input was read.
    """

    n_decoded: int = 0
    last_time_s: float = math.nan
    n_new: int = 0
    n_repeats: int | None = None
    n_equal: int = 0
    warnings: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    blind: str = ""
    blind_s: list[tuple[float, float]] = field(default_factory=list)
    frame_rates: FrameRates | None = None
    is_whole: bool = False


@dataclass
class Selection:
    """Chooses frames by their times; `take` is called once for each frame, in order.

    The time span is in seconds, the end excluded. `max_frames` limits the number of frames in all,
    and `min_interval_s` is the least time between two of them, see `sampling_step`.
    """

    start_s: float = 0.0
    end_s: float = math.inf
    max_frames: int | None = None
    min_interval_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.end_s > self.start_s:
            raise ParameterError("", f"end {self.end_s:g} s is not after start {self.start_s:g} s")
        self._last_s = self._last_new_s = math.nan
        self._n_taken = 0

    def is_over(self, time_s: float) -> bool:
        """Whether no frame at this time or later is taken."""
        return time_s >= self.end_s or self._n_taken == self.max_frames

    def is_due(self, time_s: float) -> bool:
        """Whether a new image at this time would be taken."""
        return not time_s - self._last_new_s < self.min_interval_s

    def take(self, time_s: float, *, is_new: bool = True) -> bool:
        """Whether the frame at this time is taken; a duplicate does not delay the next frame."""
        before_s = self._last_new_s if is_new else self._last_s
        if time_s - before_s < self.min_interval_s:
            return False
        self._last_s = time_s
        self._n_taken += 1
        if is_new:
            self._last_new_s = time_s
        return True


@dataclass
class Holes:
    """The places of a damaged file where frames cannot be decoded."""

    n_frames: int = 0
    places: list[str] = field(default_factory=list)

    def add(self, index: int, time_s: float, n_steps: float) -> None:
        """Note a hole of this many frame intervals after the frame `index`."""
        self.n_frames += round(n_steps) - 1
        self.places.append(f"after frame {index} ({time_s:.3f} s)")

    def report(self) -> str:
        """The number of lost frames and the first place, in words; empty if there are none."""
        if not self.places:
            return ""
        n_more = len(self.places) - 1
        more = f" and in {counted(n_more, 'more place')}" if n_more else ""
        what = f"{counted(self.n_frames, 'frame')} cannot be decoded {self.places[0]}{more}"
        return f"the file is damaged: {what}; the model begins anew after each"


class Video:
    """A source of frames, opened by `open_video`: a context manager and an iterable of `Frame`.

    The source is a file, images, a bag or an array. Each frame has its own memory. Every iteration
    starts at the beginning.

    Attributes
    ----------
    info : SourceInfo
        Properties of the input.
    size_wh : (int, int)
        Width and height of the frames, in px.
    rate_fps : float
        Nominal rate of the chosen frames.
    region : Region
        The part of the images that is read.
    source_wh : (int, int)
        Width and height of the crop, or of the whole image, in px.
    progress : ReadProgress
        Number of frames decoded so far, time of the last one, and warnings.
    unused : dict of str to str
        The options that would have no effect on the input, and why.
    """

    unused: Mapping[str, str] = MappingProxyType({})

    def __init__(
        self,
        decoder: Decoder,
        reopen: Callable[[], Decoder],
        info: SourceInfo,
        size_wh: tuple[int, int],
        selection: Selection,
        *,
        region: Region,
        rate_fps: float,
        bit_depth: int | None = None,
        skips_repeats: bool = False,
        given: GivenTimes | None = None,
        file_fps: float | None = None,
    ) -> None:
        self._decoder, self._reopen, self._is_read = decoder, reopen, False
        self._selection, self._skips_repeats = selection, skips_repeats
        self.region, self.source_wh = region, region.size_wh
        self.info, self.size_wh, self.rate_fps = info, size_wh, rate_fps
        self.progress = ReadProgress()
        self._bit_depth, self._darkest, self._brightest = bit_depth, 1 << 16, 0
        self._given, self._given_report = given, ""
        self._file_fps = file_fps or info.fps

    def pictures(self) -> Iterator[Picture]:
        """The chosen images as decoded; each is valid until the next one.

        Damaged frames leave a gap, with a warning. Reading ends early if PyAV finds that the image
        size changes. (OpenCV silently scales such images to the size of the first one.)
        """
        if self._is_read:
            self._decoder.close()
            self._decoder = self._reopen()
        self._is_read = True
        decoder, progress, fps = self._decoder, self.progress, self._file_fps
        selection, clock, given = copy.copy(self._selection), FrameClock(fps), self._given
        file_times = array("d")
        times = array("d") if given else file_times
        spans, surround = BlindSpans(self.info.levels[0]), Surround(self.info.levels)
        continuity = Continuity(
            skips_repeats=self._skips_repeats,
            is_coded=not self.info.is_lossless,
            hidden=self.hidden(self.source_wh),
            levels=self.info.diffuse_levels,
        )
        progress.n_decoded, progress.last_time_s, progress.n_new = 0, math.nan, 0
        progress.n_repeats = 0 if self._skips_repeats else None
        loss, fault, is_ended = Loss(), "", False
        # OpenCV's errors may be packets without an image, which the stated rate may count.
        step_s = 0.0 if decoder.kind == "pyav" else math.inf
        holes, is_broken = Holes(), False
        for index, stamp_s in enumerate(decoder.stamps()):
            before_s = file_times[-1] if file_times else math.nan
            time_s = clock.time(index, stamp_s)
            # The stated rate may count packets without an image.
            usual_s = max(1.0 / fps, step_s)
            if decoder.is_damaged and stamp_s > before_s + 1.5 * usual_s:
                holes.add(index - 1, times[-1], (stamp_s - before_s) / usual_s)
                is_broken = True
            elif file_times:
                step_s = time_s - before_s
            file_times.append(time_s)
            if given:
                time_s = given.time(index + holes.n_frames, time_s)
                times.append(time_s)
            if selection.is_over(time_s):
                break
            # Without a start time, frames at negative times (from edit lists) are included.
            has_begun = selection.start_s <= 0.0 or time_s >= selection.start_s
            image = None
            if has_begun and (self._skips_repeats or selection.is_due(time_s)):
                try:
                    image = decoder.picture()
                except Unreadable as error:
                    fault = str(error)
                    break
                self._look(image)
                image = self.region.of(image)
                spans.step(image, time_s)
                surround.step(image)
            progress.n_decoded, progress.last_time_s = index + 1, time_s
            if not has_begun:
                continue
            is_repeat, _ = continuity.step(image, time_s)
            if is_repeat:
                progress.n_repeats = (progress.n_repeats or 0) + 1
            if selection.take(time_s, is_new=continuity.is_new) and image is not None:
                is_repeat, after_gap = continuity.take()
                progress.n_new += not is_repeat
                yield Picture(index, time_s, image, is_repeat, after_gap or is_broken)
                is_broken = False
        else:
            is_ended = True
            loss = self._lost_frames(file_times)
            fault = holes.report() or loss.fault
            n_frames = len(times) + holes.n_frames
            self._given_report = given.report(n_frames) if given else ""
        self._report(fault, loss, times, spans, surround, clock)
        progress.is_whole = is_ended and selection.start_s <= 0.0 and not progress.damage
        decoder.close()

    def _report(
        self,
        fault: str,
        loss: Loss,
        times: "array[float]",
        spans: BlindSpans,
        surround: Surround,
        clock: FrameClock,
    ) -> None:
        """Report what was noticed while reading; a `fault`, if any, is damage of the file."""
        progress, decoder = self.progress, self._decoder
        rates = progress.frame_rates = frame_rates(times)
        missing = "" if decoder.is_damaged and fault else missing_frames(times, rates, loss.n_short)
        ending = fault and self._ending(fault, loss.n_short)
        blind, progress.n_equal = spans.report(), spans.n_equal
        if spans.throughout and decoder.kind == "opencv" and not decoder.takes_every_frame:
            import_av(self.info.given, "nothing can be seen, as if OpenCV read interlaced video")
        progress.blind, progress.blind_s = blind if spans.throughout else "", spans.spans_s
        light = self._too_dark_or_bright()
        stamps = clock.report() if self.info.fps_stated and not self._given else None
        repetition = self._repetition(spans)
        is_cut = self.source_wh != self.info.size_wh or self.region.masked is not None
        small = "" if is_cut or spans.throughout else surround.report()
        lines = (
            *(stamps, self._given_report, loss.remark, missing),
            *(repetition, blind, ending, light, small),
        )
        # An input that is read again reports each line once.
        progress.warnings += [line for line in lines if line and line not in progress.warnings]
        is_pause = PAUSE in missing and not ending
        progress.damage = [line for line in ("" if is_pause else missing, ending) if line]

    def sampling(self) -> str:
        """After reading: how an unusual frame rate was handled, in words; empty if it is usual."""
        fps, progress, every = self.info.fps, self.progress, round(self.info.fps / self.rate_fps)
        if progress.frame_rates is not None and progress.frame_rates.varies:
            mean_fps, min_fps, max_fps, _ = progress.frame_rates
            return (
                f"the frame rate varies from {min_fps:.3g} to {max_fps:.3g} frames/s "
                f"({mean_fps:.3g} on average); the model processed {progress.n_new} of "
                f"{progress.n_decoded} frames, each at its own time"
            )
        if every == 1:
            return ""
        return (
            f"{fps:.4g} frames/s; one frame in {every} was processed, {self.rate_fps:.4g} a second "
            f"({argument('fps', 'all')} processes every frame)"
        )

    def _repetition(self, spans: BlindSpans) -> str:
        """How many images repeat the one before, and what became of them; empty if few do."""
        n_frames, n_repeats = self.progress.n_decoded, self.progress.n_repeats or 0
        if not self._skips_repeats and self.info.is_lossless:
            if spans.n_equal < _MANY_REPEATS or spans.n_runs <= _MANY_RUNS_SHARE * n_frames:
                return ""
            left_out = argument("repeats", "skip")
            equal = f"{spans.n_equal} of {n_frames} images equal the one before"
            return f"{equal}, and are processed ({left_out} leaves them out)"
        if n_repeats < _MANY_REPEATS or n_repeats <= _MANY_REPEATS_SHARE * n_frames:
            return ""
        rate_fps = self.info.fps * (1.0 - n_repeats / n_frames)
        return (
            f"{n_repeats} of {n_frames} frames are duplicates: the video has about "
            f"{rate_fps:.2g} new frames a second, not {self.info.fps:.4g}; the model skips "
            f"the duplicates ({argument('repeats', 'keep')} processes them)"
        )

    def _look(self, image: Image) -> None:
        """Note the darkest and the brightest sample, see `_too_dark_or_bright`."""
        is_clear = self._brightest > 1 if image.dtype == np.uint8 else image.dtype != np.uint16
        if not is_clear:
            self._darkest = min(self._darkest, int(image.min()))
            self._brightest = max(self._brightest, int(image.max()))

    def _too_dark_or_bright(self) -> str:
        (black, white), darkest, brightest = self.info.levels, self._darkest, self._brightest
        if white == 255 and brightest == 1:
            return "all samples of 8 bits are 0 or 1, where white is 255; multiply them by 255"
        if self._bit_depth:
            cut_by = argument("bit_depth", self._bit_depth)
            too_bright = f"samples up to {brightest} are cut off at white by {cut_by}"
            return too_bright if brightest > white else ""
        bits = max(8, brightest.bit_length())
        if self.info.bits != 16 or brightest in (0, black, darkest):
            return ""
        if _NARROW * (brightest - darkest) < 1 << bits:  # such as the counts of a thermal camera
            why = f"all samples of 16 bits are from {darkest} to {brightest}, almost equal"
            spread = f"dlgmd_cli.run((images - {darkest}) / {brightest - darkest})"
            return f"{why}; spread them over the range from 0 to 1, in Python by {spread}"
        if bits > _FEW_BITS:
            return ""
        why = f"all samples of 16 bits are {brightest} or less, where white is {white}"
        return f"{why}; if the camera has {bits} bits, give {argument('bit_depth', bits)}"

    def _lost_frames(self, times: Sequence[float]) -> Loss:
        """What a whole input has lost, see `lost_frames`."""
        path, is_damaged = Path(self.info.path), self._decoder.is_damaged
        if self._decoder.kind in DECODERS and path.is_file() and len(times):
            info = replace(self.info, fps=self._file_fps)
            return lost_frames(path, info, times, is_damaged=is_damaged)
        return Loss("the file is cut off or damaged" if is_damaged else "")

    def _ending(self, fault: str, n_short: int | None) -> str:
        n_frames = self.progress.n_decoded
        stated = n_frames + n_short if n_short else self.info.n_frames
        of_stated = f" of about {stated}" if stated and stated > n_frames else ""
        until = f"{self.progress.last_time_s:.3f} s"
        return f"{fault}; decoded and used {n_frames}{of_stated} frames, up to {until}"

    def frames(
        self,
        *sizes_wh: tuple[int, int],
        small: bool = False,
        picture_wh: tuple[int, int] | None = None,
    ) -> Iterator[Frame]:
        """The chosen frames in order.

        Parameters
        ----------
        sizes_wh : (int, int)
            Width and height of the frames, in px; the video's `size_wh` unless given. For several
            sizes, `Frame.at` returns the frame at each.
        small : bool
            Also give the image that the expansion is measured on.
        picture_wh : (int, int), optional
            Also give each frame's image for display, at this size in px.
        """
        first, *others = dict.fromkeys(sizes_wh) or [self.size_wh]
        of_small = small_wh(*self.source_wh) if small else first
        sizes, reducer = {first, *others, of_small}, Reducer()
        for picture in self.pictures():
            image, levels = picture.image, self.info.levels
            greys = grey_at_sizes(image, sizes, levels, reducer)
            yield Frame(
                picture.index,
                picture.time_s,
                greys[first],
                picture.is_repeat,
                picture.after_gap,
                picture=None if picture_wh is None else to_bgr(image, picture_wh, levels),
                small=greys[of_small] if small else None,
                others={size_wh: greys[size_wh] for size_wh in others},
            )

    def hidden(self, size_wh: tuple[int, int] | None = None) -> npt.NDArray[np.bool_] | None:
        """The cells that the mask hides, (H, W) bool, for `Model.ignore`; None if there are none.

        The size is the video's `size_wh` unless another is given.
        """
        return self.region.hidden(size_wh or self.size_wh)

    def __iter__(self) -> Iterator[Frame]:
        return self.frames(small=True)  # as `Alarm.step` needs them

    def close(self) -> None:
        """Free the input; may be called twice."""
        self._decoder.close()

    def __enter__(self) -> "Video":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True)
class KeptFrames:
    """A file of frames of one size and type, which several processes map into memory.

    `kind` is the data type of one frame.
    """

    path: Path
    kind: np.dtype[np.void]

    @classmethod
    def write(
        cls, path: Path, frames: Iterable[Frame], on_frame: Callable[[int], None]
    ) -> "KeptFrames":
        """Write frames, at least one, except for duplicates; `on_frame` gets the number done."""
        with path.open("wb") as file:
            for frame in frames:
                cancel.check()
                if frame.is_repeat:
                    continue
                image = ("grey", frame.grey.dtype, frame.grey.shape)
                facts = [("frame", np.int64), ("time_s", np.float64), ("after_gap", np.bool_)]
                kind = np.dtype([*facts, image], align=True)
                row = frame.index, frame.time_s, frame.after_gap, frame.grey
                file.write(np.array(row, kind).tobytes())
                on_frame(frame.index + 1)
        return cls(path, kind)

    def rows(self) -> npt.NDArray[np.void]:
        """Number, time, gap flag and image of each frame, mapped into memory."""
        return np.asarray(np.memmap(self.path, self.kind, mode="r"))

    def __iter__(self) -> Iterator[Frame]:
        for row in self.rows():
            is_gap = bool(row["after_gap"])
            yield Frame(int(row["frame"]), float(row["time_s"]), row["grey"], after_gap=is_gap)


@contextmanager
def read_ahead(
    items: Iterable[ItemT], depth: int = 3, together: int = 1
) -> Iterator[Iterator[ItemT]]:
    """A context that yields the items in order while a thread fetches items in advance.

    The thread hands over `together` items at a time, and is up to `depth` such batches ahead. An
    exception from the iterable is raised after the items before it. Leaving the context waits for
    the batch being fetched and fetches no more. If the system refuses another thread, the caller's
    thread fetches the items.
    """
    iterator = iter(items)
    pool = ThreadPoolExecutor(1, thread_name_prefix="dlgmd-decode")

    def fetched() -> tuple[list[ItemT], Exception | None]:
        batch: list[ItemT] = []
        try:
            batch.extend(islice(iterator, together))
        except Exception as error:
            return batch, error
        return batch, None

    def in_order() -> Iterator[ItemT]:
        try:
            waiting = deque(pool.submit(fetched) for _ in range(depth))
        except RuntimeError:  # no thread could be started, and no item was fetched
            yield from iterator
            return
        while True:
            batch, error = waiting.popleft().result()
            waiting.append(pool.submit(fetched))
            yield from batch
            if error is not None:
                raise error
            if len(batch) < together:
                return

    try:
        yield in_order()
    finally:
        pool.shutdown(cancel_futures=True)
