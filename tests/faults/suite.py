"""Everything that is tried, in groups: the tests assert on them, `-m tests.faults` counts."""

import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

from faults import THOROUGH, batch_disks, batch_odd, batch_signals, processes
from faults.batch_bench import BatchBench
from faults.batch_inputs import batch_of_inputs
from faults.inputs import all_inputs
from faults.worker import run_all

DECODERS = ["opencv", *(["pyav"] if find_spec("av") else [])]
N_MUTANTS = 3000 if THOROUGH else 520
N_KILLS = 50 if THOROUGH else 8
N_SIGNALS = 50 if THOROUGH else 4
N_BATCH_KILLS = 50 if THOROUGH else 6
N_BATCH_SIGNALS = 18 if THOROUGH else 2
# Each process more takes time to start.
N_JOBS = 2 if THOROUGH else 1
N_WORKERS = 20 if THOROUGH else 2
# Every so manieth video of a batch is held against a run of its own.
N_APART = 1 if THOROUGH else 8


def of_inputs(folder, decoders, n_mutants=N_MUTANTS):
    """The outcomes of a run over every input, by decoder and kind of input."""
    inputs = all_inputs(folder / "inputs", n_mutants)

    def run(decoder):
        return run_all(inputs, ["--decoder", decoder], folder / decoder)

    groups = {}
    with ThreadPoolExecutor() as pool:  # each waits for a process
        for decoder, outcomes in zip(decoders, pool.map(run, decoders), strict=True):
            for case, outcome in zip(inputs, outcomes, strict=True):
                groups.setdefault(f"{decoder}: {case.kind}", []).append(outcome)
    return groups


def of_processes(folder):
    """What can be done to the process and its disk: a function of no arguments for each group."""
    plots = [] if THOROUGH else ["--no-plots"]
    benches = {}

    def bench(name, *arguments):
        if name not in benches:
            benches[name] = processes.Bench(folder / name, *arguments)
        return benches[name]

    def signals(number, count):
        return lambda: processes.signals(bench("long", ["--no-plots"]), number, count)

    def on_short(try_it):
        return lambda: try_it(bench("short", plots, 20))

    groups = {
        "failing writes": on_short(processes.no_room_for_a_write),
        "full disk": on_short(processes.no_room_on_disk),
        "limited file size": on_short(processes.no_files_so_large),
        "nowhere to write": on_short(processes.nowhere_to_write),
        "results removed": on_short(processes.folder_removed),
    }
    if sys.platform != "win32":
        groups["closed streams"] = on_short(processes.closed_streams)
        groups["killed"] = signals(signal.SIGKILL, N_KILLS)
        groups["Ctrl-C"] = signals(signal.SIGINT, N_SIGNALS)
        groups["terminated"] = signals(signal.SIGTERM, N_SIGNALS)
    return groups


def of_batch_inputs(folder, decoders, n_mutants=N_MUTANTS):
    """The outcomes of a batch over all inputs, by decoder and kind of input.

    Unless there is time, decoders after the first get fewer mutants.
    """
    groups = {}
    for number, decoder in enumerate(decoders):
        share = 1 if THOROUGH or number == 0 else 4
        inputs = all_inputs(folder / f"batch-{decoder}" / "inputs", n_mutants // share)
        outcomes = batch_of_inputs(inputs, folder / f"batch-{decoder}", decoder, N_APART)
        for case, outcome in outcomes.items():
            kind = case.kind if case else "as a whole"
            groups.setdefault(f"batch, {decoder}: {kind}", []).append(outcome)
    return groups


def of_batch_processes(folder):
    """What can be done to a batch, its workers and its disk: a function for each group."""
    plots = ["--format", "svg"] if THOROUGH else ["--no-plots"]
    benches = {}

    def bench(name, *arguments):
        if name not in benches:
            benches[name] = BatchBench(folder / f"batch-{name}", *arguments)
        return benches[name]

    def on_long(try_it, *arguments, **how):
        return lambda: try_it(bench("long", plots), *arguments, **how)

    def on_short(try_it):
        return lambda: try_it(bench("short", ["--no-plots"], 5, 60, N_JOBS))

    groups = {
        "nowhere to write": on_short(batch_disks.nowhere_to_write),
        "full disk": on_short(batch_disks.no_room_on_disk),
        "limited file size": on_short(batch_disks.no_files_so_large),
        "results removed": on_short(batch_disks.results_removed),
        "results replaced": on_short(batch_disks.results_replaced),
        "inputs disturbed": on_short(batch_disks.inputs_disturbed),
        "nothing temporary": on_short(batch_disks.nothing_temporary),
        "thousands": on_short(batch_odd.many),
        "odd names": on_short(batch_odd.names),
        "odd places": on_short(batch_odd.places),
    }
    if sys.platform != "win32":
        to_batch, to_worker = batch_signals.to_the_batch, batch_signals.to_a_worker
        stopped, n_stopped = batch_signals.to_a_worker_that_stops, N_WORKERS // 2
        groups |= {
            "closed streams": on_short(batch_odd.streams),
            "limits": on_short(batch_odd.limits),
            "killed": on_long(to_batch, signal.SIGKILL, N_BATCH_KILLS),
            "Ctrl-C": on_long(to_batch, signal.SIGINT, N_BATCH_SIGNALS),
            "Ctrl-C to all": on_long(to_batch, signal.SIGINT, N_BATCH_SIGNALS, to_group=True),
            "terminated": on_long(to_batch, signal.SIGTERM, N_BATCH_SIGNALS),
            "hung up": on_long(to_batch, signal.SIGHUP, N_BATCH_SIGNALS),
            "all killed": on_long(batch_signals.to_everything, N_WORKERS),
            "a worker killed": on_long(to_worker, 2 * N_WORKERS),
            "a worker stopped": on_long(stopped, n_stopped),
        }
    return {f"batch: {name}": try_it for name, try_it in groups.items()}


def problems_of(outcomes):
    """Those that may not be so."""
    return [outcome for outcome in outcomes if outcome.problem]
