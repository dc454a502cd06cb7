"""HTML of the page of one input, and of the index of many."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli import __version__
from dlgmd_cli.errors import MissingExtraError, printable
from dlgmd_cli.pages.gather import Gathered, Input
from dlgmd_cli.pages.page_film import PageFilm
from dlgmd_cli.parameters.facts import Json, finite, for_json
from dlgmd_cli.plots.curves import LOOKS, signal_limits, stretches, thinned
from dlgmd_cli.plots.heat import TINT
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.results.csv import text_cell
from dlgmd_cli.results.labels import Label
from dlgmd_cli.results.result import Result

_TEMPLATES = Path(__file__).with_name("templates")
# Columns of a sparkline, and its width and height in px.
_SPARK_COLUMNS, _SPARK_WIDTH, _SPARK_HEIGHT = 120, 240, 44
# Greatest number of alarms of a result that the index lists.
_MAX_LISTED = 4
_SUMMARY_WORDS = {
    "rule": "rule of the alarm",
    "alarms": "alarms",
    "first_alarm_frame": "frame of the first alarm",
    "first_alarm_time_s": "first alarm (s)",
    "first_alarm_side": "image region of the first alarm",
    "first_alarm_ttc_s": "time to contact then (s)",
    "blind_share": "share of the time with a reason in blind",
    "mp_max": "peak MP",
    "mp_max_frame": "frame of the peak",
    "mp_max_time_s": "time of the peak (s)",
    "spikes": "spiking frames",
    "first_spike_time_s": "first spike (s)",
    "mean_attenuation_db": "mean attenuation (dB)",
    "attenuation_frames": "frames of that mean",
    "median_attenuation_db": "median attenuation (dB)",
    "pooled_attenuation_db": "pooled attenuation (dB)",
}


@dataclass(frozen=True)
class PageResult:
    """A result on a page, with its film, or the reason why there is no film."""

    label: str
    result: Result
    film: PageFilm | None = None
    no_film: str = ""


@dataclass(frozen=True)
class Index:
    """The facts about an index that its pages need.

    `href` is the index's URL relative to the pages, `key` identifies the index in the browser,
    `library` is the file of the library that the pages share, and `folder` is the name of the
    folder where labels.csv is to be saved.
    """

    href: str
    key: str
    library: str
    folder: str


def require_packages() -> None:
    """Raise MissingExtraError if the packages of the extra `view` are not installed."""
    try:
        import jinja2  # noqa: F401
        import plotly.offline  # noqa: F401
    except ImportError as error:
        raise MissingExtraError.of("pages", error.name) from None


def thumbnail_row(result: Result) -> int:
    """The row shown in the thumbnail: the first alarm, else the peak, else the middle."""
    onsets, level = result.alarm_onsets, result.level
    if onsets.size:
        return int(onsets[0])
    return len(result) // 2 if np.isnan(level).all() else int(np.nanargmax(level))


def library() -> tuple[str, str]:
    """File name and text of the library that draws the curves."""
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    return f"plotly-{get_plotlyjs_version()}.min.js", str(get_plotlyjs())


def index_of(gathered: Gathered, href: str) -> Index:
    """The index of inputs; `href` is its URL relative to the pages."""
    keys = "".join(subject.key for subject in gathered.inputs)
    key = hashlib.sha256(keys.encode()).hexdigest()[:16]
    return Index(href, key, library()[0], printable(PurePath(gathered.labels_folder).name))


def input_page(
    subject: Input,
    parts: Sequence[PageResult],
    collisions: Sequence[int],
    index: Index | None = None,
) -> str:
    """The page of an input as HTML: one file, or, with an `index`, beside the library's file."""

    return _rendered(
        "page.html.j2",
        name=printable(subject.name),
        data=_page_data(subject, parts, collisions, index),
        films=[base64.b64encode(part.film.data).decode() if part.film else "" for part in parts],
        notes=list(dict.fromkeys(printable(part.no_film) for part in parts if part.no_film)),
        drawer=[_drawer(part) for part in parts],
        index=index,
        tint=TINT,
        plotly="" if index else library()[1],
    )


