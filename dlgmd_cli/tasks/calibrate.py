"""The thresholds with the highest recall of labelled collisions, as a preset."""

import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dlgmd_cli import errors
from dlgmd_cli.errors import ParameterError, counted, printable
from dlgmd_cli.frame import Flags
from dlgmd_cli.machine import cancel
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.checks import Spec, blame, shown
from dlgmd_cli.parameters.keys import Parameters, changed
from dlgmd_cli.results import record, store
from dlgmd_cli.results.calibration import (
    WIDTH,
    Calibration,
    Choice,
    Choices,
    Rules,
    choose,
    fold_of,
    tally_held_out,
    tally_of,
    with_choice,
)
from dlgmd_cli.results.candidates import signal_of
from dlgmd_cli.results.evaluation import ALL, groups
from dlgmd_cli.results.labels import Case, of_kind, read_cases
from dlgmd_cli.results.scoring import Signal, differences, score, tally
from dlgmd_cli.tasks.call import ModelName, Progress, Request, Setup, fold, no_progress
from dlgmd_cli.tasks.evaluate import rules_of, run_cases, scored

_log = logging.getLogger(__name__)

_FOLDS, _TRIALS = Spec(int, 2, 1000), Spec(int, 1, 1_000_000)
TRIALS = "trials.db"
_STUDY = "calibrate"
_WIDTHS = Spec(int, 16, 8192)
# Ranges wider than this ratio are searched on a logarithmic scale.
_WIDE = 10.0
# Parameters that are calibrated in every trial, and need no search.
_CALIBRATED = ("kappa", "n_sp", "t_mp", "ttc_alarm")
_OPTION = "Invalid value for '--search'"

# The lowest and the highest value of a parameter in a search; whole numbers are int.
Range = tuple[float, float]


def calibrate(
    labels: str | os.PathLike[str],
    model: ModelName | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    horizon: float = 1.0,
    max_false_per_min: float | str = 1.0,
    folds: int = 5,
    search: Mapping[str, tuple[float, float]] | Iterable[str] = (),
    trials: int = 50,
    name: str = "calibrated",
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Calibration:
    """Find the thresholds with the highest recall of collisions, as `dlgmd calibrate` does.

    Parameters
    ----------
    labels, horizon, max_false_per_min, jobs, progress
        As in `evaluate`.
    model, formulation, param, engine
        The model to start from, as in `run`. The rule of its alarm stays.
    folds : int
        Number of folds of the cross-validation over videos.
    search : mapping of str to (float, float), or iterable of str
        Also search parameters in these ranges, both ends included: ``{"sigma_i": (1, 5)}`` or
        ``["sigma_i=1:5"]``.
    trials : int
        With `search`: number of trials, earlier ones in `out` included.
    name, out, formats, overwrite
        Write the preset to ``out/name.yaml``, for ``model=``, and the figure beside it in
        `formats`; an earlier one is replaced only if `overwrite`. The trials are in
        ``out/trials.db``: the same call continues them.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Calibration
        `params` are the calibrated parameters, and `preset` is the text of the file. `scores` has
        their performance, also on held-out videos, and `verdict` says whether they are better
        than before. `run` and `evaluate` take `setup`
        as a model, with the width and the rate that it is made for.

    Raises
    ------
    ResultError
        If the labels cannot be read, or fewer than two videos have a collision.
    ParameterError, SourceError, OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `evaluate`.

    Examples
    --------
    >>> found = calibrate("flights/labels.csv", 9, out="best")  # doctest: +SKIP
    >>> run("flight.mp4", "best/calibrated.yaml")  # doctest: +SKIP
    """
    if not name.strip(". ") or Path(name).name != name:
        raise ParameterError("", f"--name: {printable(name)!r} is not the name of a file")
    request = fold(model, formulation, param, engine, options)
    rule = rule_of(request.setup.params)
    if request.options.normalise == "sequence" and rule.uses_level:
        why = "--normalise sequence leaves no threshold to calibrate"
        raise ParameterError("", why, "Add --normalise absolute.")
    rules = Rules(**rules_of(horizon, max_false_per_min), folds=_FOLDS.check(folds, "--folds"))
    n_trials = _TRIALS.check(trials, "--trials")
    if isinstance(search, Mapping):
        search = [f"{key}={low}:{high}" for key, (low, high) in search.items()]
    ranges = dict(parse_range(text, request.setup.params) for text in search)
    if ranges and not rule.uses_level:
        why = f"the alarms of the rule {rule.name} follow the {rule.quantity}, whatever the "
        why += "model's values"
        raise ParameterError("--search", why, "Leave it out, or add --alarm spikes.")
    if WIDTH in ranges and (request.options.scale or request.options.size):
        why = "width_px cannot be searched together with --scale or --size"
        raise ParameterError("--search", why, "Leave one of them out.")
    labels, formats = Path(labels), store.known_formats(formats)
    if out is not None:
        store.refuse_existing(Path(out) / f"{name}.yaml", overwrite=overwrite)
    cases = read_cases(labels)
    of_kind(cases, rules.max_false_kind)  # raises if there are none
    with ExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()) if out is None else out)
        claim = opened.enter_context(store.claimed(folder))
        made = None
        if ranges:
            settings = {
                "cases": [[case.name, case.kind, *case.collisions] for case in cases],
                "rules": asdict(rules),
                "model": request.setup.settings(),
                "options": request.options.to_record(),
            }
            made = Search(folder, ranges, settings, overwrite=overwrite)
            opened.callback(made.close)
        candidates = scored(labels, cases, run_cases(cases, request, jobs), progress)
        _require_collisions(candidates.cases, labels)
        experiment = Experiment(request, rules, tuple(candidates.cases), jobs)
        tried = [] if made is None else _trials(experiment, made, n_trials, progress)
        searched = ", ".join(f"{key} = {_range_text(bounds)}" for key, bounds in ranges.items())
        about = f"; searched in {counted(n_trials, 'trial')}: {searched}" if ranges else ""
        about_it = {"labels": labels.name, "searched": about, "failed": candidates.failed}
        before = candidates.signals(request.setup.label)
        calibrated = calibrated_by(experiment, before, name, tried, **about_it)
        if out is not None:
            calibrated.write(claim, formats)
    return calibrated


