"""Programs that are disturbed while they run, and what is wrong with the results that they left."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

from conftest import files_of

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.results.record import read_record

PATIENCE_S = 300.0  # until something must have come about, however busy the machine is
# Closes a pipe once it answers signals, which is the first thing that it does.
_PROGRAM = """
import os, sys
from dlgmd_cli.machine import cancel
import dlgmd_cli.__main__ as entry
if __name__ == "__main__":
    told = int(sys.argv.pop(1))
    def listen(listen=cancel.listen):
        listen()
        os.close(told)
    cancel.listen = listen
    entry.main()
"""


def fault_of_result(folder: Path):
    """What is wrong with a folder that has a run.yaml, or None: every CSV is read back."""
    try:
        lengths = {len(read_result(folder))}
        for name, header in csv.headers().items():
            lengths.add(len(csv.read_columns(folder / name, header)["frame"]))
    except DlgmdError as error:
        return str(error)
    lengths.add(read_record(folder / store.RUN)["processed"]["frames"])
    return None if len(lengths) == 1 else f"{folder}: as many frames as {lengths}"


def faults_of(out: Path, truth=None):
    """What is wrong with all results below a folder; `truth` are the `results_of` whole ones."""
    records = store.records_below(out, store.RUN)
    faults = [fault for one in records if (fault := fault_of_result(one.parent))]
    for record in records:
        if truth is None or read_record(record)["complete"] is not True:
            continue
        for name, data in results_of(record.parent).items():
            known = truth.get(f"{record.parent.relative_to(out).as_posix()}/{name}")
            if known != data:
                faults.append(f"{record.parent / name} differs from that of an undisturbed run")
    return faults


def results_of(out: Path):
    """The files of the results below a folder: all but the summary."""
    return {name: data for name, data in files_of(out).items() if Path(name).name != "summary.csv"}


def hidden_in(folder: Path):
    """What was left half written below a folder."""
    return list(folder.rglob(f"{store.PREFIX}*"))


def environment():
    """The environment of a process that imports what this one does."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@contextmanager
def started(*arguments, cwd):
    """The command in a process of its own session, once it answers signals; killed in the end."""
    ready, told = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, str(told), *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        pass_fds=[told],
        start_new_session=True,
        text=True,
        env=environment(),
    )
    os.close(told)
    os.read(ready, 1)
    os.close(ready)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def session_of(pid):
    """All living processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
            if int(session) == pid and state != "Z":
                found.append(int(path.parent.name))
    return found


@contextmanager
def small_files(n_bytes):
    """Files may not grow beyond a size, here and in processes started meanwhile."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
