"""A model as C: its constants, sums, tables and costs per frame, and the files of an export."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli import __version__
from dlgmd_cli.errors import ParameterError, argument, printable
from dlgmd_cli.frame import SMALL_PX
from dlgmd_cli.microcontroller.sums import N_LEVELS, Code, float_code, float_literal, functions
from dlgmd_cli.models import expansion, growth
from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.dlgmd import DLGMD, MAX_T_DE, RELEASED_CELLS
from dlgmd_cli.models.expansion import LEAST_QUALITY
from dlgmd_cli.models.health import BLIND_S, LEAST_MEASURED
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.models.windows import (
    ABOVE_DEG,
    BELOW_DEG,
    BESIDE_DEG,
    LEAST_SHOWN,
    Camera,
    outside,
)
from dlgmd_cli.parameters.facts import Json, Value
from dlgmd_cli.parameters.presets import (
    DEFAULT_MODEL_FPS,
    PRESETS,
    SMALL_WIDTH_PX,
    DlgmdParameters,
)
from dlgmd_cli.results import store
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.scenes.objects import ball_approaches
from dlgmd_cli.tasks.call import ModelName, choose, options_for, require_measured, with_rule
from dlgmd_cli.tasks.camera import camera_of
from dlgmd_cli.video.base import parse_size

# Sides of a frame in px (the test's stimulus needs 16), and the greatest number of cells.
MIN_SIDE_PX, MAX_SIDE_PX, MAX_CELLS = 16, 1024, 2**18 - 1
# Intervals between frames are clipped to this range, in µs.
MIN_STEP_US, MAX_STEP_US = 1000, 1_000_000
# Stack in bytes, an upper bound. Code in bytes, approximately: a constant, bytes per operation of a
# cell, the expansion. The tests measure both.
STACK_BYTES = 1200
CODE_BYTES, OPERATION_BYTES, EXPANSION_BYTES = 1200, 10, 6500
# Numbers of the expansion that keep their names in C.
_OF_GROWTH = ("MAX_RETURN_PX", "RESIDUALS", "LEAST_PX", "OVERLAP", "LEAST_SPREAD")
_OF_RATES = ("USUAL_S", "LEAST_S", "ERROR", "LEAST_WEIGHT", "LEAST_RATE")
# The rules in the C sources; the position of a rule is its number in dlgmd.h.
C_RULES = ("spikes", "ttc", "expansion")


def export(
    model: ModelName | None = None,
    out: str | os.PathLike[str] | None = None,
    *,
    size: str | tuple[int, int] = (96, 72),
    param: Mapping[str, Value] | None = None,
    alarm: str | None = None,
    fov: float | None = None,
    camera_tilt: float | None = None,
    prefix: str = "",
    overwrite: bool = False,
) -> Export:
    """Write a D-LGMD, the expansion and the alarm as C99, as `dlgmd export` does.

    Parameters
    ----------
    model, param, alarm
        As in `run`. For frames up to 128 px wide, the default is the preset ``"flight-small"``.
    out : str or path, optional
        Folder for the sources; earlier ones are replaced only with `overwrite`.
    size : str or (int, int)
        Width and height of the frames in px, such as ``"96x72"``.
    fov, camera_tilt : float, optional
        As in `run`.
    prefix : str
        Beginning of the names of functions, types, macros and files.

    Returns
    -------
    Export
        `costs` has the memory in bytes and the operations per frame. `save` writes the sources.

    Raises
    ------
    ParameterError
        If the model, its rule or the size has no C version, or a value is not valid.
    OutputError, OutputExistsError
        If a file cannot be written, or may not be replaced.

    Examples
    --------
    >>> export(9, "firmware", size="160x120").costs["ram_bytes"]  # doctest: +SKIP
    69180
    """
    size_wh = parse_size(size)
    if model is None and size_wh[0] <= SMALL_WIDTH_PX:  # small frames have a preset of their own
        model = PRESETS[-1]
    setup = choose(model, with_rule(param, alarm))
    require_measured([setup], {"fov": fov, "camera_tilt": camera_tilt})
    command = "".join(f" --set {name}" for name in setup.config.named.values())
    options = options_for(setup, {"fov": fov, "camera_tilt": camera_tilt})
    camera = camera_of(replace(options, crop=None), size_wh)[0]
    if camera != Camera():
        command += f" --fov {camera.fov_deg:g} --camera-tilt {camera.tilt_deg:g}"
    exported = Export(
        setup.params, *size_wh, setup.label, setup.config.model_fps, command, prefix, camera
    )
    if out is not None:
        exported.save(out, overwrite=overwrite)
    return exported


@dataclass(eq=False)
class Export(Outcome):
    """A model for frames of one size, in single precision.

    `fps` is the frame rate that the model is made for, and `command` the options that choose the
    model on the command line. All names in the C sources begin with `prefix`: several exports can
    be linked. `camera` has the angles of the camera; frames are whole images of this camera.

    Raises ParameterError if the model or the size has no C, or if no C name may begin with the
    prefix.
    """

    params: Any
    width: int
    height: int
    label: str = "D-LGMD"
    fps: float = DEFAULT_MODEL_FPS
    command: str = ""
    prefix: str = ""
    camera: Camera = field(default_factory=Camera)

    def __post_init__(self) -> None:
        if self.prefix and not re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,30}", self.prefix):
            why = f"{printable(self.prefix[:60])!r} cannot begin a name in C"
            raise ParameterError("", why, "Write, for example, front_.", "prefix")
        if type(self.params) is not DlgmdParameters:
            why = f"there is no C version of the model {self.params.model}"
            raise ParameterError("", why, "Only dlgmd can be exported.")
        if self.params.alarm not in C_RULES:
            why = f"there is no C version of the rule {self.params.alarm}"
            raise ParameterError("", why, f"Choose {' or '.join(C_RULES)}.")
        low, high = sorted((self.width, self.height))
        if low < MIN_SIDE_PX or high > MAX_SIDE_PX or self.n_cells > MAX_CELLS:
            why = f"{self.width}x{self.height} is out of range"
            sides = f"sides of {MIN_SIDE_PX} to {MAX_SIDE_PX} px and at most {MAX_CELLS} cells"
            raise ParameterError("", why, f"Choose {sides}.", "size")
        if self.expands and self.width > SMALL_PX:
            why = f"C measures the expansion of images up to {SMALL_PX} px wide"
            hint = f"Choose a smaller size, or add {argument('alarm', 'spikes')}."
            raise ParameterError("", why, hint, "size")
        if self.expands and (why := _too_small(self.width, self.height)):
            hint = f"Choose a larger size, or add {argument('alarm', 'spikes')}."
            raise ParameterError("", why, hint, "size")
        if self.expands and (why := outside(self.camera, (self.width, self.height))):
            hint = f"Choose other angles, or add {argument('alarm', 'spikes')}."
            raise ParameterError("", why, hint, "camera_tilt")

    @property
    def n_cells(self) -> int:
        """Cells of a frame."""
        return self.width * self.height

    @property
    def expands(self) -> bool:
        """Whether the rule uses the expansion, which is then measured."""
        return rule_of(self.params).uses_expansion

    @property
    def level_whs(self) -> list[tuple[int, int]]:
        """Widths and heights of the smaller images of a pyramid, in px: larger than a patch."""
        halves = (
            (-(-self.width // 2**level), -(-self.height // 2**level))
            for level in range(1, growth.TOP_LEVEL + 1)
        )
        return [wh for wh in halves if min(wh) > growth.PATCH_WH[0]]

    @cached_property
    def neuron(self) -> DLGMD:
        """The model, with its connections and their longest delay."""
        return DLGMD(self.params)

    @property
    def connections(self) -> Connections:
        """The kernels."""
        return self.neuron.connections

    @cached_property
    def code(self) -> Code:
        """The sums."""
        return float_code(self.connections)

    @property
    def sizes(self) -> dict[str, int | str]:
        """The definitions in `dlgmd.h`, which the `#if`s of all sources test."""
        plain, expanding, even = (
            "({} + (DLGMD_EARLIER - 1) * {} + 3) / 4 * 4".format(
                *self._bytes(expands=expands, evens=evens)
            )
            for expands, evens in ((False, False), (True, False), (True, True))
        )
        return {
            "DLGMD_WIDTH": self.width,
            "DLGMD_HEIGHT": self.height,
            "DLGMD_FPS": round(self.fps),
            "DLGMD_RULE": C_RULES.index(self.params.alarm),
            "DLGMD_RADIUS": self.connections.radius_px,
            "DLGMD_MAX_DELAY": self.connections.max_delay_frames,
            "DLGMD_FFI_DELAY": self.neuron.least_delay,
            "DLGMD_COLUMNS": max(1, self.code.n_columns),
            "DLGMD_MARGIN": self.code.margin,
            "DLGMD_TOP_LEVEL": len(self.level_whs),
            "DLGMD_LEVEL_CELLS": max(1, sum(width * height for width, height in self.level_whs)),
            "DLGMD_PATCH": growth.PATCH_WH[0],
            "DLGMD_POINTS": expansion.N_AHEAD**2,
            "DLGMD_SEES": int(not outside(self.camera, (self.width, self.height))),
            "DLGMD_AHEAD_CDEG": round(100.0 * self.camera.ahead[1]),
            "DLGMD_STATE_BYTES": "(!DLGMD_EXPANSION ? "
            f"{plain} : DLGMD_DEFLICKER ? {even} : {expanding})",
        }

    def state_bytes(self, *, expands: bool, evens: bool, n_earlier: int = 1) -> int:
        """RAM: the size of `dlgmd_state` in bytes, with expansion and removal of flicker or not.

        The state keeps `n_earlier` frames to compare with, DLGMD_EARLIER in C.
        """
        first, each = self._bytes(expands=expands, evens=evens)
        return _whole(first + (n_earlier - 1) * each)

    def _bytes(self, *, expands: bool, evens: bool) -> tuple[int, int]:
        """Bytes of the state without its last padding, and bytes per further frame kept."""
        radius = self.connections.radius_px
        columns = max(1, self.code.n_columns) * (self.width + 2 * radius)
        work = 4 * (columns + 4 * (self.width + 3))
        scalars = 4 * (self.neuron.least_delay + 1) + 12
        if expands:
            work = max(work, self._track_bytes())
            # Data about the light of the frames.
            scalars += 40 + (4 * 7 + 2 * 4 * self.height + 2 * 6 * self.height) * evens
        rows = self.connections.max_delay_frames * (self.height + radius) + 4 * radius + 1
        frames = self.n_cells + self.code.margin + rows * (self.width + self.code.margin)
        kept = self.n_cells + (4 + 4 * self.height * evens) * expands
        return scalars + _whole(work) + frames, kept

    def _track_bytes(self) -> int:
        """Bytes to follow points: the points, a patch, a row and two pyramids."""
        patch = growth.PATCH_WH[0]
        points = 28 * expansion.N_AHEAD**2
        cells = 2 * 3 * ((patch + 1) ** 2 + patch**2) + (patch + 3) ** 2
        pyramids = 2 * max(1, sum(width * height for width, height in self.level_whs))
        return points + cells + 3 * (self.width + 4) + pyramids

    @property
    def costs(self) -> dict[str, int]:
        """Memory in bytes, and operations of the kernels per frame.

        Flash holds the tables and the code. The size of the code is an estimate, for gcc -O2 on a
        Cortex-M4: a constant and a number of bytes per operation.
        """
        multiplications, additions = self.code.operations
        code = CODE_BYTES + OPERATION_BYTES * (multiplications + additions)
        return {
            "ram_bytes": self.state_bytes(expands=self.expands, evens=self.expands),
            "stack_bytes": STACK_BYTES,
            "flash_bytes": round(code + EXPANSION_BYTES * self.expands, -2),
            "multiplications": multiplications * self.n_cells,
            "additions": additions * self.n_cells,
        }

    def tables(self) -> dict[str, store.Write]:
        """File name -> function that writes the file."""
        return {name: store.file_of(content) for name, content in self.contents.items()}

    @cached_property
    def contents(self) -> dict[str, bytes]:
        """The contents of all files, by name; test vectors are Python's answers to an approach."""
        frames, answers = looming(self, ball_approaches(self.width, self.height))
        texts = {**sources(self), "vectors.h": vectors(self, answers)}
        contents = {name: text.encode() for name, text in prefixed(texts, self.prefix).items()}
        return contents | {"frames.gray": b"".join(frame.tobytes() for frame in frames)}

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: the folder, and the costs."""
        yield from {path.parent for path in self.paths}
        yield ("a frame costs", ""), [(name, f"{n:,}") for name, n in self.costs.items()]

    def facts(self) -> dict[str, Json]:
        """The JSON object: the folder, None if nothing was written, and the costs."""
        return {"folder": str(self.paths[0].parent) if self.paths else None, **self.costs}

    def constants(self) -> dict[str, str]:
        """The constants in `dlgmd_model.h`, as C."""
        params = self.params
        cells = RELEASED_CELLS if params.is_released else self.n_cells * params.m
        values = {
            "T_MP": params.t_mp,
            "KAPPA": params.kappa * self.n_cells,
            # Threshold of G per grey level of FFI, at most T_DE_MAX; gain of G.
            "T_DE": params.t0 / cells / N_LEVELS if params.ffi_gd else 0.0,
            "GAIN": params.gain,
        }
        if params.saturate:
            values |= {"T_DE_MAX": MAX_T_DE, "G_MAX": 1.0}
        constants = {"FIRST_VALID": str(self.neuron.first_valid_frame), "N_SP": f"{params.n_sp}u"}
        if not params.saturate:
            constants |= {"T_DE_MAX": "FLT_MAX", "G_MAX": "FLT_MAX"}
        constants |= {name: float_literal(value) for name, value in values.items()}
        return constants | self._of_expansion()

    def _of_expansion(self) -> dict[str, str]:
        """Constants of the expansion: those of `growth`, of `expansion`, of the window and rule."""
        values = {
            "LEAST_TEXTURE": growth.LEAST_TEXTURE * growth.PATCH_WH[0] ** 2,
            **{key: getattr(growth, key) for key in _OF_GROWTH},
            **{key: getattr(expansion, key) for key in _OF_RATES},
            # Rates at which the weights of old measurements decay, 1/s.
            "AHEAD_RATE": 1.0 / expansion.TAU_S,
            "LEAST_QUALITY": LEAST_QUALITY,
            "LEAST_MEASURED": LEAST_MEASURED,
            "BLIND_S": BLIND_S,
            "LEAST_SHOWN": LEAST_SHOWN,
            "FOCAL": self.camera.focal(self.width),
            "TTC_ALARM": self.params.ttc_alarm,
            "EXPANSION_ALARM": self.params.expansion_alarm,
            "MIN_STEP_US": MIN_STEP_US,
            "MAX_STEP_US": MAX_STEP_US,
        }
        # Without a window, DLGMD_SEES is 0, and the expansion is not compiled.
        window = self.camera.window((self.height, self.width)) or (0.0, 0.0, 0.0, 0.0)
        left, top, right, bottom = map(float_literal, window)
        return {
            "N_AHEAD": str(expansion.N_AHEAD),
            "MIN_POINTS": str(growth.MIN_POINTS),
            "N_STEPS": str(growth.N_STEPS),
            "N_LEVELS_BACK": str(min(growth.TOP_LEVEL_BACK, len(self.level_whs)) + 1),
            "BESIDE_CDEG": str(round(100.0 * BESIDE_DEG)),
            "ABOVE_CDEG": str(round(100.0 * ABOVE_DEG)),
            "BELOW_CDEG": str(round(100.0 * BELOW_DEG)),
            "WINDOW": f"{{{top}, {bottom}, {left}, {right}}}",
            **{name: float_literal(value) for name, value in values.items()},
        }

    def model_header(self) -> str:
        """The text of `dlgmd_model.h`."""
        head = "/* Constants and sums of dlgmd.c. No other file includes this one. */\n"
        return f"{head}#include <float.h>\n\n{defines(self.constants())}\n\n{functions(self.code)}"


def defines(values: Mapping[str, Value]) -> str:
    """Names and values as `#define` lines of C."""
    return "\n".join(f"#define {key} {value}" for key, value in values.items())


def _whole(n: int) -> int:
    """The next multiple of 4."""
    return -(-n // 4) * 4


SOURCES = Path(__file__).parent / "c"

# Text of the README, by whether the expansion raises the alarm.
WITHOUT = {
    False: "- the expansion, unless `DLGMD_EXPANSION` is defined as 1\n",
    True: """
