"""Inputs that do harm to the process that opens them, told by the names of their files."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from dlgmd_cli.video.frames import InputOptions


@dataclass(frozen=True)
class Sabotaged(InputOptions):
    """As InputOptions, but for some videos; every process that opens one is written down."""

    def open(self, path):
        name = Path(path).stem
        with Path(path).with_name("pids.txt").open("a") as log:
            log.write(f"{os.getpid()}\n")
        if "kills" in (name.partition("-")[0], self.decoder):
            os.kill(os.getpid(), signal.SIGKILL)
        elif name.startswith("aborts"):
            os.abort()
        elif name.startswith("hangs"):
            time.sleep(60)
        elif name.startswith("slow"):
            time.sleep(1)
        elif name.startswith("slays"):
            marker = Path(path).with_suffix(".done")
            if not marker.exists() or "always" in name:
                marker.touch()
                os.kill(os.getppid(), signal.SIGKILL)
                time.sleep(60)
        return super().open(path)
