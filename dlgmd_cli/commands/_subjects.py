"""What a sweep's models look at: cubes that move sideways, or the user's input."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import click

from dlgmd_cli.commands._console import progress
from dlgmd_cli.commands._input import choose_input
from dlgmd_cli.commands._types import OptionGroup
from dlgmd_cli.errors import DlgmdError, ParameterError
from dlgmd_cli.runs.facts import facts, too_short
from dlgmd_cli.video.frames import InputOptions

if TYPE_CHECKING:
    from dlgmd_cli.runs.spool import Spool, Tape
    from dlgmd_cli.runs.sweep import Attenuation, ResponseMeasures
    from dlgmd_cli.video.frames import Video as OpenVideo

SCENE = "translating-cubes"
DEFAULT_SPEEDS_PX, DEFAULT_SIDE_PX, DEFAULT_SIZE = (1.0, 2.0, 3.0, 4.0), 40.0, (200, 150)
MAX_FRAMES = 75

cube_options = OptionGroup(
    "cubes",
    dict,
    click.option(
        "--speed",
        type=float,
        multiple=True,
        metavar="V",
        help="Without INPUT: speed of a cube in px/frame; repeatable.  [default: 1, 2, 3 and 4]",
    ),
    click.option(
        "--cube-size",
        "--object-size",
        "cube_size",
        type=float,
        metavar="S",
        help=f"Without INPUT: side of the cubes in px.  [default: {DEFAULT_SIDE_PX:g}]",
    ),
    click.option(
        "--frames",
        type=int,
        metavar="N",
        help="Without INPUT: length of each clip.  [default: an odd number, so that cubes meet "
        f"whole pixels; as many as the fastest is in sight, {MAX_FRAMES} at most]",
    ),
)


class Subject(Protocol):
    """What is looked at.

    Attributes
    ----------
    name : str
        What results are called.
    size_wh : (int, int)
        Width and height of the frames that models see, in px.
    speeds_px : tuple of float
        Of each clip, the speed of its cube; empty for an input.
    decoder : tuple of str
        What decodes it, if anything does.
    """

    @property
    def name(self) -> str: ...

    @property
    def size_wh(self) -> tuple[int, int]: ...

    @property
    def speeds_px(self) -> tuple[float, ...]: ...

    @property
    def decoder(self) -> tuple[str, ...]: ...

    def settings(self) -> dict[str, Any]:
        """All that a result depends on, and models do not."""
        ...

    def measure(self) -> "Attenuation | ResponseMeasures":
        """What is measured."""
        ...

    def spool(self, spool: "Spool") -> dict[str, Any]:
        """Take all frames down; returns what the record says of them."""
        ...

    def too_short(self, tape: "Tape", label: str, n_needed: int) -> DlgmdError:
        """The error for too few frames."""
        ...


class Cubes:
    """Black cubes over white, each alone in its clip; see `Subject`."""

    name = SCENE
    decoder: tuple[str, ...] = ()

    def __init__(self, given: dict[str, Any], size: tuple[int, int] | None) -> None:
        from dlgmd_cli.flights.scenes import SCENES

        self.size_wh = size or DEFAULT_SIZE
        self.speeds_px = tuple(dict.fromkeys(given["speed"])) or DEFAULT_SPEEDS_PX
        self._scene = SCENES[SCENE]
        self._flags: dict[str, Any] = {
            "--size": (self.size_wh[1], self.size_wh[0]),
            "--object-size": DEFAULT_SIDE_PX if given["cube_size"] is None else given["cube_size"],
            "--contrast": -1.0,
            "--background": 1.0,
            "--frames": given["frames"],
        }
        if given["frames"] is None:
            self._flags["--frames"] = self._n_in_sight()
        self._clips = [self._configured(speed) for speed in self.speeds_px]

    def _configured(self, speed_px: float) -> Any:
        """The scene's options for one clip."""
        return self._scene.configure({**self._flags, "--speed": (speed_px,)})

    def _n_in_sight(self) -> int:
        """How many frames every cube is in sight."""
        longest = [self._scene.n_frames(self._configured(speed)) for speed in self.speeds_px]
        n_frames = min(*longest, MAX_FRAMES)
        # In the middle halfway, a cube at a whole number of px/frame is otherwise half a pixel off.
        return n_frames - 1 + n_frames % 2

    def settings(self) -> dict[str, Any]:
        """Size, speed and length."""
        return {
            "cubes": {
                "speeds_px": list(self.speeds_px),
                "side_px": self._flags["--object-size"],
                "frames": self._flags["--frames"],
                "width": self.size_wh[0],
                "height": self.size_wh[1],
            }
        }

    def measure(self) -> "Attenuation":
        """Attenuation alone."""
        from dlgmd_cli.runs.sweep import Attenuation

        return Attenuation()

    def spool(self, spool: "Spool") -> dict[str, Any]:
        """Render every clip."""
        from dlgmd_cli.video.frames import Frame

        for options in self._clips:
            pictures = enumerate(self._scene.frames(options))
            spool.add(Frame(index, index / options.fps, picture) for index, picture in pictures)
        return {}

    def too_short(self, tape: "Tape", label: str, n_needed: int) -> ParameterError:
        """Blames the number of frames, or what it follows from."""
        n_frames = tape.lengths[0]
        return ParameterError(
            "--frames",
            f"{n_frames} frame{'s' * (n_frames > 1)} of each cube, but {label} needs at least "
            f"{n_needed}",
            "Choose more of them, slower cubes, or a wider --size.",
        )


