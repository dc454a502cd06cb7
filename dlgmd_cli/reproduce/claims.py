"""The paper's claims with their thresholds, and what was found of each."""

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import FORMULATIONS, nearest
from dlgmd_cli.reproduce.plan import ANY, Values
from dlgmd_cli.results.csv import cell, write_rows

CLAIMS = Path(__file__).with_name("claims.yaml")
COLUMNS = ("id", "claim", "source", "formulation", "measure", "value", "threshold", "holds")
YES, NO, UNDECIDED = "yes", "no", "undecided"
# How a value is held against the threshold; and which of the values of several seeds is the worst.
_HOLDS = {
    "at least": (operator.ge, np.min),
    "above": (operator.gt, np.min),
    "at most": (operator.le, np.max),
    "below": (operator.lt, np.max),
}


@dataclass(frozen=True)
class Claim:
    """One claim of the paper; see `claims.yaml` for what its texts are."""

    id: str
    claim: str
    measure: str
    threshold: float
    holds: str
    reason: str
    why_not: str = ""


@dataclass(frozen=True)
class Story:
    """An exhibit's texts and claims; `repeat` holds commands."""

    id: str
    title: str
    source: str
    about: str
    repeat: Sequence[str]
    claims: Mapping[str, Claim]


@dataclass(frozen=True)
class Finding:
    """What was found of a claim under one formulation: the worst of its values, one per seed."""

    claim: Claim
    source: str
    formulation: str
    values: tuple[float, ...]

    @property
    def value(self) -> float:
        """The value of the worst seed, of those for which there is one; NaN if there is none."""
        known = [value for value in self.values if not math.isnan(value)]
        return float(_HOLDS[self.claim.holds][1](known)) if known else math.nan

    @property
    def holds(self) -> str:
        """`yes` if it holds for every seed, `no` if it fails for one, else `undecided`."""
        if not math.isnan(self.value) and not self._meets(self.value):
            return NO
        return YES if self.n_met == len(self.values) else UNDECIDED

    @property
    def n_met(self) -> int:
        """For how many seeds it holds."""
        return sum(self._meets(value) for value in self.values)

    def _meets(self, value: float) -> bool:
        return bool(_HOLDS[self.claim.holds][0](value, self.claim.threshold))

    def row(self) -> list[str]:
        """Its row of `claims.csv`."""
        one = self.claim
        numbers = cell(self.value), cell(one.threshold)
        return [one.id, one.claim, self.source, self.formulation, one.measure, *numbers, self.holds]


def load_claims(path: Path = CLAIMS) -> tuple[dict[str, Story], list[str]]:
    """The exhibits by id, in the order of the file, and the paper's inconsistencies."""
    document = yaml.safe_load(path.read_text("utf-8"))
    stories = {}
    for name, spec in document["exhibits"].items():
        claims = {key: Claim(key, **each) for key, each in spec.pop("claims").items()}
        stories[name] = Story(name, claims=claims, **spec)
    return stories, document["inconsistencies"]


def matching(stories: Mapping[str, Story], only: Iterable[str]) -> dict[str, Story]:
    """The exhibits and claims that ids or their beginnings stand for; all if there is none.

    `fig1` is fig1 alone, not fig10; `fig13` is fig13a and fig13b; `table4` is all of Table IV.

    Raises
    ------
    ParameterError
        If an id stands for nothing.
    """
    asked = [text.strip() for text in only if text.strip()]
    if not asked:
        return dict(stories)
    ids = {each: story.id for story in stories.values() for each in (story.id, *story.claims)}
    for text in asked:
        if not any(_stands_for(text, each) for each in ids):
            near = nearest(text[:100], ids)
            hint = f"Did you mean '{near}'? " if near else ""
            mend = f"{hint}Choose from {', '.join(stories)}, or one of their claims."
            raise ParameterError(
                "Invalid value for '--only'", f"there is no {text[:40]!r} to reproduce", mend
            )
    found = {}
    for story in stories.values():
        is_whole = any(_stands_for(text, story.id) for text in asked)
        claims = {
            key: claim
            for key, claim in story.claims.items()
            if is_whole or any(_stands_for(text, key) for text in asked)
        }
        if claims:
            found[story.id] = Story(**{**vars(story), "claims": claims})
    return found


def _stands_for(text: str, name: str) -> bool:
    """Whether `name` is `text`, or goes on behind it with something else than a digit."""
    return name.startswith(text) and not name[len(text) : len(text) + 1].isdigit()


def findings(story: Story, values: Values) -> list[Finding]:
    """Each claim of an exhibit under each formulation."""
    return [
        Finding(claim, story.source, formulation, tuple(values[key][formulation]))
        for key, claim in story.claims.items()
        for formulation in (ANY, *FORMULATIONS)
        if formulation in values[key]
    ]


def write_claims(path: Path, found: Iterable[Finding]) -> None:
    """Write `claims.csv`; OSError passes through."""
    write_rows(path, COLUMNS, (one.row() for one in found))


def counts(found: Sequence[Finding]) -> dict[str, dict[str, int]]:
    """Formulation -> how many claims hold, do not, are undecided.

    Claims that are not about the D-LGMD count under `any`.
    """
    result: dict[str, Any] = {}
    for one in found:
        result.setdefault(one.formulation, dict.fromkeys((YES, NO, UNDECIDED), 0))
        result[one.formulation][one.holds] += 1
    return result
