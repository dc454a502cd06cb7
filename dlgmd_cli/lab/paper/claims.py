"""The paper's claims with their thresholds, and the findings about them."""

import csv
import math
import operator
import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.paper.clips import NULLS, VERSIONS
from dlgmd_cli.lab.paper.plan import ANY, Evidence, Plan, Trial

CLAIMS = Path(__file__).with_name("claims.yaml")
YES, NO, UNDECIDED = "yes", "no", "undecided"
# It holds, but it also does without inhibition, which is said to bring it about.
EMPTY = "empty"
# Neither side is ahead; and the measure is undefined on most of the clips, or could not be taken.
TIE, UNTESTABLE = "tie", "untestable"
VERDICTS = (YES, EMPTY, TIE, NO, UNDECIDED, UNTESTABLE)
# Whose a claim is: the paper's about its model, the paper's about other models, or this project's.
OURS = "ours"
WHOSE = ("paper", "models", OURS)
# What a claim is about. Only one that says what inhibition brings about must fail without it.
SELECTS, RESPONDS, PART = KINDS = ("selects", "responds", "part")
# Of `claims.csv`; the last ones say what made it.
_MADE_BY = ("dlgmd", "commit", "cpu", "os")
COLUMNS = (
    *("id", "reading", "claim", "source", "whose", "formulation"),
    *("measure", "criterion", "threshold"),
    *("shown_on", "seed", "value", "holds", "median", "low", "high", "seeds", "verdict"),
    *("at_first", "n_tried", "flipped_by", "undecided_by"),
    *("null_value", "null_holds", "input", "input_sha256", *_MADE_BY),
)
# What holds between a value and the threshold, and its sign.
_HOLDS = {
    "at least": (operator.ge, "≥"),
    "above": (operator.gt, ">"),
    "at most": (operator.le, "≤"),
    "below": (operator.lt, "<"),
}
# Probability that a median lies outside its interval, at most.
_OUTSIDE = 0.05


@dataclass(frozen=True)
class Claim:
    """One claim of the paper; `claims.yaml` explains the fields.

    `readings` are other measures of the same sentence, by name. Each is a claim of its own, whose
    values evidence has under the id `CLAIM~NAME`.
    """

    id: str
    claim: str
    measure: str
    threshold: float
    holds: str
    reason: str
    unit: str = ""
    whose: str = "paper"
    kind: str = SELECTS
    source: str = ""
    paper: str = ""
    tie: tuple[float, float] | None = None
    why_not: str = ""
    why_undecided: str = ""
    words: str = ""
    objection: str = ""
    answer: str = ""
    tries: Sequence[float] = ()
    label: str = ""
    readings: Mapping[str, "Claim"] = field(default_factory=dict)

    @classmethod
    def of(cls, key: str, fields: Mapping[str, Any]) -> "Claim":
        """A claim from its fields in `claims.yaml`."""
        claim = cls(key, **{**fields, "readings": {}})
        readings = {
            name: replace(claim, id=f"{key}~{name}", tries=(), **changes)
            for name, changes in fields.get("readings", {}).items()
        }
        return replace(claim, readings=readings)

    @property
    def sign(self) -> str:
        """The comparison with the threshold."""
        return _HOLDS[self.holds][1]


@dataclass(frozen=True)
class ExhibitSpec:
    """Texts and claims of an exhibit, from `claims.yaml`.

    `says` is what the paper says, in this project's words; `decides` what would decide the claims
    that are open.
    """

    id: str
    title: str
    source: str
    says: str
    about: str
    claims: Mapping[str, Claim]
    decides: str = ""