def index_rows(
    subject: Input,
    href: str,
    parts: Sequence[PageResult],
    collisions: Sequence[int] | None,
    scores: Sequence[Mapping[str, int] | None],
) -> list[dict[str, Any]]:
    """The rows of an input in the index, one per result.

    A score has the numbers of `hits`, of `missed` collisions and of `false` alarms. If the input is
    not labelled, `collisions` and all scores are None.
    """
    rows = []
    for part, score in zip(parts, scores, strict=True):
        result, alarms = part.result, part.result.alarm_list
        way = -1.0 if result.rule.at_most else 1.0
        thumbnail = part.film.thumbnail if part.film else b""
        rows.append(
            {
                "labelled": {**_labelled(subject), "collisions": collisions},
                "key": subject.key,
                "name": printable(subject.name),
                "href": href,
                "label": printable(part.label),
                "rule": result.rule.name,
                "said": result.rule.text,
                "thumbnail": base64.b64encode(thumbnail).decode(),
                "duration_s": float(result.time_s[-1] - result.time_s[0]),
                "n_frames": len(result),
                "collisions": collisions,
                "spark": _spark(result, collisions or ()),
                "n_alarms": len(alarms),
                "alarms": alarms[:_MAX_LISTED],
                "peaks": [result.rule.peak_text(one.peak_signal) for one in alarms[:_MAX_LISTED]],
                "silences": result.silences,
                "first_s": alarms[0].start_s if alarms else "",
                "peak": max((way * alarm.peak_signal for alarm in alarms), default=""),
                "score": score,
                "n_warnings": len(result.warnings),
            }
        )
    return rows


