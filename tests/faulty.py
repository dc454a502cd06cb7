"""Work on videos in which, by its name, one takes its process with it."""

import os
import signal
import time
from pathlib import Path

from dlgmd_cli.tasks.batch import video

run_video = video.run_video


def faulty(job, task):
    """As `run_video`, but for some names."""
    name = os.path.basename(task.video.name)
    if name.startswith("segfault"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if name.startswith("exits"):
        os._exit(3)
    if name.startswith("killed"):
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("once"):  # kills its process the first time
        mark = Path(task.video.path).with_suffix(".mark")
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("hangs"):
        time.sleep(600)
    if name.startswith("bug"):
        raise IndexError("inner secret")
    return run_video(job, task)
