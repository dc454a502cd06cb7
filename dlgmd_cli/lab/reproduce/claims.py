"""The paper's claims with their thresholds, and the findings about them."""

import math
import operator
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from dlgmd_cli.checks import nearest
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.reproduce.clips import NULLS, VERSIONS
from dlgmd_cli.lab.reproduce.plan import ANY
from dlgmd_cli.results.csv import cell, write_rows

CLAIMS = Path(__file__).with_name("claims.yaml")
COLUMNS = (
    *("id", "claim", "source", "formulation", "measure", "value", "threshold", "holds"),
    *("whose", "unit", "criterion", "reason", "paper_value", "seeds", "null_value", "null_holds"),
)
YES, NO, UNDECIDED = "yes", "no", "undecided"
# It holds, but it also does without inhibition.
EMPTY = "empty"
# Whose a claim is: the paper's about its model, the paper's about other models, or this project's.
WHOSE = ("paper", "models", "ours")
# Comparison of a value with the threshold; and the worst of the values of several seeds.
_HOLDS = {
    "at least": (operator.ge, np.min),
    "above": (operator.gt, np.min),
    "at most": (operator.le, np.max),
    "below": (operator.lt, np.max),
}


@dataclass(frozen=True)
class Claim:
    """One claim of the paper; `claims.yaml` explains the fields."""

    id: str
    claim: str
    measure: str
    threshold: float
    holds: str
    reason: str
    unit: str = ""
    whose: str = "paper"
    source: str = ""
    paper: str = ""
    why_not: str = ""

    @property
    def sign(self) -> str:
        """The comparison with the threshold."""
        return {"at least": "≥", "above": ">", "at most": "≤", "below": "<"}[self.holds]


@dataclass(frozen=True)
class ExhibitSpec:
    """Texts and claims of an exhibit, from `claims.yaml`; `repeat` has commands that repeat it.

    `says` is what the paper says, in this project's words.
    """

    id: str
    title: str
    source: str
    says: str
    about: str
    repeat: Sequence[str]
    claims: Mapping[str, Claim]


@dataclass(frozen=True)
class Finding:
    """The values of a claim under one version of the model, one per seed.

    `null` are those of the same version without inhibition, if it was measured.
    """

    claim: Claim
    source: str
    version: str
    values: tuple[float, ...]
    null: tuple[float, ...] = ()

    @property
    def of_null(self) -> "Finding | None":
        """The same of the null model."""
        return replace(self, values=self.null, null=()) if self.null else None

    @property
    def verdict(self) -> str:
        """As `holds`, but `empty` if it also holds for the null model."""
        null = self.of_null
        return EMPTY if self.holds == YES and null is not None and null.holds == YES else self.holds

    @property
    def value(self) -> float:
        """The worst value of all seeds, ignoring NaN; NaN if all are."""
        known = [value for value in self.values if not math.isnan(value)]
        return float(_HOLDS[self.claim.holds][1](known)) if known else math.nan

    @property
    def holds(self) -> str:
        """`yes` if it holds for every seed, `no` if it fails for one, otherwise `undecided`."""
        if not math.isnan(self.value) and not self._meets(self.value):
            return NO
        return YES if self.n_met == len(self.values) else UNDECIDED

    @property
    def n_met(self) -> int:
        """Number of seeds for which it holds."""
        return sum(self._meets(value) for value in self.values)

    def _meets(self, value: float) -> bool:
        return bool(_HOLDS[self.claim.holds][0](value, self.claim.threshold))


def load_claims() -> tuple[dict[str, ExhibitSpec], dict[str, list[str]]]:
    """The exhibits by id, in the order of the file, and the lists of remarks on the whole."""
    document = yaml.safe_load(CLAIMS.read_text("utf-8"))
    specs = {}
    for name, spec in document["exhibits"].items():
        claims = {key: Claim(key, **each) for key, each in spec.pop("claims").items()}
        specs[name] = ExhibitSpec(name, claims=claims, **spec)
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
    asked = [text.strip() for text in only if text.strip()]
    ids = {each: spec.id for spec in specs.values() for each in (spec.id, *spec.claims)}
    for text in asked:
        if not any(_matches(text, each) for each in ids):
            near = nearest(text[:100], ids)
            hint = f"Did you mean '{near}'? " if near else ""
            mend = f"{hint}Choose from {', '.join(specs)}, or one of their claims."
            raise ParameterError(
                "Invalid value for '--only'", f"there is no {text[:40]!r} to reproduce", mend
            )
    found = {}
    for name, spec in specs.items():
        claims = {
            key: claim
            for key, claim in spec.claims.items()
            if not asked or any(_matches(text, each) for text in asked for each in (name, key))
        }
        if claims:
            found[name] = replace(spec, claims=claims)
    return found


def _matches(text: str, name: str) -> bool:
    """Whether `name` begins with `text`, and the next character, if any, is not a digit."""
    return name.startswith(text) and not name[len(text) : len(text) + 1].isdigit()


def findings(
    spec: ExhibitSpec, values: Mapping[str, Mapping[str, Sequence[float]]]
) -> list[Finding]:
    """Each claim of an exhibit under each version of the model; `values` by claim and version."""
    return [
        Finding(
            claim,
            claim.source or spec.source,
            version,
            tuple(values[key][version]),
            tuple(values[key].get(NULLS.get(version, ""), ())),
        )
        for key, claim in spec.claims.items()
        for version in (ANY, *VERSIONS)
        if version in values[key]
    ]


def write_claims(path: Path, found: Iterable[Finding]) -> None:
    """Write `claims.csv`; OSError passes through."""
    rows = (
        [
            *(one.claim.id, one.claim.claim, one.source, one.version, one.claim.measure),
            *(cell(one.value), cell(one.claim.threshold), one.holds),
            *(one.claim.whose, one.claim.unit, one.claim.holds, one.claim.reason),
            *(one.claim.paper, str(len(one.values))),
            *((cell(one.of_null.value), one.of_null.holds) if one.of_null else ("", "")),
        ]
        for one in found
    )
    write_rows(path, COLUMNS, rows)


def counts(found: Iterable[Finding]) -> dict[str, Counter[str]]:
    """Version -> numbers of claims by verdict, of the paper's claims about its model."""
    numbers: dict[str, Counter[str]] = {}
    for one in found:
        if one.claim.whose == WHOSE[0] and one.version != ANY:
            numbers.setdefault(one.version, Counter())[one.verdict] += 1
    return numbers