@dataclass(frozen=True)
class Finding:
    """The values of a claim under one version of the model, one per seed, or a single one.

    `frames` says on which frames, see `Plan.name`, and `inputs` which they are, see `Evidence`.
    `null` are the values of the same version without inhibition, if it was measured. `tried` are
    the findings of other thresholds, readings, constants and motions.
    """

    claim: Claim
    source: str
    version: str
    values: tuple[float, ...]
    null: tuple[float, ...] = ()
    frames: str = ""
    seeds: tuple[int | None, ...] = (None,)
    inputs: Mapping[int | None, Mapping[str, str]] = field(default_factory=dict)
    tried: Sequence["Tried"] = ()

    @property
    def of_null(self) -> "Finding | None":
        """The same of the null model."""
        return replace(self, values=self.null, null=()) if self.null else None

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the median over seeds, or the range with fewer than six."""
        return interval(self.values)

    @property
    def median(self) -> float:
        """The median over the seeds where the value is defined; NaN if it is nowhere."""
        known = [value for value in self.values if not math.isnan(value)]
        return statistics.median(known) if known else math.nan

    @property
    def holds(self) -> str:
        """`yes` or `no` if the whole interval meets the criterion or fails it, or `undecided`.

        It is a `tie` instead of the first two if the median is as good as equality, and
        `untestable` if the measure is undefined on more than half of the clips.
        """
        if 2 * sum(map(math.isnan, self.values)) > len(self.values):
            return UNTESTABLE
        met = {self.meets(value) for value in self.interval}
        if None in met or len(met) == 2:
            return UNDECIDED
        if self.claim.tie and self.claim.tie[0] <= self.median <= self.claim.tie[1]:
            return TIE
        return YES if met == {True} else NO

    @property
    def at_first(self) -> str:
        """As `holds`, but `empty` if inhibition should bring it about, and it holds without."""
        null = self.of_null if self.claim.kind == SELECTS else None
        return EMPTY if self.holds == YES and null is not None and null.holds == YES else self.holds

    @property
    def flipped_by(self) -> list[str]:
        """What of that which was tried gives another verdict."""
        open_ = (UNDECIDED, UNTESTABLE)
        if self.at_first in open_:
            return []
        same = (self.at_first, *open_)
        return [each.text for each in self.tried if each.found.at_first not in same]

    @property
    def undecided_by(self) -> list[str]:
        """What of that which was tried gives no verdict, where the finding itself has one."""
        if self.at_first == UNDECIDED:
            return []
        return [each.text for each in self.tried if each.found.at_first == UNDECIDED]

    @property
    def verdict(self) -> str:
        """The verdict `at_first`, or `undecided` if something that was tried gives another."""
        return UNDECIDED if self.flipped_by else self.at_first

    def meets(self, value: float) -> bool | None:
        """Whether a value meets the criterion; None if it is undefined."""
        if math.isnan(value):
            return None
        holds, _ = _HOLDS[self.claim.holds]
        return bool(holds(value, self.claim.threshold))


class Tried(NamedTuple):
    """Something that was tried in words, what was found, and whether it is another reading."""

    text: str
    found: Finding
    is_reading: bool = False


def interval(values: Sequence[float]) -> tuple[float, float]:
    """The interval between two order statistics that has the median with 95 % or more.

    Values may be infinite. An undefined one could be anything, and counts as the least for the
    lower end, and as the greatest for the upper one; an end that is undefined is NaN.
    """
    n, rank, tail = len(values), 0, 0.5 ** len(values)
    while 2.0 * tail <= _OUTSIDE:
        rank += 1
        tail += math.comb(n, rank) * 0.5**n
    rank = max(0, rank - 1)  # 0 is the least value
    known, n_unknown = sorted(v for v in values if not math.isnan(v)), sum(map(math.isnan, values))
    low, high = rank - n_unknown, len(known) - 1 - rank + n_unknown
    first, last = (known[at] if 0 <= at < len(known) else math.nan for at in (low, high))
    return first, last


def load_claims() -> tuple[dict[str, ExhibitSpec], dict[str, list[str]]]:
    """The exhibits by id, in the order of the file, and the lists of remarks on the whole."""
    document = yaml.safe_load(CLAIMS.read_text("utf-8"))
    specs = {}
    for name, spec in document["exhibits"].items():
        claims = {key: Claim.of(key, each) for key, each in spec["claims"].items()}
        specs[name] = ExhibitSpec(name, **{**spec, "claims": claims})
    return specs, document["remarks"]


def select(specs: Mapping[str, ExhibitSpec], only: Iterable[str]) -> dict[str, ExhibitSpec]:
    """The exhibits and claims whose ids begin with one of `only`; all of them if it is empty.

    `fig1` selects fig1 alone, not fig10; `fig9a` selects its claims in fig9; `table4` selects all
    of Table IV.

    Raises
    ------
    ParameterError
        If nothing begins with one of `only`.
    """
    prefixes = [text.strip() for text in only if text.strip()] or [""]
    ids = [each for spec in specs.values() for each in (spec.id, *spec.claims)]
    for text in prefixes:
        if not any(_matches(text, each) for each in ids):
            choices = f"Choose from {', '.join(specs)}, or one of their claims."
            raise ParameterError("", f"the paper has no {text[:40]!r}", choices, "only")
    chosen = {}
    for name, spec in specs.items():
        claims = {
            key: claim
            for key, claim in spec.claims.items()
            if any(_matches(text, each) for text in prefixes for each in (name, key))
        }
        if claims:
            chosen[name] = replace(spec, claims=claims)
    return chosen


def _matches(text: str, name: str) -> bool:
    """Whether `name` begins with `text`, and the next character, if any, is not a digit."""
    return name.startswith(text) and not name[len(text) : len(text) + 1].isdigit()


def findings(
    claims: Iterable[Claim],
    source: str,
    evidence: Evidence,
    plan: Plan,
    trials: Iterable[tuple[Trial, Evidence]] = (),
) -> list[Finding]:
    """Claims under each version of the model, as far as the evidence of a plan has them.

    `trials` are the evidence with another constant, or of other motion.
    """
    trials, results = list(trials), []
    for claim in claims:
        for version in (ANY, *VERSIONS):
            found = _finding(claim, version, source, evidence, plan)
            if found:
                tried = tuple(_tried(found, evidence, trials, plan))
                results.append(replace(found, tried=tried))
    return results


def _finding(
    claim: Claim, version: str, source: str, evidence: Evidence, plan: Plan
) -> Finding | None:
    """The finding about a claim under a version; None if the evidence does not have it."""
    values = evidence.values.get(claim.id, {})
    if version not in values:
        return None
    found, null = values[version], values.get(NULLS.get(version, ""), ())
    seeds = plan.seeds if len(found) == len(plan.seeds) else (None,) * len(found)
    place = OURS if claim.whose == OURS else claim.source or source
    facts = plan.name, seeds, evidence.inputs
    return Finding(claim, place, version, tuple(found), tuple(null), *facts)


def _tried(
    found: Finding, evidence: Evidence, trials: Iterable[tuple[Trial, Evidence]], plan: Plan
) -> Iterator[Tried]:
    """What else was tried: thresholds, readings, constants that matter, and other motion."""
    claim = found.claim
    unit = f" {claim.unit}" if claim.unit else ""
    for threshold in claim.tries:
        other = replace(found, claim=replace(claim, threshold=threshold))
        yield Tried(f"threshold {number(threshold)}{unit}", other)
    for reading in claim.readings.values():
        if read := _finding(reading, found.version, found.source, evidence, plan):
            yield Tried(reading.label, read, is_reading=True)
    for trial, seen in trials:
        tried = _finding(claim, found.version, found.source, seen, plan)
        if tried and not _are_alike(found, tried):
            yield Tried(trial.text, tried, trial.is_reading)


def _are_alike(one: Finding, other: Finding) -> bool:
    """Whether two findings have the same values: what was changed does not matter to them."""
    # As texts, what is undefined is alike.
    return repr((one.values, one.null)) == repr((other.values, other.null))


def write_claims(path: Path, results: Iterable[Finding], made_by: Mapping[str, str]) -> None:
    """Write `claims.csv`, a row for each claim, reading, version and seed; OSError passes through.

    `made_by` are the versions and the machine, see `paper.made_by`.
    """
    machine = {name: made_by.get(name, "") for name in _MADE_BY}
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        for finding in results:
            readings = [each for each in finding.tried if each.is_reading]
            for text, each in [("", finding), *((one.text, one.found) for one in readings)]:
                writer.writerows(row | {"reading": text} | machine for row in _rows(each))


def _rows(finding: Finding) -> Iterator[dict[str, str]]:
    """The rows of a finding, one per seed."""
    claim, null = finding.claim, finding.of_null
    low, high = finding.interval
    words = {True: YES, False: NO, None: UNDECIDED}
    for place, (seed, value) in enumerate(zip(finding.seeds, finding.values, strict=True)):
        inputs = {**finding.inputs.get(None, {}), **finding.inputs.get(seed, {})}
        yield {
            "id": claim.id.partition("~")[0],
            "claim": claim.claim,
            "source": finding.source,
            "whose": claim.whose,
            "formulation": finding.version,
            "measure": claim.measure,
            "criterion": claim.holds,
            "threshold": _cell(claim.threshold),
            "shown_on": finding.frames,
            "seed": "" if seed is None else str(seed),
            "value": _cell(value),
            "holds": words[finding.meets(value)],
            "median": _cell(finding.median),
            "low": _cell(low),
            "high": _cell(high),
            "seeds": str(len(finding.values)),
            "verdict": finding.verdict,
            "at_first": finding.at_first,
            "n_tried": str(len(finding.tried)),
            "flipped_by": "; ".join(finding.flipped_by),
            "undecided_by": "; ".join(finding.undecided_by),
            "null_value": _cell(null.values[place]) if null else "",
            "null_holds": null.holds if null else "",
            "input": " ".join(inputs),
            "input_sha256": " ".join(inputs.values()),
        }


def _cell(value: float) -> str:
    """A number in `claims.csv`; empty where it is undefined."""
    return "" if math.isnan(value) else f"{value:.9g}"


def counts(results: Iterable[Finding]) -> dict[str, Counter[str]]:
    """Version -> numbers of claims by verdict, of the paper's claims about its model.

    A claim that does not depend on the version counts in each.
    """
    of_paper = [finding for finding in results if finding.claim.whose == WHOSE[0]]
    numbers = {v: Counter(o.verdict for o in of_paper if o.version in (v, ANY)) for v in VERSIONS}
    return {version: each for version, each in numbers.items() if each}


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


def shown(finding: Finding) -> str:
    """The value, or the median over seeds with its interval."""
    if len(finding.values) == 1:
        text, threshold = number(finding.median), finding.claim.threshold
        # With three digits, a value could look like the threshold that it just meets or fails.
        is_close = text == number(threshold) and finding.median != threshold
        return f"{finding.median:.6g}".replace("-", "−") if is_close else text
    low, high = map(number, finding.interval)
    return number(finding.median) if low == high else f"{number(finding.median)} ({low} to {high})"
