"""A parameter search with Optuna; trials are stored in a file, and a later search continues it."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError, OutputExistsError, ParameterError
from dlgmd_cli.lab.evaluation.crossvalidation import Choice, Choices
from dlgmd_cli.parameters import Parameters, shown
from dlgmd_cli.results.record import differences
from dlgmd_cli.runs.setup import Setup

TRIALS = "trials.db"
_NAME = "calibrate"
WIDTH = "width_px"
# Ranges wider than this ratio are searched on a logarithmic scale.
_WIDE = 10.0
# Parameters that are calibrated in every trial, and need no search.
_CALIBRATED = ("kappa", "n_sp", "t_mp")
_OPTION = "Invalid value for '--search'"


@dataclass(frozen=True)
class Range:
    """The range in which a parameter is searched, both bounds included."""

    low: float
    high: float
    is_whole: bool

    @property
    def is_wide(self) -> bool:
        """Whether it is searched on a logarithmic scale."""
        return self.low > 0 and self.high / self.low > _WIDE

    def text(self) -> str:
        """`LOW:HIGH`, as on the command line."""
        return f"{self.low:.9g}:{self.high:.9g}"


def parse_ranges(texts: Sequence[str], params: Parameters) -> dict[str, Range]:
    """Parse `KEY=LOW:HIGH`, KEY a parameter or `width_px`; returns the ranges by key.

    Raises ParameterError.
    """
    return dict(_range(text, params) for text in texts)


def _range(text: str, params: Parameters) -> tuple[str, Range]:
    """The key and the range in one `KEY=LOW:HIGH`."""
    key, _, bounds = text.partition("=")
    key = key.strip()
    try:
        low, high = (float(part) for part in bounds.split(":"))
    except ValueError:
        mend = "Write sigma_e=0.2:2."
        raise ParameterError(_OPTION, f"{shown(text)} is not KEY=LOW:HIGH", mend) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ParameterError(_OPTION, f"{shown(text)} does not rise from LOW to HIGH")
    if key in _CALIBRATED:
        raise ParameterError(_OPTION, f"{key} is calibrated without a search", "Leave it out.")
    if key == WIDTH:
        least, most, is_whole = 16.0, 8192.0, True
    else:
        specs = params.specs()
        if key not in specs:
            raise params.unknown(key)
        default = params.defaults()[key]
        if isinstance(default, bool | str):
            raise ParameterError(_OPTION, f"{key} is not a number", "Set it with --param.")
        least, most, is_whole = specs[key].low, specs[key].high, isinstance(default, int)
    if low < least or high > most:
        raise ParameterError(_OPTION, f"{key} may only be from {least:g} to {most:g}")
    if is_whole and (low != round(low) or high != round(high)):
        raise ParameterError(_OPTION, f"{key} takes whole numbers only")
    return key, Range(low, high, is_whole)


def with_values(setup: Setup, values: Mapping[str, Any]) -> Setup:
    """A setup with other values; raises ParameterError if they contradict each other."""
    own = {key: value for key, value in values.items() if key != WIDTH}
    width_px = values.get(WIDTH, setup.width_px)
    params: Parameters = replace(setup.params, **own)  # type: ignore[type-var]
    return replace(setup, params=params, width_px=width_px)


@dataclass(frozen=True)
class Trial:
    """The values of a trial, and the thresholds chosen with them."""

    values: dict[str, Any]
    found: Choices


class Search:
    """The trials in `folder`/trials.db; a search with the same settings continues them.

    Parameters
    ----------
    folder : Path
        An existing folder.
    ranges : dict of str to Range
        The ranges to search, by parameter.
    asked : dict
        Everything that the trials depend on: labels, rules, ranges, model and options.
    overwrite : bool
        Remove the trials of a search with other settings.

    Raises
    ------
    MissingExtraError
        If Optuna is not installed.
    OutputExistsError
        If the folder has trials of a search with other settings, and not `overwrite`.
    """

    def __init__(
        self,
        folder: Path,
        ranges: Mapping[str, Range],
        asked: Mapping[str, Any],
        *,
        overwrite: bool = False,
    ) -> None:
        try:
            import optuna
        except ImportError:
            raise MissingExtraError(
                "--search", "Optuna is not installed", "Run: pip install 'dlgmd[calibrate]'."
            ) from None
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.ranges, self._optuna = ranges, optuna
        path = folder / TRIALS
        text = json.dumps(asked, sort_keys=True)
        self._study = self._open(path)
        known = self._study.user_attrs.get("asked")
        before = {} if known is None else json.loads(known)
        differing = differences(before, settings=json.loads(text))
        if known is not None and differing:
            self.close()
            if not overwrite:
                raise OutputExistsError(
                    str(path),
                    f"contains the trials of another search ({', '.join(differing)})",
                    "Add --overwrite to remove them, or choose another --out.",
                )
            path.unlink()
            self._study = self._open(path)
            known = None
        if known is None:
            self._study.set_user_attr("asked", text)

    def _open(self, path: Path) -> Any:
        """Open or create the study in a file; its sampler's seed is the number of its trials."""
        optuna = self._optuna
        storage = optuna.storages.RDBStorage(f"sqlite:///{path.absolute()}")
        study = optuna.create_study(
            storage=storage, study_name=_NAME, direction="maximize", load_if_exists=True
        )
        study.sampler = optuna.samplers.TPESampler(seed=len(study.get_trials(deepcopy=False)))
        self._storage = storage
        return study

    def close(self) -> None:
        """Close the file."""
        self._storage.remove_session()
        with suppress(AttributeError):
            self._storage.engine.dispose()

    def __len__(self) -> int:
        return sum(trial.state.is_finished() for trial in self._study.get_trials(deepcopy=False))

    def trials(self) -> list[Trial]:
        """Every trial whose values were valid, in order."""
        state = self._optuna.trial.TrialState.COMPLETE
        return [
            Trial(dict(one.params), _from_json(one.user_attrs["found"]))
            for one in self._study.get_trials(deepcopy=False, states=(state,))
        ]

    def run(
        self, n_trials: int, setup: Setup, measure: Callable[[Setup], Choices]
    ) -> Iterator[int]:
        """Run trials until there are `n_trials`; yields the number done after each.

        The first trial has the setup's own values, limited to the ranges.
        """
        state = self._optuna.trial.TrialState
        if not self._study.get_trials(deepcopy=False):
            own = {**setup.params.to_dict(), WIDTH: setup.width_px}
            self._study.enqueue_trial(
                {key: min(max(own[key], r.low), r.high) for key, r in self.ranges.items()}
            )
        while (n_done := len(self)) < n_trials:
            trial = self._study.ask()
            values = {key: self._suggest(trial, key, one) for key, one in self.ranges.items()}
            try:
                changed = with_values(setup, values)
            except ParameterError:  # the values contradict each other
                self._study.tell(trial, state=state.FAIL)
            else:
                found = measure(changed)
                trial.set_user_attr("found", _as_json(found))
                recall, rate, lead_s = found.overall.rank
                # Small weights: false alarms and lead decide between nearly equal recalls.
                self._study.tell(trial, recall + 1e-3 * rate + 1e-4 * lead_s)
            yield n_done + 1

    @staticmethod
    def _suggest(trial: Any, key: str, one: Range) -> int | float:
        """Let Optuna suggest a value within a range."""
        if one.is_whole:
            whole: int = trial.suggest_int(key, int(one.low), int(one.high), log=one.is_wide)
            return whole
        value: float = trial.suggest_float(key, one.low, one.high, log=one.is_wide)
        return value


def best_trial(trials: Sequence[Trial], fold: int | None = None) -> Trial:
    """The trial whose choice ranks highest: on all videos, or on all but those of a fold."""

    def rank(trial: Trial) -> tuple[float, float, float]:
        chosen = trial.found.overall if fold is None else trial.found.of_folds[fold]
        return chosen.rank

    return max(trials, key=rank)


def _as_json(found: Choices) -> list[Any]:
    """A calibration as lists of numbers."""
    return [[one.n_sp, one.threshold, list(one.rank)] for one in (found.overall, *found.of_folds)]


def _from_json(lists: Sequence[Any]) -> Choices:
    """The inverse of `_as_json`."""
    overall, *of_folds = (
        Choice(n_sp, threshold, tuple(rank))  # type: ignore[arg-type]
        for n_sp, threshold, rank in lists
    )
    return Choices(overall, tuple(of_folds))
