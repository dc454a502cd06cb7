"""`dlgmd compare`: run several models over one video, decoded once."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.checks import blame
from dlgmd_cli.commands.console import (
    INFINITE_DISTINGUISHABILITY,
    Command,
    print_json,
    print_path,
    print_table,
)
from dlgmd_cli.commands.frame import job
from dlgmd_cli.commands.options import (
    Output,
    Parsed,
    distinct,
    engine_option,
    input_argument,
    input_options,
    report_options,
    require_one_each,
    setup_options,
)
from dlgmd_cli.commands.plot import annotation_options
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.names import distinct_names, numbered
from dlgmd_cli.parameters import (
    FORMULATIONS,
    DistributedParameters,
    DlgmdParameters,
    parse_overrides,
    reformulated,
)

if TYPE_CHECKING:
    from dlgmd_cli.plots.annotations import Annotations
    from dlgmd_cli.results.result import Result
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.setup import Setup

# The models with which the default is compared.
COMPARED_MODELS = ("lgmd", "emd-lgmd")


def _setups(
    set_names: tuple[str, ...],
    configs: tuple[Path, ...],
    models: tuple[str, ...],
    formulations: tuple[str, ...],
    no_ffi_gd: bool,
    engine: str | None,
    variants: tuple[tuple[str, dict[str, Any]], ...] = (),
    labels: tuple[str, ...] = (),
) -> "list[Setup]":
    """Every model that the options ask for, each once, with distinct labels or those given."""
    from dlgmd_cli.results.csv import text_cell
    from dlgmd_cli.runs.setup import choose

    found = [choose(set=name) for name in dict.fromkeys(set_names)]
    files = list(dict.fromkeys(configs))
    for path, label in zip(
        files, distinct_names([path.with_suffix("") for path in files]), strict=True
    ):
        found.append(replace(choose(config=path), label=text_cell(label)))
    if not (set_names or configs or models):
        found.append(choose())
        models = () if formulations or no_ffi_gd or variants else COMPARED_MODELS
    found += [choose(model=name) for name in dict.fromkeys(models)]
    for option, is_given, kind in (
        ("--formulation", formulations, DlgmdParameters),
        ("--no-ffi-gd", no_ffi_gd, DlgmdParameters),
        ("--engine", engine, DistributedParameters),
    ):
        if is_given and not any(isinstance(one.params, kind) for one in found):
            raise click.UsageError(f"{option} works only with the D-LGMD model. Add --set 9.")
    if variants and len(found) > 1:
        names = ", ".join(one.label for one in found)
        raise click.UsageError(f"--variant works with one model, not with {len(found)} ({names}).")
    every: dict[tuple[Any, ...], Setup] = {}
    for one in found:
        for each in (*_derived(one, formulations, no_ffi_gd), *_variants(one, variants)):
            if engine and isinstance(each.params, DistributedParameters):
                each = replace(each, engine=engine)
            size = each.width_px, each.options.scale, each.options.size
            every.setdefault((each.params, size, each.label), each)
    own = numbered([one.label for one in every.values()])
    require_one_each(
        labels, len(own), "model", f"Give one for each, in this order: {', '.join(own)}."
    )
    shown = [text_cell(label) for label in labels] or own
    return [replace(one, label=name) for one, name in zip(every.values(), shown, strict=True)]


def _variant(text: str) -> tuple[str, dict[str, Any]]:
    """`weak:a=1,r=4` -> ("weak", {"a": 1, "r": 4})."""
    name, _, pairs = text.partition(":")
    if not name.strip() or not pairs.strip():
        raise ParameterError("", f"{text[:60]!r} is not NAME:KEY=VALUE,…", "Write weak:a=1,r=4.")
    with blame(""):
        return name.strip(), parse_overrides(pairs.split(","))


def _variants(one: "Setup", variants: Sequence[tuple[str, dict[str, Any]]]) -> "Iterator[Setup]":
    """A setup with other parameters, once for each of the variants."""
    from dlgmd_cli.results.csv import text_cell

    for name, changes in variants:
        with blame(f"Invalid value for '--variant': {name[:40]}"):
            values = {**one.params.to_dict(), **reformulated(changes)}
            yield replace(one, label=text_cell(name), params=type(one.params).from_mapping(values))


def _derived(one: "Setup", formulations: Sequence[str], no_ffi_gd: bool) -> "Iterator[Setup]":
    """A setup, and for a D-LGMD also its variants: other formulations, without FFI-GD."""
    yield one
    if not isinstance(one.params, DlgmdParameters):
        return
    variants = {one.label: one.params}
    for formulation in formulations:
        if formulation != one.params.formulation:
            changes = reformulated({"formulation": formulation})
            variants[f"{one.label}/{formulation}"] = replace(one.params, **changes)
    if no_ffi_gd and one.params.ffi_gd:
        for label, params in list(variants.items()):
            variants[f"{label}/no-ffi-gd"] = replace(params, ffi_gd=False)
    for label, params in list(variants.items())[1:]:
        yield replace(one, label=label, params=params)


@click.command(
    cls=Command,
    epilog="Example: dlgmd compare flight.mp4 --set 3 --set 9 --model lgmd --collision-frame 120",
)
@input_argument
@setup_options(
    _setups,
    click.option(
        "--formulation",
        "formulations",
        multiple=True,
        type=click.Choice(tuple(FORMULATIONS)),
        help="Also run each D-LGMD in this formulation, see 'dlgmd run --help'; repeatable.",
    ),
    click.option(
        "--no-ffi-gd",
        is_flag=True,
        help="Also run each D-LGMD without the threshold of G (FFI-GD).",
    ),
    engine_option,
    click.option(
        "--variant",
        "variants",
        multiple=True,
        type=Parsed("NAME:KEY=VALUE,…", _variant),
        callback=distinct,
        help="Also run the model with these parameters, such as weak:a=1,r=4; repeatable.",
    ),
    click.option(
        "--label",
        "labels",
        multiple=True,
        metavar="NAME",
        callback=distinct,
        help="Name of a model in files, tables and figures; give one for each model, in the order "
        "of the table: sets, configs, models, each followed by what is derived from it.",
    ),
)
@input_options
@annotation_options
@report_options
def compare(
    input_path: str,
    setups: "list[Setup]",
    given: dict[str, Any],
    annotations: "Annotations",
    output: Output,
) -> None:
    """Run several models over one video.

    INPUT is as in 'dlgmd run'. Without --set, --config, --model and what is derived from them, the
    preset flight is compared with the LGMD and the EMD-LGMD.

    Writes OUT/NAME/ with compare.csv, figures of the membrane potentials, above the spikes and
    alarms of each model, and of the attenuations, and compare.yaml. The figure scales each membrane
    potential to its own extremes, unless --normalise absolute is given. Spikes and alarms are those
    of 'dlgmd run'.
    """
    from dlgmd_cli.results import store
    from dlgmd_cli.runs import run as runs
    from dlgmd_cli.video.options import InputOptions

    options = InputOptions(**given)
    with job(input_path, setups, options, output, store.COMPARISON) as one:
        with one.progress() as on_frame:
            found = runs.run_models(one.video, setups, options, on_frame=on_frame)
        found = [result.until(annotations.collision_frame) for result in found]
        results = {setup.label: result for setup, result in zip(setups, found, strict=True)}
        runs.require_response(one.video, setups, found, options)
        warnings = _warnings(setups, results)
        warnings += annotations.outside(int(found[0].frame[0]), int(found[0].frame[-1]))
        one.warn(warnings)
        record = _record(results, warnings, annotations)
        column = "mp_abs" if options.normalise == "absolute" else "mp_seq"
        look = {"annotations": annotations, "column": column, "width": output.width}
        one.commit(_files(results, record, output, look))
    _show(record, one.folder, output.as_json)
    one.end(len(found[0]), complete=record["complete"])


def _warnings(setups: "Sequence[Setup]", results: "Mapping[str, Result]") -> list[str]:
    """The warnings, one per line; prefixed with a label unless they are about every result."""
    lines = []
    for one in setups:
        left_out = [
            key for key in one.options.to_record() if key not in ("scale", "size", "mask_sha256")
        ]
        if left_out:
            lines.append(
                f"{one.origin}: its recorded options ({', '.join(left_out)}) are not used; give "
                "them on the command line"
            )
    for label, result in results.items():
        for line in result.warnings:
            is_common = all(line in other.warnings for other in results.values())
            lines.append(line if is_common else f"{label}: {line}")
        if not result.n_valid:
            lines.append(f"{label}: too few frames for an answer")
    return list(dict.fromkeys(lines))


def _record(
    results: "Mapping[str, Result]", warnings: list[str], annotations: "Annotations"
) -> dict[str, Any]:
    first = next(iter(results.values())).record
    models = []
    for label, result in results.items():
        summary = {**result.summary, "sharpness": _defined(result.sharpness)}
        if annotations.false_positive_frame is not None:
            ratio = result.distinguishability(annotations.false_positive_frame)
            summary["distinguishability"] = _defined(ratio)
        processed = result.record["processed"]
        models.append(
            {
                "label": label,
                "model": result.record["model"],
                "engine": result.record["engine"],
                **{key: processed[key] for key in ("width", "height", "cells") if key in processed},
                **result.params.to_dict(),
                "summary": summary,
            }
        )
    collision = annotations.collision_frame
    return {
        "input": first["input"],
        **({} if collision is None else {"collision_frame": collision}),
        **{key: first[key] for key in ("settings",) if key in first},
        "models": models,
        "options": first["options"],
        "warnings": warnings,
        "complete": first["complete"],
    }


def _defined(value: float) -> float | None:
    return None if math.isnan(value) else value


def _files(
    results: "Mapping[str, Result]", record: dict[str, Any], output: Output, look: dict[str, Any]
) -> "dict[str, Write]":
    """The function that writes each file of a comparison, by name; `look` is for its figures."""
    from dlgmd_cli.results import csv, store
    from dlgmd_cli.results.record import record_text

    columns = {label: result.columns(csv.COMPARISON[1:]) for label, result in results.items()}
    files: dict[str, Write] = {"compare.csv": partial(csv.write_comparison, columns=columns)}
    if output.formats:
        from dlgmd_cli.plots.style import figure_files
        from dlgmd_cli.plots.traces import plot

        kinds = {"mp": "spikes", "attenuation": "attenuation"}
        figures = {
            f"compare-{name}": partial(plot, kind, results, **look) for name, kind in kinds.items()
        }
        files |= figure_files(figures, output.formats, output.dpi)
    text = record_text(record, [one["engine"] for one in record["models"]])
    files[store.COMPARISON] = store.file_of(text)
    return files


def _show(record: dict[str, Any], folder: Path, as_json: bool) -> None:
    infinite = [
        one for one in record["models"] if one["summary"].get("distinguishability") == math.inf
    ]
    if as_json:
        for one in infinite:  # JSON has no infinity
            one["summary"]["distinguishability"] = "inf"
        summaries = {one["label"]: one["summary"] for one in record["models"]}
        facts = {"result": str(folder), "complete": record["complete"]}
        print_json({**facts, "warnings": record["warnings"], "models": summaries})
        return
    columns = {
        "mp_max_frame": ("peak frame", "{}"),
        "first_spike_time_s": ("first spike", "{:.3f} s"),
        "first_alarm_frame": ("first alarm", "frame {}"),
        "first_alarm_side": ("from", "{}"),
        "sharpness": ("sharpness", "{:.3f}"),
        "distinguishability": ("distinguishability", "{:.4g}"),
    }
    if "distinguishability" not in record["models"][0]["summary"]:
        del columns["distinguishability"]
    rows = []
    for one in record["models"]:
        summary = dict(one["summary"])
        if not summary["mp_max"]:  # a potential that is 0 throughout has no peak
            summary["mp_max_frame"] = None
        cells = [
            "–" if summary.get(key) is None else form.format(summary[key])
            for key, (_, form) in columns.items()
        ]
        rows.append((one["label"], *cells))
    print_table(("model", *(title for title, _ in columns.values())), rows)
    if infinite:
        click.echo(INFINITE_DISTINGUISHABILITY)
    print_path(folder)
