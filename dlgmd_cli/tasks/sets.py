"""The paper's parameter sets, the other models and the presets: a table of all, or one as YAML."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from dlgmd_cli.errors import ParameterError, argument, printable
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.checks import Spec, refuse
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.parameters.presets import ModelName
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Cells
from dlgmd_cli.results.files import FIGURE_FORMATS
from dlgmd_cli.results.outcome import Outcome, Shown, drawn_by

# The parameters in which the paper's sets differ, and the scale of the spikes.
_SHOWN = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r", "a", "t0", "kappa")


def sets(
    model: ModelName | None = None,
    plot: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> Sets | ParameterSet:
    """The paper's parameter sets, or one set, preset, model or file, as `dlgmd sets` prints them.

    Parameters
    ----------
    model : optional
        As in `run`. Without it, all of the paper's sets.
    plot : str or path, optional
        Draw the kernels of a D-LGMD into this .png, .pdf or .svg: excitation, inhibition, latency.
        An earlier file is replaced only with `overwrite`.

    Returns
    -------
    Sets or ParameterSet
        `table` has a row per set; or, with `model`, a row per parameter: `save` writes its
        YAML, and `plot` draws its kernels.

    Raises
    ------
    ParameterError
        If there is no such model, or it has no kernels to draw, or `plot` is no figure.
    OutputError, OutputExistsError
        If the figure cannot be written, or may not be replaced.

    Examples
    --------
    >>> print(sets("lgmd").record_text())  # doctest: +SKIP
    >>> sets().table["sigma_e"]  # doctest: +SKIP
    """
    if model is None:
        return Sets()
    config = presets.config_of(model)
    chosen = ParameterSet(config, presets.parameters_of(config))
    if plot is None:
        refuse({"overwrite": overwrite}, f"works only with {argument('plot')}")
        return chosen
    path = Path(plot)
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in FIGURE_FORMATS:
        why = f"{printable(str(path))[:80]!r} is no figure"
        raise ParameterError("", why, "Write kernels.png, .pdf or .svg.", "plot")
    draw = partial(drawn_by("sheets.plot_kernels"), *chosen.drawn("kernels"))
    files = drawn_by("style.figure_files")({path.stem: draw}, (suffix,))
    with store.claimed(path.parent, names=files, overwrite=overwrite, named_by="plot") as claim:
        chosen.paths = claim.write(files)
    return chosen


@dataclass(eq=False)
class Sets(Outcome):
    """The paper's parameter sets, and the names of the other models and the presets."""

    TABLES = ("sets.csv",)

    def cells(self) -> Cells:
        """A row per set."""
        rows = []
        for name in presets.preset_names():
            values = presets.load_set(name).to_dict()
            rows.append((name, *(values[key] for key in _SHOWN)))
        return {"sets.csv": (("set", *_SHOWN), rows)}

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: the table, and what other names there are."""
        symbols = {key: presets.DlgmdParameters.specs()[key].symbol for key in _SHOWN}
        (_, rows), *_ = self.cells().values()
        texts = [(str(name), *(f"{value:g}" for value in values)) for name, *values in rows]
        yield ("set", *symbols.values()), texts
        named = (f"{symbol} {key}" for key, symbol in symbols.items() if symbol != key)
        yield f"Keys: {', '.join(named)}. 'dlgmd sets N' shows all parameters, with units."
        others = {*presets.MODELS} - {presets.DlgmdParameters.model, *presets.PUBLISHED}
        yield f"Other models: {', '.join(name for name in presets.MODELS if name in others)}."
        yield f"Models of the field:\n{', '.join(presets.PUBLISHED)}."
        yield "'dlgmd sets lgmd' shows the parameters of one of them."
        yield f"Presets: {', '.join(presets.PRESETS)}; the first is the default."

    def facts(self) -> dict[str, Json]:
        """The JSON object: the parameters of each set, and the other names."""
        names = presets.preset_names()
        every: dict[str, Json] = {name: presets.load_set(name).to_dict() for name in names}
        return {"sets": every, "models": [*presets.MODELS], "presets": [*presets.PRESETS]}


@dataclass(eq=False)
class ParameterSet(Outcome):
    """The parameters of a set, a preset, a model or a file; `save` writes them for ``--config``."""

    RECORD = "parameters.yaml"
    TABLES = ("parameters.csv",)
    FIGURES = {"kernels": "sheets.plot_kernels"}  # noqa: RUF012

    config: presets.Config
    params: presets.Parameters

    def cells(self) -> Cells:
        """A row per parameter; its value as text."""
        header = ("key", "value", "unit", "symbol", "meaning")
        specs = self.params.specs()
        rows = [
            (key, str(value), specs[key].unit, specs[key].symbol, specs[key].meaning)
            for key, value in self.params.to_dict().items()
        ]
        return {"parameters.csv": (header, rows)}

    def record_text(self) -> str:
        """The parameters as YAML, for ``--config``; a comment says what each means."""
        width, fps = f"width_px: {self.config.width_px:g}", f"model_fps: {self.config.model_fps:g}"
        lines = [
            f"# {self._origin()}",
            f"model: {self.params.model}",
            f"{width:<22} # width of the processed frame (px)",
            f"{fps:<22} # frames a second at most, of a video",
        ]
        specs = self.params.specs()
        lines += [_line(key, value, specs[key]) for key, value in self.params.to_dict().items()]
        return "\n".join(lines) + "\n"

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: the YAML, or the file of the figure."""
        yield from self.paths or (self.record_text().rstrip(),)

    def facts(self) -> dict[str, Json]:
        """The JSON object: the parameters, and for which frames they are made."""
        design: dict[str, Json] = {
            "model": self.params.model,
            "width_px": self.config.width_px,
            "model_fps": self.config.model_fps,
        }
        return {**super().facts(), **design, "parameters": self.params.to_dict()}

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The label and the kernels; raises ParameterError for other models than D-LGMDs."""
        taps = getattr(create_model(self.params), "connections", None)
        if taps is None or not isinstance(self.params, presets.DlgmdParameters):
            why = f"only the D-LGMD model has kernels, not {self.params.model}"
            raise ParameterError("", why)
        return self.config.label, taps.excitation, taps.inhibition, taps.latency

    def _origin(self) -> str:
        """The origin of the parameters, in words."""
        named, source = self.config.named, self.params.source
        if "preset" in named:
            is_default = named["preset"] == presets.PRESETS[0]
            return f"The preset {self.config.label}{', the default' * is_default}."
        if "set" in named:
            return f"Set {named['set']}; Table II of {source}, and defaults."
        return f"{source}, and defaults." if source else "The defaults."


def _line(key: str, value: Any, spec: Spec) -> str:
    """A parameter with its meaning as a comment."""
    line = yaml.safe_dump({key: value}).strip()
    unit = "" if spec.unit == "–" else f" ({spec.unit})"
    symbol = "" if spec.symbol == "–" else f"{spec.symbol}: "
    return f"{line:<22} # {symbol}{spec.meaning}{unit}; {spec.allowed}"
