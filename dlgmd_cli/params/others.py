"""The parameters of the models that the D-LGMD is compared with."""

from dataclasses import dataclass
from typing import ClassVar

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.params.base import Parameters, key, n_sp_key, t_mp_key


@dataclass(frozen=True)
class LgmdParameters(Parameters):
    """Parameters of the LGMD of [Zhao2018], as published in its authors' released code."""

    model: ClassVar[str] = "lgmd"
    preset: ClassVar[str] = "lgmd"
    source: ClassVar[str] = "LGMD; Zhao et al., 2018, after Yue and Rind, 2006"
    # Its own normalisation is 1 / (1 + exp(-K / n_cell)), from 1/2 at rest.
    kappa = None

    p1: float = key(0.0, "p_1", "–", "persistence of change after one frame", low=-1, high=1)
    p2: float = key(0.0, "p_2", "–", "persistence of change after two frames", low=-1, high=1)
    w_i: float = key(0.3, "W_I", "–", "strength of inhibition", low=0, high=100)
    delta_c: float = key(
        0.01, "Δ_C", "grey levels", "least of the scale of grouping", low=1e-6, high=255
    )
    c_omega: float = key(
        4.0, "C_ω", "–", "share of the greatest Ce that scales grouping", low=0.001, high=1000
    )
    c_de: float = key(0.15, "C_de", "–", "decay coefficient of G", low=1e-6, high=100)
    t_de: float = key(15.0, "T_de", "grey levels", "threshold of decayed G", low=0, high=1e6)
    t_ffi: float = key(
        25.0, "T_FFI", "grey levels", "feed-forward inhibition that switches off", low=0, high=255
    )
    t_mp: float = t_mp_key(0.999)
    n_sp: int = n_sp_key()

    def _check_together(self) -> None:
        """What persists must die away."""
        if self.p2 >= 1.0 - abs(self.p1) or self.p2 <= -1.0:
            raise ParameterError(
                "",
                f"p1 = {self.p1:g} with p2 = {self.p2:g} makes every change grow for ever",
                "Bring them nearer to 0.",
            )


@dataclass(frozen=True)
class EmdLgmdParameters(Parameters):
    """Parameters of the LGMD on elementary motion detectors, after [Bermudez2007]."""

    model: ClassVar[str] = "emd-lgmd"
    preset: ClassVar[str] = "emd-lgmd"
    source: ClassVar[str] = "EMD-LGMD; after Bermudez i Badia, Pyk and Verschure, 2007"

    tau_high: float = key(
        8.0, "τ_h", "frames", "time constant of the high-pass", low=0.01, high=1000
    )
    tau_low: float = key(2.0, "τ_l", "frames", "time constant of the delay", low=0.01, high=1000)
    delta: float = key(0.02, "δ", "–", "expansion that a frame predicts", low=0, high=1)
    f_active: float = key(0.05, "F_a", "luminance", "change that makes a cell count", low=0, high=1)
    c: float = key(2.0, "c", "–", "strength of feed-forward inhibition", low=0, high=100)
    t_mp: float = t_mp_key(0.4)
    n_sp: int = n_sp_key()
    kappa: float = key(
        0.0013, "κ", "luminance²", "mean excitation at which mp_abs is 1/2", low=1e-12, high=100
    )
