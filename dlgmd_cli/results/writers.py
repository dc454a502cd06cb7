"""The functions that write the files of a run, see `files`: tables and captions."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from dlgmd_cli.errors import printable
from dlgmd_cli.results import csv
from dlgmd_cli.results.result import Result

# The shortest time that a caption is shown, in seconds.
SHOWN_S = 0.5


def write_frames(result: Result, path: Path) -> None:
    """Write a table with one row per frame; its name says which."""
    header = csv.headers(result.own_columns)[path.name]
    csv.write_values(path, header, result.columns(header).tolist())


def write_alarms(result: Result, path: Path) -> None:
    """Write the table with one row per alarm."""
    rows = ([*alarm.to_dict().values()] for alarm in result.alarm_list)
    csv.write_values(path, csv.ALARM_COLUMNS, rows)


class Caption(NamedTuple):
    """A caption: its times in seconds, and its text, on one line."""

    start_s: float
    end_s: float
    text: str


def captions(result: Result) -> Iterator[Caption]:
    """A caption for each alarm: its number, rule, image region and strongest signal."""
    for number, alarm in enumerate(result.alarm_list, start=1):
        said = alarm.rule, alarm.side, result.rule.peak_text(alarm.peak_signal)
        text = printable(f"Alarm {number}: {', '.join(filter(None, said))}")
        start_s = max(alarm.start_s, 0.0)
        yield Caption(start_s, max(alarm.end_s, start_s + SHOWN_S), text)


def clock(time_s: float) -> str:
    """A time as captions have it: ``00:00:03.267``."""
    seconds, ms = divmod(round(1000.0 * time_s), 1000)
    return f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}.{ms:03}"


def write_vtt(result: Result, path: Path) -> None:
    """Write the captions as WebVTT; OSError passes through."""
    parts = ["WEBVTT\n"]
    for one in captions(result):
        text = one.text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        parts.append(f"{clock(one.start_s)} --> {clock(one.end_s)}\n{text}\n")
    path.write_text("\n".join(parts), encoding="utf-8", newline="\n")