def _trials(
    experiment: "Experiment", search: "Search", n_trials: int, progress: Progress
) -> list["Trial"]:
    n_done = len(search)
    if n_done:
        _log.info("%d trials are done already.", n_done)
    try:
        with progress("calibrate", n_trials, "trial") as advance:
            for n_done in search.run(n_trials, experiment.asked.setup, experiment.choose):
                advance(n_done)
    except (cancel.Interrupted, KeyboardInterrupt):
        _log.info(
            "%d of %d trials are done; the same command continues from there.", n_done, n_trials
        )
        raise
    trials = search.trials()
    if not trials:
        raise errors.DlgmdError("", "no trial had a valid combination of parameters")
    return trials


def _require_collisions(cases: Sequence[Case], labels: Path) -> None:
    """Raise ResultError if fewer than two videos have a collision; log a warning if few have."""
    n_with = sum(bool(case.collisions) for case in cases)
    if n_with < 2:
        why = f"{counted(n_with, 'video')} with a collision; calibration needs at least 2"
        raise errors.ResultError(str(labels), why)
    if n_with < 20:
        _log.warning("only %d videos have a collision; the calibration may not generalise", n_with)


@dataclass(frozen=True)
class Experiment:
    """The model to calibrate, the labelled videos, and how they are read; equal in all trials."""

    asked: Request
    rules: Rules
    cases: tuple[Case, ...]
    jobs: int | None

    @cached_property
    def folds(self) -> list[int]:
        """The fold of each video."""
        return fold_of([(bool(case.collisions), case.kind) for case in self.cases], self.rules)

    @cached_property
    def counted(self) -> Flags:
        """The videos on which the rate of false alarms is limited."""
        return of_kind(self.cases, self.rules.max_false_kind)

    def signals(self, setup: Setup) -> list[Signal]:
        """Run a setup over all videos; returns their signals."""
        by_name = {}
        for case, results in run_cases(self.cases, replace(self.asked, setups=(setup,)), self.jobs):
            if isinstance(results, errors.DlgmdError):
                raise results
            by_name[case.name] = signal_of(results[setup.label], case)
        return [by_name[case.name] for case in self.cases]

    def chosen(self, signals: Sequence[Signal]) -> Choices:
        """The thresholds that do best on the signals of all videos."""
        counts = rule_of(self.asked.setup.params).counts
        return choose(signals, self.folds, self.rules, self.counted, counts)

    def choose(self, setup: Setup) -> Choices:
        """Run a setup over all videos, and choose its thresholds."""
        return self.chosen(self.signals(setup))


