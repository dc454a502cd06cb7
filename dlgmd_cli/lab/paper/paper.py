"""The paper checked: what its exhibits need, the claims judged, and the report of it."""

import base64
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from types import ModuleType

import numpy as np
import yaml

import dlgmd_cli
from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.lab.paper import claims, flights, objects, stimuli, table4
from dlgmd_cli.lab.paper.claims import VERDICTS, ExhibitSpec, Finding, counts, findings, number
from dlgmd_cli.lab.paper.clips import VERSIONS, Value, check_reference, model
from dlgmd_cli.lab.paper.plan import (
    ANY,
    Draw,
    Evidence,
    Plan,
    Started,
    Steps,
    compute,
    needed,
    plans_of,
)
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.results.store import ClaimedFolder, claimed

# Takes a name, a total and a unit; yields a callback for the number done.
Progress = Callable[[str, int | None, str], AbstractContextManager[Callable[..., None]]]

REPORT, TABLE = "report.html", "claims.csv"
TEMPLATE = Path(__file__).with_name("report.html.jinja")
# Of each verdict.
_WORDS = (
    "holds",
    "holds, but also without inhibition",
    "a tie: as good as equal",
    "does not hold",
    "undecided",
    "not testable here: undefined on most clips, or not measured",
)
_PARTS = ("The paper's claims about its model", "Its claims about other models", "Ours")


def require_jinja() -> ModuleType:
    """Import Jinja2; raises MissingExtraError if it is not installed."""
    try:
        import jinja2
    except ImportError:
        raise MissingExtraError.of("report", "jinja2") from None
    return jinja2


def made_by() -> dict[str, str]:
    """The versions and the machine, as the record of a run has them."""
    still = np.zeros((6, 32, 32), np.uint8)
    (result,) = dlgmd_cli.run(still, [9], fps=30.0)
    record = yaml.safe_load(result.record_text())
    return {**record["versions"], **record["machine"]}


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
    def figures(self) -> dict[str, tuple[str, Draw]]:
        """File name without suffix -> on which frames, and the function that draws the figure."""
        figures = {stem: ("", draw) for stem, draw in self.shown[0][1].figures.items()}
        for plan, evidence in self.shown[1:]:
            suffix = "full" if plan.is_larger else "authors"
            for stem, draw in evidence.figures.items():
                figures[f"{stem}-{suffix}"] = (plan.name, draw)
        return figures

    @property
    def tables(self) -> dict[str, list[tuple[Value, ...]]]:
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

    def write(self, folder: Path, on_figure: Callable[[int], None]) -> list[Path]:
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
                        save_figure(figure, stage / paths[-1].name)
                on_figure(number)
            judged = [finding for section in self.sections for finding in section.all_found]
            machine = made_by()
            claims.write_claims(stage / TABLE, judged, machine)
            (stage / REPORT).write_text(self.html(stage, machine), encoding="utf-8")
        return paths

    def html(self, folder: Path, machine: Mapping[str, str]) -> str:
        """The page, with the figures in a folder; every text is escaped."""
        jinja2 = require_jinja()
        environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
        environment.filters["number"], environment.filters["shown"] = number, shown
        with_authors = any(section.shown[-1][0].reference for section in self.sections)
        template = environment.from_string(TEMPLATE.read_text("utf-8"))
        page: str = template.render(
            **vars(self),
            picture=lambda stem: base64.b64encode((folder / f"{stem}.png").read_bytes()).decode(),
            versions_of={name: model(9, name) for name in VERSIONS},
            any=ANY,
            with_authors=with_authors,
            counts=counts(self.found),
            whose=dict(zip(claims.WHOSE, _PARTS, strict=True)),
            words=dict(zip(VERDICTS, _WORDS, strict=True)),
            marks=dict(zip(VERDICTS, "✓○=✗?–", strict=True)),
            made_by=machine,
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


_EACH: tuple[Callable[[Plan], Steps], ...] = (
    stimuli.fig5,
    stimuli.fig6,
    stimuli.fig9,
    stimuli.fig10,
    stimuli.fig11,
    stimuli.fig12,
    objects.fig8,
    flights.fig1,
    flights.fig13,
    flights.fig14,
    flights.fig17,
    flights.lateral,
    table4.table4_da,
    table4.table4_time,
    table4.ablation,
)
# All exhibits by id.
EXHIBITS = {each.__name__.replace("_", "-"): each for each in _EACH}
EXHIBITS |= {f"fig{group + 11}": partial(flights.approach, group) for group in (4, 5)}
# Least load average at which times are not judged.
_IDLE = 0.5
_HEADER = (
    "version",
    "claims hold",
    "hold without inhibition, too",
    "tie",
    "do not hold",
    "undecided",
    "not testable here",
)


def paper(
    out: Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    reference: Path | None = None,
    overwrite: bool = False,
    jobs: int | None = None,
    progress: Progress,
) -> Written:
    """Make the figures and tables of the paper, and judge its claims, as `dlgmd lab paper` does.

    `out` is the folder for the report. `only` names figures, tables or claims, with commas between
    several. `quick` is three seeds instead of 20, and nothing at 1920x1080. `reference` is a folder
    of the authors' frames.

    Raises ParameterError if one of these is not there, MissingExtraError without Jinja2 or MuJoCo,
    and OutputError or OutputExistsError if the report cannot be written.
    """
    specs, remarks = claims.load_claims()
    specs = claims.select(specs, [name for text in only for name in text.split(",")])
    check_reference(reference)
    require_jinja()
    # Nothing else has run in the last minute, as far as known.
    is_idle = hasattr(os, "getloadavg") and os.getloadavg()[0] < _IDLE
    plan = Plan(quick, is_idle=is_idle)
    plans = {name: plans_of(name, plan, reference) for name in specs}
    started = {name: [Started(EXHIBITS[name](p)) for p in plans[name]] for name in plans}
    tasks = needed(exhibit for each in started.values() for exhibit in each)
    with claimed(out, names=(REPORT, TABLE), overwrite=overwrite):
        with progress("paper", len(tasks), "clip") as on_result:
            data = compute(tasks, jobs, on_result)
        sections = []
        for name, spec in specs.items():
            each = [exhibit.evidence(data) for exhibit in started[name]]
            sections.append(Section(spec, list(zip(plans[name], each, strict=True))))
        options = {"only": ",".join(only), "quick": quick, "reference": reference}
        report = Report(sections, remarks, plan, _command(options))
        with progress("figures", len(specs), "figure") as on_figure:
            paths = report.write(out, on_figure)
    held = counts(report.found).items()
    rows = [(name, *(str(count[kind]) for kind in VERDICTS)) for name, count in held]
    return Written(tuple(paths[:2]), ((_HEADER, rows),))


def _command(options: Mapping[str, object]) -> str:
    """The command that repeats a report, from its options; empty ones are left out."""
    given = {name: value for name, value in options.items() if value}
    words = [f"--{name}{'' if value is True else f' {value}'}" for name, value in given.items()]
    return " ".join(["dlgmd lab paper", *words])
