"""Many flights between their options and their files."""

from functools import partial
from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands._console import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    Failed,
    print_path,
    progress,
    say,
)
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.threads import n_processors

if TYPE_CHECKING:
    from dlgmd_cli.flights.dataset import Fleet, Pool, Standing


def render_fleet(fleet: "Fleet", *, jobs: int | None, overwrite: bool) -> None:
    """Render what is not there yet, and write the labels, also of less than all.

    Raises
    ------
    OutputExistsError
        If something stands in the way and may not be replaced.
    """
    from dlgmd_cli.flights.dataset import Standing
    from dlgmd_cli.results.files import prove_writable

    with Interrupts() as interrupts:
        standing = Standing.of(fleet)
        standing.check(overwrite=overwrite)
        prove_writable(fleet.folder)
        if standing.labels:
            say(f"{len(standing.labels)} of {fleet.count} flights were there already.")
        failures: dict[int, DlgmdError] = {}
        is_interrupted = False
        try:
            _render(standing, jobs, failures, overwrite)
        except KeyboardInterrupt:
            is_interrupted = True
        except Exception:
            interrupts.hold()
            if _conclude(standing, overwrite):
                say(_kept(standing))
            raise
        interrupts.hold()
        if not _conclude(standing, overwrite) and is_interrupted:
            raise KeyboardInterrupt
    is_interrupted = is_interrupted or interrupts.count > 0
    if is_interrupted and standing.missing:
        say(_kept(standing))
    if is_interrupted:
        raise click.exceptions.Exit(EXIT_INTERRUPTED)
    _report(standing, failures)


def _render(
    standing: "Standing", jobs: int | None, failures: dict[int, DlgmdError], overwrite: bool
) -> None:
    """Render what is missing; `failures` is filled with what could not be made."""
    from dlgmd_cli.flights.dataset import render_flights
    from dlgmd_cli.runs.workers import Workers, here

    fleet, missing = standing.fleet, standing.missing
    n_workers = min(jobs or n_processors(), len(missing))
    if not missing:
        return
    pool: Pool = here if n_workers == 1 else partial(Workers, n_workers)
    with progress(fleet.scene.name, fleet.count, "flight") as on_flight:
        on_flight(fleet.count - len(missing))
        done = render_flights(fleet, missing, pool, overwrite=overwrite)
        for n_done, (number, error) in enumerate(done, start=fleet.count - len(missing) + 1):
            if error is not None:
                failures[number] = error
                name = fleet.name_of(number)
                say(str(error) if name in error.what else f"{name}: {error}")
            on_flight(n_done)


def _conclude(standing: "Standing", overwrite: bool) -> bool:
    """Write the labels of what is there, if that is anything."""
    standing.update()
    if not standing.labels:
        return False
    standing.write_labels(overwrite=overwrite)
    print_path(standing.fleet.labels_path)
    return True


def _report(standing: "Standing", failures: dict[int, DlgmdError]) -> None:
    """Fail if any flight did."""
    if not standing.missing:
        return
    count, n_missing = standing.fleet.count, len(standing.missing)
    raise Failed(
        f"{n_missing} of {count} flights failed, {count - n_missing} are in "
        f"{standing.fleet.folder}. Mend what stands above; the same command goes on.",
        EXIT_FAILED,
    )


def _kept(standing: "Standing") -> str:
    """What an end before the end leaves."""
    fleet = standing.fleet
    return (
        f"{fleet.folder} keeps {len(standing.labels)} of {fleet.count} flights; "
        "the same command goes on from there."
    )
