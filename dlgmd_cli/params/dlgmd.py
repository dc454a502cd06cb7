"""The parameters of the D-LGMD."""

import math
from dataclasses import dataclass
from typing import ClassVar

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.params.base import Parameters, key, n_sp_key, t_mp_key

FORMULATIONS = ("default", "released", "equations")
MAX_LATENCY_FRAMES = 64.0


@dataclass(frozen=True)
class DlgmdParameters(Parameters):
    """Parameters of the D-LGMD; the defaults are set 9 of [Zhao2023], Tables I and II."""

    model: ClassVar[str] = "dlgmd"
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "Zhao et al., IEEE TNNLS 34(5), 2023"

    alpha: float = key(-0.1, "α", "frames", "shift of the latency, Eq. (5)", low=-10, high=64)
    beta: float = key(0.5, "β", "1/frames", "saturation of the latency, Eq. (5)", low=0, high=100)
    lam: float = key(0.7, "λ", "1/px", "spread of the latency, Eq. (5)", low=0, high=10)
    sigma_e: float = key(1.5, "σ_E", "px", "width of excitation, Eq. (4)", low=0.01, high=100)
    sigma_i: float = key(5.0, "σ_I", "px", "width of inhibition, Eq. (4)", low=0.01, high=100)
    r: int = key(6, "r", "px", "radius of the kernels", low=1, high=32)
    a: float = key(1.5, "a", "–", "strength of inhibition, Eq. (7)", low=0, high=100)
    k: float = key(1.0, "k", "–", "gain of the grouping, Eq. (9)", low=1e-12, high=100)
    ffi_gd: bool = key(True, "FFI-GD", "–", "threshold G by feed-forward inhibition, Eq. (10)")
    t0: float = key(0.5, "T_0", "–", "base of that threshold, Eq. (11)", low=0, high=100)
    m: float = key(0.4, "m", "–", "luminance change that T_0 is for, Eq. (11)", low=0.001, high=100)
    t_mp: float = t_mp_key(0.4)
    n_sp: int = n_sp_key()
    kappa: float = key(
        0.0035, "κ", "–", "mean excitation at which mp_abs is 1/2", low=1e-9, high=100
    )
    formulation: str = key(
        "default", "–", "–", "how latency meets whole frames", choices=FORMULATIONS
    )

    def _check_together(self) -> None:
        """Latency must be causal everywhere, and history short enough to keep."""
        nearest = self.alpha + 1.0 / (self.beta + 1.0)
        if nearest < 0.0:
            raise ParameterError(
                "",
                f"alpha = {self.alpha:g} with beta = {self.beta:g} makes the latency negative "
                f"({nearest:.3g} frames at the centre)",
                "Inhibition cannot come before its cause; raise alpha.",
            )
        if self.alpha > MAX_LATENCY_FRAMES - 1.0 / (self.beta + 1.0):
            raise ParameterError(
                "",
                f"alpha = {self.alpha:g} makes the latency longer than {MAX_LATENCY_FRAMES:g} "
                "frames everywhere",
                "Lower alpha.",
            )
        reach = self.beta + math.exp(-(self.lam**2) * 2 * self.r**2)
        if reach <= 0.0 or self.alpha + 1.0 / reach > MAX_LATENCY_FRAMES:
            raise ParameterError(
                "",
                f"beta = {self.beta:g} with lam = {self.lam:g} and r = {self.r} makes the latency "
                f"longer than {MAX_LATENCY_FRAMES:g} frames",
                "Raise beta or lower lam.",
            )
