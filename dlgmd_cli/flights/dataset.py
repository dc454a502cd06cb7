"""Many flights of one scene, each from a seed of its own, and what they are labelled with."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, OutputExistsError, ResultError
from dlgmd_cli.flights.scene import FlightOptions, FlightScene
from dlgmd_cli.results.files import appearing, refuse_existing
from dlgmd_cli.results.labels import LABELS, Label, read_labels, write_labels
from dlgmd_cli.results.record import read_document
from dlgmd_cli.stimuli.encode import (
    DrawSheet,
    clip_paths,
    identity,
    refuse_standing,
    sheet_path,
    write_clip,
)
from dlgmd_cli.stimuli.form import Form, n_digits

# The number of a flight, and what went wrong with it if anything did.
Ending = tuple[int, DlgmdError | None]
Render = Callable[[int], DlgmdError | None]
# What shares tasks out, given what makes the one who does them: a pool of processes, or one.
Pool = Callable[
    [Callable[[], Render]], AbstractContextManager[Callable[[Iterable[int]], Iterator[Ending]]]
]


@dataclass(frozen=True)
class Fleet:
    """Flights of one scene in one folder; number i has the seed of `options`, and i more.

    Attributes
    ----------
    scene : FlightScene
        What they are flights of.
    options : FlightOptions
        Of the first; the others differ in the seed.
    count : int
        How many there are.
    folder : Path
        Where they are to be.
    form : Form
        What their frames are kept in.
    draw_sheet : callable or None
        Draws a contact sheet of each; can be pickled.
    """

    scene: FlightScene
    options: FlightOptions
    count: int
    folder: Path
    form: Form
    draw_sheet: DrawSheet | None = None

    def __post_init__(self) -> None:
        self.form.check(self.options)
        self.options_of(self.count - 1)

    @property
    def labels_path(self) -> Path:
        """Where the labels are."""
        return self.folder / LABELS

    def options_of(self, number: int) -> FlightOptions:
        """The options of a flight."""
        return replace(self.options, seed=self.options.seed + number)

    def name_of(self, number: int) -> str:
        """What a flight's files are called."""
        return f"{self.scene.name}-{number:0{n_digits(self.count)}d}"

    def paths_of(self, number: int) -> tuple[Path, ...]:
        """A flight's files: frames, truth, record."""
        return clip_paths(self.scene, self.form, self.folder, self.name_of(number))

    def sheet_of(self, number: int) -> Path | None:
        """A flight's contact sheet, None if there is to be none."""
        if self.draw_sheet is None:
            return None
        return sheet_path(self.folder, self.name_of(number))

    def render(self, number: int, *, overwrite: bool) -> DlgmdError | None:
        """Render a flight; what keeps its files from being made is returned, not raised."""
        try:
            write_clip(
                self.scene,
                self.options_of(number),
                self.folder,
                self.form,
                name=self.name_of(number),
                overwrite=overwrite,
                draw_sheet=self.draw_sheet,
            )
        except DlgmdError as error:
            return error
        return None


