"""A process pool on a Dask cluster instead of this machine.

Start the workers as single-threaded processes, ``dask worker --nworkers N --nthreads 1``. A video
whose decoder crashes then costs one worker only, and Dask's nanny restarts it.
"""

import json
import logging
import platform
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from dlgmd_cli import __version__
from dlgmd_cli.errors import (
    MissingExtraError,
    ParameterError,
    WorkerError,
    argument,
    argument_names,
    name_arguments,
)
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.files import is_locked
from dlgmd_cli.machine.pool import FAILED, KILLED, TaskEnd, TaskT, ValueT, done, worked
from dlgmd_cli.machine.threads import limit_threads

if TYPE_CHECKING:
    from distributed import Client

_log = logging.getLogger(__name__)

CONNECT_S, _CLOSE_S = 10.0, 5.0
# Interval (s) between checks of the stop flag; every 10th check also asks the scheduler.
_TICK_S, _TICKS_PER_CHECK = 0.1, 10
_LOGGERS = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")
_ADDRESS = re.compile(r"((tcp|tls|ws|wss|ucx)://)?[^\s/:]+:[0-9]{1,5}|[a-z]+://\[[^\s/]+\]:[0-9]+")


def run_tasks(
    function: Callable[[TaskT], ValueT],
    tasks: Iterable[TaskT],
    scheduler: str,
    *,
    folders: Sequence[Path] = (),
) -> Iterator[tuple[TaskT, TaskEnd[ValueT]]]:
    """Call `function` on every task on the workers of a cluster; see `pool.run_tasks`.

    Dask retries a task whose worker is lost a few times on other workers. If all retries fail,
    another task may be the cause, and the task runs once more on its own. All tasks are submitted
    at once; each is yielded with its outcome when it ends.

    `scheduler` is the address of the Dask scheduler, or the name of its scheduler file. `folders`
    are locked result folders, see `store.locked`, which every worker must see.

    Raises
    ------
    ParameterError
        If the scheduler's address is not valid.
    MissingExtraError
        If Dask is not installed.
    WorkerError
        If the scheduler does not answer or is lost; if the cluster lacks dlgmd, has another
        version, or does not see the result folders.
    Interrupted
        If the user asks to stop. Tasks that have begun run to completion on the workers.
    """
    tasks = list(tasks)
    if not tasks:
        return
    client = _connect(scheduler)
    try:
        _wait_for_workers(client, scheduler)
        _check_workers(client, [str(folder) for folder in folders])
        suspects: list[TaskT] = []
        yield from _work(client, scheduler, function, tasks, suspects)
        for task in suspects:
            yield from _work(client, scheduler, function, [task], None)
    finally:
        # The scheduler drops the tasks of a closed client.
        with suppress(Exception):
            client.close(timeout=_CLOSE_S)


def _work(
    client: "Client",
    scheduler: str,
    function: Callable[[TaskT], ValueT],
    tasks: Sequence[TaskT],
    suspects: list[TaskT] | None,
) -> Iterator[tuple[TaskT, TaskEnd[ValueT]]]:
    """Submit tasks and yield them as they end; tasks with lost workers go to `suspects`."""
    from distributed import Future, KilledWorker

    ended: SimpleQueue[Future] = SimpleQueue()
    running = {}
    for task in tasks:
        work = partial(_call, function, argument_names())
        future = _asked(scheduler, client.submit, work, task, pure=False)
        running[future] = task
        future.add_done_callback(ended.put)
    n_ticks = 0
    while running:
        cancel.check()
        try:
            future = ended.get(timeout=_TICK_S)
        except Empty:
            n_ticks += 1
            if n_ticks % _TICKS_PER_CHECK == 0:
                _asked(scheduler, client.nthreads)
            continue
        task = running.pop(future)
        if future.status == "cancelled":
            raise _lost(scheduler)
        try:
            error = _asked(scheduler, future.exception, timeout=CONNECT_S)
            answer: Any = None if error else _asked(scheduler, future.result, timeout=CONNECT_S)
        except TimeoutError:  # its worker and the result were lost: another worker repeats the task
            running[future] = task
            future.add_done_callback(ended.put)
            continue
        if isinstance(error, KilledWorker) and suspects is not None:
            suspects.append(task)
        elif isinstance(error, KilledWorker):
            why = "every worker that ran it was lost, as happens when memory runs out"
            smaller = f"process smaller frames with {argument('scale')}"
            hint = f"Start fewer workers on a machine, or {smaller}."
            yield task, TaskEnd(KILLED, error=WorkerError("", why, hint))
        elif error is not None:
            why = " ".join(str(error).split())[:200]
            why = f"the cluster cannot do this work ({type(error).__name__}: {why})"
            hint = "Install the same versions of Python, dlgmd and Dask everywhere."
            raise WorkerError(scheduler, why, hint)
        else:
            yield task, answer if isinstance(answer, TaskEnd) else done(*answer)


