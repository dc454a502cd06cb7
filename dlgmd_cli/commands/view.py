"""`dlgmd view`: make web pages of stored results, with the film of the input."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import click

from dlgmd_cli.commands.console import Command, print_path, tell, warn, warn_outside
from dlgmd_cli.commands.defaults import OwnDefault
from dlgmd_cli.commands.options import (
    FRAME,
    MODEL,
    complete_file,
    file_or_folder,
    is_file_name,
    numeric,
    overwrite_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import DlgmdError, counted, printable
from dlgmd_cli.parameters.presets import find_model
from dlgmd_cli.results.names import numbered, recorded_name

if TYPE_CHECKING:
    from dlgmd_cli.pages.gather import Gathered, Input
    from dlgmd_cli.pages.page import Index, Part, Score
    from dlgmd_cli.results.result import Result

# Greatest number of characters of a page's name; and the size in bytes from which on a page is too
# large for most mailboxes.
_MAX_NAME, _LARGE_BYTES = 80, 25_000_000


@click.command(
    cls=Command,
    short_help="Make a web page of results.",
    epilog="Example: dlgmd view dlgmd-out/flight --collision-frame 140 --out page.html",
)
@click.argument(
    "paths", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--out",
    cls=OwnDefault,
    type=file_or_folder("page.html"),
    default="dlgmd-out",
    show_default=True,
    metavar="PATH",
    help="Folder for the page, view-NAME.html, or a file ending in .html.",
)
@overwrite_option
@click.option(
    "--collision-frame",
    "frames",
    type=FRAME,
    metavar="N",
    multiple=True,
    help="Frame of a true collision; repeatable.",
)
@click.option(
    "--labels",
    "--collisions",
    "labels_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Table of the videos' collisions, as for 'dlgmd evaluate'. The index then tells hits, "
    "misses and false alarms.",
)
@click.option(
    "--input",
    "input_path",
    metavar="PATH",
    shell_complete=complete_file,
    help="Where the input is now, if it was moved since the run.",
)
@click.option(
    "--film-width",
    "width_px",
    type=numeric(int, 64, 1920),
    default=480,
    show_default=True,
    metavar="PX",
    help="Greatest width of the film.",
)
@click.option(
    "--model",
    "models",
    type=MODEL,
    multiple=True,
    metavar="MODULE:CLASS",
    help="A model of your own in the results: its module is imported to make the film. Repeatable.",
)
@click.option("--no-film", is_flag=True, help="Leave out the film; nothing is decoded.")
def view(
    paths: tuple[Path, ...],
    out: Path,
    overwrite: bool,
    frames: tuple[int, ...],
    labels_path: Path | None,
    input_path: str | None,
    width_px: int,
    models: tuple[str, ...],
    no_film: bool,
) -> None:
    """Make a web page of results: the film beside MP, attenuation and spikes.

    RESULT is a folder that 'dlgmd run', 'dlgmd compare' or 'dlgmd batch' wrote. Results of the same
    input share a page. Several inputs get a page each, in the folder NAME-pages beside an index
    that filters and sorts them; move both together.

    Pages need no network. The film shows the input and, tinted, the cells of layer G, for which the
    model is run once more. Collisions can be labelled; the browser keeps the labels, and the index
    gathers them into one labels.csv. Needs dlgmd[view].
    """
    from dlgmd_cli.pages.gather import gather
    from dlgmd_cli.pages.page import require_packages
    from dlgmd_cli.results.labels import read_by_video
    from dlgmd_cli.results.store import fitting, refuse_existing

    require_packages()
    for model in models:
        find_model(model, "Invalid value for '--model'")
    gathered = gather(paths, read_by_video(labels_path) if labels_path else {})
    is_one = len(gathered.inputs) == 1 and not gathered.is_batch
    if frames and len(gathered.inputs) > 1:
        raise click.UsageError(
            "--collision-frame works only with results of one input. Give a table with --labels."
        )
    if input_path and len(gathered.inputs) > 1:
        raise click.UsageError("--input works only with results of one input.")
    first = gathered.inputs[0].results[0].result
    name = recorded_name(first.record["input"]) if is_one else paths[0].absolute().name
    stem = fitting(printable(name[:_MAX_NAME]).replace("\\", "-")) or "results"
    out = out if is_file_name(out) else out / f"view-{stem}.html"
    refuse_existing(out, overwrite=overwrite)
    request = _Request(frames, input_path, width_px, no_film)
    if is_one:
        _write_page(gathered.inputs[0], out, request)
    else:
        _write_index(gathered, out, request, overwrite=overwrite)
    print_path(out)


@dataclass(frozen=True)
class _Request:
    frames: tuple[int, ...]
    input_path: str | None
    width_px: int
    no_film: bool


def _link(name: str) -> str:
    """A file's name, which may have any bytes, as part of a link."""
    return quote(os.fsencode(name))