def index_page(
    rows: Sequence[Mapping[str, Any]], failed: Sequence[tuple[str, str]], index: Index
) -> str:
    """The index of many inputs as HTML."""

    videos = {row["key"]: row["labelled"] for row in rows}
    return _rendered(
        "index.html.j2",
        rows=rows,
        models=list(dict.fromkeys(row["label"] for row in rows)),
        rules=list(dict.fromkeys(row["said"] for row in rows)),
        has_scores=any(row["score"] for row in rows),
        failed=[(printable(name), printable(why)) for name, why in failed],
        data={"index": index.key, "videos": list(videos.values())},
        where=_where(index),
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


def _page_data(
    subject: Input, parts: Sequence[PageResult], collisions: Sequence[int], index: Index | None
) -> dict[str, Json]:
    results = [part.result for part in parts]
    levels = [float(v) for r in results for v in r.attenuation_db if v > FLOOR_DB]
    foot_db, stem = min(levels, default=-10.0) - 2.0, f"-{text_cell(PurePath(subject.path).stem)}"
    return {
        "name": printable(subject.name),
        **_labelled(subject),
        "index": index.key if index else None,
        "library": index.library if index else None,
        "download": f"labels{stem if index else ''}.csv",
        "where": _where(index),
        "collisions": list(collisions),
        "looks": [[colour, [] if dash == "-" else [*dash[1]]] for colour, dash in LOOKS],
        "results": [_result_data(part, foot_db) for part in parts],
    }


def _labelled(subject: Input) -> dict[str, Any]:
    """The data of an input's rows in labels.csv, without the collisions, for the page's script."""
    labels = subject.labels or [Label("")]
    return {
        "key": subject.key,
        "video": text_cell(subject.in_labels),
        "targets": {label.collision_frame: label.target for label in labels if label.target},
        "further": {
            label.collision_frame: {text_cell(name): text for name, text in label.further}
            for label in labels
            if label.further
        },
        "kind": labels[0].kind,
        "manner": labels[0].manner,
    }


def _where(index: Index | None) -> str:
    """A sentence that says where to save labels.csv: its paths are relative to that place."""
    if index is None:
        return "Save labels.csv beside the video."
    if not index.folder:
        return "Save labels.csv where you like: its paths are whole."
    return f"Save labels.csv in the folder “{index.folder}”: its paths start there."


def _result_data(part: PageResult, foot_db: float) -> dict[str, Json]:
    """Curves and events of one result, for the page's script."""
    result = part.result
    db = result.attenuation_db
    # Comparisons do not store P: with them, -inf means that nothing passed.
    silent = db <= FLOOR_DB
    return {
        "label": printable(part.label),
        "frame": result.frame.tolist(),
        "time": _numbers(result.time_s, 6),
        "level": _numbers(result.level, 4),
        "db": _numbers(np.where(silent, np.nan, db), 3),
        "expansion": _numbers(result.expansion, 4),
        "ttc_s": _numbers(result.ttc_s, 4),
        "signal": _numbers(result.signal, 4),
        "held_by": result.signal_limit.tolist(),
        "held": [_span(result, first, last) for first, last, _ in result.held],
        "blind_by": result.blind.tolist(),
        "blind": [_span(result, first, last) for first, last, _ in result.blind_spans],
        "limits": [round(limit, 4) for limit in signal_limits(result)],
        "rule": result.rule.to_dict(),
        "silent": np.flatnonzero(silent & ~result.is_repeat).tolist(),
        "foot": round(foot_db, 3),
        "spikes": np.flatnonzero(result.new_spikes).tolist(),
        "alarms": [
            [round(start, 6), round(start + length, 6)]
            for start, length in stretches(result.time_s, result.alarmed)
        ],
        "spans": result.alarm_spans.tolist(),
        "sides": [alarm.side for alarm in result.alarm_list],
        "threshold": result.threshold,
        "bySequence": result.by_sequence,
        "fps": part.film.fps if part.film else None,
        "size": part.film.size_wh if part.film else None,
    }


def _span(result: Result, first: int, last: int) -> list[float]:
    """The times from a row to the end of another, in s."""
    times = result.time_s[[first, min(last + 1, len(result) - 1)]]
    return [round(float(when_s), 6) for when_s in times]


def _numbers(values: npt.ArrayLike, digits: int) -> list[float | None]:
    """Rounded numbers for JSON; None (null) where not finite."""
    numbers = np.asarray(values, dtype=np.float64).tolist()
    return [finite(round(value, digits)) for value in numbers]


def _drawer(part: PageResult) -> dict[str, Json]:
    """Summary, parameters, input and warnings of a result, as texts for the drawer."""
    result, record, summary = part.result, part.result.record, for_json(part.result.summary)
    specs, values = result.params.specs(), result.params.to_dict()

    known, processed = record.get("input") or {}, record.get("processed") or {}
    facts = {
        "input": PurePath(str(known.get("path", ""))).name,
        "size": f"{known.get('width')}x{known.get('height')} px",
        "frame rate": f"{_text(known.get('fps'))} frames/s",
        "frames": known.get("frames"),
        "processed size": f"{processed.get('width')}x{processed.get('height')} px",
        "processed frames": len(result),
        "decoder": known.get("decoder"),
        **{
            # Pages are shared: they must not name folders of this computer.
            key: PurePath(str(value)).name if key == "mask" else value
            for key, value in record.get("options", {}).items()
        },
        **{f"version of {name}": text for name, text in record.get("versions", {}).items()},
    }
    warnings = list(result.warnings)
    if part.film is not None and not part.film.is_as_stored:
        warnings.append(
            "running the model again for the film gave a different MP: the curves are stored ones, "
            "the tinted cells are new"
        )
    if result.interrupted:
        warnings.append("the run was interrupted")
    return {
        "label": printable(part.label),
        "model": result.params.model,
        "summary": [(word, _text(summary[key])) for key, word in _SUMMARY_WORDS.items()],
        "parameters": [
            (key, specs[key].symbol, _text(value), specs[key].unit, specs[key].meaning)
            for key, value in values.items()
        ],
        "facts": [(key, _text(value)) for key, value in facts.items()],
        "warnings": [printable(line) for line in warnings],
    }


def _text(value: Json) -> str:
    """A value as text for the drawer."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    return printable(str(value))


def _spark(result: Result, collisions: Sequence[int]) -> dict[str, Json]:
    """A sparkline of the rule's signal: path, threshold, alarms and collisions in px."""
    time_s, (low, high) = result.time_s, signal_limits(result)
    start_s, length_s = float(time_s[0]), float(time_s[-1] - time_s[0]) or 1.0

    def x(when_s: float) -> float:
        return round((when_s - start_s) / length_s * _SPARK_WIDTH, 1)

    def y(value: float) -> float:
        share = (min(max(value, low), high) - low) / (high - low)
        return round(_SPARK_HEIGHT - 2 - share * (_SPARK_HEIGHT - 4), 1)

    points = list(zip(*thinned(time_s, result.signal, _SPARK_COLUMNS), strict=True))
    known = [not np.isnan(value) for _, value in points]
    steps = [
        f"{'L' if known[i - 1] and i else 'M'}{x(when_s)},{y(value)}"
        for i, (when_s, value) in enumerate(points)
        if known[i]
    ]
    times_hit = np.interp(list(collisions), result.frame, time_s) if collisions else ()
    return {
        "path": "".join(steps),
        "threshold": y(result.rule.threshold),
        "alarms": [
            (x(begin), max(2.0, x(begin + length) - x(begin)))
            for begin, length in stretches(time_s, result.alarmed)
        ],
        "blind": [
            (x(begin), max(1.0, x(end) - x(begin)))
            for begin, end in (_span(result, *rows) for *rows, _ in result.blind_spans)
        ],
        "collisions": [x(float(when_s)) for when_s in times_hit],
    }
