"""Write the page of an input, with its films, and the index of several inputs."""

import logging
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote
from zipfile import ZIP_DEFLATED, ZipFile

from dlgmd_cli.errors import (
    INSTALL_EXTRA,
    DlgmdError,
    SourceError,
    argument,
    counted,
    printable,
    warn,
)
from dlgmd_cli.pages import page
from dlgmd_cli.pages.gather import Gathered, Input, LabelledResult, collisions_of
from dlgmd_cli.pages.page_film import PageFilm, render
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import Case, Label, tell_outside
from dlgmd_cli.results.names import numbered
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.scoring import tally
from dlgmd_cli.tasks.call import Progress
from dlgmd_cli.tasks.evaluate.candidates import Stopping, signal_of
from dlgmd_cli.video.writer import best_codec

_log = logging.getLogger(__name__)

# Greatest number of characters of a page's name; size in bytes from which a page is too large for
# most mailboxes.
_MAX_NAME, _LARGE_BYTES = 80, 25_000_000


def pack(folder: Path, files: Iterable[str], path: Path) -> None:
    """Write an archive of some files of a folder."""
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for name in files:
            archive.write(folder / name, name)


@dataclass(frozen=True)
class Asked:
    """The options of the pages, and the progress of their films."""

    frames: Sequence[int]
    input_path: str | None
    no_film: bool
    progress: Progress


def stem(name: str) -> str:
    """A name of any bytes as a valid file name without suffix."""
    return store.fitting(printable(name[:_MAX_NAME]).replace("\\", "-"))


def _link(name: str) -> str:
    """A file's name of any bytes as part of a link."""
    return quote(os.fsencode(name))


def write_index(
    claim: store.ClaimedFolder, out: Path, gathered: Gathered, request: Asked, *, overwrite: bool
) -> list[str]:
    """Write a page for each input into a folder beside the index, then the index.

    Returns the files in that folder, relative to the index.
    """
    folder = out.with_name(f"{out.stem}-pages")
    flat = (re.sub(r"[/\\]", "-", printable(subject.name)) for subject in gathered.inputs)
    short = numbered([name[:_MAX_NAME] for name in flat])
    names = [f"{store.fitting(name)}.html" for name in short]
    index = page.index_of(gathered, f"../{_link(out.name)}")
    rows = []
    with store.claimed(folder, names=names, overwrite=overwrite) as pages:
        library_name, text = page.library()  # the file's name includes the library's version
        pages.write({library_name: store.file_of(text)})
        for subject, name in zip(gathered.inputs, names, strict=True):
            href = f"{_link(folder.name)}/{_link(name)}"
            rows += write_page(pages, name, subject, request, index, href)
        claim.write({out.name: store.file_of(page.index_page(rows, gathered.failed, index))})
    if gathered.failed:
        _log.info("The index lists %s at its end.", counted(len(gathered.failed), "failed video"))
    return [f"{folder.name}/{name}" for name in (*names, library_name)]


def write_page(
    claim: store.ClaimedFolder,
    name: str,
    subject: Input,
    request: Asked,
    index: page.Index | None = None,
    href: str = "",
) -> list[dict[str, Any]]:
    """Write the page of an input; returns the input's rows in the index, which link to `href`."""
    known = collisions_of(subject, request.frames)
    collisions = known or []
    tell_outside(subject.name, subject.results[0].result.frame, collisions)
    if len(collisions) == 1:  # later alarms respond to the recoil, not to the obstacle
        until = [replace(r, result=r.result.until(collisions[0])) for r in subject.results]
        subject = replace(subject, results=tuple(until))
    no_film = f"{argument('no_film')} was given." if request.no_film else ""
    if not no_film and best_codec() != "h264":
        no_film = f"PyAV is not installed. {INSTALL_EXTRA.format('view')}."
        warn(f"{subject.name}: no film: {no_film.rstrip('.')}")
    parts = []
    for each in subject.results:
        film, why = (None, no_film) if no_film else _film(subject, each, request)
        parts.append(page.PageResult(each.label, each.result, film, why))
    text = page.input_page(subject, parts, collisions, index)
    if len(text) > _LARGE_BYTES:
        what, size = printable(str(claim.folder / name)), len(text) / 1e6
        _log.info("%s has %.0f MB. It is smaller with %s.", what, size, argument("no_film"))
    claim.write({name: store.file_of(text)})
    scores = [None if known is None else _score(part.result, known) for part in parts]
    return page.index_rows(subject, href, parts, known, scores)


def _score(result: Result, collisions: list[int]) -> dict[str, int] | None:
    """Hits and false alarms of a result, as in 'dlgmd evaluate'; None if it cannot be scored."""
    labels = tuple(Label("", frame) for frame in collisions or (None,))
    try:
        signal = signal_of(result, Case("", "", labels), Stopping())
    except SourceError:  # the run was interrupted, or a collision is outside
        return None
    rule = result.rule
    counts = tally(signal, rule.n_in_a_row, rule.strength_at(rule.threshold))
    n_hits = int(counts.is_hit.sum())
    missed = len(collisions) - n_hits
    return {"hits": n_hits, "missed": missed, "false": int(counts.n_false[0])}


def _film(subject: Input, labelled: LabelledResult, request: Asked) -> tuple[PageFilm | None, str]:
    """The film of a result of an input; None and the reason if there is no film."""
    label, result = labelled.label, labelled.result
    n_frames = result.record["input"].get("frames") or len(result)
    path, row = request.input_path or subject.path, page.thumbnail_row(result)
    try:
        with request.progress(f"{subject.name} · {label}", 2 * n_frames, "frame") as on_frame:
            return render(result, labelled.peers, path, row, on_frame), ""
    except DlgmdError as error:
        warn(f"{subject.name} · {label}: no film: {str(error).rstrip('.')}")
        # Pages are shared: they must not name folders of this computer.
        return None, f"{PurePath(error.what).name}: {error.why}." if error.what else str(error)
