"""What may befall a run or a batch: files, signals, full disks. See `python -m tests.faults`."""

import os

# As often as it takes to be sure, rather than as often as there is time for.
THOROUGH = bool(os.environ.get("DLGMD_THOROUGH"))
