"""`dlgmd lab measure`: the tables of numbers in the pages, where they are from, and how old."""

import click

from dlgmd_cli.commands.console import Command, show
from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.outcome import Written


@click.command(cls=Command)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--check", is_flag=True, help="Fail if a page has a table of unknown source.")
def measure(names: tuple[str, ...], check: bool) -> None:
    """Measure tables of the pages, and write them into README.md and docs/.

    \b
    Examples:
      dlgmd lab measure              # the tables, their age, and how long they take
      dlgmd lab measure real sets    # measure these two
      dlgmd lab measure --check      # as CI does

    Run it in the root of a clone. Tables of real clips read them from the folder that
    DLGMD_REFERENCE names. A table of numbers has a mark above it that names its source:
    'measured: NAME VERSION DIGEST', 'generated: …' or 'source: …'.
    """
    from dlgmd_cli.lab.measure import pages
    from dlgmd_cli.lab.measure.tables import TABLES

    at = pages.root()
    if unknown := [name for name in names if name not in TABLES]:
        raise click.BadParameter(
            f"there is no table {unknown[0]!r}. Choose from {', '.join(TABLES)}.",
            param_hint="'NAME'",
        )
    for name in names:
        click.echo(f"{name}: {pages.write(name, TABLES[name].make(), at).relative_to(at)}")
    if names:
        return
    found = [table for page in pages.pages(at) for table in pages.tables_of(page)]
    rows = [
        (name, table.page.name, pages.age(table, at), f"{TABLES[name].minutes} min")
        for table in found
        if table.kind == "measured" and (name := table.text.split()[0]) in TABLES
    ]
    show(Written((), ((("table", "page", "measured with", "takes"), rows),)))
    faults = [
        f"{table.page.relative_to(at)}:{table.line}: {fault}"
        for table in found
        if (fault := pages.unknown_source(table, at, TABLES))
    ]
    faults += [f"no page has {name!r}" for name in TABLES if name not in {row[0] for row in rows}]
    for fault in faults:
        click.echo(fault)
    if check and faults:
        raise ResultError("", f"{len(faults)} of {len(found)} tables have no known source", HINT)


HINT = "Mark each as 'dlgmd lab measure --help' says."
