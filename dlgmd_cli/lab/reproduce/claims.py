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
from dlgmd_cli.lab.reproduce.plan import ANY
from dlgmd_cli.parameters import FORMULATIONS
from dlgmd_cli.results.csv import cell, write_rows

CLAIMS = Path(__file__).with_name("claims.yaml")
COLUMNS = ("id", "claim", "source", "formulation", "measure", "value", "threshold", "holds")
YES, NO, UNDECIDED = "yes", "no", "undecided"
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
    why_not: str = ""


@dataclass(frozen=True)
class ExhibitSpec:
    """Texts and claims of an exhibit, from `claims.yaml`; `repeat` has commands that repeat it."""

    id: str
    title: str
    source: str
    about: str
    repeat: Sequence[str]
    claims: Mapping[str, Claim]


@dataclass(frozen=True)
class Finding:
    """The values of a claim under one formulation, one per seed."""

    claim: Claim
    source: str
    formulation: str
    values: tuple[float, ...]

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


def load_claims(path: Path = CLAIMS) -> tuple[dict[str, ExhibitSpec], list[str]]:
    """The exhibits by id, in the order of the file, and the inconsistencies of the paper."""
    document = yaml.safe_load(path.read_text("utf-8"))
    specs = {}
    for name, spec in document["exhibits"].items():
        claims = {key: Claim(key, **each) for key, each in spec.pop("claims").items()}
        specs[name] = ExhibitSpec(name, claims=claims, **spec)
    return specs, document["inconsistencies"]


def select(specs: Mapping[str, ExhibitSpec], only: Iterable[str]) -> dict[str, ExhibitSpec]:
    """The exhibits and claims whose ids begin with one of `only`; all of them if it is empty.

    `fig1` selects fig1 alone, not fig10; `fig13` selects fig13a and fig13b; `table4` selects all of
    Table IV.

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
    """Each claim of an exhibit under each formulation; `values` by claim and formulation."""
    return [
        Finding(claim, spec.source, formulation, tuple(values[key][formulation]))
        for key, claim in spec.claims.items()
        for formulation in (ANY, *FORMULATIONS)
        if formulation in values[key]
    ]


def write_claims(path: Path, found: Iterable[Finding]) -> None:
    """Write `claims.csv`; OSError passes through."""
    rows = (
        [
            *(one.claim.id, one.claim.claim, one.source, one.formulation, one.claim.measure),
            *(cell(one.value), cell(one.claim.threshold), one.holds),
        ]
        for one in found
    )
    write_rows(path, COLUMNS, rows)


def counts(found: Sequence[Finding]) -> dict[str, dict[str, int]]:
    """Formulation -> numbers of claims that hold, do not hold, and are undecided.

    Claims that are not about the D-LGMD count under `any`.
    """
    numbers = Counter((one.formulation, one.holds) for one in found)
    names = dict.fromkeys(one.formulation for one in found)
    return {name: {kind: numbers[name, kind] for kind in (YES, NO, UNDECIDED)} for name in names}
