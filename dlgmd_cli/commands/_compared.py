"""The summaries of a comparison on stdout, as a table or as JSON."""

import math
from pathlib import Path
from typing import Any

from dlgmd_cli.commands._console import explain_infinity, print_json, print_path, print_table


def show_comparison(record: dict[str, Any], target: Path, *, as_json: bool) -> None:
    """Print what compare.yaml holds of every model, and where it lies."""
    if as_json:
        summaries = {one["label"]: _finite(one["summary"]) for one in record["models"]}
        facts = {"result": str(target), "complete": record["complete"]}
        print_json({**facts, "models": summaries})
        return
    header = ["model", "peak frame", "first spike", "first collision", "sharpness"]
    if "distinguishability" in record["models"][0]["summary"]:
        header.append("distinguishability")
    print_table(tuple(header), [_row(one, len(header)) for one in record["models"]])
    if any(_is_infinite(one["summary"]) for one in record["models"]):
        explain_infinity()
    print_path(target)


def _row(described: dict[str, Any], n_columns: int) -> tuple[str, ...]:
    """One model's row of the table, a dash for what there is not."""
    summary = dict(described["summary"])
    if not summary["mp_max"]:  # the first of frames that are all alike is no peak
        summary["mp_max_frame"] = None
    formats = {
        "mp_max_frame": "{}",
        "first_spike_time_s": "{:.3f} s",
        "first_collision_frame": "frame {}",
        "sharpness": "{:.3f}",
        "distinguishability": "{:.4g}",
    }
    cells = [
        "–" if summary.get(key) is None else shape.format(summary[key])
        for key, shape in formats.items()
    ]
    return (described["label"], *cells)[:n_columns]


def _is_infinite(summary: dict[str, Any]) -> bool:
    return summary.get("distinguishability") == math.inf


def _finite(summary: dict[str, Any]) -> dict[str, Any]:
    """A summary that JSON can hold: infinity has no number there."""
    return {**summary, "distinguishability": "inf"} if _is_infinite(summary) else summary