@dataclass
class Standing:
    """What of a fleet is there, whole and as it is asked for.

    Attributes
    ----------
    labels : dict of int to Label
        By number of the flight.
    """

    fleet: Fleet
    labels: dict[int, Label] = field(default_factory=dict)

    @classmethod
    def of(cls, fleet: Fleet) -> "Standing":
        """What is there now."""
        found = cls(fleet)
        found.update()
        return found

    def update(self) -> None:
        """See which of the missing ones are there by now."""
        for number in self.missing:
            self._look(number)

    @property
    def missing(self) -> list[int]:
        """The flights that are not."""
        return [number for number in range(self.fleet.count) if number not in self.labels]

    def check(self, *, overwrite: bool) -> None:
        """Raise OutputExistsError if what is no flight of these may not be replaced."""
        for number in self.missing:
            paths, sheet = self.fleet.paths_of(number), self.fleet.sheet_of(number)
            facts = read_document(paths[-1]) if not overwrite else {}
            if facts.keys() & {"scene", "seed"}:
                differing = ", ".join(_differing(self.fleet, number, facts)[:5])
                lacking = "without a sheet" if _lacks_sheet(sheet, facts) else "damaged"
                raise OutputExistsError(
                    str(paths[-1]),
                    f"another flight stands here ({differing or lacking})",
                    "Add --overwrite to replace such flights, or choose another --out.",
                )
            every = paths if sheet is None else (*paths, sheet)
            refuse_standing(every, self.fleet.form, overwrite=overwrite)
        _check_labels(self.fleet, overwrite=overwrite)

    def write_labels(self, *, overwrite: bool) -> None:
        """Write the labels of all that is there.

        Raises
        ------
        OutputExistsError
            If labels of other videos stand there and may not be replaced.
        OutputError
            If it cannot be written.
        """
        _check_labels(self.fleet, overwrite=overwrite)
        labels = [self.labels[number] for number in sorted(self.labels)]
        with appearing(self.fleet.labels_path) as (path,):
            write_labels(path, labels)

    def _look(self, number: int) -> None:
        """See whether a flight is there."""
        frames, truth, record = self.fleet.paths_of(number)
        if not (frames.exists() and truth.exists()):
            return
        facts = read_document(record)
        frame = facts.get("collision_frame", "unsaid")
        is_said = frame is None or (type(frame) is int and frame >= 0)
        if _lacks_sheet(self.fleet.sheet_of(number), facts):
            return
        if is_said and not _differing(self.fleet, number, facts):
            self.labels[number] = Label(frames.name, frame)


def render_flights(
    fleet: Fleet, numbers: Iterable[int], pool: Pool, *, overwrite: bool = False
) -> Iterator[Ending]:
    """Render flights; the files do not depend on who does it.

    Parameters
    ----------
    fleet : Fleet
        What they are flights of.
    numbers : iterable of int
        Which.
    pool : callable
        What shares them out, such as `runs.workers.here`.
    overwrite : bool
        Replace what stands in the way.

    Yields
    ------
    (int, DlgmdError or None)
        Number of a flight, as it is done, and what went wrong with it.
    """
    with pool(partial(_renderer, fleet, overwrite)) as answers:
        yield from answers(numbers)


def _renderer(fleet: Fleet, overwrite: bool) -> Render:
    """What renders flights, by their numbers, in one process."""
    return partial(fleet.render, overwrite=overwrite)


def _lacks_sheet(sheet: Path | None, facts: dict[str, Any]) -> bool:
    """Whether a sheet is asked for, and none was drawn together with the flight of a record."""
    return sheet is not None and not (facts.get("sheet") == sheet.name and sheet.is_file())


def _differing(fleet: Fleet, number: int, facts: dict[str, Any]) -> list[str]:
    """Which settings in a record are not those of a flight."""
    wanted = identity(fleet.scene, fleet.options_of(number), fleet.form)
    options, found = wanted.pop("options"), facts.get("options")
    differing = [key for key, value in wanted.items() if facts.get(key) != value]
    if not isinstance(found, dict):
        found = {}
    return differing + [
        f"--{key}"
        for key in {**options, **found}
        if key != "seed" and options.get(key, ...) != found.get(key, ...)
    ]


def _check_labels(fleet: Fleet, *, overwrite: bool) -> None:
    """Raise OutputExistsError if labels of other videos stand where the fleet's are to be."""
    path = fleet.labels_path
    refuse_existing(path, overwrite=True)
    if overwrite or not path.exists():
        return
    mend = "Add --overwrite to replace it, or choose another --out."
    try:
        listed = read_labels(path)
    except ResultError as error:
        raise OutputExistsError(str(path), error.why, mend) from None
    ours = {fleet.paths_of(number)[0].name for number in range(fleet.count)}
    strays = [label.video for label in listed if label.video not in ours]
    if strays:
        raise OutputExistsError(str(path), f"it lists other videos, such as {strays[0]}", mend)
