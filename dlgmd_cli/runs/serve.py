"""What a worker process does: it answers tasks until the one that started it closes the line."""

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

from dlgmd_cli.video.prefetch import opencv_threads

# How long a task may take to clean up after itself once nobody waits for it.
PATIENCE_S = 3.0


class _Line:
    """The way back to the one that started this process; elsewhere it leads nowhere."""

    def __init__(self) -> None:
        self._pipe: IO[bytes] | None = None

    def open(self, pipe: IO[bytes]) -> None:
        self._pipe = pipe

    def send(self, kind: str, value: Any) -> None:
        if self._pipe is not None:
            self._pipe.write(pickle.dumps((kind, value)))
            self._pipe.flush()


_line = _Line()


def note(value: Any) -> None:
    """Tell who started this worker process how far its task is; anywhere else do nothing."""
    _line.send("note", value)


def serve() -> None:
    """Answer tasks; the entry point of a worker process, which ends with it."""
    tasks: SimpleQueue[bytes | None] = SimpleQueue()
    # What libraries print must not get between the messages.
    _line.open(os.fdopen(os.dup(1), "wb"))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    threading.Thread(target=_listen, args=(sys.stdin.buffer, tasks), daemon=True).start()
    code = 0
    # Interrupted where nobody waits for an answer any more, or cannot be told.
    with suppress(KeyboardInterrupt, BrokenPipeError):
        code = _answer(tasks)
    # At once: the threads of a decoder that hangs would hold up the end.
    os._exit(code)


def _answer(tasks: "SimpleQueue[bytes | None]") -> int:
    """Answer tasks, of which the first is what answers, until None, or something is raised."""
    try:
        with opencv_threads(1):
            work: Callable[[Any], Any] | None = None
            # Unpickled here, for that imports modules, and some heed the thread that they are in.
            while (data := tasks.get()) is not None:
                if work is None:
                    work = pickle.loads(data)()
                    _line.send("ready", None)
                else:
                    _line.send("answer", work(pickle.loads(data)))
    except Exception as error:
        _line.send("error", error)
        return 1
    return 0


def _listen(pipe: IO[bytes], tasks: "SimpleQueue[bytes | None]") -> None:
    """Take tasks in; once the line is closed, interrupt whatever is going on."""
    with suppress(Exception):  # the end, or a message that was cut off by it
        while True:
            tasks.put(pickle.load(pipe))
    tasks.put(None)
    if hasattr(signal, "pthread_kill"):  # which ends waiting, too
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    threading.Event().wait(PATIENCE_S)
    os._exit(1)
