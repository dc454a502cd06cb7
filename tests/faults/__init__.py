"""What may befall a run and a batch: bad files, signals, full disks. `python -m tests.faults` runs it all."""

import os

# As often as it takes to be sure, rather than as often as there is time for.
THOROUGH = bool(os.environ.get("DLGMD_THOROUGH"))
