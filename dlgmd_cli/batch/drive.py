"""A batch from its plan to its summaries: whoever does the work, and whatever ends it."""

from collections.abc import Callable
from contextlib import suppress

from dlgmd_cli.batch.events import Ended, Event, Pool
from dlgmd_cli.batch.resume import Plan
from dlgmd_cli.errors import OutputError


def drive(plan: Plan, pool: Pool, on_event: Callable[[Event], None]) -> None:
    """Let `pool` do what is left of a plan, and keep the summaries up to date.

    Parameters
    ----------
    plan : Plan
        Its summaries take the endings. Whatever ends the batch, they hold what was done, and are
        written.
    pool : Pool
        Who does the work.
    on_event : callable
        Called with everything that happens, after it was taken down.

    Raises
    ------
    OutputError
        If a summary cannot be written.
    """
    try:
        with pool:
            for event in pool.work_on(plan.tasks):
                if isinstance(event, Ended):
                    for number, ending in event.outcome.items():
                        plan.summaries[number].add(event.task.video.name, ending)
                # What cannot be written now may be later; the end tells.
                with suppress(OutputError):
                    for summary in plan.summaries:
                        summary.write(at_once=False)
                on_event(event)
    finally:
        for summary in plan.summaries:
            summary.write()
