"""The base of all scenes, and one as a clip: frames, ground truth, record and contact sheet."""

import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import cv2

from dlgmd_cli.errors import OutputExistsError, ParameterError, argument
from dlgmd_cli.frame import GreyImage
from dlgmd_cli.machine import cancel
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.parameters.facts import Record
from dlgmd_cli.results.csv import write_values
from dlgmd_cli.results.record import versions, yaml_text
from dlgmd_cli.results.store import ClaimedFolder, refuse_existing
from dlgmd_cli.video.writer import MAX_TICKS_PER_S, best_codec, encoded_rate, write_video

# The largest even side that MPEG-4 takes.
MAX_SIDE_PX = 8190
MAX_FRAMES = 100_000


def option(
    default: Any, name: str, low: float = -math.inf, high: float = math.inf, **facts: Any
) -> Any:
    """A field of `ClipOptions`: its default, the argument's name, and what `Spec` takes.

    The default None leaves the choice to the scene.
    """
    spec = Spec(low=low, high=high, **facts)
    return field(default=default, metadata={"name": name, "spec": spec})


def invalid(name: str, why: str, hint: str = "") -> ParameterError:
    """The error for the value of one option."""
    return ParameterError("", why, hint, name)


@dataclass(frozen=True)
class ClipOptions:
    """Options of every clip, checked on construction.

    `shape` is (height, width) in px. `n_frames` is the length; None leaves it to the scene.
    `fov_deg` is the horizontal field of view of a pinhole camera with square pixels. `seed`
    determines everything random.
    """

    shape: tuple[int, int] = option((270, 480), "size", 16, MAX_SIDE_PX, unit="px", kind=int)
    fps: float = option(30.0, "fps", 1, 600)
    n_frames: int | None = option(None, "frames", 1, MAX_FRAMES, kind=int)
    fov_deg: float = option(60.0, "fov", 1, 170, unit="degrees")
    seed: int = option(0, "seed", 0, 2**63 - 1, kind=int)

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            name, spec = each.metadata["name"], each.metadata["spec"]
            is_tuple = isinstance(each.default, tuple)
            values = tuple(value) if isinstance(value, tuple | list) else (value,)
            if not is_tuple and len(values) != 1:
                raise invalid(name, f"the scene takes one value, not {len(values)}")
            if values != (None,) or each.default is not None:
                try:
                    values = tuple(spec.check(number) for number in values)
                except ParameterError as error:
                    unit = "" if spec.unit == "–" else f" {spec.unit}"
                    raise invalid(name, error.why, f"Choose {spec.allowed}{unit}.") from None
            object.__setattr__(self, each.name, values if is_tuple else values[0])
        if len(self.shape) != 2:
            raise invalid("size", "it needs a height and a width")

    def to_dict(self) -> dict[str, Any]:
        """Option -> value for records; their names have dashes, such as `object-size`."""
        names = {each.name: each.metadata["name"].replace("_", "-") for each in fields(self)}
        values = {recorded: getattr(self, name) for name, recorded in names.items()}
        height, width = self.shape
        return {**values, "size": f"{width}x{height}"}

    @property
    def focal_px(self) -> float:
        """Focal length of the camera, in px."""
        return self.shape[1] / 2 / math.tan(math.radians(self.fov_deg) / 2)


OptionsT = TypeVar("OptionsT", bound=ClipOptions)