def _call(
    function: Callable[[TaskT], ValueT], names: Mapping[str, str], task: TaskT
) -> TaskEnd[ValueT] | tuple[ValueT, list[str]]:
    """Run one task with a single thread, since other workers share the machine; see `worked`."""
    limit_threads(1)
    name_arguments(names)
    try:
        return worked(function, task)
    except Exception as error:
        return TaskEnd(FAILED, error=error)


def _connect(scheduler: str) -> "Client":
    """A Dask client for a scheduler address or scheduler file; raises as `run_tasks` does."""
    address = address_of(scheduler)
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError.of(argument("scheduler"), "distributed") from None
    for name in _LOGGERS:  # important errors are raised, not only logged
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    warnings.filterwarnings("ignore", module="distributed")
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError:
        why = f"no Dask scheduler answered within {CONNECT_S:g} s"
        hint = f"Start one with 'dask scheduler', or check {argument('scheduler')}."
        raise WorkerError(scheduler, why, hint) from None
    except Exception as error:
        why = str(error).split("\n")[0] or type(error).__name__
        hint = f"Check {argument('scheduler')}."
        raise WorkerError(scheduler, f"no connection ({why})", hint) from None


def address_of(scheduler: str) -> str:
    """The address in a scheduler file, or the address itself; raises as `run_tasks` does."""
    path, why = Path(scheduler), "it is not a scheduler file"
    if _ADDRESS.fullmatch(scheduler) and not path.is_file():
        return scheduler
    if not path.is_file() and not scheduler.endswith(".json"):
        why = f"{scheduler!r} is neither an address nor a scheduler file"
        hint = "Give one like tcp://HOST:8786, or a file's name."
        raise ParameterError(argument("scheduler"), why, hint)
    try:
        address = json.loads(path.read_bytes())["address"]
        if _ADDRESS.fullmatch(address):
            return str(address)
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
    except (ValueError, KeyError, TypeError):
        pass
    raise WorkerError(scheduler, why, "Write it with: dask scheduler --scheduler-file FILE.")


def _wait_for_workers(client: "Client", scheduler: str) -> None:
    if not _asked(scheduler, client.nthreads):
        _log.info("Waiting for workers of the cluster.")
    while not _asked(scheduler, client.nthreads):
        cancel.check()
        with suppress(TimeoutError):
            _asked(scheduler, client.wait_for_workers, 1, timeout=_TICKS_PER_CHECK * _TICK_S)


def _check_workers(client: "Client", folders: list[str]) -> None:
    """Raise WorkerError unless the scheduler and all workers can do the work."""
    try:
        seen = {"the scheduler": client.run_on_scheduler(_report, [])}
    except Exception as error:
        seen = {"the scheduler": error}
    seen |= client.run(_report, folders, on_error="return")
    for where, report in seen.items():
        if isinstance(report, ImportError):
            version: str | None = None
        elif isinstance(report, Exception):
            raise WorkerError(where, f"cannot be asked ({' '.join(str(report).split())[:200]})")
        else:
            version, host, hidden = report
            if hidden:
                why = f"{host} cannot reach the folder of the results, {hidden}"
                reached = "that all workers can reach: a shared folder or a URL"
                hint = f"Choose an {argument('out')} {reached}."
                raise WorkerError("", why, hint)
        if version != __version__:
            why = f"it has dlgmd {version}" if version else "dlgmd is not installed"
            hint = f"Install dlgmd {__version__} on the scheduler and all workers."
            raise WorkerError(where, why, hint)


def _report(folders: list[str]) -> tuple[str, str, str]:
    """Version of dlgmd, the machine's name, and the first folder that the machine cannot see."""
    return __version__, platform.node(), next((f for f in folders if not is_locked(f)), "")


def _asked(scheduler: str, ask: Callable[..., Any], *given: Any, **options: Any) -> Any:
    """Call a method of the client; raises WorkerError if the scheduler is lost."""
    try:
        return ask(*given, **options)
    except TimeoutError:
        raise
    except Exception:
        raise _lost(scheduler) from None


def _lost(scheduler: str) -> WorkerError:
    hint = "Start it again, then the same command, which continues from there."
    return WorkerError(scheduler, "the scheduler was lost, or dropped the work", hint)
