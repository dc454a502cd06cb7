"""What is said at the end of a batch: tables, counts, and the error if videos failed."""

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dlgmd_cli.commands._console import (
    EXIT_FAILED,
    Failed,
    print_json,
    print_path,
    print_table,
    say,
)
from dlgmd_cli.errors import printable

if TYPE_CHECKING:
    from dlgmd_cli.batch.find import Found
    from dlgmd_cli.batch.resume import Plan
    from dlgmd_cli.batch.task import Ending

DONE = "done"
# Longer tables show only what failed.
_MAX_ROWS = 60


class Report:
    """The end of a batch.

    Parameters
    ----------
    found : Found
        What there was to do.
    plan : Plan
        Its summaries hold what became of it.
    labels : list of str
        What the models are called.
    complete : bool
        Whether no interrupt ended it.
    """

    def __init__(self, found: "Found", plan: "Plan", labels: list[str], *, complete: bool) -> None:
        self._found, self._plan, self._labels, self._complete = found, plan, labels, complete
        self._statuses = {video.name: self._status(video.name) for video in found.videos}

    def _status(self, video: str) -> str:
        """How a video ended in all models: done, what else the first one did, or nothing yet."""
        every = [summary.endings.get(video) for summary in self._plan.summaries]
        if None in every:
            return ""
        return next((one.status for one in every if one and one.status != DONE), DONE)

    def show(self, *, as_json: bool) -> None:
        """Tables and where the summaries are, or one JSON object, on stdout."""
        from dlgmd_cli.batch.summary import NAME

        paths = [summary.place.show(NAME) for summary in self._plan.summaries]
        if as_json:
            print_json(self._counts(paths))
        else:
            for label, summary in zip(self._labels, self._plan.summaries, strict=True):
                _show(summary.endings, label if len(self._labels) > 1 else "video")
            for path in paths:
                print_path(path)
        if not self._complete:
            n_done = sum(status == DONE for status in self._statuses.values())
            say(
                f"Interrupted; {n_done} of {len(self._statuses)} videos are done, and the same "
                "command goes on from there."
            )

    def raise_failures(self) -> None:
        """Raise what makes the exit code 1 if not all is done."""
        n_failed = sum(status != DONE for status in self._statuses.values())
        n_total = len(self._statuses)
        where = ", ".join(printable(one.place.show()) for one in self._plan.summaries)
        if n_failed:
            verb = "is" if n_total - n_failed == 1 else "are"
            raise Failed(
                f"{n_failed} of {n_total} videos failed, {n_total - n_failed} {verb} in {where}. "
                f"Mend or drop {'that one' if n_failed == 1 else f'those {n_failed}'} and rerun.",
                EXIT_FAILED,
            )
        if self._found.faults:
            raise Failed(
                f"not every folder could be read; what was found is in {where}. Mend its access "
                "rights and rerun.",
                EXIT_FAILED,
            )

    def _counts(self, paths: list[str]) -> dict[str, Any]:
        counts = Counter(status for status in self._statuses.values() if status)
        summaries = dict(zip(self._labels, paths, strict=True))
        return {
            "summary": paths[0] if len(paths) == 1 else summaries,
            "complete": self._complete,
            "videos": len(self._statuses),
            "already_done": len(self._found.videos) - len(self._plan.tasks),
            "status": {DONE: 0, **counts},
        }


def _show(endings: "Mapping[str, Ending]", title: str) -> None:
    """A table of what became of every video."""
    rows = sorted(endings.items())
    if len(rows) > _MAX_ROWS:
        rows = [(name, ending) for name, ending in rows if ending.status != DONE]
    header = (title, "status", "frames", "peak MP", "spikes", "collisions", "first collision")
    if rows:
        print_table(header, [_row(name, ending) for name, ending in rows])


def _row(name: str, ending: "Ending") -> tuple[str, ...]:
    """The cells of one video, a dash for what there is not."""
    summary: dict[str, Any] = ending.record.get("summary", {})
    cells = ["–"] * 5
    if summary:
        cells[0] = str(ending.record["input"]["frames"])
        cells[1] = f"{summary['mp_max']:.6g}" if summary["mp_max"] else "–"
        cells[2], cells[3] = str(summary["spikes"]), str(summary["collisions"])
        if summary["first_collision_frame"] is not None:
            cells[4] = "frame {first_collision_frame}, {first_collision_time_s:.3f} s".format(
                **summary
            )
    return (printable(name), ending.status, *cells)
