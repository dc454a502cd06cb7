"""`dlgmd compare`: run several models over one video, decoded once."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show
from dlgmd_cli.commands.plot import frame_options, one_panel_option
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.checks import blame
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.results.names import distinct_names, numbered


def _setups(
    set_names: tuple[str, ...],
    configs: tuple[str, ...],
    models: tuple[str, ...],
    variants: tuple[tuple[str, dict[str, Value]], ...] = (),
    labels: tuple[str, ...] = (),
    alarm: str | None = None,
) -> "list[options.Setup]":
    """All requested models with their variants."""
    from dlgmd_cli.tasks.call import choose, with_rule
    from dlgmd_cli.tasks.compare import COMPARED_MODELS

    named = options.named_models(set_names, configs, models)
    named = named or [None, *(() if variants else COMPARED_MODELS)]
    setups = [choose(name, with_rule(None, alarm)) for name in named]
    names = distinct_names([Path(path).with_suffix("") for path in dict.fromkeys(configs)])
    for place, label in enumerate(names, start=len(dict.fromkeys(set_names))):
        setups[place] = replace(setups[place], label=label)
    return with_variants(setups, variants, labels)


def with_variants(
    setups: "list[options.Setup]",
    variants: Sequence[tuple[str, dict[str, Value]]],
    labels: tuple[str, ...],
) -> "list[options.Setup]":
    """The setups, each followed by its variants, with the given labels, or with distinct ones."""
    from dlgmd_cli.results.csv import text_cell
    from dlgmd_cli.tasks.call import require_one_each

    every = [each for setup in setups for each in (setup, *_variants_of(setup, variants, setups))]
    distinct = numbered([text_cell(setup.label) for setup in every])
    require_one_each(
        labels, len(distinct), "model", f"Give one for each, in this order: {', '.join(distinct)}."
    )
    shown = [text_cell(label) for label in labels] or distinct
    return [replace(setup, label=name) for setup, name in zip(every, shown, strict=True)]


def _variant(text: str) -> tuple[str, dict[str, Value]]:
    """`weak:a=1,r=4` -> ("weak", {"a": 1, "r": 4})."""
    name, _, pairs = text.partition(":")
    if not name.strip() or not pairs.strip():
        raise ParameterError("", f"{text[:60]!r} is not NAME:KEY=VALUE,…", "Write weak:a=1,r=4.")
    with blame(""):
        return name.strip(), presets.parse_overrides(pairs.split(","))


def _variants_of(
    setup: "options.Setup",
    variants: Sequence[tuple[str, dict[str, Value]]],
    setups: "Sequence[options.Setup]",
) -> "Iterator[options.Setup]":
    """Copies of `setup`, one of `setups`, for each variant whose keys the setup has.

    If there are several setups, a label has the setup's name before the variant's name. Raises
    ParameterError if no setup has the keys of a variant.
    """
    for name, changes in variants:
        takers = [other for other in setups if changes.keys() <= other.params.to_dict().keys()]
        if takers and setup not in takers:
            continue
        with blame(f"Invalid value for '--variant': {name[:40]}"):
            values = {**setup.params.to_dict(), **setup.params.reformulated(changes)}
            label = name if len(setups) == 1 else f"{setup.label}/{name}"
            yield replace(setup, label=label, params=type(setup.params).from_mapping(values))


variant_option = click.option(
    "--variant",
    "variants",
    multiple=True,
    type=options.Parsed("NAME:KEY=VALUE,…", _variant),
    callback=options.distinct,
    help="Also run each model with these parameters, such as weak:a=1,r=4; repeatable.",
)
label_option = click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="NAME",
    callback=options.distinct,
    help="Name of a model in files, tables and figures; give one for each model, in the order "
    "of the table: sets, configs, models, each followed by its variants.",
)


@click.command(cls=Command)
@options.input_argument
@options.setup_options(_setups, options.alarm_option, variant_option, label_option)
@options.input_options(
    *("size", "fps", "start", "end", "input_fps", "times", "normalise"),
    *("fov", "camera_tilt", "heading"),
)
@frame_options
@one_panel_option
@options.output_options
def compare(input_path: str, **arguments: Any) -> None:
    """Run several models over one video.

    \b
    Examples:
      dlgmd compare flight.mp4                  # preset flight and two LGMDs
      dlgmd compare flight.mp4 --set 9 --variant r4:r=4  # set 9, also with r = 4
      dlgmd compare flight.mp4 --set 3,6,7,8 --model lgmd --one-panel --format pdf

    INPUT is as in 'dlgmd run'. Without --set, --config, --model and --variant, the preset flight is
    compared with the LGMD and the EMD-LGMD. 'dlgmd plot' draws the stored result with marks, spans
    and other limits.

    Writes OUT/NAME/ with compare.csv, compare.yaml and two figures: the membrane potentials above
    the spikes and alarms of each model, and the attenuations. The spikes follow the potential in
    the figure, which --normalise selects. Spikes and alarms are the same as in 'dlgmd run'.
    """
    from dlgmd_cli.tasks import compare as task

    show(task.compare(input_path, progress=progress, **arguments))
