"""A model as C: its constants, sums, tables and costs per frame, and the files of an export."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli import __version__
from dlgmd_cli.errors import ParameterError, argument, printable
from dlgmd_cli.export.sums import N_LEVELS, Code, fixed_code, float_code, float_literal, functions
from dlgmd_cli.frame import SMALL_PX
from dlgmd_cli.models import expansion, motion
from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.dlgmd import DLGMD, MAX_T_DE, RELEASED_CELLS
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.models.windows import LEAST_SHOWN, PARTS, Camera, outside
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.presets import DEFAULT_MODEL_FPS, DlgmdParameters

# Sides of a frame in px (the test's stimulus needs 16), and the greatest number of cells.
MIN_SIDE_PX, MAX_SIDE_PX, MAX_CELLS = 16, 1024, 2**18 - 1
# Intervals between frames are clipped to this range, in µs.
MIN_STEP_US, MAX_STEP_US = 1000, 1_000_000
# Stack in bytes, an upper bound. Code in bytes, approximately, for floating (False) and fixed point
# (True): a constant, bytes per operation of a cell, the expansion. The tests measure both.
STACK_BYTES = 1800
CODE_BYTES = {False: (1200, 10, 8800), True: (1400, 7, 11400)}
# The rules in the C sources; the position of a rule is its number in dlgmd.h.
C_RULES = ("spikes", "ttc", "expansion")


@dataclass(frozen=True)
class Export:
    """A model for frames of one size, in floating or in fixed point.

    `fps` is the frame rate that the model is made for, and `command` the options that choose the
    model on the command line. All names in the C sources begin with `prefix`: several exports can
    be linked. `camera` has the angles of the camera; frames are whole images of this camera.

    Raises ParameterError if the model, size and arithmetic have no C, or if no C name may begin
    with the prefix.
    """

    params: Any
    width: int
    height: int
    is_fixed: bool = False
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
        if self.expands and (why := expansion.too_small((self.width, self.height))):
            hint = f"Choose a larger size, or add {argument('alarm', 'spikes')}."
            raise ParameterError("", why, hint, "size")
        if self.expands and (why := outside(self.camera, self.small_wh)):
            hint = f"Choose other angles, or add {argument('alarm', 'spikes')}."
            raise ParameterError("", why, hint, "camera_tilt")
        if self.is_fixed and not self.params.saturate:
            why = "G has no upper bound without saturation, and integers need one"
            raise ParameterError(argument("fixed"), why, f"Add {argument('param')} saturate=true.")

    @property
    def n_cells(self) -> int:
        """Cells of a frame."""
        return self.width * self.height

    @property
    def expands(self) -> bool:
        """Whether the rule uses the expansion, which is then measured."""
        return rule_of(self.params).uses_expansion

    @property
    def factor(self) -> int:
        """Factor by which frames are reduced on each side before the expansion is measured."""
        return self.camera.factor(self.width, expansion.factor_of(self.width))

    @property
    def small_wh(self) -> tuple[int, int]:
        """Width and height of the images reduced by `factor`, in px."""
        return self.width // self.factor, self.height // self.factor

    @property
    def window_wh(self) -> tuple[int, int]:
        """Greatest width and height of a window, in cells: an angular window, or one on motion."""
        width, height = self.small_wh
        moving = (min(width, height) // 2 + 1) // 2 * 2 + 1
        wide = self._most_cells(width, max(part.width_deg for part in PARTS))
        high = self._most_cells(height, max(part.height_deg for part in PARTS))
        return max(moving, wide), max(moving, high)

    def _most_cells(self, n: int, part_deg: float) -> int:
        """Most cells of `n` along a side that an angle spans: the window that ends at a border."""
        focal = self.camera.focal(self.small_wh[0])
        edge = math.atan(n / 2.0 / focal) - math.radians(part_deg)
        return min(n - 2, math.floor(n / 2.0 - focal * math.tan(edge)) + 1)

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
        if not self.is_fixed:
            return float_code(self.connections)
        # G = k S Ce is the product of S √k and Ce √k.
        return fixed_code(self.connections, math.sqrt(self.params.gain))

    @property
    def sizes(self) -> dict[str, int | str]:
        """The definitions in `dlgmd.h`, which the `#if`s of all sources test."""
        plain, expanding, even = (
            "({} + (DLGMD_EARLIER - 1) * {} + {unit} - 1) / {unit} * {unit}".format(
                *self._bytes(expands=expands, evens=evens),
                unit=self._alignment(expands=expands),
            )
            for expands, evens in ((False, False), (True, False), (True, True))
        )
        wide, high = self.window_wh
        return {
            "DLGMD_WIDTH": self.width,
            "DLGMD_HEIGHT": self.height,
            "DLGMD_FPS": round(self.fps),
            "DLGMD_FIXED": int(self.is_fixed),
            "DLGMD_RULE": C_RULES.index(self.params.alarm),
            "DLGMD_RADIUS": self.connections.radius_px,
            "DLGMD_MAX_DELAY": self.connections.max_delay_frames,
            "DLGMD_FFI_DELAY": self.neuron.least_delay,
            "DLGMD_COLUMNS": max(1, self.code.n_columns),
            "DLGMD_MARGIN": self.code.margin,
            "DLGMD_FACTOR": self.factor,
            "DLGMD_WINDOW_X": wide,
            "DLGMD_WINDOW_Y": high,
            "DLGMD_SEES": int(not outside(self.camera, self.small_wh)),
            "DLGMD_AHEAD_CDEG": round(100.0 * self.camera.ahead[1]),
            "DLGMD_STATE_BYTES": "(!DLGMD_EXPANSION ? "
            f"{plain} : DLGMD_DEFLICKER ? {even} : {expanding})",
        }

    def state_bytes(self, *, expands: bool, evens: bool, n_earlier: int = 1) -> int:
        """RAM: the size of `dlgmd_state` in bytes, with expansion and removal of flicker or not.

        The state keeps `n_earlier` frames to compare with, DLGMD_EARLIER in C.
        """
        first, each = self._bytes(expands=expands, evens=evens)
        return _whole(first + (n_earlier - 1) * each, self._alignment(expands=expands))

    def _alignment(self, *, expands: bool) -> int:
        """Alignment of the state, in bytes."""
        return 8 if expands and self.is_fixed else 4

    def _bytes(self, *, expands: bool, evens: bool) -> tuple[int, int]:
        """Bytes of the state without its last padding, and bytes per further frame kept."""
        radius, number = self.connections.radius_px, 2 if self.is_fixed else 4
        columns = max(1, self.code.n_columns) * (self.width + 2 * radius)
        work = number * (columns + 4 * (self.width + 3))
        scalars = 4 * (self.neuron.least_delay + 1) + 12
        if expands:
            scalars = _whole(scalars, 8) + 88 if self.is_fixed else scalars + 72
            work = max(
                work, 4 * (self.width // 4) * (self.height // 4), self._reduced_bytes(evens=evens)
            )
            # Data about the light of the frames: flicker and steps of the exposure.
            lit = _whole(1 + 3 * self.factor * self.width, 2)
            scalars += (4 * 7 + 2 * 4 * self.height + _whole(lit + 2 * 6 * self.height, 4)) * evens
        rows = self.connections.max_delay_frames * (self.height + radius) + 4 * radius + 1
        frames = self.n_cells + self.code.margin + rows * (self.width + self.code.margin)
        kept = self.n_cells + (4 + 4 * self.height * evens) * expands
        return scalars + _whole(work, 4) + frames, kept

    def _reduced_bytes(self, *, evens: bool) -> int:
        """Bytes for measuring the expansion: a window, the whole change, or blocks."""
        number = 2 if self.is_fixed else 4
        (width, height), (wide, high) = self.small_wh, self.window_wh
        fit = 6 * wide + 2 + number * (wide * high + width) + (wide + 2) * (high + 2) + 2 * width
        return max(fit, width * (height + 1), evens * (4 * (2 * 9 * 15 + 120) + width))

    @property
    def costs(self) -> dict[str, int]:
        """Memory in bytes, and operations of the kernels per frame.

        Flash holds the tables and the code. The size of the code is an estimate, for gcc -O2 on a
        Cortex-M4: a constant and a number of bytes per operation.
        """
        multiplications, additions = self.code.operations
        base, each, expanding = CODE_BYTES[self.is_fixed]
        base += expanding * self.expands
        return {
            "ram_bytes": self.state_bytes(expands=self.expands, evens=self.expands),
            "stack_bytes": STACK_BYTES,
            "flash_bytes": round(base + each * (multiplications + additions), -2),
            "multiplications": multiplications * self.n_cells,
            "additions": additions * self.n_cells,
        }

    def constants(self) -> dict[str, str]:
        """The constants in `dlgmd_model.h`, as C."""
        params, half = self.params, self.params.kappa * self.n_cells
        t_mp, kappa = float_literal(params.t_mp), float_literal(half)
        if self.is_fixed:
            t_mp = str(math.ceil(params.t_mp * 2**15))
            kappa = f"UINT64_C({max(1, round(half * 2**12))})"
        first = {"FIRST_VALID": str(self.neuron.first_valid_frame), "N_SP": f"{params.n_sp}u"}
        return {**first, "T_MP": t_mp, "KAPPA": kappa} | self._of_product() | self._of_expansion()

    def _of_expansion(self) -> dict[str, str]:
        """Constants of the expansion: limits and times."""
        most = math.floor(motion.MAX_SHIFT * self.width / SMALL_PX + 0.5)
        # Name -> value, and binary places of its integer in fixed point.
        values = {
            "USUAL_INTERVAL": (expansion.USUAL_S, 20),
            "USUAL_FPS": (1.0 / expansion.USUAL_S, 16),
            "SHARE_INTERVAL": (expansion.SHARE_S, 20),
            # Rate at which the weight of old measurements decays, 1/s.
            "AHEAD_RATE": (1.0 / expansion.TAU_S, 16),
            "BESIDE_RATE": (2.0 / expansion.TAU_S, 16),
            "BOTH_RATE": (1.0 / expansion.TAU_BOTH_S, 16),
            "MAX_RATE": (expansion.MAX_RATE, 24),
            "LEAST_RATE": (expansion.LEAST_RATE, 24),
            "LEAST_SHARE": (expansion.LEAST_SHARE, 24),
            "LEAST_SQUARE": (motion.LEAST_SQUARE, 20),
            "TTC_ALARM": (self.params.ttc_alarm, 12),
            "EXPANSION_ALARM": (self.params.expansion_alarm, 24),
            "APPROACH_ALARM": (1.0 / self.params.ttc_alarm, 24),
            "WEIGHT_SQUARE": (PARTS[0].weight, 16),
            "WEIGHT_NARROW": (PARTS[1].weight, 16),
            "WEIGHTS": (1.0, 16),
        }
        constants = {"MOST_BLOCKS": str(max(1, most))}
        constants |= {"FOCAL": f"INT64_C({round(2**16 * self.camera.focal(self.small_wh[0]))})"}
        constants |= {"LEAST_SHOWN": str(round(10 * LEAST_SHOWN))}
        angles = ((part.width_deg, part.height_deg, part.above_deg) for part in PARTS)
        constants |= {"PARTS": _braced((round(100 * deg) for deg in part) for part in angles)}
        # Without windows, DLGMD_SEES is 0, and the expansion is not compiled.
        windows = self.camera.windows(self.small_wh[::-1]) or [(0, 0, 0, 0)] * len(PARTS)
        constants |= {"WINDOWS": _braced(windows)}
        constants |= {"MIN_STEP_US": f"{MIN_STEP_US}u", "MAX_STEP_US": f"{MAX_STEP_US}u"}
        constants |= {"LEAST_US": f"{round(1e6 * expansion.LEAST_S)}u"}
        for name, (value, places) in values.items():
            constants[name] = (
                str(round(value * 2**places)) if self.is_fixed else float_literal(value)
            )
        return constants

    def _of_product(self) -> dict[str, str]:
        """Gain, threshold and upper bound of G; T_DE is the threshold per grey level of FFI."""
        params = self.params
        cells = RELEASED_CELLS if params.is_released else self.n_cells * params.m
        t_de = params.t0 / cells / N_LEVELS if params.ffi_gd else 0.0
        if not self.is_fixed:
            return {
                "T_DE": float_literal(t_de),
                "T_DE_MAX": float_literal(MAX_T_DE) if params.saturate else "FLT_MAX",
                "G_MAX": "1.0f" if params.saturate else "FLT_MAX",
                "GAIN": float_literal(params.gain),
            }
        unit = 2 ** (2 * (self.code.s_bits - self.code.s_shift))
        shift = min(max(0, 31 - math.floor(math.log2(t_de * unit))), 63) if t_de else 0
        return {
            "T_DE": f"UINT64_C({min(2**32 - 1, round(t_de * unit * 2**shift))})",
            "T_DE_SHIFT": str(shift),
            "T_DE_MAX": f"UINT32_C({math.ceil(MAX_T_DE * unit)})",
            "G_ONE": f"UINT32_C({unit})",
        }

    def model_header(self) -> str:
        """The text of `dlgmd_model.h`."""
        head = "/* Constants and sums of dlgmd.c. No other file includes this one. */\n"
        include = "" if self.is_fixed else "#include <float.h>\n\n"
        sums = functions(self.code, is_fixed=self.is_fixed)
        return f"{head}{include}{defines(self.constants())}\n\n{sums}"


def defines(values: Mapping[str, Value]) -> str:
    """Names and values as `#define` lines of C."""
    return "\n".join(f"#define {key} {value}" for key, value in values.items())


def _braced(rows: Iterable[Iterable[int]]) -> str:
    """Rows of integers as an array in C."""
    return "{" + ", ".join(f"{{{', '.join(map(str, row))}}}" for row in rows) + "}"


def _whole(n: int, unit: int) -> int:
    """The next multiple of `unit`."""
    return -(-n // unit) * unit


SOURCES = Path(__file__).parent / "c"

# Text of the README, by whether the expansion raises the alarm.
WITHOUT = {
    False: "- the expansion, unless `DLGMD_EXPANSION` is defined as 1\n",
    True: """
