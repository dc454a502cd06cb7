"""What hypothesis draws for more than one test module."""

import math

from hypothesis import assume
from hypothesis import strategies as st
from reference import slow


@st.composite
def connections(draw, *, sigmas, max_r, max_a, longest=math.inf):
    """What kernels follow from, by key, as far as the latency in frames allows."""
    values = {
        "alpha": draw(st.floats(-0.5, 5.0)),
        "beta": draw(st.floats(0.0, 3.0)),
        "lam": draw(st.floats(0.0, 2.0)),
        "sigma_e": draw(st.floats(*sigmas)),
        "sigma_i": draw(st.floats(*sigmas)),
        "r": draw(st.integers(1, max_r)),
        "a": draw(st.floats(0.0, max_a)),
        "formulation": draw(st.sampled_from(slow.FORMULATIONS)),
    }
    r, alpha, beta, lam = (values[key] for key in ("r", "alpha", "beta", "lam"))
    assume(slow.latency(0, 0, alpha, beta, lam) >= 0.0)
    assume(beta + math.exp(-lam * lam * 2 * r * r) > 0.02)
    assume(slow.latency(r, r, alpha, beta, lam) <= longest)
    return values
