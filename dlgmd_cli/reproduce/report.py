"""The report: one self-contained HTML page, its figures, and `claims.csv`."""

import base64
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.reproduce import claims
from dlgmd_cli.reproduce.claims import VERDICTS, ExhibitSpec, Finding, counts, findings
from dlgmd_cli.reproduce.clips import VERSIONS, model
from dlgmd_cli.reproduce.plan import ANY, Evidence, Plan
from dlgmd_cli.results.record import provenance, versions
from dlgmd_cli.results.store import ClaimedFolder

REPORT, TABLE = "report.html", "claims.csv"
TEMPLATE = Path(__file__).with_name("report.html.jinja")
# Of each verdict.
_WORDS = (
    *("holds", "holds, but also without inhibition", "a tie: as good as equal", "does not hold"),
    *("undecided", "not testable here: undefined on most clips, or not measured"),
)
_PARTS = ("The paper's claims about its model", "Its claims about other models", "Ours")
_SETS = tuple(f"set{number}" for number in range(1, 10))


def require_jinja() -> Any:
    """Import Jinja2; raises MissingExtraError if it is not installed."""
    try:
        import jinja2
    except ImportError:
        raise MissingExtraError.of("report", "jinja2") from None
    return jinja2


@dataclass(frozen=True)
class Section:
    """An exhibit in the report: its texts, and what it shows.

    `shown` is what it shows under each plan: its own, then others, at full size or on the authors'
    frames. Where it shows the authors' frames, they decide.
    """

    spec: ExhibitSpec
    shown: Sequence[tuple[Plan, Evidence]]

    @property
    def found(self) -> list[Finding]:
        """The finding about each claim and version.

        A claim is judged under the first plan that shows it, or on the authors' frames.
        """
        results = []
        plans = sorted(self.shown, key=lambda shown: shown[0].reference is None)
        for claim in self.spec.claims.values():
            each = (findings([claim], self.spec.source, evidence, plan) for plan, evidence in plans)
            results += next(filter(None, each), [])
        return results

    @property
    def beside(self) -> dict[str, dict[tuple[str, str], Finding]]:
        """Name of another plan -> findings by claim and version, but those that are judged."""
        judged = {(finding.claim.id, finding.version): finding.frames for finding in self.found}
        return {
            plan.name: {
                (finding.claim.id, finding.version): finding
                for finding in findings(self.spec.claims.values(), self.spec.source, evidence, plan)
                if judged.get((finding.claim.id, finding.version)) != plan.name
            }
            for plan, evidence in self.shown
        }

    @property
    def all_found(self) -> list[Finding]:
        """The findings under every plan, for `claims.csv`."""
        return self.found + [each for others in self.beside.values() for each in others.values()]

    @property
    def by_claim(self) -> list[list[Finding]]:
        """The findings grouped by claim, in the order of the file."""
        return [list(some) for _, some in groupby(self.found, lambda finding: finding.claim.id)]

    @property
    def figures(self) -> dict[str, tuple[str, Callable[[], Any]]]:
        """File name without suffix -> on which frames, and the function that draws the figure."""
        figures = {stem: ("", draw) for stem, draw in self.shown[0][1].figures.items()}
        for plan, evidence in self.shown[1:]:
            suffix = "full" if plan.is_larger else "authors"
            for stem, draw in evidence.figures.items():
                figures[f"{stem}-{suffix}"] = (plan.name, draw)
        return figures

    @property
    def tables(self) -> dict[str, list[tuple[Any, ...]]]:
        """Title -> rows of the tables, of all plans."""
        tables = dict(self.shown[0][1].tables)
        for plan, evidence in self.shown[1:]:
            tables |= {f"{title}, {plan.name}": rows for title, rows in evidence.tables.items()}
        return tables

    @property
    def held(self) -> dict[str, Counter[str]]:
        """Version -> numbers by verdict of the paper's claims about its model."""
        return counts(self.found)


@dataclass(frozen=True)
class Report:
    """All sections, remarks on the whole, and the command that repeats this."""

    sections: Sequence[Section]
    remarks: Mapping[str, Sequence[str]]
    plan: Plan
    command: str

    @property
    def found(self) -> list[Finding]:
        """The findings of all sections."""
        return [finding for section in self.sections for finding in section.found]

    def write(self, folder: Path, dpi: int, on_figure: Callable[[int], None]) -> list[Path]:
        """Write the figures as PNG and PDF, then `claims.csv`, then the page; returns their paths.

        The path of the page comes first. An earlier page stays until the new one is complete.
        Raises OutputError.
        """
        paths = [folder / REPORT, folder / TABLE]
        with ClaimedFolder(folder, REPORT).staged() as stage:
            for number, section in enumerate(self.sections, start=1):
                for stem, (_, draw) in section.figures.items():
                    figure = draw()
                    for suffix in ("png", "pdf"):
                        paths.append(folder / f"{stem}.{suffix}")
                        save_figure(figure, stage / paths[-1].name, dpi)
                on_figure(number)
            judged = [finding for section in self.sections for finding in section.all_found]
            claims.write_claims(stage / TABLE, judged)
            (stage / REPORT).write_text(self.html(stage), encoding="utf-8")
        return paths

    def html(self, folder: Path) -> str:
        """The page, with the figures in a folder; every text is escaped."""
        jinja2 = require_jinja()
        environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
        environment.filters["number"], environment.filters["shown"] = number, shown
        with_authors = any(section.shown[-1][0].reference for section in self.sections)
        template = environment.from_string(TEMPLATE.read_text("utf-8"))
        page: str = template.render(
            **vars(self),
            picture=lambda stem: base64.b64encode((folder / f"{stem}.png").read_bytes()).decode(),
            versions_of={name: model("set9", name) for name in VERSIONS},
            any=ANY,
            with_authors=with_authors,
            counts=counts(self.found),
            whose=dict(zip(claims.WHOSE, _PARTS, strict=True)),
            words=dict(zip(VERDICTS, _WORDS, strict=True)),
            marks=dict(zip(VERDICTS, "✓○=✗?–", strict=True)),
            parameters={name: model(name).to_dict() for name in (*_SETS, "lgmd", "emd-lgmd")},
            versions=versions(),
            made_by=provenance(),
        )
        return page


def shown(finding: Finding) -> str:
    """The value, or the median over seeds with its interval."""
    if len(finding.values) == 1:
        text, threshold = number(finding.median), finding.claim.threshold
        # With three digits, a value could look like the threshold that it just meets or fails.
        is_close = text == number(threshold) and finding.median != threshold
        return f"{finding.median:.6g}".replace("-", "−") if is_close else text
    low, high = map(number, finding.interval)
    return number(finding.median) if low == high else f"{number(finding.median)} ({low} to {high})"


def number(value: float | str) -> str:
    """A value with three digits, or whole from 1000 on; a dash for NaN; a text as it is."""
    if isinstance(value, str):
        return value
    if value != value:
        return "–"
    if abs(value) < 1e-12:  # rounding
        return "0"
    text = f"{value:.0f}" if 1000.0 <= abs(value) < 1e6 else f"{value:.3g}"
    return text.replace("-", "−").replace("inf", "∞")
