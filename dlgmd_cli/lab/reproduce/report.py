"""The report: one self-contained HTML page, its figures, and `claims.csv`."""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.lab.reproduce.claims import (
    NO,
    UNDECIDED,
    YES,
    ExhibitSpec,
    Finding,
    counts,
    write_claims,
)
from dlgmd_cli.lab.reproduce.clips import model
from dlgmd_cli.lab.reproduce.compute import EXHIBITS
from dlgmd_cli.lab.reproduce.flights import da_rows, time_rows
from dlgmd_cli.lab.reproduce.plan import ANY, Data, Plan
from dlgmd_cli.parameters import FORMULATIONS
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.results.record import versions
from dlgmd_cli.results.store import replacing

REPORT, TABLE = "report.html", "claims.csv"
TEMPLATE = Path(__file__).with_name("report.html.jinja")
_WORDS = {YES: "holds", NO: "does not hold", UNDECIDED: "undecided"}
_MARKS = {YES: "✓", NO: "✗", UNDECIDED: "?"}
_SETS = tuple(f"set{number}" for number in range(1, 10))


def require_jinja() -> Any:
    """Import Jinja2; raises MissingExtraError if it is not installed."""
    try:
        import jinja2
    except ImportError:
        why = "Jinja2 is not installed"
        raise MissingExtraError("report", why, "Run: pip install 'dlgmd[view]'.") from None
    return jinja2


@dataclass(frozen=True)
class Section:
    """An exhibit in the report: its texts, its findings, and its figures as base64 PNG by name."""

    spec: ExhibitSpec
    found: Sequence[Finding]
    pictures: Mapping[str, str]


def write_report(
    folder: Path,
    specs: Mapping[str, ExhibitSpec],
    found: Mapping[str, Sequence[Finding]],
    inconsistencies: Sequence[str],
    plan: Plan,
    data: Data,
    command: str,
    on_figure: Callable[[int], None],
    dpi: int,
) -> list[Path]:
    """Write the figures as PNG and PDF, then `claims.csv`, then the report; returns their paths.

    The path of the report comes first. An earlier report stays until the new one is complete.
    Raises OutputError.
    """
    sections, paths = [], []
    with replacing(folder, record=REPORT) as stage:
        for name, spec in specs.items():
            pictures = {}
            for stem, draw in EXHIBITS[name].figures(plan, data).items():
                figure = draw()
                for suffix in ("png", "pdf"):
                    save_figure(figure, stage / f"{stem}.{suffix}", dpi)
                    paths.append(folder / f"{stem}.{suffix}")
                png = (stage / f"{stem}.png").read_bytes()
                pictures[stem] = base64.b64encode(png).decode()
            sections.append(Section(spec, found[name], pictures))
            on_figure(len(sections))
        every = [one for some in found.values() for one in some]
        write_claims(stage / TABLE, every)
        html = page(sections, inconsistencies, plan, data, command)
        (stage / REPORT).write_text(html, encoding="utf-8")
    return [folder / REPORT, folder / TABLE, *paths]


def page(
    sections: Sequence[Section],
    inconsistencies: Sequence[str],
    plan: Plan,
    data: Data,
    command: str,
) -> str:
    """The report as HTML; every text is escaped."""
    jinja2 = require_jinja()
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["number"] = number
    template = environment.from_string(TEMPLATE.read_text("utf-8"))
    every = [one for section in sections for one in section.found]
    return str(
        template.render(
            sections=sections,
            by_claim=_by_claim,
            inconsistencies=inconsistencies,
            plan=plan,
            command=command,
            formulations=FORMULATIONS,
            any=ANY,
            counts=counts(every),
            words=_WORDS,
            marks=_MARKS,
            parameters={name: model(name).to_dict() for name in (*_SETS, "lgmd", "emd-lgmd")},
            tables={"table4-time": time_rows(data), "table4-da": da_rows(plan, data)},
            versions=versions(),
        )
    )


def _by_claim(found: Sequence[Finding]) -> list[list[Finding]]:
    """The findings grouped by claim."""
    by_id: dict[str, list[Finding]] = {}
    for one in found:
        by_id.setdefault(one.claim.id, []).append(one)
    return list(by_id.values())


def number(value: float) -> str:
    """A value with three digits, or whole from 1000 on; a dash for NaN."""
    if value != value:
        return "–"
    text = f"{value:.0f}" if 1000.0 <= abs(value) < 1e6 else f"{value:.3g}"
    return text.replace("-", "−").replace("inf", "∞")
