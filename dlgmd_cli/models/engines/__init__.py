"""The two engines that compute the summation and the grouping layer from the latest P."""

import math
from importlib import import_module
from typing import NamedTuple, Protocol

import numpy as np

from dlgmd_cli.errors import NOT_INSTALLED, MissingExtraError, argument, warn
from dlgmd_cli.models.base import AUTO, Flags, FloatImage
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.models.receptors import Pathway
from dlgmd_cli.parameters.checks import require_known
from dlgmd_cli.parameters.presets import ENGINES

# Below this many pixels, loading Numba takes longer than it saves over a few hundred frames.
WORTH_COMPILING_PX = 500_000


class Grouping(NamedTuple):
    """Gain k, threshold T_de and saturation of the grouping layer, Eqs. (9) and (10)."""

    gain: float
    t_de: float
    cap: float


class Sums(NamedTuple):
    """ΣS and ΣG of a frame, and the `first_moments` of G."""

    s: float
    g: float
    moments: tuple[float, float]


class Engine(Protocol):
    """Computes the layers for one set of connections and frames of one size and type."""

    def respond(
        self,
        p: Pathway,
        hidden: Flags | None,
        grouping: Grouping | None,
        s_out: FloatImage | None = None,
        g_out: FloatImage | None = None,
    ) -> Sums:
        """The sums of the newest frame, in luminance; S and G are written to the images, (H, W).

        S(t) = max(Σ_d P(t-d) ∗ K_d, 0), Eqs. (2), (3), (6), (7)
        G(t) = S · Ce where S · Ce ≥ T_de, saturated, Eqs. (8) to (10); without a `grouping`, G is
               not computed and its sums are 0

        S is 0 where `hidden`, (H, W), is True.
        """
        ...


def choose_engine(name: str, n_cells: int = 0) -> str:
    """Resolve `auto` to the best engine for `n_cells` = H · W; other names are returned unchanged.

    Raises ParameterError if there is no such engine, and MissingExtraError if its package is not
    installed. Warns if Numba would be best but cannot be loaded.
    """
    require_known("engine", name, (*ENGINES, AUTO))
    if name == "opencv" or (name == AUTO and n_cells < WORTH_COMPILING_PX):
        return "opencv"
    fault = _fault_of_numba()
    if fault is None:
        return "numba"
    if name == "numba":
        other = f"use {argument('engine', 'opencv')}"
        raise MissingExtraError.of(argument("engine", "numba"), "numba", fault, other)
    if fault != NOT_INSTALLED:
        warn(f"the package 'numba' {fault}; the engine is opencv")
    return "opencv"


def create_engine(
    name: str, connections: Connections, shape: tuple[int, ...], unit: float
) -> Engine:
    """An engine, imported on first use, for frames of `shape`, (H, W), whose P is in `unit`."""
    kind = getattr(import_module(f"{__name__}.{name}"), f"{name.title()}Engine")
    engine: Engine = kind(connections, shape, unit)
    return engine


def _fault_of_numba() -> str | None:
    """Why Numba cannot be used, or None."""
    try:
        import_module("numba")
    except Exception as error:  # for example, it refuses a NumPy that is too new
        if isinstance(error, ModuleNotFoundError) and error.name == "numba":
            return NOT_INSTALLED
        return f"cannot be loaded ({str(error) or type(error).__name__})"
    return None


def just_below(threshold: float) -> float:
    """The largest float32 b below `threshold`: for a float32 x, x > b means x ≥ `threshold`."""
    nearest = np.float32(threshold)
    if float(nearest) >= threshold:  # as float64: NumPy would round the threshold first
        nearest = np.nextafter(nearest, np.float32(-math.inf))
    return float(nearest)