def calibrated_by(
    experiment: Experiment,
    before: Sequence[Signal],
    label: str,
    trials: Sequence["Trial"] = (),
    **about: Any,
) -> Calibration:
    """Calibrate the thresholds of a model, or choose the best of some trials.

    Models of the best trials, on all videos and without each fold, run once more. `before` has the
    signals of the original model, `label` names the calibrated one, and `about` is what else the
    outcome says.
    """
    rules, folds, setup = experiment.rules, experiment.folds, experiment.asked.setup
    old = rule_of(setup.params)
    trials = trials or [Trial({}, experiment.chosen(before))]
    best, *winners = (best_trial(trials, number) for number in range(max(folds) + 2))
    setups, signals = {}, {str({}): list(before)}
    for trial in (best, *winners):
        key = str(trial.values)
        setups[key] = with_values(setup, trial.values)
        if key not in signals:
            signals[key] = experiment.signals(setups[key])
    overall = best.found[0]
    choices = tuple(trial.found[number] for number, trial in enumerate(winners, start=1))
    own, final = signals[str(best.values)], setups[str(best.values)]
    at, n_sp = old.strength_at(old.threshold), old.n_in_a_row
    tallies = {
        "held_out": tally_held_out(
            [signals[str(trial.values)] for trial in winners], folds, choices, rules.horizon_s
        ),
        "same_videos": [tally_of(signal, overall, rules.horizon_s) for signal in own],
        "before": [tally(signal, n_sp, at, rules.horizon_s) for signal in before],
    }
    scores = {
        name: {
            group: score([counts[i] for i in members])
            for (word, group), members in groups(experiment.cases).items()
            if word == "kind" or group == ALL
        }
        for name, counts in tallies.items()
    }
    calibrated = replace(final, params=with_choice(final.params, overall), label=label)
    read = experiment.asked.options.to_record()
    against = differences(tallies["held_out"], tallies["before"])
    return Calibration(calibrated, setup, read, choices, scores, rules, against=against, **about)


def best_trial(trials: Sequence["Trial"], number: int = 0) -> "Trial":
    """The trial whose choice of a number, see `Choices`, ranks highest."""
    return max(trials, key=lambda trial: trial.found[number].rank)


@dataclass(frozen=True)
class Trial:
    """The values of a trial, and the thresholds chosen with them."""

    values: dict[str, Any]
    found: Choices


def _range_text(bounds: Range) -> str:
    """`LOW:HIGH`, as on the command line."""
    return f"{bounds[0]:.9g}:{bounds[1]:.9g}"


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
        low, high = (spec.parse(part, key) for part in parts)
    if low >= high:
        raise ParameterError(_OPTION, f"{shown(text)} does not rise from LOW to HIGH")
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
        settings: Mapping[str, Any],
        *,
        overwrite: bool = False,
    ) -> None:
        try:
            import optuna
        except ImportError:
            raise errors.MissingExtraError.of("--search", "optuna") from None
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._optuna, self._path = optuna, folder / TRIALS
        kinds: Any = optuna.distributions
        self.distributions = {
            key: (kinds.IntDistribution if isinstance(low, int) else kinds.FloatDistribution)(
                low, high, log=low > 0 and high / low > _WIDE
            )
            for key, (low, high) in ranges.items()
        }
        texts = {key: _range_text(bounds) for key, bounds in ranges.items()}
        text = json.dumps({**settings, "ranges": texts}, sort_keys=True)
        self._open()
        known = self._study.user_attrs.get("asked")
        if known and (
            differing := record.differences(json.loads(known), settings=json.loads(text))
        ):
            self.close()
            if not overwrite:
                raise errors.OutputExistsError(
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
            own = {**setup.params.to_dict(), WIDTH: setup.width_px}
            self._study.enqueue_trial(
                {key: min(max(own[key], d.low), d.high) for key, d in self.distributions.items()}
            )
        while (n_done := len(self)) < n_trials:
            trial = self._study.ask(self.distributions)
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
    return replace(setup, params=changed(setup.params, **own), width_px=width_px)
