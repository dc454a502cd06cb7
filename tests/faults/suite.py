"""Everything that is tried, in groups: the tests assert on them, `-m tests.faults` counts."""

import signal
import sys
from concurrent.futures import ThreadPoolExecutor

from faults import THOROUGH, processes
from faults.inputs import all_inputs
from faults.worker import run_all

N_MUTANTS = 3000 if THOROUGH else 520
N_KILLS = 50 if THOROUGH else 8
N_SIGNALS = 50 if THOROUGH else 4


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