Bands of mains light are removed as in Python. With `DLGMD_DEFLICKER` defined as 0, they
are not, and the code is smaller.

`dlgmd_state` has a union of what different parts of a step use (MISRA C:2012, rule 19.2, advisory):
each member is written before it is read, within the same part.
""",
}

# Fields of an answer that are compared with Python, named as in C.
NUMBERS = (
    *("mp", "mp_abs", "g_x", "g_y"),
    *("expansion", "expansion_upright", "expansion_quality", "ttc_s", "expansion_x", "expansion_y"),
)

# Shortest side of a frame, in px, whose expansion is measured in C as in Python.
LEAST_SIDE = 40
Frames = list[npt.NDArray[np.uint8]]


def looming(export: Export, approaches: Iterable[Frames]) -> tuple[Frames, list[Detection]]:
    """Frames of an approach up to contact, and Python's answers to these frames.

    The approach is the first that raises an alarm; if none does, the approach with the highest MP.
    """
    tried = []
    for frames in approaches:
        ahead = expansion.Expansion(camera=export.camera, looks_around=False)
        alarm = Alarm(export.params, resize=False, repeats="keep", expansion=ahead)
        answers = [alarm.step(frame) for frame in frames]
        if any(answer.alarm for answer in answers):
            return frames, answers
        tried.append((frames, answers))
    return max(tried, key=lambda pair: max(a.mp_abs for a in pair[1] if a.is_valid))


def sources(export: Export) -> dict[str, str]:
    """The sources by name, with the values of this export in place of `@key@`."""
    costs = {key: f"{n:,}" for key, n in export.costs.items()}
    multiplications, additions = export.code.operations
    lines = [
        f"RAM: {costs['ram_bytes']} bytes of state, and at most {costs['stack_bytes']} of stack",
        f"Flash: about {costs['flash_bytes']} bytes (gcc -O2, Cortex-M4)",
        f"Operations of the kernels per frame: {costs['multiplications']} multiplications and "
        f"{costs['additions']} additions",
        f"Per cell: {multiplications} multiplications and {additions} additions",
    ]
    one, two = (
        export.state_bytes(expands=export.expands, evens=export.expands, n_earlier=n)
        for n in (1, 2)
    )
    values = {
        "sizes": defines(export.sizes),
        "label": printable(export.label),
        "model": export.params.model,
        "version": __version__,
        # As CMake and Arduino take it.
        "release": ".".join(re.findall(r"\d+", __version__)[:3]),
        "width": str(export.width),
        "height": str(export.height),
        "command": export.command,
        "fps": f"{export.fps:g}",
        "costs": "\n   ".join(lines),
        "list_of_costs": "\n".join(f"- {line}" for line in lines),
        "earlier": f"{two - one:,}",
        "clear": f"{LEAST_QUALITY:g}",
        "without": WITHOUT[export.expands],
        "parameters": "\n".join(f"    {k}: {v}" for k, v in export.params.to_dict().items()),
    }

    contents = {"dlgmd_model.h": export.model_header()}
    for path in SOURCES.iterdir():
        text = path.read_text(encoding="utf-8")
        for key, value in values.items():
            text = text.replace(f"/* @{key}@ */", value).replace(f"@{key}@", value)
        contents[path.name] = text
    return contents


def prefixed(texts: Mapping[str, str], prefix: str) -> dict[str, str]:
    """Sources by name, with a prefix before each C name that including code can see."""
    lower, upper = re.compile(r"\bdlgmd(?=[_.]\w)"), re.compile(r"\bDLGMD_")
    return {
        lower.sub(f"{prefix}dlgmd", name): upper.sub(
            f"{prefix.upper()}DLGMD_", lower.sub(f"{prefix}dlgmd", text)
        )
        for name, text in texts.items()
    }


def vectors(export: Export, answers: list[Detection]) -> str:
    """The text of `vectors.h`."""
    rows = []
    for answer in answers:
        flags = [str(int(flag)) for flag in (answer.is_valid, answer.spike, answer.alarm)]
        values = [getattr(answer, name) for name in NUMBERS]
        numbers = [f"{0.0 if np.isnan(value) else value:.9g}" for value in values]
        rows.append(f"    {{{', '.join(flags + numbers)}}},\n")
    return (
        "/* Python's answers to the frames in frames.gray; 0 where they are undefined. */\n"
        f"#define N_FRAMES {len(rows)}\n"
        f"/* The quality of precise rates. */\n#define CLEAR {LEAST_QUALITY:g}\n"
        "/* Half-saturation constant of mp_abs, as K. */\n"
        f"#define HALF {export.params.kappa * export.n_cells:.9g}\n\n"
        "static const struct expected {\n"
        "    bool valid, spike, alarm;\n"
        f"    double {', '.join(NUMBERS)};\n"
        "} expected[N_FRAMES] = {\n" + "".join(rows) + "};\n"
    )


def _too_small(width: int, height: int) -> str:
    """Why frames are too small for the expansion in C; empty if they are not."""
    if min(width, height) >= LEAST_SIDE:
        return ""
    return (
        f"images of {width}x{height} px are too small or too narrow to measure their expansion "
        f"(both sides need {LEAST_SIDE} px)"
    )
