"""Many flights of one scene, each with its own seed, and their labels."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, OutputExistsError, ResultError, argument, overwrite_hint
from dlgmd_cli.machine.files import remove_leftovers
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.results.labels import LABELS, Label, read_labels, write_labels
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.results.store import ClaimedFolder, refuse_existing
from dlgmd_cli.scenes.stimuli.clip import Rendering, check_codec, n_digits

# The kind of footage in the labels.
RENDERED = "rendered"


@dataclass(frozen=True)
class FlightSet:
    """Flights like `like` in its folder; flight i has the seed `like.options.seed` + i.

    Their names are that of `like` with a number.
    """

    like: Rendering
    count: int

    def __post_init__(self) -> None:
        check_codec(self.like.codec, self.like.options)
        self.clip(self.count - 1)

    @property
    def labels_path(self) -> Path:
        """The file of labels."""
        return self.like.folder / LABELS

    def clip(self, number: int) -> Rendering:
        """One of the flights."""
        options = replace(self.like.options, seed=self.like.options.seed + number)
        name = f"{self.like.name}-{number:0{n_digits(self.count)}d}"
        return replace(self.like, options=options, name=name)

    def present(self) -> dict[int, Label]:
        """Labels, by number, of the flights that exist, are complete and match the options."""
        labels = {}
        for number in range(self.count):
            clip = self.clip(number)
            facts = read_record(clip.paths[2])
            if facts and not _differing(clip, facts):
                words = facts.get("target") or "", RENDERED, facts.get("manner", "")
                labels[number] = Label(clip.paths[0].name, facts["collision_frame"], *words)
        return labels

    def check(self, missing: Iterable[int], *, overwrite: bool) -> None:
        """Raise OutputExistsError if files in the way of the flights may not be replaced."""
        for clip in map(self.clip, missing):
            facts = {} if overwrite else read_record(clip.paths[2])
            if facts.keys() & {"scene", "seed"}:
                differing = ", ".join(_differing(clip, facts)[:5])
                raise OutputExistsError(
                    str(clip.paths[2]),
                    f"another flight already exists here ({differing})",
                    overwrite_hint("such flights"),
                )
            clip.refuse_existing(overwrite=overwrite)
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
            remove_leftovers(self.like.folder)  # of workers that were killed

    def _render(self, number: int, *, overwrite: bool) -> None:
        self.clip(number).write(overwrite=overwrite)

    def write_labels(
        self, claim: ClaimedFolder, labels: dict[int, Label], *, overwrite: bool
    ) -> None:
        """Write the labels; raises OutputExistsError if the file lists other videos."""
        self._check_labels(overwrite=overwrite)
        listed = [labels[number] for number in sorted(labels)]
        claim.write({LABELS: partial(write_labels, labels=listed)})

    def _check_labels(self, *, overwrite: bool) -> None:
        """Raise OutputExistsError if there is a file of labels that lists other videos."""
        path = self.labels_path
        refuse_existing(path, overwrite=True)
        if overwrite or not path.exists():
            return
        hint = overwrite_hint()
        try:
            listed = read_labels(path)
        except ResultError as error:
            raise OutputExistsError(str(path), error.why, hint) from None
        ours = {self.clip(number).paths[0].name for number in range(self.count)}
        strays = [label.video for label in listed if label.video not in ours]
        if strays:
            raise OutputExistsError(str(path), f"lists other videos, such as {strays[0]}", hint)


def _differing(clip: Rendering, facts: dict[str, Any]) -> list[str]:
    """Differences between a record and the requested flight; empty if it is complete."""
    wanted = clip.identity()
    differing = differences(facts, options=wanted.pop("options"), settings=wanted)
    if differing:
        return [key for key in differing if key != argument("seed")]
    frames, truth, _, *sheet = clip.paths
    if not all(facts.get("sheet") == path.name and path.is_file() for path in sheet):
        return ["without a sheet"]
    is_whole = "collision_frame" in facts and frames.exists() and truth.exists()
    return [] if is_whole else ["damaged"]
