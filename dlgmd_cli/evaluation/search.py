"""A search for parameters with Optuna, whose trials are kept in a file and continued from it."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError, OutputExistsError, ParameterError
from dlgmd_cli.evaluation.calibration import Calibration, Choice
from dlgmd_cli.parameters import Parameters, shown
from dlgmd_cli.runs.run import Setup

TRIALS = "trials.db"
_NAME = "calibrate"
WIDTH = "width_px"
# From this ratio of the bounds on, the logarithm is searched.
_WIDE = 10.0
# What is found for every trial without a search.
_FOUND = ("kappa", "n_sp", "t_mp")
_OPTION = "Invalid value for '--search'"


@dataclass(frozen=True)
class Range:
    """Where a parameter is searched, both bounds included."""

    low: float
    high: float
    is_whole: bool

    @property
    def is_wide(self) -> bool:
        """Whether its logarithm is searched."""
        return self.low > 0 and self.high / self.low > _WIDE

    def text(self) -> str:
        """As it was typed."""
        return f"{self.low:.9g}:{self.high:.9g}"


def parse_ranges(texts: Sequence[str], params: Parameters) -> dict[str, Range]:
    """`KEY=LOW:HIGH` strings, of parameters or `width_px`, by key; raises ParameterError."""
    return dict(_range(text, params) for text in texts)


def _range(text: str, params: Parameters) -> tuple[str, Range]:
    """One of them."""
    key, _, bounds = text.partition("=")
    key = key.strip()
    try:
        low, high = (float(part) for part in bounds.split(":"))
    except ValueError:
        mend = "Write sigma_e=0.2:2."
        raise ParameterError(_OPTION, f"{shown(text)} is not KEY=LOW:HIGH", mend) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ParameterError(_OPTION, f"{shown(text)} does not rise from LOW to HIGH")
    if key in _FOUND:
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
    """A setup with other values; raises ParameterError if they do not go together."""
    own = {key: value for key, value in values.items() if key != WIDTH}
    width_px = values.get(WIDTH, setup.width_px)
    params: Parameters = replace(setup.params, **own)  # type: ignore[type-var]
    return replace(setup, params=params, width_px=width_px)


@dataclass(frozen=True)
class Trial:
    """Parameters that were tried, and what was chosen with them."""

    values: dict[str, Any]
    found: Calibration


class Search:
    """Trials in `folder`/trials.db; those of the same search that are there count.

    Parameters
    ----------
    folder : Path
        Must be there.
    ranges : dict of str to Range
        What is searched.
    asked : dict
        What tells this search from others.
    overwrite : bool
        Whether the trials of another search may be removed.

    Raises
    ------
    MissingExtraError
        If Optuna is not installed.
    OutputExistsError
        If the trials of another search are there, and may not be removed.
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
        if known not in (None, text):
            self.close()
            if not overwrite:
                raise OutputExistsError(
                    str(path),
                    "contains the trials of another search",
                    "Add --overwrite to remove them, or choose another --out.",
                )
            path.unlink()
            self._study = self._open(path)
            known = None
        if known is None:
            self._study.set_user_attr("asked", text)

    def _open(self, path: Path) -> Any:
        """The study in a file, made if need be; it draws on from the number of its trials."""
        optuna = self._optuna
        storage = optuna.storages.RDBStorage(f"sqlite:///{path.absolute()}")
        study = optuna.create_study(
            storage=storage, study_name=_NAME, direction="maximize", load_if_exists=True
        )
        study.sampler = optuna.samplers.TPESampler(seed=len(study.get_trials(deepcopy=False)))
        self._storage = storage
        return study

    def close(self) -> None:
        """Let go of the file."""
        self._storage.remove_session()
        with suppress(AttributeError):
            self._storage.engine.dispose()

    def __len__(self) -> int:
        return sum(trial.state.is_finished() for trial in self._study.get_trials(deepcopy=False))

    def trials(self) -> list[Trial]:
        """Every trial that was possible, in order."""
        state = self._optuna.trial.TrialState.COMPLETE
        return [
            Trial(dict(one.params), _from_json(one.user_attrs["found"]))
            for one in self._study.get_trials(deepcopy=False, states=(state,))
        ]

    def run(
        self, n_trials: int, setup: Setup, measure: Callable[[Setup], Calibration]
    ) -> Iterator[int]:
        """Try until there are so many trials; yields how many there are after each.

        The first has the setup's own values, as far as they are within the ranges.
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
            except ParameterError:  # values that do not go together
                self._study.tell(trial, state=state.FAIL)
            else:
                found = measure(changed)
                trial.set_user_attr("found", _as_json(found))
                recall, rate, lead_s = found.overall.rank
                # So small that it only decides between equal recalls.
                self._study.tell(trial, recall + 1e-3 * rate + 1e-4 * lead_s)
            yield n_done + 1

    @staticmethod
    def _suggest(trial: Any, key: str, one: Range) -> int | float:
        """A value of a range."""
        if one.is_whole:
            whole: int = trial.suggest_int(key, int(one.low), int(one.high), log=one.is_wide)
            return whole
        value: float = trial.suggest_float(key, one.low, one.high, log=one.is_wide)
        return value


def best_trial(trials: Sequence[Trial], fold: int | None = None) -> Trial:
    """The trial whose choice on all videos, or on all but those of a fold, ranks highest."""

    def rank(trial: Trial) -> tuple[float, float, float]:
        chosen = trial.found.overall if fold is None else trial.found.of_folds[fold]
        return chosen.rank

    return max(trials, key=rank)


def _as_json(found: Calibration) -> list[Any]:
    """A calibration as lists of numbers."""
    return [[one.n_sp, one.threshold, list(one.rank)] for one in (found.overall, *found.of_folds)]


def _from_json(lists: Sequence[Any]) -> Calibration:
    """The inverse of `_as_json`."""
    overall, *of_folds = (
        Choice(n_sp, threshold, tuple(rank))  # type: ignore[arg-type]
        for n_sp, threshold, rank in lists
    )
    return Calibration(overall, tuple(of_folds))