@dataclass(eq=False)
class Scene(ABC, Generic[OptionsT]):
    """A stimulus that can be rendered.

    Attributes
    ----------
    name, description : str
        Name on the command line, also the stem of its files; and a line for the list.
    defaults : ClipOptions
        The options with their defaults.
    truth_type : type
        The dataclass of a frame's ground truth; its fields are the columns of the CSV.
    is_flight : bool
        Flights have a `record`, and a video that most players support. The videos of other scenes
        are the same on every machine.
    """

    truth_type: ClassVar[type]
    is_flight: ClassVar[bool] = False
    name: str
    description: str
    defaults: OptionsT

    def configure(self, given: Mapping[str, Any]) -> OptionsT:
        """The defaults with some options replaced, by name, such as ``{"speed": 2.0}``.

        Raises ParameterError if the scene has no such option, or cannot be rendered with these
        values.
        """
        names = {each.metadata["name"]: each.name for each in fields(self.defaults)}
        for name in given:
            if name not in names:
                hint = f"It takes {', '.join(map(argument, names))}."
                raise ParameterError(argument(name), f"{self.name} has no such option", hint)
        options = replace(self.defaults, **{names[name]: value for name, value in given.items()})
        self.n_frames(options)
        return options

    @abstractmethod
    def n_frames(self, options: OptionsT) -> int:
        """Number of frames; raises ParameterError if the scene cannot be rendered like that."""

    @abstractmethod
    def frames(self, options: OptionsT) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8; every call gives the same."""

    @abstractmethod
    def truth(self, options: OptionsT) -> Iterator[Any]:
        """The ground truth of each frame, a `truth_type`; NaN where undefined."""

    def record(self, options: OptionsT) -> Record:
        """Properties of the whole clip, as YAML data."""
        return {}


N_STILLS = 12
_SUFFIXES = {"mpeg4": ".mp4", "h264": ".mp4", "ffv1": ".avi", "png": ""}
# Least number of digits in a numbered name.
_N_DIGITS = 4
_PICTURE = re.compile(r"\d{4,}\.png", re.ASCII)


def choose_codec(*, lossless: bool = False, png: bool = False, playable: bool = False) -> str:
    """How frames are stored: as "png" (a folder of images), "ffv1", or a lossy video.

    A `playable` video is "h264" if an encoder is installed, since most players support it; any
    other is "mpeg4".
    """
    if png or lossless:
        return "png" if png else "ffv1"
    return best_codec() if playable else "mpeg4"


def check_codec(codec: str, options: ClipOptions) -> None:
    """Raise ParameterError if a video cannot store the exact size or frame rate."""
    if codec == "png":
        return
    height, width = options.shape
    if height % 2 or width % 2:  # OpenCV would cut off a row or a column, silently
        why = f"{width}x{height} is odd, and a video needs an even width and height"
        hint = f"Choose {width + width % 2}x{height + height % 2}, or {argument('png')}."
        raise invalid("size", why, hint)
    if codec == "h264":
        if not math.isclose(encoded_rate(options.fps), options.fps, rel_tol=1e-6):
            raise invalid("fps", f"H.264 cannot hold {options.fps!r}", "Choose another.")
        return
    rounded = round(options.fps, 3)
    if rounded != options.fps:
        why = f"{options.fps!r} has more than three decimals, which this video does not keep"
        raise invalid("fps", why, f"Choose {rounded:g}, or {argument('png')}.")
    if codec == "mpeg4" and Fraction(str(rounded)).numerator > MAX_TICKS_PER_S:
        why = f"MPEG-4 cannot hold {rounded:g}"
        raise invalid("fps", why, f"Choose fewer decimals, or {argument('lossless')}.")


@dataclass(frozen=True)
class ContactSheet:
    """Selected frames of a clip, with its properties.

    The images, (H, W) uint8, are as rendered, without losses by a video codec; `rows` holds the
    ground truth of each. `n_frames` is the length of the whole clip, `record` is `Scene.record`.
    """

    name: str
    options: ClipOptions
    n_frames: int
    record: Record
    images: Sequence[GreyImage]
    rows: Sequence[Any]


# Draws a contact sheet into a PNG file.
DrawSheet = Callable[[ContactSheet, Path], None]


@dataclass(frozen=True)
class Rendering:
    """A scene to be rendered to ``folder/NAME.mp4``, and its ground truth to ``folder/NAME.csv``.

    A flight also gets ``folder/NAME.yaml`` with its options, phases and collision.

    Attributes
    ----------
    codec : str
        See `choose_codec`.
    name : str
        Stem of the files.
    draw_sheet : callable, optional
        Draws the contact sheet ``NAME-sheet.png``; without it there is none.
    """

    scene: Scene[Any]
    options: ClipOptions
    folder: Path
    codec: str
    name: str
    draw_sheet: DrawSheet | None = None

    @property
    def paths(self) -> tuple[Path, ...]:
        """Its files: frames, truth, the record of a flight, and the sheet if wanted."""
        ends = [_SUFFIXES[self.codec], ".csv"]
        ends += [".yaml"] if self.scene.is_flight else []
        ends += ["-sheet.png"] if self.draw_sheet is not None else []
        return tuple(self.folder / f"{self.name}{end}" for end in ends)

    def identity(self) -> Record:
        """Everything that determines the files."""
        return {
            "scene": self.scene.name,
            "seed": self.options.seed,
            "options": self.options.to_dict(),
            "codec": self.codec,
            "versions": versions(*(["pyav"] if self.codec == "h264" else [])),
        }

    def refuse_existing(self, *, overwrite: bool) -> None:
        """Raise OutputExistsError if a file already exists and may not be replaced."""
        frames, *others = self.paths
        if self.codec != "png":
            others.insert(0, frames)
        elif os.path.lexists(frames):
            why, hint = "", f"Choose another {argument('out')}."
            if frames.is_symlink() or not frames.is_dir():
                why = "this is not a folder of images"
            elif strays := [
                entry.name
                for entry in frames.iterdir()
                if not _PICTURE.fullmatch(entry.name) or not entry.is_file()
            ]:
                why = f"this folder holds other files, such as {min(strays)}"
            elif not overwrite:
                why, hint = "already exists", f"Add {argument('overwrite', True)} to replace it."
            if why:
                raise OutputExistsError(str(frames), why, hint)
        for path in others:
            refuse_existing(path, overwrite=overwrite)

    def write(
        self,
        *,
        overwrite: bool = False,
        on_frame: Callable[[int], None] = lambda n_rendered: None,
    ) -> tuple[Path, ...]:
        """Render and write all files into the folder, which is claimed; returns `paths`.

        Parameters
        ----------
        overwrite : bool
            Replace earlier files. A folder with files other than numbered images is never
            replaced.
        on_frame : callable, optional
            Called after each frame with the number of frames rendered.

        Raises
        ------
        ParameterError
            If the scene cannot be rendered, or a video cannot store it, with these options.
        OutputExistsError, OutputError
            If a file may not be replaced, or cannot be written.
        Interrupted
            If the user asks to stop. Incomplete files are removed.
        """
        scene, options, paths = self.scene, self.options, self.paths
        n_frames = scene.n_frames(options)
        check_codec(self.codec, options)
        self.refuse_existing(overwrite=overwrite)
        facts = scene.record(options)
        chosen = chosen_frames(n_frames, facts.get("collision_frame"))
        stills: dict[int, GreyImage] = {}
        # The truth of an earlier clip must never stand beside the images of this one.
        record = paths[2 if scene.is_flight else 1].name
        with ClaimedFolder(self.folder, record).staged(what=paths[0]) as stage:
            temporary = [stage / path.name for path in paths]
            images = _watched(scene.frames(options), chosen, stills, on_frame)
            if self.codec == "png":
                _write_pictures(temporary[0], images, n_digits(n_frames))
            else:
                shape, fps = options.shape, options.fps
                write_video(temporary[0], images, shape, fps, codec=self.codec, target=paths[0])
            rows = list(scene.truth(options))
            write_truth(temporary[1], scene.truth_type, rows)
            if scene.is_flight:
                drawn = {} if self.draw_sheet is None else {"sheet": paths[-1].name}
                first = {"scene": scene.name, "seed": options.seed, **facts}
                document = {**first, **drawn, **self.identity()}
                temporary[2].write_text(yaml_text(document), encoding="utf-8")
            if self.draw_sheet is not None:
                shown = [rows[index] for index in stills]
                sheet = ContactSheet(self.name, options, n_frames, facts, [*stills.values()], shown)
                self.draw_sheet(sheet, temporary[-1])
        return paths


def write_truth(path: Path, columns: type, rows: Iterable[Any]) -> None:
    """Write ground truth as CSV with the fields of a dataclass as columns; NaN is left empty."""
    names = [field.name for field in fields(columns)]
    write_values(path, names, ([getattr(row, name) for name in names] for row in rows))


def chosen_frames(n_frames: int, collision_frame: int | None = None) -> tuple[int, ...]:
    """Frames for a contact sheet: the first, the last, the collision, and others evenly between.

    Spacing may differ before and after the collision, so that its frame is included.
    """
    if n_frames <= N_STILLS:
        return tuple(range(n_frames))
    last, n_steps = n_frames - 1, N_STILLS - 1
    middle = collision_frame or 0
    if not 0 < middle < last:
        return tuple(_evenly(0, last, n_steps))
    n_before = min(max(1, round(middle * n_steps / last)), n_steps - 1)
    return (*_evenly(0, middle, n_before)[:-1], *_evenly(middle, last, n_steps - n_before))


def n_digits(count: int) -> int:
    """Number of digits to number `count` files from 0."""
    return max(_N_DIGITS, len(str(count - 1)))


def _evenly(first: int, last: int, n_steps: int) -> list[int]:
    """Numbers from `first` to `last`, both included, in steps that differ by 1 at most."""
    return [first + step * (last - first) // n_steps for step in range(n_steps + 1)]


def _watched(
    frames: Iterable[GreyImage],
    chosen: Collection[int],
    stills: dict[int, GreyImage],
    on_frame: Callable[[int], None],
) -> Iterator[GreyImage]:
    """Pass the frames on, report their number, and copy the `chosen` ones into `stills`."""
    for index, frame in enumerate(frames):
        cancel.check()
        if index in chosen:
            stills[index] = frame.copy()
        yield frame
        on_frame(index + 1)


def _write_pictures(folder: Path, frames: Iterable[GreyImage], digits: int) -> None:
    """Write frames, (H, W) uint8 each, as numbered PNG; OSError passes through."""
    folder.mkdir()
    for index, frame in enumerate(frames):
        # cv2.imwrite would not report a full disk.
        encoded = cv2.imencode(".png", frame)[1].tobytes()
        (folder / f"{index:0{digits}d}.png").write_bytes(encoded)
