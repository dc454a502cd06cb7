"""The paper checked: what its exhibits need, the claims judged, and the report of it."""

import base64
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain, groupby
from pathlib import Path
from types import ModuleType

import numpy as np
import yaml

import dlgmd_cli
from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.lab.paper import claims, flights, objects, stimuli, table4
from dlgmd_cli.lab.paper.claims import VERDICTS, ExhibitSpec, Finding, counts, findings, number
from dlgmd_cli.lab.paper.clips import VERSIONS, check_reference, code_digest, model
from dlgmd_cli.lab.paper.plan import (
    ANY,
    Evidence,
    Plan,
    Started,
    Steps,
    Trial,
    compute,
    needed,
    plan_of,
    trials_of,
)
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.results.store import ClaimedFolder, claimed

# Takes a name, a total and a unit; yields a callback for the number done.
Progress = Callable[[str, int | None, str], AbstractContextManager[Callable[..., None]]]

REPORT, TABLE, PAGE = "report.html", "claims.csv", "claims.md"
TEMPLATES = Path(__file__).parent
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

    `trials` is what it would show with another constant or other motion.
    """

    spec: ExhibitSpec
    plan: Plan
    evidence: Evidence
    trials: Sequence[tuple[Trial, Evidence]] = ()

    @cached_property
    def found(self) -> list[Finding]:
        """The finding about each claim and version."""
        each, source = self.spec.claims.values(), self.spec.source
        return findings(each, source, self.evidence, self.plan, self.trials)

    @property
    def by_claim(self) -> list[list[Finding]]:
        """The findings grouped by claim, in the order of the file."""
        return [list(some) for _, some in groupby(self.found, lambda finding: finding.claim.id)]

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
        """Write figures as PNG and PDF, `claims.csv`, `claims.md` and the report; returns paths.

        That of the report comes first. An earlier report stays until the new one is complete.
        Raises OutputError.
        """
        paths = [folder / REPORT, folder / PAGE, folder / TABLE]
        with ClaimedFolder(folder, REPORT).staged() as stage:
            for number, section in enumerate(self.sections, start=1):
                for stem, draw in section.evidence.figures.items():
                    figure = draw()
                    for suffix in ("png", "pdf"):
                        paths.append(folder / f"{stem}.{suffix}")
                        save_figure(figure, stage / paths[-1].name)
                on_figure(number)
            machine = made_by()
            claims.write_claims(stage / TABLE, self.found, machine)
            for name in (PAGE, REPORT):
                (stage / name).write_text(self.text(name, stage, machine), encoding="utf-8")
        return paths

    def text(self, name: str, folder: Path, machine: Mapping[str, str]) -> str:
        """The report, with the figures in a folder, every text escaped; or the page in Markdown."""
        jinja2 = require_jinja()
        is_html = name.endswith(".html")
        environment = jinja2.Environment(autoescape=is_html, trim_blocks=True, lstrip_blocks=True)
        environment.filters["number"], environment.filters["shown"] = number, claims.shown
        template = environment.from_string((TEMPLATES / f"{name}.jinja").read_text("utf-8"))
        text: str = template.render(
            **vars(self),
            picture=lambda stem: base64.b64encode((folder / f"{stem}.png").read_bytes()).decode(),
            versions_of={name: model(9, name) for name in VERSIONS},
            any=ANY,
            with_authors=any(section.plan.reference for section in self.sections),
            counts=counts(self.found),
            whose=dict(zip(claims.WHOSE, _PARTS, strict=True)),
            words=dict(zip(VERDICTS, _WORDS, strict=True)),
            marks=dict(zip(VERDICTS, "✓○=✗?–", strict=True)),
            made_by=machine,
        )
        return text


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
    plans = {name: plan_of(name, plan, reference) for name in specs}
    started = {name: Started(EXHIBITS[name], plans[name]) for name in plans}
    trials = {
        name: [
            (trial, Started(EXHIBITS[name], trial.plan, trial.constant, trial.value))
            for trial in trials_of(name, of)
        ]
        for name, of in plans.items()
    }
    tried = (exhibit for each in trials.values() for _, exhibit in each)
    tasks = needed(chain(started.values(), tried))
    with claimed(out, names=(REPORT, TABLE), overwrite=overwrite):
        kept = out / "responses" / code_digest()
        kept.mkdir(parents=True, exist_ok=True)
        with progress("paper", len(tasks), "clip") as on_result:
            data = compute(tasks, jobs, on_result, kept)
        sections = []
        for name, spec in specs.items():
            shown, others = started[name].evidence(data), trials[name]
            seen = [(trial, exhibit.evidence(data)) for trial, exhibit in others]
            sections.append(Section(spec, plans[name], shown, seen))
        options = {"only": ",".join(only), "quick": quick, "reference": reference}
        report = Report(sections, remarks, plan, _command(options))
        with progress("figures", len(specs), "figure") as on_figure:
            paths = report.write(out, on_figure)
    held = counts(report.found).items()
    rows = [(name, *(str(count[kind]) for kind in VERDICTS)) for name, count in held]
    return Written(tuple(paths[:3]), ((_HEADER, rows),))


def _command(options: Mapping[str, object]) -> str:
    """The command that repeats a report, from its options; empty ones are left out."""
    given = {name: value for name, value in options.items() if value}
    words = [f"--{name}{'' if value is True else f' {value}'}" for name, value in given.items()]
    return " ".join(["dlgmd lab paper", *words])
