"""A parameter search with Optuna; trials are stored in a file, and a later search continues it."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError, OutputExistsError, ParameterError
from dlgmd_cli.parameters.checks import Spec, blame, shown
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.results.calibration import WIDTH, Choice, Choices
from dlgmd_cli.results.record import differences
from dlgmd_cli.tasks.setup import Setup

TRIALS = "trials.db"
_NAME = "calibrate"
_WIDTHS = Spec(int, 16, 8192)
# Ranges wider than this ratio are searched on a logarithmic scale.
_WIDE = 10.0
# Parameters that are calibrated in every trial, and need no search.
_CALIBRATED = ("kappa", "n_sp", "t_mp", "ttc_alarm")
_OPTION = "Invalid value for '--search'"


@dataclass(frozen=True)
class Trial:
    """The values of a trial, and the thresholds chosen with them."""

    values: dict[str, Any]
    found: Choices


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


def parse_range(text: str, params: Parameters) -> tuple[str, Range]:
    """Parse `KEY=LOW:HIGH`, KEY a parameter or `width_px`; returns the key and the range.

    Raises ParameterError.
    """
    key, _, bounds = text.partition("=")
    key, parts = key.strip(), bounds.split(":")
    if len(parts) != 2:
        raise ParameterError(_OPTION, f"{shown(text)} is not KEY=LOW:HIGH", "Write sigma_e=0.2:2.")
    if key in _CALIBRATED:
        raise ParameterError(_OPTION, f"{key} is calibrated without a search", "Leave it out.")
    spec = _WIDTHS if key == WIDTH else params.specs().get(key)
    if spec is None:
        raise params.unknown(key)
    if spec.kind in (bool, str):
        raise ParameterError(_OPTION, f"{key} is not a number", "Set it with --param.")
    with blame(_OPTION):
        low, high = (float(spec.parse(part, key)) for part in parts)
    if low >= high:
        raise ParameterError(_OPTION, f"{shown(text)} does not rise from LOW to HIGH")
    return key, Range(low, high, spec.kind is int)


class Search:
    """The trials in `folder`/trials.db; a search with the same settings continues them.

    Parameters
    ----------
    folder : Path
        An existing folder.
    ranges : dict of str to Range
        The ranges to search, by parameter.
    settings : dict
        What else the trials depend on: labels, rules, model and options.
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
        settings: Mapping[str, Any],
        *,
        overwrite: bool = False,
    ) -> None:
        try:
            import optuna
        except ImportError:
            raise MissingExtraError.of("--search", "optuna") from None
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.ranges, self._optuna, self._path = ranges, optuna, folder / TRIALS
        texts = {key: bounds.text() for key, bounds in ranges.items()}
        text = json.dumps({**settings, "ranges": texts}, sort_keys=True)
        self._open()
        known = self._study.user_attrs.get("asked")
        if known and (differing := differences(json.loads(known), settings=json.loads(text))):
            self.close()
            if not overwrite:
                raise OutputExistsError(
                    str(self._path),
                    f"contains the trials of another search ({', '.join(differing)})",
                    "Add --overwrite to remove them, or choose another --out.",
                )
            self._path.unlink()
            self._open()
        if "asked" not in self._study.user_attrs:
            self._study.set_user_attr("asked", text)

    def _open(self) -> None:
        """Open or create the study in the file; its sampler's seed is the number of its trials."""
        optuna = self._optuna
        self._storage = optuna.storages.RDBStorage(f"sqlite:///{self._path.absolute()}")
        self._study = optuna.create_study(
            storage=self._storage, study_name=_NAME, direction="maximize", load_if_exists=True
        )
        n_trials = len(self._study.get_trials(deepcopy=False))
        self._study.sampler = optuna.samplers.TPESampler(seed=n_trials)

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
            Trial(
                dict(t.params),
                tuple(Choice(n_sp, at, tuple(rank)) for n_sp, at, rank in t.user_attrs["found"]),
            )
            for t in self._study.get_trials(deepcopy=False, states=(state,))
        ]

    def run(
        self, n_trials: int, setup: Setup, measure: Callable[[Setup], Choices]
    ) -> Iterator[int]:
        """Run trials until there are `n_trials`; yields the number done after each.

        The first trial has the setup's own values, limited to the ranges.
        """
        kinds = self._optuna.distributions
        distributions = {
            key: (kinds.IntDistribution if bounds.is_whole else kinds.FloatDistribution)(
                bounds.low, bounds.high, log=bounds.is_wide
            )
            for key, bounds in self.ranges.items()
        }
        if not len(self):  # none, or the first one was interrupted
            own = {**setup.params.to_dict(), WIDTH: setup.width_px}
            self._study.enqueue_trial(
                {key: min(max(own[key], r.low), r.high) for key, r in self.ranges.items()}
            )
        while (n_done := len(self)) < n_trials:
            trial = self._study.ask(distributions)
            try:
                changed = with_values(setup, trial.params)
            except ParameterError:  # the values contradict each other
                self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
            else:
                choices = measure(changed)
                numbers = [[choice.n_sp, choice.threshold, list(choice.rank)] for choice in choices]
                trial.set_user_attr("found", numbers)
                recall, rate, lead_s = choices[0].rank
                # Small weights: false alarms and lead decide between nearly equal recalls.
                self._study.tell(trial, recall + 1e-3 * rate + 1e-4 * lead_s)
            yield n_done + 1


def with_values(setup: Setup, values: Mapping[str, Any]) -> Setup:
    """A setup with other values; raises ParameterError if they contradict each other."""
    own = {key: value for key, value in values.items() if key != WIDTH}
    width_px = values.get(WIDTH, setup.width_px)
    params: Parameters = replace(setup.params, **own)  # type: ignore[type-var]
    return replace(setup, params=params, width_px=width_px)
