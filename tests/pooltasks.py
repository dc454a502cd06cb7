"""What the pool's processes are asked to do in its tests."""

import ctypes
import os
import time


def work(task):
    """Do what the task's name says."""
    if task == "raise":
        raise ValueError("no")
    if task == "crash":
        ctypes.string_at(0)
    if task == "kill":
        os.kill(os.getpid(), 9)
    if task == "exit":
        os._exit(3)
    if task == "hang":
        time.sleep(100)
    if task == "pid":
        return os.getpid()
    return task * 2
