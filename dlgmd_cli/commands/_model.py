"""The options that choose a model and its parameters, shared by every command that runs one."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands._types import OptionGroup
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import ENGINES, FORMULATIONS, MODELS, DlgmdParameters, Parameters

if TYPE_CHECKING:
    from dlgmd_cli.models.base import Model
    from dlgmd_cli.parameters import Config

DEFAULT_SET, DEFAULT_MODEL = "9", "dlgmd"


class ModelChoice:
    """The parameters that the options ask for, and the file that they started from.

    Attributes
    ----------
    params : Parameters
        Defaults < set or file < `--param` and `--formulation`.
    model : str
        Name of the model that they belong to.
    label : str
        What messages and figures call the choice: `set9`, or a file's stem.
    origin : str
        The file, as errors name it.
    recorded_options : dict
        Options of the run that wrote the file, if a run did.
    recorded_engine : str or None
        The engine of that run.

    Parameters
    ----------
    set_name, config, pairs, model, formulation
        What the `MODEL_OPTIONS` say.
    base : Config, optional
        Where D-LGMD parameters come from if no set or file is named, in place of set 9.
    """

    def __init__(
        self,
        set_name: str | None,
        config: Path | None,
        pairs: tuple[str, ...],
        model: str | None,
        formulation: str | None,
        base: "Config | None" = None,
    ) -> None:
        from dlgmd_cli import parameters  # brings in yaml

        if set_name is not None and config is not None:
            raise click.UsageError("--set and --config exclude each other. Give one of them.")
        if model not in (DEFAULT_MODEL, None) and set_name is not None:
            raise click.UsageError(f"--set is of the D-LGMD, not of --model {model}.")
        file = _file(set_name, config, model, base)
        self.origin, self.recorded_options = file.name, file.options
        if file.engine not in (*ENGINES, None):
            raise ParameterError(
                file.name,
                f"there is no engine {str(file.engine)[:40]!r}",
                f"Choose from {', '.join(ENGINES)}.",
            )
        self.recorded_engine = file.engine
        self.model = model or file.model or DEFAULT_MODEL
        if self.model not in MODELS:
            raise ParameterError(
                file.name,
                f"there is no model {self.model[:40]!r}",
                f"Choose from {', '.join(MODELS)}.",
            )
        if config is not None:
            self.label = config.stem
        elif file is base:
            self.label = file.name
        else:
            self.label = (
                self.model if self.model != DEFAULT_MODEL else f"set{set_name or DEFAULT_SET}"
            )
        kind = MODELS[self.model].parameters
        overrides = parameters.parse_overrides(pairs)
        if formulation is not None:
            if "formulation" not in kind.specs():
                raise click.UsageError(f"--formulation is of the D-LGMD, not of {self.model}.")
            overrides["formulation"] = formulation
        self.params: Parameters = parameters.merge(kind, file, overrides)

    def create(self, engine: str | None, tell: Callable[[str], None]) -> "Model":
        """The model, computed by `engine` or, unless that is given, as the file's run was."""
        from dlgmd_cli.models.base import create_model  # brings in numpy

        return create_model(self.params, engine=engine or self.recorded_engine or "auto", tell=tell)

    def dlgmd_params(self) -> DlgmdParameters:
        """The parameters, which must be the D-LGMD's."""
        if not isinstance(self.params, DlgmdParameters):
            raise click.UsageError(f"the model {self.model!r} has no such kernels.")
        return self.params


def _file(
    set_name: str | None, config: Path | None, model: str | None, base: "Config | None"
) -> "Config":
    """The file that the parameters come from: the user's, or a preset; `base` for the default."""
    from dlgmd_cli import parameters

    if config is not None:
        return parameters.load_config(config)
    if model not in (DEFAULT_MODEL, None):
        return parameters.load_model_preset(model)
    if base is not None and set_name is None:
        return base
    try:
        return parameters.load_preset(set_name if set_name is not None else DEFAULT_SET)
    except ParameterError as error:
        mend = f"{error.mend.rstrip('.')}, or give a file with --config."
        raise ParameterError("Invalid value for '--set'", error.why, mend) from None


param_option = click.option(
    "--param",
    "pairs",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override one parameter; repeatable.",
)
formulation_option = click.option(
    "--formulation",
    type=click.Choice(FORMULATIONS),
    help="How latency meets whole frames.  [default: default]",
)
MODEL_OPTIONS = (
    click.option("--set", "set_name", metavar="N", help="The paper's set, 1 to 9.  [default: 9]"),
    click.option(
        "--config",
        type=click.Path(path_type=Path),
        help="YAML file of parameters in place of a set; a run.yaml repeats its run.",
    ),
    param_option,
    click.option(
        "--model",
        type=click.Choice(list(MODELS)),
        help=f"The model, with its published values.  [default: {DEFAULT_MODEL}]",
    ),
    formulation_option,
)
model_options = OptionGroup("choice", ModelChoice, *MODEL_OPTIONS)

engine_option = click.option(
    "--engine",
    type=click.Choice(ENGINES),
    help="What computes the model; numba needs dlgmd[fast].  "
    "[default: numba for large frames if installed, else opencv]",
)
