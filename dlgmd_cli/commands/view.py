"""`dlgmd view`: make web pages of stored results, with the film of the input."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import click

from dlgmd_cli.commands.console import Command, print_path, say, warn
from dlgmd_cli.commands.options import FRAME, complete_file, file_ending, numeric, overwrite_option
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import DlgmdError, printable
from dlgmd_cli.names import numbered, recorded_name

if TYPE_CHECKING:
    from dlgmd_cli.pages.gather import Gathered, Input
    from dlgmd_cli.pages.page import Part

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
    type=file_ending("page.html"),
    metavar="FILE",
    help="The page, ending in .html.  [default: dlgmd-out/view-NAME.html]",
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
    "labels_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Table of the videos' collisions, as for 'dlgmd evaluate'.",
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
@click.option("--no-film", is_flag=True, help="Leave out the film; nothing is decoded.")
def view(
    paths: tuple[Path, ...],
    out: Path | None,
    overwrite: bool,
    frames: tuple[int, ...],
    labels_path: Path | None,
    input_path: str | None,
    width_px: int,
    no_film: bool,
) -> None:
    """Make a web page of results: the film beside MP, attenuation and spikes.

    RESULT is a folder that 'dlgmd run', 'dlgmd compare' or 'dlgmd batch' wrote. Results of the same
    input share a page. Several inputs get a page each, and an index that links to them.

    Every page is one file that needs no network. Its film shows the input and, tinted, the cells
    of layer G, for which the model is run once more. Needs dlgmd[view].
    """
    from dlgmd_cli.pages.gather import gather
    from dlgmd_cli.pages.page import require_packages
    from dlgmd_cli.results.labels import read_collisions
    from dlgmd_cli.results.store import fitting, refuse_existing

    require_packages()
    labels = read_collisions(labels_path) if labels_path else {}
    gathered = gather(paths)
    is_one = len(gathered.inputs) == 1 and not gathered.is_batch
    if frames and len(gathered.inputs) > 1:
        raise click.UsageError(
            "--collision-frame works only with results of one input. Give a table with --labels."
        )
    if input_path and len(gathered.inputs) > 1:
        raise click.UsageError("--input works only with results of one input.")
    first = gathered.inputs[0].results[0].result
    name = recorded_name(first.record["input"]) if is_one else paths[0].absolute().name
    stem = fitting(name[:_MAX_NAME]) or "results"
    out = out or Path("dlgmd-out") / f"view-{stem}.html"
    refuse_existing(out, overwrite=overwrite)
    request = _Request(frames, labels, input_path, width_px, no_film)
    if is_one:
        _write_page(gathered.inputs[0], out, request)
    else:
        _write_index(gathered, out, request, overwrite=overwrite)
    print_path(out)


@dataclass(frozen=True)
class _Request:
    frames: tuple[int, ...]
    labels: dict[str, list[int]]
    input_path: str | None
    width_px: int
    no_film: bool


def _link(name: str) -> str:
    """A file's name, which may have any bytes, as part of a link."""
    return quote(os.fsencode(name))


def _write_index(gathered: "Gathered", out: Path, request: _Request, *, overwrite: bool) -> None:
    """Write a page for each input into a folder beside the index, then the index."""
    from dlgmd_cli.pages.page import index_page
    from dlgmd_cli.results.store import fitting, locked, refuse_existing, write_text

    folder = out.with_name(f"{out.stem}-pages")
    flat = [one.name.replace("/", "-").replace("\\", "-") for one in gathered.inputs]
    pages = [
        folder / f"{fitting(name)}.html" for name in numbered([one[:_MAX_NAME] for one in flat])
    ]
    with locked(folder):
        for page in pages:
            refuse_existing(page, overwrite=overwrite)
        rows = []
        for one, page in zip(gathered.inputs, pages, strict=True):
            rows.append(_write_page(one, page, request, index=out.name))
            rows[-1]["href"] = f"{_link(folder.name)}/{_link(page.name)}"
        write_text(out, index_page(rows, gathered.failed))
    if gathered.failed:
        n_failed = len(gathered.failed)
        those = "1 failed video is" if n_failed == 1 else f"{n_failed} failed videos are"
        say(f"{those} listed at the end of the index.")


def _write_page(one: "Input", out: Path, request: _Request, index: str = "") -> dict[str, Any]:
    """Write the page of an input; returns its row of the index."""
    from dlgmd_cli.pages.gather import collisions_of
    from dlgmd_cli.pages.page import index_row, page
    from dlgmd_cli.results.store import write_text

    collisions = collisions_of(one, request.frames, request.labels)
    first, last = int(one.results[0].result.frame[0]), int(one.results[0].result.frame[-1])
    for frame in collisions:
        if not first <= frame <= last:
            warn(f"{one.name}: the collision at frame {frame} is outside frames {first} to {last}")
    if len(collisions) == 1:  # the recoil follows, which is no response to the obstacle
        until = [replace(r, result=r.result.until(collisions[0])) for r in one.results]
        one = replace(one, results=tuple(until))
    parts = _parts(one, request)
    text = page(one, parts, collisions, index=f"../{_link(index)}" if index else "")
    if len(text) > _LARGE_BYTES:
        say(
            f"{printable(str(out))} has {len(text) / 1e6:.0f} MB. A smaller --film-width makes it "
            "smaller."
        )
    write_text(out, text)
    return dict(index_row(one, out.name, parts, collisions))


def _parts(one: "Input", request: _Request) -> "Sequence[Part]":
    """Every result of an input, with its film, or the reason why it has none."""
    from dlgmd_cli.pages.film import render
    from dlgmd_cli.pages.page import Part, thumbnail_row
    from dlgmd_cli.video.writer import best_codec

    parts, no_film = [], "--no-film was given." if request.no_film else ""
    if not no_film and best_codec() != "h264":
        no_film = "PyAV is not installed. Run: pip install av."
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
                warn(f"{one.name} · {labelled.label}: no film: {str(error).rstrip('.')}")
                # Pages are shared: they do not name the folder of the file.
                why = f"{PurePath(error.what).name}: {error.why}." if error.what else str(error)
        parts.append(Part(labelled.label, labelled.result, film, why))
    return parts
