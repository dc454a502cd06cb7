"""Commands that replace the result of one value by that of another, and are ended at any moment.

Whenever that is, a folder then has the old result whole, the new one whole, or none: its record is
not there. After a signal that is answered, it may have the first rows of the new one, and the
record says ``complete: false``. What `live` records grows row by row: it has those rows that there
was time for, and they are what the model answers to these frames.
"""

import csv
import multiprocessing
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import yaml
from conftest import FPS, files_of, looming_frames, until, write_video
from disturbed import PATIENCE_S, environment, hidden_in, session_of

from dlgmd_cli import Alarm
from dlgmd_cli.machine.files import LOCK
from dlgmd_cli.results.csv import cell
from dlgmd_cli.video.opening import open_video

N_FRAMES, WIDTH, HEIGHT = 20, 64, 48
# The two values, one result of which replaces that of the other.
VALUES = (2, 4)
COMMANDS = {
    "run": "run clip.avi --fps all --param r={} --no-plots --overwrite --out {}",
    "compare": "compare clip.avi --set 3 --variant 9:r={} --no-plots --overwrite --out {}",
    "batch": "batch clip.avi clip2.avi --fps all --param r={} --no-plots --force --jobs 1 --out {}",
    "live": "live clip.avi --realtime --fps all --param r={} --overwrite --record {}",
    "synth": "synth receding-cube --size 64x48 --frames 1{} --overwrite --out {}",
}
RECORDS = {
    "run": ["clip/run.yaml"],
    "compare": ["clip/compare.yaml"],
    "batch": ["clip/run.yaml", "clip2/run.yaml"],
    "live": ["run.yaml"],
    "synth": ["receding-cube.csv"],
}
SIGNALS = [signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGHUP]
# A case in so many comes after the same command undisturbed.
UNDISTURBED = 5
# Their time is known only at the end.
_LATER_COLUMNS = ("mp_seq",)
OLD, NEW, ABSENT, PARTIAL = "old", "new", "absent", "partial"


class Case(NamedTuple):
    """A command that was ended: how, the states of its folders, and what is wrong with them."""

    number: int
    command: str
    signal: str
    states: tuple[str, ...]
    faults: tuple[str, ...]


