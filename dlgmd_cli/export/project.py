"""A model as C: its constants, sums and tables, and its costs per frame."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.export.sums import CHANGE_BITS, LEVELS, Code, fixed_code, float_code, functions
from dlgmd_cli.export.sums import float_literal as f
from dlgmd_cli.models.contrast import (
    MAX_QUARTILE_CELLS,
    NOMINAL_FPS,
    centre_weights,
    quadrants,
)
from dlgmd_cli.models.dlgmd import MAX_T_DE, RELEASED_CELLS
from dlgmd_cli.models.engines import BLOCK
from dlgmd_cli.models.expansion import LEAST_RATE, LOCAL_SHARE, MAX_RATE, factor_of
from dlgmd_cli.models.kernels import Connections, connect
from dlgmd_cli.parameters.presets import ContrastParameters, DlgmdParameters

# With at most this many cells, the sum of their squares (up to 128**2) fits 32 bits. The stimulus
# of the test needs 16 px.
MIN_SIDE_PX, MAX_SIDE_PX, MAX_CELLS = 16, 1024, 2**18 - 1
MAX_GROWTH = 4096.0
# Longer intervals between frames count as this.
MAX_STEP_MS = 1000
# exp(-x) is 0 for an x of this.
MAX_FALL = 50.0
# Bytes of stack, an upper bound. Bytes of code, approximately, by whether the model is the
# contrast-relative one and whether it is fixed: a constant, and per operation of a cell. The tests
# measure both.
STACK_BYTES = 1400
CODE_BYTES = {
    (False, False): (1200, 10),
    (False, True): (1370, 7),
    (True, False): (1720, 14),
    (True, True): (2620, 8),
}
# Bytes of code that follow the picture, compare quadrants and adapt.
FOLLOWING_BYTES = 2250
# Bytes of code that measure the expansion, by whether it is fixed.
EXPANDING_BYTES = {False: 3200, True: 4800}


@dataclass(frozen=True)
class Export:
    """A model for frames of one size, in floating or in fixed point.

    `fps` is the rate that it is made for, and `command` what chooses it on the command line.

    Raises ParameterError if there is no C of that model, size and arithmetic.
    """

    params: Any
    width: int
    height: int
    is_fixed: bool = False
    label: str = "D-LGMD"
    fps: float = NOMINAL_FPS
    command: str = ""

    def __post_init__(self) -> None:
        if type(self.params) not in (DlgmdParameters, ContrastParameters):
            why = f"there is no C version of the model {self.params.model}"
            raise ParameterError("", why, "Only dlgmd and dlgmd-contrast can be exported.")
        low, high = sorted((self.width, self.height))
        if low < MIN_SIDE_PX or high > MAX_SIDE_PX or self.n_cells > MAX_CELLS:
            raise ParameterError(
                "Invalid value for '--size'",
                f"{self.width}x{self.height} is out of range",
                f"Choose sides of {MIN_SIDE_PX} to {MAX_SIDE_PX} px and at most {MAX_CELLS} cells.",
            )
        if self.is_fixed and not self.is_contrast and not self.params.saturate:
            why = "G has no upper bound without saturation, and integers need one"
            raise ParameterError("--fixed", why, "Add --param saturate=true.")

    @property
    def n_cells(self) -> int:
        """Cells of a frame."""
        return self.width * self.height

    @property
    def is_contrast(self) -> bool:
        """Whether it is the contrast-relative model."""
        return isinstance(self.params, ContrastParameters)

    @property
    def shift(self) -> int:
        """The largest shift of the picture that is undone; 0 if it is less than a block."""
        return self.params.shift if self.is_contrast and self.params.shift >= BLOCK else 0

    @property
    def is_timed(self) -> bool:
        """Whether its answers depend on the times of frames."""
        return self.is_contrast and (self.params.w_fps > 0.0 or self.adapts or self.expands)

    @property
    def adapts(self) -> bool:
        """Whether K is compared with its own past."""
        return self.is_contrast and self.params.c_m > 0.0

    @property
    def expands(self) -> bool:
        """Whether K grows with the expansion of the picture."""
        return self.shift > 0 and self.params.d_0 > 0.0

    @cached_property
    def connections(self) -> Connections:
        """The kernels."""
        return connect(self.params)

    @property
    def ffi_delay(self) -> int:
        """How many frames back FFI(t) looks, Eq. (12)."""
        return 2 if self.params.formulation == "released" else 1

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame with an answer."""
        return 1 + max(self.connections.max_delay_frames, self.ffi_delay)

    @cached_property
    def code(self) -> Code:
        """The sums. Where the model takes luminance, their weights convert grey levels to it."""
        if not self.is_fixed:
            return float_code(self.connections, 1.0 if self.is_contrast else 1.0 / LEVELS)
        if self.is_contrast:
            return fixed_code(self.connections, 1.0, CHANGE_BITS, math.inf)
        # G = k S Ce is the product of S √k and Ce √k.
        gain = math.sqrt(self.params.k)
        kernels = self.connections.signed().values()
        s_max = gain * sum(float(np.maximum(kernel, 0.0).sum()) for kernel in kernels)
        return fixed_code(self.connections, gain / LEVELS, 0, s_max)

    @property
    def sizes(self) -> dict[str, int]:
        """The definitions in `dlgmd.h`; its `#if`s and those of the other sources test them."""
        return {
            "DLGMD_WIDTH": self.width,
            "DLGMD_HEIGHT": self.height,
            "DLGMD_FPS": round(self.fps),
            "DLGMD_CONTRAST": int(self.is_contrast),
            "DLGMD_FIXED": int(self.is_fixed),
            "DLGMD_SHIFT": self.shift,
            "DLGMD_BALANCE": int(self.is_contrast and self.params.balance),
            "DLGMD_ADAPTS": int(self.adapts),
            "DLGMD_EXPANDS": int(self.expands),
            "DLGMD_RADIUS": self.connections.radius_px,
            "DLGMD_MAX_DELAY": self.connections.max_delay_frames,
            "DLGMD_FFI_DELAY": self.ffi_delay,
            "DLGMD_COLUMNS": max(1, self.code.n_columns),
            "DLGMD_MARGIN": self.code.margin,
            "DLGMD_STATE_BYTES": self.state_bytes,
        }

    @property
    def state_bytes(self) -> int:
        """RAM: the size of `dlgmd_state` in bytes."""
        radius, delays = self.connections.radius_px, self.connections.max_delay_frames + 1
        number = 2 if self.is_fixed else 4
        columns = number * max(1, self.code.n_columns) * (self.width + 2 * radius)
        if self.is_contrast:
            blocks = 2 * 2 * (self.width // 4) * (self.height // 4) if self.shift else 0
            work = max(
                _whole(columns, 4) + 4 * self.width, 2 * 4 * 256, blocks, self._reduced_bytes
            )
            work += number * 256 * delays
            scalars = (16 if self.is_fixed else 12) + 8 + 12
            scalars += (8 if self.is_fixed else 4) * (self.adapts + 2 * self.expands)
            scalars += 8 * (self.shift > 0)
        else:
            work = _whole(columns + number * 4 * (self.width + 3), number)
            scalars = 4 * (self.ffi_delay + 1) + 12
        rows = (delays - 1) * (self.height + radius) + 4 * radius + 1
        frames = self.n_cells + self.code.margin + rows * (self.width + self.code.margin)
        alignment = 8 if self.is_fixed and self.is_contrast else 4
        return _whole(scalars + work + frames, alignment)

    @property
    def _reduced_bytes(self) -> int:
        """Of what the expansion is measured with: a window, or the change of the whole picture."""
        if not self.expands:
            return 0
        factor, number = factor_of(self.width), 2 if self.is_fixed else 4
        width, height = self.width // factor, self.height // factor
        window = (min(width, height) // 2 + 1) // 2 * 2 + 1
        fit = 6 * window + 2 + number * (window**2 + width) + (window + 2) ** 2 + 2 * width
        return _whole(max(fit, width * (height + 1)), 4)

    @property
    def costs(self) -> dict[str, int]:
        """Memory in bytes, and operations of the kernels per frame.

        Flash holds the tables and the code. The size of the code is an estimate, for gcc -O2 on a
        Cortex-M4: a constant and a number of bytes per operation.
        """
        multiplications, additions = self.code.operations
        base, each = CODE_BYTES[self.is_contrast, self.is_fixed]
        base += FOLLOWING_BYTES * (self.shift > 0) + EXPANDING_BYTES[self.is_fixed] * self.expands
        tables = (2 if self.is_fixed else 4) * (self.width + self.height) * self.is_contrast
        return {
            "ram_bytes": self.state_bytes,
            "stack_bytes": STACK_BYTES,
            "flash_bytes": round(tables + base + each * (multiplications + additions), -2),
            "multiplications": multiplications * self.n_cells,
            "additions": additions * self.n_cells,
        }

    def constants(self) -> dict[str, str]:
        """The constants in `dlgmd_model.h`, as C."""
        params = self.params
        common = {"FIRST_VALID": str(self.first_valid_frame), "N_SP": f"{params.n_sp}u"}
        half = params.kappa * self.n_cells
        if self.is_fixed:
            common["T_MP"] = str(math.ceil(params.t_mp * 2**15))
            scale = 2**32 / self.n_cells if self.is_contrast else 2**12
            common["KAPPA"] = f"UINT64_C({max(1, round(half * scale))})"
        else:
            common |= {"T_MP": f(params.t_mp), "KAPPA": f(half)}
        return common | (self._of_contrast() if self.is_contrast else self._of_product())

    def _of_contrast(self) -> dict[str, str]:
        """The thresholds in grey levels, and the cells that the lower quartile is taken of."""
        params = self.params
        step = max(1, math.isqrt(self.n_cells // MAX_QUARTILE_CELLS))
        n_looked_at = -(-self.width // step) * -(-self.height // step)
        values = {
            "C_P": params.c_p,
            "C_N": params.c_n,
            "P_MIN": params.p_min * LEVELS,
            "C_S": params.c_s,
            "S_MIN": params.s_min * LEVELS,
            "C_M": params.c_m,
        }
        interval_s = 1.0 / (params.w_fps or NOMINAL_FPS)
        of_quadrant = quadrants(centre_weights((self.height, self.width), params.sigma_c))[0]
        both = self.n_cells / 2.0 / of_quadrant
        # Of means: how fast the weight of what is old falls, per frame at the usual rate.
        weights = {"SIGMA_RATE": params.w_sigma, "USUAL_RATE": params.w_m}
        per_frame = {
            key: -math.log1p(-weight) if weight < 1.0 else MAX_FALL
            for key, weight in weights.items()
        }
        # The same per second.
        times_s = {"MEAN_RATE": params.tau_m, "AHEAD_RATE": params.tau_d}
        times_s["BESIDE_RATE"] = params.tau_d / 2.0
        per_second = {key: min(1.0 / time_s, 1e3 * MAX_FALL) for key, time_s in times_s.items()}
        rates = {"MAX_RATE": MAX_RATE, "LEAST_RATE": LEAST_RATE, "TIME_LEFT": LOCAL_SHARE}
        expansion = 1.0 / params.d_0 if self.expands else 0.0
        if self.is_fixed:
            constants = {key: f"{round(value * 2**16)}u" for key, value in values.items()}
            constants |= {key: f"{round(value * 2**24)}u" for key, value in per_frame.items()}
            constants |= {key: f"{round(value * 2**16)}u" for key, value in per_second.items()}
            constants["USUAL_INTERVAL"] = f"{round(interval_s * 2**20)}u"
            constants["USUAL_FPS"] = f"{round(params.w_fps * 2**16)}u"
            constants["BOTH"] = str(round(both * 2**15))
            constants["GROWTH"] = f"{round(min(params.growth, MAX_GROWTH) * 2**14)}u"
            constants["S_BITS"] = str(self.code.s_bits)
            constants["EXPANSION"] = f"INT64_C({round(expansion * 2**10)})"
            constants |= {key: f"INT64_C({round(rate * 2**24)})" for key, rate in rates.items()}
            constants["TIME_LEFT"] = f"INT64_C({round(rates['TIME_LEFT'] * 2**36)})"
            constants["K_0"] = f"UINT64_C({round(params.k_0 * 2**32)})"
        else:
            values |= {**per_frame, **per_second, **rates, "GROWTH": params.growth, "BOTH": both}
            values |= {"EXPANSION": expansion, "K_0": params.k_0 * self.n_cells}
            values |= {"USUAL_INTERVAL": interval_s, "USUAL_FPS": params.w_fps}
            constants = {key: f(value) for key, value in values.items()}
        constants["MAX_STEP_MS"] = f"{MAX_STEP_MS}u"
        return constants | {"QUARTILE_STEP": str(step), "QUARTILE_CELLS": str(n_looked_at)}

    def _of_product(self) -> dict[str, str]:
        """Gain, threshold and upper bound of G; T_DE is the threshold per grey level of FFI."""
        params = self.params
        cells = RELEASED_CELLS if params.formulation == "released" else self.n_cells * params.m
        t_de = params.t0 / cells / LEVELS if params.ffi_gd else 0.0
        if not self.is_fixed:
            return {
                "T_DE": f(t_de),
                "T_DE_MAX": f(MAX_T_DE) if params.saturate else "FLT_MAX",
                "G_MAX": "1.0f" if params.saturate else "FLT_MAX",
                "GAIN": f(params.k),
            }
        one = 2 ** (2 * (self.code.s_bits - self.code.s_shift))
        shift = max(0, 31 - math.floor(math.log2(t_de * one))) if t_de else 0
        shift = min(shift, 63)
        return {
            "T_DE": f"UINT64_C({min(2**32 - 1, round(t_de * one * 2**shift))})",
            "T_DE_SHIFT": str(shift),
            "T_DE_MAX": f"UINT32_C({math.ceil(MAX_T_DE * one)})",
            "G_ONE": f"UINT32_C({one})",
        }

    def tables(self) -> str:
        """Weights of the columns and of the rows; the weight of a cell is their product."""
        profiles = centre_weights((self.height, self.width), self.params.sigma_c)
        weights = np.outer(*profiles).astype(float)
        text = ""
        for name, profile in (("x", weights.mean(axis=0)), ("y", weights.mean(axis=1))):
            if self.is_fixed:
                # They add up to the greatest number of 16 bits, so that ΣG fits 32 bits.
                ends = np.round(np.cumsum(profile) / profile.sum() * (2**16 - 1))
                values = [str(int(value)) for value in np.diff(ends, prepend=0.0)]
            else:
                values = [f(value) for value in profile]
            kind = "uint16_t" if self.is_fixed else "float"
            rows = [", ".join(values[i : i + 8]) for i in range(0, len(values), 8)]
            inside = ",\n    ".join(rows)
            text += f"static const {kind} weights_{name}[{len(values)}] = {{\n    {inside}}};\n"
        return text

    def model_header(self) -> str:
        """The text of `dlgmd_model.h`."""
        parts = ["/* Constants and sums of dlgmd.c. No other file includes this one. */"]
        if not self.is_fixed:
            parts.append("#include <float.h>\n")
        parts.append(defines(self.constants()) + "\n")
        if self.is_contrast:
            parts.append(self.tables())
        parts.append(functions(self.code, is_fixed=self.is_fixed, is_contrast=self.is_contrast))
        return "\n".join(parts)


def defines(values: Mapping[str, object]) -> str:
    """Names and values as C defines them."""
    return "\n".join(f"#define {key} {value}" for key, value in values.items())


def _whole(n: int, unit: int) -> int:
    """The next multiple of `unit`."""
    return -(-n // unit) * unit
