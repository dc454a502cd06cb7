"""Web pages of stored results: one for each input, or an index of several."""

import os
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.pages.gather import gather
from dlgmd_cli.parameters.checks import in_argument, refuse
from dlgmd_cli.parameters.presets import find_model
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import read_by_video
from dlgmd_cli.results.names import recorded_name
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.tasks.call import Place, Progress, no_progress


def view(
    results: Place | Iterable[Place],
    out: Place = "dlgmd-out",
    *,
    collision_frame: Sequence[int] = (),
    collisions: Place | None = None,
    input_path: str | None = None,
    models: Iterable[str] = (),
    no_film: bool = False,
    packed: bool = False,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Written:
    """Make a web page of stored results, as `dlgmd view` does: one, or an index and one per input.

    Parameters
    ----------
    results : str, path, or iterable of them
        Folders of results, or trees of them.
    out : str or path
        Folder for ``view-NAME.html``, or a file with the suffix ``.html``.
    collision_frame : sequence of int
        Frames of collisions, for results of one input.
    collisions : str or path, optional
        Table of the collisions of many inputs, as for `evaluate`.
    input_path : str, optional
        Path of the input if it was moved, for results of one input.
    models : iterable of str
        Custom models in the results, as ``"module:Class"``, to be imported for their films.
    no_film : bool
        Leave out the film; nothing is decoded.
    packed : bool
        Also pack all files into a ZIP archive beside `out`.
    overwrite : bool
        Whether an earlier page may be replaced.
    progress
        As in `batch`.

    Returns
    -------
    Written
        `paths` has the page or the index, and the archive.

    Raises
    ------
    ParameterError
        If `collision_frame` or `input_path` is given for several inputs.
    ResultError
        If a result is missing or damaged.
    MissingExtraError
        If the packages of the extra ``view`` are not installed.
    OutputError, OutputExistsError
        If a page cannot be written, or may not be replaced.

    Examples
    --------
    >>> view("dlgmd-out/flight", collision_frame=[140]).paths  # doctest: +SKIP
    """
    paths = [*map(Path, [results] if isinstance(results, str | os.PathLike) else results)]
    out = Path(out)
    from dlgmd_cli.pages import page, site  # they import Matplotlib, which is slow

    page.require_packages()
    if no_film:
        of_film = {"input_path": input_path, "models": models}
        refuse(of_film, f"works only with the film, not with {argument('no_film', True)}")
    for model in models:
        with in_argument("model"):
            find_model(model)
    gathered = gather(paths, read_by_video(Path(collisions)) if collisions else {})
    first, *others = gathered.inputs
    for name, is_given, hint in (
        ("collision_frame", collision_frame, f"Give a table with {argument('collisions')}."),
        ("input_path", input_path, ""),
    ):
        if is_given and others:
            raise ParameterError("", f"{argument(name)} works only with results of one input", hint)
    is_one = not (others or gathered.is_batch)
    if out.suffix.lower() != ".html":
        known = first.results[0].result.record["input"]
        name = recorded_name(known) if is_one else paths[0].absolute().name
        out = out / f"view-{site.stem(name) or 'results'}.html"
    request = site.Asked(collision_frame, input_path, no_film, progress)
    # Without a lock: a batch may be writing into its own folders below.
    written = [out, *([out.with_suffix(".zip")] if packed else ())]
    names = [path.name for path in written]
    with store.claimed(out.parent, names=names, overwrite=overwrite, locks=False) as claim:
        files = [out.name]
        if is_one:
            site.write_page(claim, out.name, first, request)
        else:
            files += site.write_index(claim, out, gathered, request, overwrite=overwrite)
        if packed:
            claim.write({names[1]: partial(site.pack, out.parent, files)})
    return Written(tuple(written))