def call(command: str, log: str) -> None:
    """Run a command in a process that was forked for it, and leads a session of its own."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the command answers it
    output = os.open(log, os.O_WRONLY | os.O_CREAT)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.argv = ["dlgmd", *command.split()]
    from dlgmd_cli.__main__ import main

    main()


def rows_by_label(table: bytes) -> dict[str, list[tuple[str, ...]]]:
    """The rows of a table, for each label if it has labels, without what is known only later."""
    found: dict[str, list[tuple[str, ...]]] = {}
    for row in csv.DictReader(table.decode().splitlines()):
        for name in _LATER_COLUMNS:
            row.pop(name, None)
        found.setdefault(row.get("label", ""), []).append(tuple(row.values()))
    return found


def beginning_faults(files: dict[str, bytes], record: str, new: dict[str, bytes]) -> Iterator[str]:
    """Why these files are not the beginning of the new result."""
    told, whole = yaml.safe_load(files[record]), yaml.safe_load(new[record])
    if told["complete"] is not False:
        yield "it is not whole, and says complete: true"
    timed = ("input", "processed", "warnings", "complete", "interrupted", "summary", "models")
    if {**told, **dict.fromkeys(timed)} != {**whole, **dict.fromkeys(timed)}:
        yield "its record has other parameters"
    if files.keys() != new.keys():
        yield f"it has the files {sorted(files)}"
        return
    for name in files.keys() - {record, "alarms.csv"}:
        had = rows_by_label(new[name])
        for label, rows in rows_by_label(files[name]).items():
            if rows != had[label][: len(rows)]:
                yield f"{name}: {label} rows are not the first ones of the new result"
            n_rows = told.get("processed", {}).get("frames", len(rows))
            if len(rows) != n_rows:
                yield f"{name}: {len(rows)} {label} rows, not {n_rows}"


def live_faults(
    files: dict[str, bytes], value: int, record: Path, answers: "Answers"
) -> Iterator[str]:
    """Why these files are not what the model answers to the frames that they name."""
    told = yaml.safe_load(files["run.yaml"])
    if told["r"] != value:
        yield f"its record is of r = {told['r']}"
    rows = list(csv.DictReader(files["mp.csv"].decode().splitlines()))
    frames = tuple(int(row["frame"]) for row in rows)
    if [*frames] != sorted({*frames}):
        yield f"frames {frames}"
    if told["complete"] and told["processed"]["frames"] != len(rows):
        yield f"{len(rows)} rows, and it says {told['processed']['frames']}"
    if told["complete"] and frames[-1] != N_FRAMES - 1:
        yield f"it says complete: true, and ends at frame {frames[-1]}"
    for row, expected in zip(rows, answers.to(frames, record), strict=True):
        if {name: row[name] for name in expected} != expected:
            yield f"frame {row['frame']} has {row}, not {expected}"
    for name in ("spikes.csv", "attenuation.csv"):  # which a row reaches after mp.csv
        again = [int(row["frame"]) for row in csv.DictReader(files[name].decode().splitlines())]
        if again not in ([*frames], [*frames][:-1]):
            yield f"{name} has the frames {again}, mp.csv {frames}"


class Answers:
    """What the model of `live` answers to frames, whichever of them it saw."""

    def __init__(self, video: Path) -> None:
        with open_video(video, repeats="keep") as source:
            self._frames = {frame.index: frame for frame in source}

    def to(self, indices: tuple[int, ...], record: Path) -> list[dict[str, str]]:
        """Cells of mp.csv for each frame, by the model of a record."""
        alarm = Alarm(record, all_frames=True, times="capture")
        found = []
        for index in indices:
            frame = self._frames[index]
            detection = alarm.step(frame.grey, frame.time_s)
            names = ("mp", "mp_abs", "ffi", "expansion", "ttc_s")
            found.append({name: cell(getattr(detection, name)) for name in names})
        return found


class Campaign:
    """Both results of a command, undisturbed, and what becomes of them when it is ended.

    The results that everything is compared with are computed before anything is ended, each twice:
    AssertionError if they differ.
    """

    def __init__(self, folder: Path, command: str, seed: int = 2026) -> None:
        self.folder, self.command, self.out = folder, command, folder / "out"
        self._random = random.Random(f"{seed} {command}")
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(
            ["kills", "dlgmd_cli.tasks.run", "dlgmd_cli.live.watch"]
        )
        for name in ("clip.avi", "clip2.avi"):
            frames = looming_frames(N_FRAMES, WIDTH, HEIGHT)
            write_video(folder / name, frames[:: -1 if "2" in name else 1], fps=2 * FPS)
        self._answers = Answers(folder / "clip.avi")
        self._whole: dict[int, list[dict[str, bytes]]] = {}
        self._models: dict[int, Path] = {}
        took_s = []
        for value in VALUES * 2:
            began = time.monotonic()
            out = folder / f"reference-{value}-{len(took_s)}"
            assert self._start(value, out, wait=True).exitcode == 0
            took_s.append(time.monotonic() - began)
            self._models[value] = out / RECORDS[command][0]
            whole = [files_of((out / record).parent) for record in RECORDS[command]]
            assert all(whole)
            if command != "live":
                assert whole == self._whole.setdefault(value, whole)
        if command != "live":
            assert self._whole[VALUES[0]] != self._whole[VALUES[1]]
        self._took_s = min(took_s)

    def _start(self, value: int, out: Path, *, wait: bool = False) -> multiprocessing.Process:
        """The command in a process of its own, which has begun."""
        line, log = COMMANDS[self.command].format(value, out), self.folder / "log"
        log.unlink(missing_ok=True)
        process = self._context.Process(target=call, args=(line, str(log)))
        process.start()
        until(log.exists, PATIENCE_S)
        if wait:
            process.join(PATIENCE_S)
        return process

    def _wait(self, process: multiprocessing.Process) -> None:
        """Wait for a moment: any, or one while files are written."""
        if self._random.random() < 0.5:
            process.join(self._random.uniform(0.0, self._took_s))
            return
        end = time.monotonic() + PATIENCE_S
        is_writing = False
        while not is_writing and process.is_alive() and time.monotonic() < end:
            time.sleep(0.0002)
            with suppress(OSError):  # what is seen may be gone before it is looked at
                is_writing = any(path.name != LOCK for path in hidden_in(self.out))
        process.join(self._random.uniform(0.0, 0.03))

    def cases(self, count: int) -> Iterator[Case]:
        """End the command so often, each time where the other value's result is to be replaced.

        Where there is none any more, and now and then, the command is first run undisturbed.
        """
        value, other = VALUES
        is_whole = False
        for number in range(count):
            faults = []
            if not is_whole or number % UNDISTURBED == 0:
                faults += self._undisturbed(other)
            before = [files_of((self.out / record).parent) for record in RECORDS[self.command]]
            sent = self._random.choice(SIGNALS)
            process = self._start(value, self.out)
            self._wait(process)
            self._end(process, sent)
            states, found = self._judge(value, before, is_caught=sent != signal.SIGKILL)
            faults += found
            log = (self.folder / "log").read_text(errors="replace")
            if "Traceback" in log or "internal error" in log:
                faults.append(log[-500:])
            if process.exitcode not in (0, 130, -sent):
                faults.append(f"exit code {process.exitcode}: {log[-500:]}")
            yield Case(number, self.command, sent.name, tuple(states), tuple(faults))
            is_whole = ABSENT not in states
            if is_whole and OLD not in states:
                value, other = other, value

    def _end(self, process: multiprocessing.Process, sent: signal.Signals) -> None:
        """Send a signal to the process, or to all that it has started, and wait for their end."""
        is_to_all = self._random.random() < 0.5
        with suppress(ProcessLookupError):
            if is_to_all and session_of(process.pid):
                os.killpg(process.pid, sent)
            else:
                os.kill(process.pid, sent)
        process.join(PATIENCE_S)
        until(lambda: not session_of(process.pid), PATIENCE_S)

    def _judge(
        self, value: int, before: list[dict[str, bytes]], *, is_caught: bool
    ) -> tuple[list[str], list[str]]:
        """The state of each folder of the command, and what is wrong with it."""
        states, faults = [], list[str]()
        for place, record in enumerate(RECORDS[self.command]):
            name = Path(record).name
            files = files_of((self.out / record).parent)
            if name not in files:
                states.append(ABSENT)
            elif files == before[place]:
                states.append(OLD)
            elif self.command == "live":
                found = [*live_faults(files, value, self._models[value], self._answers)]
                is_over = yaml.safe_load(files[name])["complete"]
                states.append(NEW if is_over else PARTIAL)
                faults += found
            elif files == self._whole[value][place]:
                states.append(NEW)
            else:
                states.append(PARTIAL)
                if is_caught and name.endswith(".yaml"):
                    faults += beginning_faults(files, name, self._whole[value][place])
                else:
                    faults.append(f"{record} is neither the old result nor the new one")
        return states, faults

    def _undisturbed(self, value: int) -> list[str]:
        """What is wrong with the command's result, and with what it leaves, if nothing ends it."""
        process = self._start(value, self.out, wait=True)
        if process.exitcode != 0:
            return [(self.folder / "log").read_text(errors="replace")[-500:]]
        states, faults = self._judge(value, [{}] * 2, is_caught=False)
        if {*states} != {NEW}:
            faults.append(f"undisturbed, its folders are {states}")
        return faults + [f"{path} is left" for path in hidden_in(self.out)]


def study(folder: Path, command: str, count: int, seed: int = 2026) -> Iterator[Case]:
    """The cases of a command in a folder, which becomes the working folder."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["PYTHONPATH"] = environment()["PYTHONPATH"]
    os.chdir(folder)
    yield from Campaign(folder, command, seed).cases(count)
