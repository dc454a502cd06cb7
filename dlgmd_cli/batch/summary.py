"""summary.csv: a row a video, rewritten whole as videos end."""

import csv
import io
import time
from collections.abc import Mapping
from typing import Any

from dlgmd_cli.batch.places import Place
from dlgmd_cli.batch.task import DONE, Ending
from dlgmd_cli.results.cells import cell, text_cell

NAME = "summary.csv"
OF_INPUT = ("frames", "width", "height", "fps", "duration_s")
OF_SUMMARY = (
    "mp_max",
    "mp_max_frame",
    "spikes",
    "collisions",
    "first_collision_frame",
    "first_collision_time_s",
    "mean_attenuation_db",
)
COLUMNS = ("video", "status", "error", *OF_INPUT, *OF_SUMMARY, "wall_s")
# Rewriting a long table after every short video would take more time than the videos.
_SHARE_OF_TIME = 0.05


class Summary:
    """The rows of one summary.csv, and the file.

    Parameters
    ----------
    place : Place
        Where it goes.

    Attributes
    ----------
    endings : dict of str to Ending
        What became of every video that has ended, by its name.
    """

    def __init__(self, place: Place) -> None:
        self.place = place
        self.endings: dict[str, Ending] = {}
        self._is_written = False
        self._next_write_s = 0.0

    def add(self, video: str, ending: Ending) -> None:
        """Take a video's ending down; `write` writes it."""
        self.endings[video] = ending
        self._is_written = False

    def write(self, *, at_once: bool = True) -> None:
        """Write the file, unless it is as it was; raises OutputError.

        Without `at_once` it may be put off, so that writing takes a small share of the time.
        """
        began = time.monotonic()
        if self._is_written or (not at_once and began < self._next_write_s):
            return
        self.place.write_text(NAME, self._text())
        self._is_written = True
        ended = time.monotonic()
        self._next_write_s = ended + (ended - began) / _SHARE_OF_TIME

    def _text(self) -> str:
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for video in sorted(self.endings):
            writer.writerow(_row(video, self.endings[video]))
        return file.getvalue()


def _row(video: str, ending: Ending) -> list[str]:
    """The cells of one video; empty where there is nothing to say."""
    numbers: list[Any] = [None] * (len(OF_INPUT) + len(OF_SUMMARY))
    if ending.status == DONE:
        numbers = [
            *_values(ending.record.get("input", {}), OF_INPUT),
            *_values(ending.record.get("summary", {}), OF_SUMMARY),
        ]
    wall = "" if ending.wall_s is None else f"{ending.wall_s:.3f}"
    text = [text_cell(video), ending.status, text_cell(ending.error)]
    return [*text, *("" if value is None else cell(value) for value in numbers), wall]


def _values(facts: Mapping[str, Any], keys: tuple[str, ...]) -> list[Any]:
    """Numbers of a record, None for what is none."""
    return [facts[key] if isinstance(facts.get(key), int | float) else None for key in keys]
