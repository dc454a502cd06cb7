"""Many flights of one scene, each with its own seed, and their labels."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, OutputExistsError, ResultError
from dlgmd_cli.files import remove_leftovers
from dlgmd_cli.lab.flights.scenes import FlightOptions
from dlgmd_cli.lab.stimuli.base import Scene
from dlgmd_cli.lab.stimuli.clip import (
    DrawSheet,
    check_codec,
    clip_paths,
    identity,
    n_digits,
    refuse_existing_clip,
    write_clip,
)
from dlgmd_cli.pool import results_of
from dlgmd_cli.results.labels import LABELS, Label, read_labels, write_labels
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.results.store import refuse_existing, write_files


@dataclass(frozen=True)
class FlightSet:
    """Flights of one scene in one folder; flight i has the seed `options.seed` + i."""

    scene: Scene[Any]
    options: FlightOptions
    count: int
    folder: Path
    codec: str
    draw_sheet: DrawSheet | None = None

    def __post_init__(self) -> None:
        check_codec(self.codec, self.options)
        self.options_of(self.count - 1)

    @property
    def labels_path(self) -> Path:
        """The file of labels."""
        return self.folder / LABELS

    def options_of(self, number: int) -> FlightOptions:
        """The options of a flight."""
        return replace(self.options, seed=self.options.seed + number)

    def name_of(self, number: int) -> str:
        """Stem of a flight's files."""
        return f"{self.scene.name}-{number:0{n_digits(self.count)}d}"

    def paths_of(self, number: int) -> tuple[Path, ...]:
        """A flight's files: frames, truth, record, and the contact sheet if wanted."""
        has_sheet = self.draw_sheet is not None
        return clip_paths(
            self.scene, self.codec, self.folder, self.name_of(number), sheet=has_sheet
        )

    def present(self) -> dict[int, Label]:
        """Labels, by number, of the flights that exist, are complete and match the options."""
        labels = {}
        for number in range(self.count):
            facts = read_record(self.paths_of(number)[2])
            if facts and not self._differing(number, facts):
                video = self.paths_of(number)[0].name
                labels[number] = Label(video, facts["collision_frame"], facts.get("target", ""))
        return labels

    def check(self, missing: Iterable[int], *, overwrite: bool) -> None:
        """Raise OutputExistsError if files in the way of the flights may not be replaced."""
        for number in missing:
            paths = self.paths_of(number)
            facts = {} if overwrite else read_record(paths[2])
            if facts.keys() & {"scene", "seed"}:
                differing = ", ".join(self._differing(number, facts)[:5])
                raise OutputExistsError(
                    str(paths[2]),
                    f"another flight already exists here ({differing})",
                    "Add --overwrite to replace such flights, or choose another --out.",
                )
            refuse_existing_clip(paths, self.codec, overwrite=overwrite)
        self._check_labels(overwrite=overwrite)

    def render(
        self, numbers: Iterable[int], jobs: int, *, overwrite: bool
    ) -> Iterator[tuple[int, DlgmdError | None]]:
        """Render flights by number; the files do not depend on the number of processes.

        Yields the number of each flight when it is done, with the error if it failed.
        """
        try:
            yield from results_of(partial(self._render, overwrite=overwrite), numbers, jobs)
        finally:
            remove_leftovers(self.folder)  # of workers that were killed

    def _render(self, number: int, *, overwrite: bool) -> None:
        """Render one flight."""
        write_clip(
            self.scene,
            self.options_of(number),
            self.folder,
            self.codec,
            name=self.name_of(number),
            overwrite=overwrite,
            draw_sheet=self.draw_sheet,
        )

    def write_labels(self, labels: dict[int, Label], *, overwrite: bool) -> None:
        """Write the labels; raises OutputExistsError if the file lists other videos."""
        self._check_labels(overwrite=overwrite)
        listed = [labels[number] for number in sorted(labels)]
        write_files(self.folder, {LABELS: partial(write_labels, labels=listed)})

    def _differing(self, number: int, facts: dict[str, Any]) -> list[str]:
        """Differences between a record and the requested flight; empty if it is complete."""
        wanted = identity(self.scene, self.options_of(number), self.codec)
        differing = differences(facts, options=wanted.pop("options"), settings=wanted)
        if differing:
            return [key for key in differing if key != "--seed"]
        frames, truth, _, *sheet = self.paths_of(number)
        if not all(facts.get("sheet") == path.name and path.is_file() for path in sheet):
            return ["without a sheet"]
        is_whole = "collision_frame" in facts and frames.exists() and truth.exists()
        return [] if is_whole else ["damaged"]

    def _check_labels(self, *, overwrite: bool) -> None:
        """Raise OutputExistsError if there is a file of labels that lists other videos."""
        path = self.labels_path
        refuse_existing(path, overwrite=True)
        if overwrite or not path.exists():
            return
        mend = "Add --overwrite to replace it, or choose another --out."
        try:
            listed = read_labels(path)
        except ResultError as error:
            raise OutputExistsError(str(path), error.why, mend) from None
        ours = {self.paths_of(number)[0].name for number in range(self.count)}
        strays = [label.video for label in listed if label.video not in ours]
        if strays:
            raise OutputExistsError(str(path), f"lists other videos, such as {strays[0]}", mend)
