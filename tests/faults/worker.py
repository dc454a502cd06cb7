"""Many runs in one process, whose death or silence tells which of them did it."""

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
from pathlib import Path

from faults.outcome import CRASHED, HUNG, Outcome, judge

SILENCE_S = 60.0


def run_all(inputs, options, folder, silence_s=SILENCE_S):
    """The outcome of `dlgmd run` over every input, in a process that is replaced if it dies."""
    outcomes, waiting = [], list(inputs)
    while waiting:
        done = _run_until_death(waiting, options, folder, silence_s)
        outcomes += done
        waiting = waiting[len(done) :]
    return outcomes


def _run_until_death(inputs, options, folder, silence_s):
    """The outcomes up to the first input that ends the process or makes it hang."""
    folder.mkdir(parents=True, exist_ok=True)
    job = json.dumps([options, [(i.name, str(i.path), i.expected) for i in inputs]])
    process = subprocess.Popen(
        [sys.executable, "-m", "faults.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path]),
        },
    )
    lines = queue.Queue()

    def read():
        for line in process.stdout:
            lines.put(line)
        lines.put(None)

    reading = threading.Thread(target=read, daemon=True)
    reading.start()
    process.stdin.write(job)
    process.stdin.close()
    outcomes = []
    for case in inputs:
        try:
            line = lines.get(timeout=silence_s)
        except queue.Empty:
            outcomes.append(Outcome(case.name, HUNG, f"silent for {silence_s:g} s: {case.path}"))
            break
        if line is None:
            code = process.wait()
            outcomes.append(Outcome(case.name, CRASHED, f"ended with {code}: {case.path}"))
            break
        outcomes.append(Outcome(**json.loads(line)))
    process.kill()
    process.wait()
    reading.join()
    process.stdout.close()
    return outcomes


def main():
    """Read the inputs from stdin, and write a line for each."""
    from click.testing import CliRunner

    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    from dlgmd_cli.app import cli

    options, cases = json.load(sys.stdin)
    report, out = sys.stdout, Path("out")
    for name, path, expected in cases:
        shutil.rmtree(out, ignore_errors=True)
        command = ["run", path, "--out", str(out), "--no-plots", *options]
        result = CliRunner().invoke(cli, command, prog_name="dlgmd")
        outcome = judge(name, result.exit_code, result.stderr, out, expected)
        if any(entry.name != out.name for entry in Path().iterdir()):
            outcome = Outcome(name, outcome.ending, f"left files: {list(Path().iterdir())}")
        print(json.dumps(outcome.to_dict()), file=report, flush=True)


if __name__ == "__main__":
    main()
