"""One process that answers tasks: it neither outlives nor hangs the one that started it."""

import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any, NamedTuple

from dlgmd_cli.errors import WorkerError

# The child finds modules where its parent does, before it unpickles anything of theirs.
_BOOT = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from dlgmd_cli.runs.serve import serve; serve()"
)
# FFmpeg and OpenCV would report damage line by line.
_QUIET = {"OPENCV_LOG_LEVEL": "SILENT", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
# How long a process may take to clean up after itself.
PATIENCE_S = 5.0
_TAIL_BYTES = 2000


class Message(NamedTuple):
    """What came from a worker.

    Attributes
    ----------
    worker : Worker
        Which one.
    kind : str
        `ready` (once, when it can take tasks), `note` (of a task it works on), `answer`, `error`
        (what the work raised), or `death`, after which nothing comes.
    value : object
        The note, the answer or the error; of a death a `Death`.
    """

    worker: "Worker"
    kind: str
    value: Any


class Death(NamedTuple):
    """How a process ended: its exit code, negative for a signal, and its last words."""

    code: int
    last_words: str

    def __str__(self) -> str:
        if self.code < 0:
            return f"it was killed by signal {-self.code}"
        return f"it ended with exit code {self.code}"


class Worker:
    """A process of its own, which works on one task at a time.

    It is in a session of its own, so that Ctrl-C is left to this process. It ends with `end` or
    `kill`, and by itself, cleaning up, should this process die.

    Parameters
    ----------
    prepare : callable
        Called once in the process; returns what answers a task. It, tasks and answers can be
        pickled.
    inbox : SimpleQueue of Message
        Where what comes from the process is put; several workers may share it.

    Raises
    ------
    WorkerError
        If there can be no more processes, threads or open files.
    """

    def __init__(
        self, prepare: Callable[[], Callable[[Any], Any]], inbox: "SimpleQueue[Message]"
    ) -> None:
        self._inbox = inbox
        self._words = _nameless_file()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _BOOT],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words or subprocess.DEVNULL,
                env={**_QUIET, **os.environ},
                **_apart(),
            )
        except OSError as error:
            if self._words is not None:
                self._words.close()
            raise _no_more(error.strerror or type(error).__name__) from None
        self._reader = threading.Thread(target=self._read, name="dlgmd-worker", daemon=True)
        try:
            self._reader.start()
        except RuntimeError as error:
            self._process.kill()
            self._read()
            raise _no_more(str(error)) from None
        self._write(sys.path)
        self._send(prepare)

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    def send(self, task: Any) -> None:
        """Hand over a task; if the process is dead, the death in the inbox is all that comes."""
        self._send(task)

    def ask_to_end(self) -> None:
        """Let it end, in the middle of a task if need be, as soon as it has cleaned up."""
        with suppress(OSError):
            self._stdin.close()

    def end(self) -> None:
        """Wait until it has ended; after `PATIENCE_S` it is killed."""
        self.ask_to_end()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._reader.join()

    def kill(self) -> None:
        """End it at once; what it was writing stays as it is."""
        self._process.kill()
        self._reader.join()

    @property
    def _stdin(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    def _send(self, thing: Any) -> None:
        self._write(pickle.dumps(thing))  # which is unpickled when its turn comes

    def _write(self, message: Any) -> None:
        data = pickle.dumps(message)
        with suppress(OSError, ValueError):  # it is dead; its pipe may be closed already
            self._stdin.write(data)
            self._stdin.flush()

    def _read(self) -> None:
        """Put what comes into the inbox, until the process has ended."""
        pipe = self._process.stdout
        assert pipe is not None
        with pipe:
            while True:
                try:
                    kind, value = pickle.load(pipe)
                except Exception:  # the end, or a message that was cut off by it
                    break
                self._inbox.put(Message(self, kind, value))
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:  # it no longer talks to us
            self._process.kill()
        code = self._process.wait()
        with suppress(OSError):
            self._stdin.close()
        self._inbox.put(Message(self, "death", Death(code, self._last_words())))

    def _last_words(self) -> str:
        """The last line that it wrote to stderr, as far as that was kept."""
        if self._words is None:
            return ""
        with self._words as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL_BYTES))
            lines = file.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _no_more(reason: str) -> WorkerError:
    return WorkerError(
        "a worker process",
        f"it cannot be started ({reason})",
        "Use fewer with --jobs, or raise the system's limits.",
    )


def _nameless_file() -> IO[bytes] | None:
    """A temporary file; None where there can be none."""
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return None


def _apart() -> dict[str, Any]:
    """What keeps a terminal's Ctrl-C from a process."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
