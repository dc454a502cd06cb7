"""Signals to a batch and to its workers, at random moments."""

import os
import random
import signal
import time
from collections import Counter
from dataclasses import replace

from faults.batch_bench import at_event, end_all, send
from faults.batch_outcome import rows_of


def to_the_batch(bench, number, count, *, to_group=False, seed=21):
    """A signal to the process that the user started, or to all of its terminal.

    Of three in turn, the first strikes a new batch, the second what that left, and the third a
    batch that replaces whole results.
    """
    moments, outcomes = random.Random(seed + number + to_group), []
    for case in range(count):
        after_s = moments.uniform(0.0, 1.05 * bench.wall_s)
        name = f"{signal.Signals(number).name} after {after_s:.3f} s"
        is_replacing = case % 3 == 2
        if is_replacing:
            bench.run()

        def disturb(process, mark, after_s=after_s):
            time.sleep(after_s)
            if process.poll() is None:
                (os.killpg if to_group else os.kill)(process.pid, number)

        outcome = bench.start(name, disturb, more=["--force"] if is_replacing else [])
        if is_replacing and number != signal.SIGKILL and not outcome.problem:
            fault = bench.fault_of_whole()
            outcome = replace(outcome, problem=fault or "")
        if case % 3 == 0 and case + 1 < count and not outcome.problem:
            outcomes.append(outcome)
        else:
            outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def to_everything(bench, count, seed=22):
    """SIGKILL to the batch and all its workers at once: nobody is left to clean up."""
    moments, outcomes = random.Random(seed), []
    for _ in range(count):
        after_s = moments.uniform(0.3, 1.05) * bench.wall_s

        def disturb(process, mark, after_s=after_s):
            time.sleep(after_s)
            end_all(mark)

        outcome = bench.start(f"all killed after {after_s:.3f} s", disturb)
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def to_a_worker(bench, count, seed=23):
    """SIGKILL to a worker at a random moment of its work: its video is lost, and no other."""
    moments, outcomes = random.Random(seed), []
    for _ in range(count):
        number, after_s = moments.randrange(20), moments.uniform(0.0, 0.1)

        def kill(worker, after_s=after_s):
            time.sleep(after_s)
            if worker is not None:
                send(worker.pid, signal.SIGKILL)

        with at_event(kill, number):
            outcome = bench.run(f"worker killed {after_s:.3f} s after event {number}")
        outcomes.append(_one_is_lost(bench, outcome, {"killed": 1}, {}))
    return outcomes


def to_a_worker_that_stops(bench, count, timeout_s=2.0):
    """SIGSTOP to a worker in the middle of a video: --timeout ends it, and its video alone."""
    outcomes = []
    for number in range(count):
        calls = []

        def stop(worker, calls=calls, number=number):
            calls.extend([worker] if worker else [])
            if worker and len(calls) == 2 + 3 * number:
                send(worker.pid, signal.SIGSTOP)

        with at_event(stop, None):
            outcome = bench.run(f"worker stopped {number}", more=["--timeout", str(timeout_s)])
        outcomes.append(_one_is_lost(bench, outcome, {"timeout": 1}))
    return outcomes


def _one_is_lost(bench, outcome, *allowed):
    """`outcome`, unless other videos suffered than may; then as ever."""
    rows = rows_of(bench.out)
    lost = Counter(row["status"] for row in rows.values() if row["status"] != "done")
    if not outcome.problem and (sorted(rows) != bench.names or lost not in allowed):
        outcome = replace(outcome, problem=f"{len(rows)} rows, and {dict(lost)} lost")
    return bench.then_as_ever(outcome)
