"""HTML of the page of one input, and of the index of many."""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli import __version__
from dlgmd_cli.errors import MissingExtraError, printable
from dlgmd_cli.pages.film import Film
from dlgmd_cli.pages.gather import Input
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.plots.traces import stretches
from dlgmd_cli.results.csv import text_cell
from dlgmd_cli.results.result import Result, Series

_TEMPLATES = Path(__file__).with_name("templates")
# Points of a sparkline, and its width and height in px.
_SPARK_POINTS, _SPARK_WIDTH, _SPARK_HEIGHT = 160, 240, 44
_SUMMARY_WORDS = {
    "mp_max": "peak MP",
    "mp_max_frame": "frame of the peak",
    "mp_max_time_s": "time of the peak (s)",
    "spikes": "spiking frames",
    "first_spike_time_s": "first spike (s)",
    "alarms": "alarms",
    "first_alarm_frame": "frame of the first alarm",
    "first_alarm_time_s": "first alarm (s)",
    "first_alarm_side": "side of the first alarm",
    "mean_attenuation_db": "mean attenuation (dB)",
}


@dataclass(frozen=True)
class Part:
    """A result on a page, with its film, or the reason why it has none."""

    label: str
    result: Result
    film: Film | None = None
    no_film: str = ""


def require_packages() -> None:
    """Raise MissingExtraError if the packages of the extra `view` are not installed."""
    try:
        import jinja2  # noqa: F401
        import plotly.offline  # noqa: F401
    except ImportError as error:
        raise MissingExtraError.of("pages", error.name) from None


def thumbnail_row(result: Result) -> int:
    """The row to show in the thumbnail: the first alarm, else the peak, else the middle."""
    onsets, level = result.alarm_onsets, result.level
    if onsets.size:
        return int(onsets[0])
    return len(result) // 2 if np.isnan(level).all() else int(np.nanargmax(level))


def page(one: Input, parts: Sequence[Part], collisions: Sequence[int], index: str = "") -> str:
    """The page of an input as HTML; `index` is the relative URL of the index, if there is one."""
    films = [base64.b64encode(part.film.data).decode() if part.film else "" for part in parts]
    notes = list(dict.fromkeys(part.no_film for part in parts if part.no_film))
    return _rendered(
        "page.html.j2",
        name=printable(one.name),
        data=_page_data(one, parts, collisions),
        films=films,
        notes=[printable(note) for note in notes],
        drawer=[_drawer(part) for part in parts],
        index=index,
        plotly=_plotly(),
    )


def index_row(one: Input, href: str, parts: Sequence[Part], collisions: Sequence[int]) -> Any:
    """The row of an input in the index."""
    thumbnail = next((part.film.thumbnail for part in parts if part.film), b"")
    results = []
    for part in parts:
        result, summary = part.result, part.result.summary
        results.append(
            {
                "label": printable(part.label),
                "alarms": summary["alarms"],
                "first_s": summary["first_alarm_time_s"],
                "side": summary["first_alarm_side"],
                "spark": _spark(result, collisions),
                "n_warnings": len(result.warnings),
            }
        )
    first = one.results[0].result
    return {
        "name": printable(one.name),
        "href": href,
        "thumbnail": base64.b64encode(thumbnail).decode(),
        "duration_s": float(first.time_s[-1] - first.time_s[0]),
        "n_frames": len(first),
        "n_collisions": len(collisions),
        "results": results,
    }


def index_page(rows: Sequence[Any], failed: Sequence[tuple[str, str]]) -> str:
    """The index of many inputs as HTML."""
    failures = [(printable(name), printable(why)) for name, why in failed]
    return _rendered(
        "index.html.j2",
        rows=rows,
        failed=failures,
        width=_SPARK_WIDTH,
        height=_SPARK_HEIGHT,
    )


