"""The files of results: their names, what they hold, and what writes them.

A run, a comparison and layers may share a folder, so everything that writes, replaces, resumes or
documents their files reads this list. A new file of a run is a line here, and the function that it
names.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from dlgmd_cli.models.columns import ALARMS, ATTENUATION, MP, SPIKES

# The records, which are written last.
RUN, COMPARISON, LAYERS = "run.yaml", "compare.yaml", "layers.yaml"
# The table of a comparison, and the arrays of layers.
COMPARED, LAYER_ARRAYS = "compare.csv", "layers.npz"
FIGURE_FORMATS = ("png", "pdf", "svg")
# The kinds of figures of a run, and those of several results, whose "mp" includes the raster.
DRAWN, DRAWN_TOGETHER = ("mp", "attenuation", "spikes"), ("mp", "attenuation")


@dataclass(frozen=True)
class File:
    """A file of a result.

    Attributes
    ----------
    name : str
        The name; without suffix if the file has `formats`.
    meaning : str
        What it holds, in Markdown, for pages and help.
    writer : str
        The function of `results/writers.py` that writes it, from the result and the path. Empty if
        the outcome itself writes it.
    formats : tuple of str
        The formats, each a suffix, in which it is written if they are asked for. Without any, it is
        always written.
    """

    name: str
    meaning: str
    writer: str = ""
    formats: tuple[str, ...] = ()

    def names(self, formats: Iterable[str]) -> list[str]:
        """The names with which it is written if these formats are asked for."""
        if not self.formats:
            return [self.name]
        return [f"{self.name}.{form}" for form in formats if form in self.formats]

    @property
    def write(self) -> Callable[..., object]:
        """The function that writes it; its module, which imports NumPy, is imported only now."""
        writers = import_module("dlgmd_cli.results.writers")
        function: Callable[..., object] = getattr(writers, self.writer)
        return function


def _figure(name: str, meaning: str) -> File:
    return File(name, meaning, formats=FIGURE_FORMATS)


# Record -> the files of its result, with the record.
FILES: dict[str, tuple[File, ...]] = {
    RUN: (
        File(
            MP,
            "membrane potential (MP), expansion and time to contact of each processed frame",
            "write_frames",
        ),
        File(ATTENUATION, "attenuation of each frame", "write_frames"),
        File(
            SPIKES,
            "whether each frame is a spike, and whether the alarm is on",
            "write_frames",
        ),
        File(ALARMS, "begin, end and image region of each alarm", "write_alarms"),
        *(_figure(kind, "figure of the table of that name, with alarms") for kind in DRAWN),
        File("alarms", "the alarms as captions for a video player", "write_vtt", ("vtt",)),
        File(RUN, "the summary, and all that `--config run.yaml` needs to repeat the run"),
    ),
    COMPARISON: (
        File(COMPARED, "the columns of each model, one below the other"),
        *(_figure(f"compare-{kind}", f"`{kind}` of all models") for kind in DRAWN_TOGETHER),
        File(COMPARISON, "summaries, and the models"),
    ),
    LAYERS: (
        File(LAYER_ARRAYS, "the layers as arrays"),
        _figure("layers", "the layers as images"),
        File(LAYERS, "frames and model"),
    ),
}


def in_words(record: str) -> str:
    """The files of a record with what they hold, in one line."""
    listed = (f"{one.names(one.formats)[0]}: {one.meaning}" for one in FILES[record])
    return "; ".join(listed).replace("`", "")


def formats_of(record: str) -> tuple[str, ...]:
    """The formats that may be asked for: those of figures, and those of a result's other files."""
    more = (form for file in FILES.get(record, ()) for form in file.formats)
    return tuple(dict.fromkeys([*FIGURE_FORMATS, *more]))


def names_of(record: str, formats: Iterable[str] | None = None) -> frozenset[str]:
    """The names of the files of a record, in some formats, or in all."""
    asked = formats_of(record) if formats is None else tuple(formats)
    return frozenset(name for file in FILES[record] for name in file.names(asked))


def written(
    result: Any, record: str, formats: Iterable[str] = ()
) -> dict[str, Callable[[Path], object]]:
    """File name -> function that writes the file, for the files with a `writer`."""
    asked = tuple(formats)
    return {
        name: partial(file.write, result)
        for file in FILES.get(record, ())
        if file.writer
        for name in file.names(asked)
    }
