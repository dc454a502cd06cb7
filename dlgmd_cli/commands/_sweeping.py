"""A sweep between its options and its files: what is computed, kept, and written."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dlgmd_cli.commands._console import progress, say
from dlgmd_cli.commands._model import ModelChoice
from dlgmd_cli.commands._subjects import Subject
from dlgmd_cli.commands._types import Output
from dlgmd_cli.parameters import Parameters
from dlgmd_cli.runs.axis import Axis, Grid
from dlgmd_cli.video.choice import InputChoice

if TYPE_CHECKING:
    from dlgmd_cli.plots.style import Width
    from dlgmd_cli.results.journal import Journal
    from dlgmd_cli.results.sweeps import SweepResult
    from dlgmd_cli.runs.spool import Tape
    from dlgmd_cli.runs.sweep import Probe


@dataclass(frozen=True)
class Plan:
    """All that a sweep is made of.

    `points` has the parameters of every point where they are possible, by its number, `engine`
    is what computes the model, not `auto`.
    """

    choice: ModelChoice
    engine: str
    grid: Grid
    points: Mapping[int, Parameters]
    subject: Subject
    options: InputChoice

    @classmethod
    def make(
        cls,
        choice: ModelChoice,
        engine: str | None,
        grid: Grid,
        points: Mapping[int, Parameters],
        subject: Subject,
        options: InputChoice,
    ) -> "Plan":
        """A plan with the engine that `run` would use."""
        from dlgmd_cli.runs.sweep import engine_for

        asked = engine or choice.recorded_engine or "auto"
        used = engine_for(choice.params, asked, subject.size_wh, say)
        return cls(choice, used, grid, points, subject, options)

    def journal(self, output: Output) -> "Journal":
        """Where points are kept as they are done."""
        from dlgmd_cli.results.files import fitting
        from dlgmd_cli.results.journal import Journal
        from dlgmd_cli.results.record import versions
        from dlgmd_cli.results.sweeps import JOURNAL, PRODUCTS

        n_clips = len(self.subject.speeds_px) or 1
        shape = (n_clips, len(self.subject.measure().columns))
        settings = {
            "x": _described(self.grid.x),
            "y": _described(self.grid.y),
            "parameters": self._constant(),
            "engine": self.engine,
            **self.subject.settings(),
            "versions": versions(*self.subject.decoder, self.engine),
        }
        return Journal(
            output.out / f"sweep-{fitting(self.subject.name, 240)}",
            JOURNAL,
            PRODUCTS,
            settings,
            is_point=lambda point, values: point in self.points and _has_shape(values, shape),
            overwrite=output.overwrite,
        )

    def compute(self, journal: "Journal", jobs: int | None) -> bool:
        """Compute what is not there yet; False if Ctrl-C ended it after at least one point."""
        missing = {
            point: self.points[point] for point in self.points if point not in journal.points
        }
        if not missing:
            return True
        from dlgmd_cli.runs.spool import Spool
        from dlgmd_cli.runs.sweep import shortest_need, sweep
        from dlgmd_cli.threads import n_processors

        try:
            with Spool() as spool:
                facts = self.subject.spool(spool)
                tape = spool.tape
                needed = shortest_need(self.points, min(tape.lengths))
                if needed is not None:
                    raise self.subject.too_short(tape, self.choice.label, needed)
                journal.begin()
                journal.note(facts)
                with progress(f"sweep {self.subject.name}", len(self.points), "point") as on_point:
                    done = sweep(
                        missing,
                        self._probe(tape),
                        jobs=jobs or n_processors(),
                        tell=say,
                        on_ready=spool.unlink,
                    )
                    for point, values in done:
                        journal.add(point, values)
                        on_point(len(journal.points))
        except KeyboardInterrupt:
            if not journal.points:
                raise
            return False
        return True

    def result(self, journal: "Journal") -> "SweepResult":
        """What the points that are there come to."""
        from dlgmd_cli.results.sweeps import SweepResult

        return SweepResult.gather(
            self.grid,
            self.subject.speeds_px,
            self.subject.measure().columns,
            journal.points,
            self.points,
        )

    def write(
        self,
        journal: "Journal",
        result: "SweepResult",
        complete: bool,
        formats: tuple[str, ...],
        width: "Width",
    ) -> None:
        """Write the table, the record and the figure, together."""
        from dlgmd_cli.results.files import appearing
        from dlgmd_cli.results.sweeps import FIGURE, RECORD, TABLE, write_sweep_record, write_table

        names = (TABLE, RECORD, *(f"{FIGURE}.{suffix}" for suffix in formats))
        with appearing(*(journal.folder / name for name in names)) as (table, record, *figures):
            write_table(table, result)
            facts = self._facts(journal, complete)
            write_sweep_record(record, facts, *self.subject.decoder, self.engine)
            if figures:
                from dlgmd_cli.plots.style import save_figure
                from dlgmd_cli.plots.sweeps import plot_sweep

                figure = plot_sweep(result, width)
                for path in figures:
                    save_figure(figure, path)

    def _probe(self, tape: "Tape") -> "Probe":
        """How points are computed."""
        from dlgmd_cli.runs.sweep import Probe

        return Probe(
            tape, self.subject.measure(), self.engine, by_sequence=self.options.by_sequence
        )

    def _constant(self) -> dict[str, Any]:
        """The model and those of its parameters that are the same everywhere."""
        axes = {self.grid.x.key, self.grid.y.key}
        values = self.choice.params.to_dict()
        same = {key: value for key, value in values.items() if key not in axes}
        return {"model": self.choice.model, **same}

    def _facts(self, journal: "Journal", complete: bool) -> dict[str, Any]:
        """What sweep.yaml says, all that it takes to repeat the sweep among it."""
        subject = {
            k: v for k, v in self.subject.settings().items() if k not in ("input", "options")
        }
        facts = {key: value for key, value in journal.facts.items() if key != "warnings"}
        constant = self._constant()
        return {
            **facts,
            "model": constant.pop("model"),
            "engine": self.engine,
            **constant,
            "options": self.options.to_record(),
            "sweep": {
                "x": _described(self.grid.x),
                "y": _described(self.grid.y),
                **{key: value for key, value in subject.items() if key != "processed"},
            },
            "warnings": journal.facts.get("warnings", []),
            "complete": complete,
            "summary": {
                "points": len(self.grid),
                "computed": len(journal.points),
                "impossible": len(self.grid) - len(self.points),
            },
        }


def _described(axis: Axis) -> dict[str, Any]:
    """An axis as records have it."""
    return {"key": axis.key, "values": list(axis.values)}


def _has_shape(values: Any, shape: tuple[int, int]) -> bool:
    """Whether `values` are lists of numbers, so many of so many."""
    n_clips, n_columns = shape
    return (
        isinstance(values, list)
        and len(values) == n_clips
        and all(isinstance(row, list) and len(row) == n_columns for row in values)
        and all(isinstance(value, int | float) for row in values for value in row)
    )