def _rendered(template: str, **values: Any) -> str:
    """Fill a template; all text is escaped."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(version=__version__, **values)


@cache
def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _page_data(one: Input, parts: Sequence[Part], collisions: Sequence[int]) -> dict[str, Any]:
    results = [part.result for part in parts]
    found = [float(v) for r in results for v in r.attenuation_db if v > FLOOR_DB]
    foot_db = (min(found) if found else -10.0) - 2.0
    return {
        "name": printable(one.name),
        # Labels are saved beside the video, so its file name is enough.
        "video": text_cell(PurePath(one.path).name),
        "collisions": list(collisions),
        "results": [_result_data(part, foot_db) for part in parts],
    }


def _result_data(part: Part, foot_db: float) -> dict[str, Any]:
    """Curves and events of one result, for the page's script."""
    result = part.result
    db = result.attenuation_db
    # Comparisons do not store P; there, -inf means that nothing passed.
    silent = db <= FLOOR_DB
    return {
        "label": printable(part.label),
        "frame": result.frame.tolist(),
        "time": _numbers(result.time_s, 6),
        "level": _numbers(result.level, 4),
        "db": _numbers(np.where(silent, np.nan, db), 3),
        "silent": np.flatnonzero(silent).tolist(),
        "foot": round(foot_db, 3),
        "spikes": np.flatnonzero(result.spikes).tolist(),
        "alarms": [
            [round(start, 6), round(start + length, 6)]
            for start, length in stretches(result.time_s, result.alarmed)
        ],
        "spans": result.alarm_spans.tolist(),
        "sides": [one.side for one in result.alarm_list],
        "threshold": result.threshold,
        "bySequence": result.by_sequence,
        "fps": part.film.fps if part.film else None,
        "size": part.film.size_wh if part.film else None,
    }


def _numbers(values: npt.ArrayLike, digits: int) -> list[float | None]:
    """Rounded numbers for JSON; None (null) where not finite."""
    series: Series = np.asarray(values, dtype=np.float64)
    return [round(value, digits) if math.isfinite(value) else None for value in series.tolist()]


def _drawer(part: Part) -> dict[str, Any]:
    """Summary, parameters, input and warnings of a result, as texts for the drawer."""
    result, record = part.result, part.result.record
    specs, values = result.params.specs(), result.params.to_dict()
    summary = [(word, _text(result.summary[key])) for key, word in _SUMMARY_WORDS.items()]
    known, processed = record.get("input") or {}, record.get("processed") or {}
    facts = {
        "input": PurePath(str(known.get("path", ""))).name,
        "size": f"{known.get('width')}x{known.get('height')} px",
        "frame rate": f"{_text(known.get('fps'))} frames/s",
        "frames": known.get("frames"),
        "processed size": f"{processed.get('width')}x{processed.get('height')} px",
        "processed frames": len(result),
        "decoder": known.get("decoder"),
        "engine": record.get("engine"),
        **{
            # Pages are shared: they do not name the folder of a file.
            key: PurePath(str(value)).name if key == "mask" else value
            for key, value in _flat(record.get("options")).items()
        },
        **{f"version of {name}": one for name, one in _flat(record.get("versions")).items()},
    }
    warnings = list(result.warnings)
    if part.film is not None and not part.film.is_as_stored:
        warnings.append(
            "running the model again for the film gave a different MP: the curves are stored ones, "
            "the tinted cells are new"
        )
    if record.get("complete") is False:
        warnings.append("the run was interrupted")
    return {
        "label": printable(part.label),
        "model": result.params.model,
        "summary": summary,
        "parameters": [
            (key, specs[key].symbol, _text(value), specs[key].unit, specs[key].meaning)
            for key, value in values.items()
        ],
        "facts": [(key, _text(value)) for key, value in facts.items()],
        "warnings": [printable(line) for line in warnings],
    }


def _flat(known: Any) -> Mapping[str, Any]:
    """A mapping in a record; empty if it is anything else."""
    return known if isinstance(known, dict) else {}


def _text(value: Any) -> str:
    """A value as text for the drawer."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    return printable(str(value))


def _spark(result: Result, collisions: Sequence[int]) -> dict[str, Any]:
    """A sparkline of the MP: points, threshold, alarms and collisions in px."""
    time_s, level = result.time_s, np.nan_to_num(result.level)
    start_s, length_s = float(time_s[0]), float(time_s[-1] - time_s[0]) or 1.0
    edges = np.unique(np.linspace(0, len(level), _SPARK_POINTS, endpoint=False).astype(int))
    pooled, times = np.maximum.reduceat(level, edges), time_s[edges]

    def x(when_s: float) -> float:
        return round((when_s - start_s) / length_s * _SPARK_WIDTH, 1)

    def y(value: float) -> float:
        return round(_SPARK_HEIGHT - 2 - value * (_SPARK_HEIGHT - 4), 1)

    times_hit = np.interp(list(collisions), result.frame, time_s) if collisions else ()
    return {
        "points": " ".join(f"{x(t)},{y(v)}" for t, v in zip(times, pooled, strict=True)),
        "threshold": y(result.threshold),
        "alarms": [
            (x(begin), max(2.0, x(begin + length) - x(begin)))
            for begin, length in stretches(time_s, result.alarmed)
        ],
        "collisions": [x(float(when_s)) for when_s in times_hit],
    }
