"""What hypothesis draws for more than one test module."""

import math

from hypothesis import assume
from hypothesis import strategies as st
from reference import slow

from dlgmd_cli.params import DlgmdParameters


@st.composite
def dlgmd_parameters(draw):
    """Connections from all over the ranges, as far as their latency allows."""
    values = {
        "alpha": draw(st.floats(-0.5, 5.0)),
        "beta": draw(st.floats(0.0, 3.0)),
        "lam": draw(st.floats(0.0, 2.0)),
        "sigma_e": draw(st.floats(0.02, 100.0)),
        "sigma_i": draw(st.floats(0.02, 100.0)),
        "r": draw(st.integers(1, 8)),
        "a": draw(st.floats(0.0, 10.0)),
        "formulation": draw(st.sampled_from(slow.FORMULATIONS)),
    }
    assume(slow.latency(0, 0, *(values[key] for key in ("alpha", "beta", "lam"))) >= 0.0)
    assume(values["beta"] + math.exp(-(values["lam"] ** 2) * 2 * values["r"] ** 2) > 0.02)
    return DlgmdParameters(**values)
