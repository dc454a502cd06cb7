"""The trials of a search: values of a model's parameters, and the thresholds chosen with them."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from dlgmd_cli import errors
from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.parameters.checks import Spec, in_argument, shown
from dlgmd_cli.parameters.facts import Json, Value
from dlgmd_cli.parameters.keys import Parameters, changed
from dlgmd_cli.results import record
from dlgmd_cli.tasks.call import Setup

TRIALS = "trials.db"
_STUDY = "calibrate"
WIDTH = "width_px"
_WIDTHS = Spec(int, 16, 8192)
# Ranges wider than this ratio are searched on a logarithmic scale.
_WIDE = 10.0
# Parameters that are calibrated in every trial, and need no search.
_CALIBRATED = ("kappa", "n_sp", "t_mp", "ttc_alarm")

# The lowest and the highest value of a parameter in a search; whole numbers are int.
Range = tuple[float, float]


@dataclass(frozen=True)
class Choice:
    """A threshold of the strength, see `Rule.strength`, the number of frames in a row that
    reach it, and their rank, see `Curve.rank`.
    """

    n_sp: int
    threshold: float
    rank: tuple[float, float, float]


# The choice on all videos, then for each fold the choice on all others.
Choices = tuple[Choice, ...]


@dataclass(frozen=True)
class Trial:
    """The values of a trial, and the thresholds chosen with them."""

    values: dict[str, Value]
    found: Choices


def best_trial(trials: Sequence[Trial], number: int = 0) -> Trial:
    """The trial whose choice of a number, see `Choices`, ranks highest."""
    return max(trials, key=lambda trial: trial.found[number].rank)


def range_text(bounds: Range) -> str:
    """`LOW:HIGH`, as on the command line."""
    return f"{bounds[0]:.9g}:{bounds[1]:.9g}"


def parse_range(text: str, params: Parameters) -> tuple[str, Range]:
    """Parse `KEY=LOW:HIGH`, KEY a parameter or `width_px`; returns the key and the range.

    Raises ParameterError.
    """
    key, _, bounds = text.partition("=")
    key, parts = key.strip(), bounds.split(":")
    if len(parts) != 2:
        why = f"{shown(text)} is not KEY=LOW:HIGH"
        raise ParameterError("", why, "Write sigma_e=0.2:2.", "search")
    if key in _CALIBRATED:
        why = f"{key} is calibrated without a search"
        raise ParameterError("", why, "Leave it out.", "search")
    spec = _WIDTHS if key == WIDTH else params.specs().get(key)
    if spec is None:
        raise params.unknown(key)
    if spec.kind in (bool, str):
        hint = f"Set it with {argument('param')}."
        raise ParameterError("", f"{key} is not a number", hint, "search")
    with in_argument("search"):
        low, high = (spec.parse(part, key) for part in parts)
    if low >= high:
        why = f"{shown(text)} does not rise from LOW to HIGH"
        raise ParameterError("", why, argument="search")
    return key, (low, high)


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
        settings: Mapping[str, Json],
        *,
        overwrite: bool = False,
    ) -> None:
        try:
            import optuna
        except ImportError:
            raise errors.MissingExtraError.of(argument("search"), "optuna") from None
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._optuna, self._path = optuna, folder / TRIALS
        kinds = optuna.distributions
        self.distributions: dict[str, kinds.IntDistribution | kinds.FloatDistribution] = {}
        for key, (low, high) in ranges.items():
            log = low > 0 and high / low > _WIDE
            if isinstance(low, int) and isinstance(high, int):
                self.distributions[key] = kinds.IntDistribution(low, high, log=log)
            else:
                self.distributions[key] = kinds.FloatDistribution(low, high, log=log)
        texts = {key: range_text(bounds) for key, bounds in ranges.items()}
        text = json.dumps({**settings, "ranges": texts}, sort_keys=True)
        self._open()
        known = self._study.user_attrs.get("asked")
        if known and (
            differing := record.differences(json.loads(known), settings=json.loads(text))
        ):
            self.close()
            if not overwrite:
                why = f"contains the trials of another search ({', '.join(differing)})"
                hint = errors.overwrite_hint("them")
                raise errors.OutputExistsError(str(self._path), why, hint)
            self._path.unlink()
            self._open()
        if "asked" not in self._study.user_attrs:
            self._study.set_user_attr("asked", text)

    def _open(self) -> None:
        """Open or create the study in the file; its sampler's seed is the number of its trials."""
        optuna = self._optuna
        self._storage = optuna.storages.RDBStorage(f"sqlite:///{self._path.absolute()}")
        self._study = optuna.create_study(
            storage=self._storage, study_name=_STUDY, direction="maximize", load_if_exists=True
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
        if not len(self):  # none, or the first one was interrupted
            first = {**setup.params.to_dict(), WIDTH: setup.width_px}
            self._study.enqueue_trial(
                {key: min(max(first[key], d.low), d.high) for key, d in self.distributions.items()}
            )
        while (n_done := len(self)) < n_trials:
            trial = self._study.ask(self.distributions)
            try:
                trial_setup = with_values(setup, trial.params)
            except ParameterError:  # the values contradict each other
                self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
            else:
                choices = measure(trial_setup)
                numbers = [[choice.n_sp, choice.threshold, list(choice.rank)] for choice in choices]
                trial.set_user_attr("found", numbers)
                recall, rate, lead_s = choices[0].rank
                # Small weights: false alarms and lead decide between nearly equal recalls.
                self._study.tell(trial, recall + 1e-3 * rate + 1e-4 * lead_s)
            yield n_done + 1


def with_values(setup: Setup, values: Mapping[str, Value]) -> Setup:
    """A setup with other values; raises ParameterError if they contradict each other."""
    others = {key: value for key, value in values.items() if key != WIDTH}
    width_px = int(values.get(WIDTH, setup.width_px))
    return replace(setup, params=changed(setup.params, **others), width_px=width_px)
