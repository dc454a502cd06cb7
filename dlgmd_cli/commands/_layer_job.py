"""What `dlgmd layers` computes: the first pass over the input, and what follows from it."""

from typing import TYPE_CHECKING, Any

from dlgmd_cli.commands._console import progress, warn
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.commands._model import ModelChoice
from dlgmd_cli.errors import SourceError
from dlgmd_cli.runs.facts import facts, too_short
from dlgmd_cli.video.frames import InputOptions

if TYPE_CHECKING:
    from dlgmd_cli.models.base import Model
    from dlgmd_cli.plots.film import FilmFacts
    from dlgmd_cli.results.layers import LayerSheet
    from dlgmd_cli.results.tables import Result
    from dlgmd_cli.runs.layers import LayerRecording
    from dlgmd_cli.video.frames import Video


class LayerJob:
    """One input through one model, and what is to be shown of it.

    Attributes
    ----------
    recording : LayerRecording
        What `compute` gathered.
    complete : bool
        Whether no interrupt ended it.
    """

    recording: "LayerRecording"
    complete: bool

    def __init__(
        self,
        input_path: str,
        source: "Video",
        detector: "Model",
        choice: ModelChoice,
        options: InputOptions,
    ) -> None:
        self._name, self._source, self._detector = input_path, source, detector
        self._choice, self._options = choice, options
        self._label = f"{source.info.name} · {choice.label}"
        self._result: Result | None = None
        self._warnings: list[str] = []

    def compute(self, frames: tuple[int, ...], interrupts: Interrupts, *, whole: bool) -> None:
        """Run the model; Ctrl-C ends it, with what was computed kept."""
        from dlgmd_cli.runs import layers as runs

        self.recording = runs.LayerRecording(frames, whole=whole)
        n_expected = self._options.n_expected(self._source.info)
        if not whole:
            n_wanted = max(frames) + 1
            n_expected = n_wanted if n_expected is None else min(n_expected, n_wanted)
        recording = self.recording
        with progress(self._source.info.name, n_expected) as on_frame:
            self.complete = interrupts.ends(
                lambda: runs.run_layers(self._source, self._detector, recording, on_frame),
                lambda: len(recording.shots),
            )

    def draw_conclusions(self) -> None:
        """Read the potential out, for a film; warn; raise SourceError if no frame is left."""
        from dlgmd_cli.results.measures import doubts
        from dlgmd_cli.runs.reading import Reading

        recording, source = self.recording, self._source
        absent = _absent(recording, source, self._options) if self.complete else []
        self._warnings = list(source.progress.warnings)
        if recording.shots:
            self._warnings += absent
        if recording.whole and self.complete and len(recording.responses):
            self._result = Reading(
                recording.responses,
                source.size_wh,
                self._choice.params,
                by_sequence=self._options.by_sequence,
            ).whole()
            self._warnings += doubts(self._result, source.info.decoder)
        for warning in self._warnings:
            warn(f"{self._name}: {warning}")
        if recording.wanted and not recording.shots:
            raise SourceError(self._name, "; ".join(absent), "Choose other frames.")

    def sheet(self) -> "LayerSheet":
        """The frames that were asked for, as far as they are there."""
        from dlgmd_cli.results.layers import LayerSheet

        return LayerSheet.of(self.recording.shots, self._detector.layer_units, self._label)

    def record(self) -> dict[str, Any]:
        """What layers.yaml says."""
        recording = self.recording
        stops_early = not self.complete or (recording.has_all and not recording.whole)
        last = recording.last if stops_early else None
        return {
            **facts(self._source, len(recording.responses), last),
            "model": self._choice.model,
            "engine": self._detector.engine_name,
            **self._choice.params.to_dict(),
            "options": self._options.to_record(),
            "frames": [shot.frame for shot in recording.shots],
            "warnings": self._warnings,
            "complete": self.complete or recording.has_all,
        }

    def film(self) -> "FilmFacts":
        """What the film is to show; raises SourceError if the model never answered."""
        from dlgmd_cli.plots.film import FilmFacts
        from dlgmd_cli.plots.heat import Scale

        recording, source = self.recording, self._source
        if self._result is None or recording.responses.n_valid == 0:
            first_valid = self._detector.first_valid_frame
            raise too_short(self._name, source, self._choice.label, self._options, first_valid)
        width, height = source.size_wh
        return FilmFacts(
            self._result,
            (height, width),
            Scale.over(recording.lowest["s"], recording.highest["s"]),
            Scale.over(recording.lowest["g"], recording.highest["g"]),
            self._detector.layer_units[1:],
            self._label,
        )


def _absent(recording: "LayerRecording", source: "Video", options: InputOptions) -> list[str]:
    """Why frames that were asked for are not there, a line each reason."""
    shown = {shot.frame for shot in recording.shots}
    missing = sorted(recording.wanted - shown)
    last_s, fps = source.progress.last_time_s, source.info.fps
    is_read = options.end is None or last_s + 1.5 / fps < options.end
    n_frames = source.progress.n_decoded
    beyond = [frame for frame in missing if is_read and frame >= n_frames]
    dropped = [frame for frame in missing if frame not in beyond]
    lines = []
    if beyond:
        lines.append(f"{_named(beyond)} not in it; its last one is frame {n_frames - 1}")
    if dropped:
        lines.append(f"{_named(dropped)} left out by --start, --end or --fps")
    return lines


def _named(frames: list[int]) -> str:
    """`frame 3 is` or `frames 3, 5 are`."""
    numbers = ", ".join(str(frame) for frame in frames)
    return f"frame {numbers} is" if len(frames) == 1 else f"frames {numbers} are"
