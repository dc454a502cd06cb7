"""Run every fault and count the endings; exit code 1 if one of them may not be."""

import os
import sys
import tempfile
from pathlib import Path

# The table is what is to be read, not what decoders say of every damage.
os.environ.update(OPENCV_LOG_LEVEL="SILENT", OPENCV_FFMPEG_LOGLEVEL="-8")
sys.path.insert(0, str(Path(__file__).parents[1]))

from faults.outcome import table
from faults.suite import (
    DECODERS,
    of_batch_inputs,
    of_batch_processes,
    of_inputs,
    of_processes,
    problems_of,
)


def main():
    """Print the table, and what is wrong below it."""
    with tempfile.TemporaryDirectory() as folder:
        groups = of_inputs(Path(folder), DECODERS) | of_batch_inputs(Path(folder), DECODERS)
        tries = of_processes(Path(folder)) | of_batch_processes(Path(folder))
        for name, try_it in tries.items():
            groups[name] = try_it()
    groups["all"] = [outcome for outcomes in groups.values() for outcome in outcomes]
    problems = problems_of(groups["all"])
    print("\n".join(table(groups)))
    for outcome in problems:
        print(f"{outcome.name}: {outcome.ending}: {outcome.problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