Bands of mains light and steps of the exposure are removed as in Python. With `DLGMD_DEFLICKER`
defined as 0, they are not, and the code is smaller.

`dlgmd_state` has a union of what different parts of a step use (MISRA C:2012, rule 19.2, advisory):
each member is written before it is read, within the same part.
""",
}
ACCURACY = {
    False: "`mp_abs` differs from Python's by at most 1e-5, `expansion` by at most 3e-4.",
    True: "Integers are rounded: in rendered flights `mp_abs` differs from Python's by at most "
    "0.03, and an\nalarm may start one frame earlier or later.",
}

# Fields of an answer that are compared with Python, named as in C.
_OF_EXPANSION = ("expansion", "ttc_s", "expansion_x", "expansion_y", "approach")
NUMBERS = ("mp", "mp_abs", "g_x", "g_y", *_OF_EXPANSION)

Frames = list[npt.NDArray[np.uint8]]


def looming(export: Export, approaches: Iterable[Frames]) -> tuple[Frames, list[Detection]]:
    """Frames of an approach up to contact, and Python's answers to these frames.

    The approach is the first that raises an alarm; if none does, the approach with the highest MP.
    """
    tried = []
    for frames in approaches:
        ahead = expansion.Expansion(camera=export.camera)
        alarm = Alarm(export.params, resize=False, repeats="keep", engine="opencv", expansion=ahead)
        answers = [alarm.step(frame) for frame in frames]
        if any(answer.alarm for answer in answers):
            return frames, answers
        tried.append((frames, answers))
    return max(tried, key=lambda pair: max(a.mp_abs for a in pair[1] if a.is_valid))


def files(export: Export, approaches: Iterable[Frames]) -> dict[str, bytes]:
    """The contents of all files, by name; the test vectors come from one of the `approaches`."""
    frames, answers = looming(export, approaches)
    texts = {**sources(export), "vectors.h": vectors(export, answers)}
    contents = {k: text.encode() for k, text in prefixed(texts, export.prefix).items()}
    return contents | {"frames.gray": b"".join(frame.tobytes() for frame in frames)}


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
        "fixed": str(int(export.is_fixed)),
        "arithmetic": "integers" if export.is_fixed else "single precision",
        "width": str(export.width),
        "height": str(export.height),
        "command": export.command,
        "fps": f"{export.fps:g}",
        "costs": "\n   ".join(lines),
        "list_of_costs": "\n".join(f"- {line}" for line in lines),
        "earlier": f"{two - one:,}",
        "accuracy": ACCURACY[export.is_fixed],
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
        "/* Half-saturation constant of mp_abs, as K. */\n"
        f"#define HALF {export.params.kappa * export.n_cells:.9g}\n\n"
        "static const struct expected {\n"
        "    bool valid, spike, alarm;\n"
        f"    double {', '.join(NUMBERS)};\n"
        "} expected[N_FRAMES] = {\n" + "".join(rows) + "};\n"
    )
