"""The options of a batch that choose its models, and what is read of every video."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands._input import choose_input
from dlgmd_cli.commands._labels import numbered
from dlgmd_cli.commands._model import (
    DEFAULT_MODEL,
    ModelChoice,
    formulation_option,
    param_option,
)
from dlgmd_cli.commands._types import OptionGroup
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import MODELS
from dlgmd_cli.video.choice import InputChoice


@dataclass(frozen=True)
class Models:
    """One model or several, each with the name of its folder of results."""

    choices: tuple[ModelChoice, ...]

    @classmethod
    def from_options(
        cls,
        set_names: tuple[str, ...],
        configs: tuple[Path, ...],
        models: tuple[str, ...],
        pairs: tuple[str, ...],
        formulation: str | None,
    ) -> "Models":
        """Each of them once; set 9 if there is none."""
        if set_names or configs:  # which are of the D-LGMD unless a file says otherwise
            models = tuple(name for name in models if name != DEFAULT_MODEL)
        wanted: list[dict[str, Any]] = [
            *({"set_name": name} for name in dict.fromkeys(set_names)),
            *({"config": path} for path in dict.fromkeys(configs)),
            *({"model": name} for name in dict.fromkeys(models)),
        ]
        nothing = {"set_name": None, "config": None, "model": None}
        return cls(
            tuple(
                ModelChoice(**{**nothing, **one}, pairs=pairs, formulation=formulation)
                for one in wanted or [{}]
            )
        )

    def labels(self) -> list[str]:
        """What they are called: names of folders, apart from each other on any file system."""
        labels = [_as_folder(choice.label) for choice in self.choices]
        return numbered([label.lower() for label in labels]) if _clash(labels) else labels

    def options(self, given: dict[str, Any]) -> InputChoice:
        """What is read of every video: as is given, else as the model's file records it.

        Raises
        ------
        ParameterError
            If several files record what differs, for every video is decoded once.
        """
        every = [
            choose_input(given, choice.recorded_options, choice.origin) for choice in self.choices
        ]
        for choice, options in zip(self.choices, every, strict=True):
            if options != every[0]:
                raise ParameterError(
                    choice.origin,
                    "the options that it records differ from those of the other models",
                    "Give them on the command line, or run it apart.",
                )
        return every[0]


def _as_folder(label: str) -> str:
    """A label as the name of a folder."""
    name = label.replace("/", "_").replace("\\", "_")
    return name if name.strip(". ") and not name.startswith(".") else f"model{name}"


def _clash(labels: list[str]) -> bool:
    return len({label.casefold() for label in labels}) < len(labels)


batch_model_options = OptionGroup(
    "models",
    Models.from_options,
    click.option(
        "--set",
        "set_names",
        multiple=True,
        metavar="N",
        help="The paper's set, 1 to 9; repeatable.  [default: 9]",
    ),
    click.option(
        "--config",
        "configs",
        multiple=True,
        type=click.Path(path_type=Path),
        help="YAML file of parameters in place of a set; repeatable.",
    ),
    click.option(
        "--model",
        "models",
        multiple=True,
        type=click.Choice(list(MODELS)),
        help="The model, with its published values; repeatable.  [default: dlgmd]",
    ),
    param_option,
    formulation_option,
)