class Video:
    """The user's input; see `Subject`."""

    speeds_px: tuple[float, ...] = ()

    def __init__(
        self,
        path: str,
        source: "OpenVideo",
        options: InputOptions,
        false_positive_frame: int | None,
    ) -> None:
        self._path, self._source, self._options = path, source, options
        self._false_positive_frame = false_positive_frame
        self.name, self.size_wh = source.info.name, source.size_wh
        self.decoder = (source.info.decoder,)

    def settings(self) -> dict[str, Any]:
        """Which input, and what is read of it."""
        from dlgmd_cli.video.frames import fingerprint

        return {
            "input": {"path": self._source.info.path, **fingerprint(self._path)},
            "options": self._options.to_record(),
            "processed": list(self.size_wh),
            "false_positive_frame": self._false_positive_frame,
        }

    def measure(self) -> "ResponseMeasures":
        """The response."""
        from dlgmd_cli.runs.sweep import ResponseMeasures

        return ResponseMeasures(self._false_positive_frame)

    def spool(self, spool: "Spool") -> dict[str, Any]:
        """Decode the input once."""
        from dlgmd_cli.runs.single import frames_ahead
        from dlgmd_cli.video.prefetch import opencv_threads

        source = self._source
        n_expected = self._options.n_expected(source.info)
        with (
            progress(self.name, n_expected) as on_frame,
            opencv_threads(1),
            frames_ahead(source) as frames,
        ):
            spool.add(frames, on_frame)
        tape = spool.tape
        warnings = [*source.progress.warnings, *_doubts(tape, source.info.decoder)]
        return {**facts(source, len(tape.frames)), "warnings": warnings}

    def too_short(self, tape: "Tape", label: str, n_needed: int) -> DlgmdError:
        """As `run` says it."""
        return too_short(self._path, self._source, label, self._options, n_needed - 1)


def _doubts(tape: "Tape", decoder: str) -> list[str]:
    """What looks wrong about the input."""
    from dlgmd_cli.models.base import undefined
    from dlgmd_cli.parameters import DlgmdParameters
    from dlgmd_cli.results.measures import Summary
    from dlgmd_cli.runs.reading import Reading
    from dlgmd_cli.runs.recording import Recording

    recording = Recording()
    for frame, p_sum in zip(tape.frames, tape.p_sums, strict=True):
        recording.append(frame, undefined(p_sum))
    reading = Reading(recording, (1, 1), DlgmdParameters(), by_sequence=False)
    return Summary.of(reading).doubts(decoder)


@dataclass(frozen=True)
class Asked:
    """What the options say of a subject, checked for sense together."""

    input_path: str | None
    cubes: dict[str, Any]
    given: dict[str, Any]
    false_positive_frame: int | None

    def __post_init__(self) -> None:
        if self.input_path is None:
            wrong = {name for name, value in self.given.items() if value is not None} - {"size"}
            if self.false_positive_frame is not None:
                wrong.add("false_positive_frame")
            why = "is of an INPUT, and there is none. Give one, or leave it out."
        else:
            wrong = {name for name, value in self.cubes.items() if value not in (None, ())}
            why = "is of the cubes that are shown without INPUT. Leave it out."
        if wrong:
            raise click.UsageError(f"--{min(wrong).replace('_', '-')} {why}")

    @contextmanager
    def open(self, recorded: dict[str, Any], origin: str) -> Iterator[tuple[Subject, InputOptions]]:
        """The subject, and what is read of it; `recorded` options are the file `origin`'s."""
        if self.input_path is None:
            yield Cubes(self.cubes, self.given["size"]), InputOptions()
            return
        options = choose_input(self.given, recorded, origin)
        with options.open(self.input_path) as source:
            yield Video(self.input_path, source, options, self.false_positive_frame), options