def _write_index(gathered: "Gathered", out: Path, request: _Request, *, overwrite: bool) -> None:
    """Write a page for each input into a folder beside the index, then the index."""
    from dlgmd_cli.pages.page import index_of, index_page, library
    from dlgmd_cli.results.store import fitting, locked, refuse_existing, write_text

    folder = out.with_name(f"{out.stem}-pages")
    named = [printable(one.name) for one in gathered.inputs]  # names may be of any bytes
    flat = [name.replace("/", "-").replace("\\", "-") for name in named]
    pages = [
        folder / f"{fitting(name)}.html" for name in numbered([one[:_MAX_NAME] for one in flat])
    ]
    index = index_of(gathered, f"../{_link(out.name)}")
    with locked(folder):
        for page in pages:
            refuse_existing(page, overwrite=overwrite)
        name, text = library()  # its version is in its name
        write_text(folder / name, text)
        rows = []
        for one, page in zip(gathered.inputs, pages, strict=True):
            href = f"{_link(folder.name)}/{_link(page.name)}"
            rows += _write_page(one, page, request, index, href)
        write_text(out, index_page(rows, gathered.failed, index))
    if gathered.failed:
        tell(f"The index lists {counted(len(gathered.failed), 'failed video')} at its end.")


def _write_page(
    one: "Input", out: Path, request: _Request, index: "Index | None" = None, href: str = ""
) -> list[dict[str, Any]]:
    """Write the page of an input; returns its rows of the index, which link to `href`."""
    from dlgmd_cli.pages.gather import collisions_of
    from dlgmd_cli.pages.page import index_rows, page
    from dlgmd_cli.results.store import write_text

    known = collisions_of(one, request.frames)
    collisions = known or []
    warn_outside(one.name, one.results[0].result, collisions)
    if len(collisions) == 1:  # the recoil follows, which is no response to the obstacle
        until = [replace(r, result=r.result.until(collisions[0])) for r in one.results]
        one = replace(one, results=tuple(until))
    parts = _parts(one, request)
    text = page(one, parts, collisions, index)
    if len(text) > _LARGE_BYTES:
        tell(
            f"{printable(str(out))} has {len(text) / 1e6:.0f} MB. A smaller --film-width makes it "
            "smaller."
        )
    write_text(out, text)
    scores = [None if known is None else _score(part.result, known) for part in parts]
    return index_rows(one, href, parts, known, scores)


def _score(result: "Result", collisions: list[int]) -> "Score | None":
    """The alarms of a result, counted as 'dlgmd evaluate' does; None if it cannot be."""
    from dlgmd_cli.errors import SourceError
    from dlgmd_cli.pages.page import Score
    from dlgmd_cli.results.candidates import signal_of
    from dlgmd_cli.results.labels import Case
    from dlgmd_cli.results.scoring import EARLY, FALSE, HIT, HORIZON_S, kinds

    try:
        signal = signal_of(result, Case("", "", tuple(collisions), ()))
    except SourceError:  # it was interrupted, or a collision is outside
        return None
    kind, collision = (found[result.alarm_onsets] for found in kinds(signal, HORIZON_S))
    n_hits = len({*collision[kind == HIT].tolist()})
    n_false = int(((kind == FALSE) | (kind == EARLY)).sum())
    return Score(n_hits, len(collisions) - n_hits, n_false)


def _parts(one: "Input", request: _Request) -> "Sequence[Part]":
    """Every result of an input, with its film, or the reason why it has none."""
    from dlgmd_cli.pages.film import render
    from dlgmd_cli.pages.page import Part, thumbnail_row
    from dlgmd_cli.video.writer import best_codec

    parts, no_film = [], "--no-film was given." if request.no_film else ""
    if not no_film and best_codec() != "h264":
        no_film = "PyAV is not installed. Run: pip install 'dlgmd[view]'."
        warn(f"{one.name}: no film: {no_film.rstrip('.')}")
    for labelled in one.results:
        why, film = no_film, None
        if not why:
            n_frames = labelled.result.record["input"].get("frames") or len(labelled.result)
            try:
                with progress(f"{one.name} · {labelled.label}", 2 * n_frames) as on_frame:
                    film = render(
                        labelled.result,
                        labelled.peers,
                        request.input_path or one.path,
                        request.width_px,
                        thumbnail_row(labelled.result),
                        on_frame,
                    )
            except DlgmdError as error:
                warn(f"{one.name} · {labelled.label}: no film: {error.line.rstrip('.')}")
                # Pages are shared: they do not name the folder of the file.
                why = f"{PurePath(error.what).name}: {error.why}." if error.what else error.line
        parts.append(Part(labelled.label, labelled.result, film, why))
    return parts
