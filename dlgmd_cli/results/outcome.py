"""`Outcome`: the result of a task; saving, drawing and showing, common to all outcomes."""

import os
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from importlib import import_module
from inspect import signature
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from dlgmd_cli.errors import DlgmdError, MissingExtraError, ParameterError
from dlgmd_cli.parameters.checks import require_known
from dlgmd_cli.parameters.facts import InputFacts, Json
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Cells, Table, table_of, write_values
from dlgmd_cli.results.files import FIGURE_FORMATS, FILES, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 200
# An item that a terminal shows: a line, a path, or a table (header, rows).
Shown = str | Path | tuple[tuple[str, ...], Sequence[tuple[str, ...]]]


def drawn_by(where: str) -> Callable[..., Any]:
    """A function of `plots`, such as ``traces.plot``; Matplotlib is imported only for drawing.

    `plots` imports outcomes; outcomes refer to `plots` only by module name.
    """
    module, _, name = where.partition(".")
    return getattr(import_module(f"dlgmd_cli.plots.{module}"), name)


def as_html(items: Iterable[Shown], figure: "Figure") -> str:
    """The tables that a terminal shows, and a figure, for a notebook."""
    parts = []
    for _, rows in (item for item in items if isinstance(item, tuple)):
        cells = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows)
        parts.append(f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>")
    image = BytesIO()
    figure.savefig(image, format="png", dpi=100)
    encoded = b64encode(image.getvalue()).decode("ascii")
    return "".join([*parts, f'<img alt="" src="data:image/png;base64,{encoded}">'])


class Outcome:
    """The result of a task. A subclass declares its files and contents; this class does the rest.

    Attributes
    ----------
    RECORD : str
        The name of the record, which is written last; may be empty.
    TABLES : tuple of str
        The names of the tables, the main table first.
    FIGURES : dict of str to str
        Kind of figure -> function that draws it, see `drawn_by`. `plot` draws the first by default.
    WRITTEN : tuple of str
        The kinds of figures that are written to files; all unless given.
    STEM : str
        The name of a figure's file without suffix; the kind fills in the placeholder.
    paths : tuple of Path
        The folder that was written, or the files.
    failure : DlgmdError or None
        The error because of which the outcome is not as requested.
    """

    RECORD: ClassVar[str] = ""
    TABLES: ClassVar[tuple[str, ...]] = ()
    FIGURES: ClassVar[Mapping[str, str]] = {}
    WRITTEN: ClassVar[tuple[str, ...]] = ()
    STEM: ClassVar[str] = "{}"
    paths: tuple[Path, ...] = ()
    failure: DlgmdError | None = None

    @property
    def complete(self) -> bool:
        """Whether the task ran to its end, over the whole input."""
        return True

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped the task."""
        return False

    def cells(self) -> Cells:
        """File name -> columns and rows (texts and numbers) of a table; the main table first."""
        return {}

    def tables(self) -> dict[str, store.Write]:
        """File name -> function that writes the table."""
        tables = self.cells().items()
        return {k: partial(write_values, header=header, rows=rows) for k, (header, rows) in tables}

    def record_text(self) -> str:
        """The text of the record."""
        raise NotImplementedError

    def figure_names(self) -> dict[str, str]:
        """Kind of each figure that is written -> file name without suffix."""
        return {kind: self.STEM.format(kind) for kind in self.WRITTEN or self.FIGURES}

    @classmethod
    def own_files(cls, formats: Iterable[str]) -> list[str]:
        """The names of all files, with figures in `formats`, known before there is an outcome."""
        figures = [f"{cls.STEM.format(kind)}.{form}" for kind in cls.FIGURES for form in formats]
        return [*cls.TABLES, *figures, cls.RECORD]

    def identity(self) -> InputFacts:
        """The identity of the input, see `store.check`."""
        return {}

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: the paths of the files."""
        yield from self.paths

    def facts(self) -> dict[str, Json]:
        """The JSON object: the paths of the files; None for undefined values."""
        return {"paths": [str(path) for path in self.paths]}

    def kept(self) -> str:
        """The sentence that says what exists after an interruption."""
        return f"{self.paths[0]} holds the whole result" if self.paths else "Nothing was written"

    @property
    def table(self) -> Table:
        """The main table: a structured array, shape (n,), with the columns of its CSV."""
        return table_of(*next(iter(self.cells().values())))

    def to_dataframe(self) -> Any:
        """The main table as a pandas DataFrame; raises MissingExtraError without pandas."""
        try:
            import pandas as pd
        except ImportError:
            raise MissingExtraError.of("to_dataframe", "pandas") from None
        return pd.DataFrame(self.table)

    def plot(self, kind: str | None = None, **options: Any) -> "Figure":
        """A figure, the first of `FIGURES` by default; `options` go to the drawing function.

        Raises ParameterError if there is no such figure.
        """
        if not self.FIGURES:
            raise ParameterError("", f"{type(self).__name__} has no figure")
        kind = kind or next(iter(self.FIGURES))
        require_known("figure", kind, self.FIGURES)
        if "ax" in options and "ax" not in signature(drawn_by(self.FIGURES[kind])).parameters:
            why = f"the figure {kind!r} has panels of its own, and takes no ax"
            raise ParameterError("", why, "Leave it out.")
        return self.figure(kind, **options)

    def figure(self, kind: str, **options: Any) -> "Figure":
        """Draw a kind of figure."""
        return drawn_by(self.FIGURES[kind])(*self.drawn(kind), **options)

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The arguments of the function that draws a figure."""
        return (self,)

    def files(
        self, formats: Iterable[str] = (), dpi: int | None = None, **options: Any
    ) -> dict[str, store.Write]:
        """File name -> function that writes the file: tables, files in `formats`, record."""
        formats = store.known_formats(formats, self.RECORD)
        files = {**self.tables(), **written(self, self.RECORD, formats)}
        if drawn := tuple(form for form in formats if form in FIGURE_FORMATS):
            files |= self.figure_files(drawn, dpi, **options)
        if self.RECORD:
            files[self.RECORD] = store.file_of(self.record_text())
        return files

    def figure_files(
        self, formats: tuple[str, ...], dpi: int | None, **options: Any
    ) -> dict[str, store.Write]:
        """File name -> function that draws the figure."""
        names = self.figure_names()
        figures = {names[kind]: partial(self.figure, kind, **options) for kind in names}
        return drawn_by("style.figure_files")(figures, formats, dpi or _DPI)

    def write(self, claim: store.ClaimedFolder, files: Mapping[str, store.Write]) -> None:
        """Write the files, see `files`, into a claimed folder."""
        paths = claim.write(files)
        # A result is named by its folder, any other outcome by its files.
        self.paths = (claim.folder,) if self.RECORD in FILES else paths

    def save(
        self,
        folder: str | os.PathLike[str],
        formats: Iterable[str] = (),
        dpi: int | None = None,
        *,
        overwrite: bool = False,
        **options: Any,
    ) -> None:
        """Write the tables, the figures in `formats` ("png", "pdf", "svg"), and the record.

        A `Result` is also written as "vtt": its alarms as captions, in alarms.vtt. `dpi` is the
        resolution of PNG, 200 unless given. A figure that cannot be drawn is left out, with a
        warning.

        Raises
        ------
        OutputExistsError
            If the folder holds other files, or an outcome and `overwrite` is False, or if another
            process is writing there.
        OutputError
            If the folder cannot be written.
        """
        formats = store.known_formats(formats, self.RECORD)
        names = () if self.RECORD in FILES else self.files(formats, dpi, **options)
        where = store.place(folder), self.RECORD, self.identity()
        with store.claimed(*where, names=names, overwrite=overwrite) as claim:
            self.write(claim, self.files(formats, dpi, **options))


@dataclass(eq=False)
class Written(Outcome):
    """Files that a task has written from existing results: figures, pages, a report.

    A terminal shows `lines` above the paths.
    """

    paths: tuple[Path, ...]
    lines: tuple[Shown, ...] = ()

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: `lines`, and the paths of the files."""
        yield from (*self.lines, *self.paths)
