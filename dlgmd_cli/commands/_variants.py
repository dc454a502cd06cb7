"""The options of a comparison: which models, with which parameters, and what they are called."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import click

from dlgmd_cli.commands._input import choose_input
from dlgmd_cli.commands._labels import numbered, told_apart
from dlgmd_cli.commands._model import DEFAULT_SET, ModelChoice
from dlgmd_cli.commands._types import OptionGroup
from dlgmd_cli.parameters import FORMULATIONS, MODELS, DlgmdParameters, Parameters
from dlgmd_cli.results.cells import text_cell
from dlgmd_cli.video.frames import InputOptions


@dataclass(frozen=True)
class Variant:
    """One curve of a comparison.

    Attributes
    ----------
    label : str
        What it is called: `set9`, `set9/released`, `lgmd`, or a file's stem.
    params : Parameters
        Its parameters.
    engine : str or None
        The engine of the run that its file records, if it does.
    size : InputOptions
        The processed size of that run, if its file records one.
    origin : str
        The file that it is from.
    left_out : tuple of str
        The other options of that run, which a comparison does not take over.
    """

    label: str
    params: Parameters
    engine: str | None
    size: InputOptions
    origin: str
    left_out: tuple[str, ...]


def _variants(
    set_names: tuple[str, ...],
    configs: tuple[Path, ...],
    models: tuple[str, ...],
    formulations: tuple[str, ...],
    no_ffi_gd: bool,
) -> list[Variant]:
    """Every variant that the options ask for, each once."""
    derives = bool(formulations) or no_ffi_gd
    if not (set_names or configs or models):
        set_names = (DEFAULT_SET,)
        # To what a bare comparison would be with, if there is nothing else.
        models = () if derives else tuple(MODELS)
    files = list(dict.fromkeys(configs))
    found = [_variant(_choice(set_name=name)) for name in set_names]
    found += [
        _variant(_choice(config=path), label)
        for path, label in zip(files, _file_labels(files), strict=True)
    ]
    found += [_variant(_choice(model=name)) for name in models]
    if derives and not any(isinstance(one.params, DlgmdParameters) for one in found):
        raise click.UsageError(
            "--formulation and --no-ffi-gd are of the D-LGMD, and none is compared. Add --set."
        )
    every = dict.fromkeys(each for one in found for each in _derived(one, formulations, no_ffi_gd))
    labels = numbered([one.label for one in every])
    return [replace(one, label=label) for one, label in zip(every, labels, strict=True)]


def _choice(
    set_name: str | None = None, config: Path | None = None, model: str | None = None
) -> ModelChoice:
    """The parameters of one set, file or model."""
    return ModelChoice(set_name, config, (), model, None)


def _file_labels(files: list[Path]) -> list[str]:
    """The files' stems; of those that are alike, as much of the path as tells them apart."""
    alike = [path for path in files if [other.stem for other in files].count(path.stem) > 1]
    apart = dict(zip(alike, told_apart([path.with_suffix("") for path in alike]), strict=True))
    return [apart.get(path, path.stem) for path in files]


def _variant(choice: ModelChoice, label: str | None = None) -> Variant:
    """A choice as it is, under its label."""
    recorded = choose_input({}, choice.recorded_options, choice.origin)
    size = InputOptions(scale=recorded.scale, size=recorded.size)
    left_out = tuple(key for key in recorded.to_record() if key not in ("scale", "size"))
    label = text_cell(label or choice.label)
    return Variant(label, choice.params, choice.recorded_engine, size, choice.origin, left_out)


def _derived(one: Variant, formulations: tuple[str, ...], no_ffi_gd: bool) -> Iterator[Variant]:
    """A variant, and if it is a D-LGMD also its other formulations and without FFI-GD."""
    yield one
    if not isinstance(one.params, DlgmdParameters):
        return
    kin = {one.label: one.params}
    for formulation in formulations:
        if formulation != one.params.formulation:
            kin[f"{one.label}/{formulation}"] = replace(one.params, formulation=formulation)
    if no_ffi_gd and one.params.ffi_gd:
        for label, params in list(kin.items()):
            kin[f"{label}/no-ffi-gd"] = replace(params, ffi_gd=False)
    for label, params in list(kin.items())[1:]:
        yield replace(one, label=label, params=params)


variant_options = OptionGroup(
    "variants",
    _variants,
    click.option(
        "--set",
        "set_names",
        multiple=True,
        metavar="N",
        help="One of the paper's sets; repeatable.",
    ),
    click.option(
        "--config",
        "configs",
        multiple=True,
        type=click.Path(path_type=Path),
        help="A YAML file of parameters; of a run.yaml also its processed size. Repeatable.",
    ),
    click.option(
        "--model",
        "models",
        multiple=True,
        type=click.Choice(list(MODELS)),
        help="A model with its published values; repeatable.  [default: all three]",
    ),
    click.option(
        "--formulation",
        "formulations",
        multiple=True,
        type=click.Choice(FORMULATIONS),
        help="Every D-LGMD in this formulation too; repeatable.",
    ),
    click.option("--no-ffi-gd", is_flag=True, help="Every D-LGMD without the threshold of G too."),
)
