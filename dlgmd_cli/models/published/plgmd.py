"""The probabilistic LGMD, Hong et al. 2024."""

import math

import cv2
import numpy as np
import numpy.typing as npt

import dlgmd_cli
from dlgmd_cli.models.base import Answer, FloatImage
from dlgmd_cli.models.published import parts

# Values that differ between the codes.
_P1 = {"authors": 0.5, "benchmark": 1 / (1 + math.e)}
_P2 = {"authors": 0.5, "benchmark": 1 / (1 + math.e**2)}
_T_S = {"authors": 100.0, "benchmark": 30.0}


class PLGMDParameters(dlgmd_cli.Parameters):
    """Parameters of `PLGMD`."""

    source = "Hong et al., Biomimetics 9(3), 2024"
    rest = 0.5

    formulation: str = parts.whose_code()
    seed: int = dlgmd_cli.key(0, "–", "–", "seed of the random numbers", 0, 2**31 - 1)
    p: float = dlgmd_cli.key(0.8, "p", "–", "probability that a synapse transmits", 0, 1)
    w_i: float = dlgmd_cli.key(0.3, "W_I", "–", "strength of inhibition", 0, 100)
    p1: float = dlgmd_cli.key(_P1, "p_1", "–", "persistence of change after one frame", 0, 0.5)
    p2: float = dlgmd_cli.key(_P2, "p_2", "–", "persistence of change after two frames", 0, 0.5)
    c_omega: float = dlgmd_cli.key(4.0, "C_ω", "–", "divisor of max|Ce| in ω", 0.001, 1000)
    t_s: float = dlgmd_cli.key(_T_S, "T_s", "grey levels", "threshold of G", 0, 1e6)
    t_mp: float = parts.threshold_2019()
    n_sp: int = parts.spikes_2019()


class PLGMD(dlgmd_cli.Model):
    """The probabilistic LGMD of [Hong2024]: each synapse transmits with probability p.

    With grey levels L, zero outside the frame, and masks B that are new in each frame, each cell
    1 with probability p, else 0::

        P(t) = L(t) - L(t-1) + p1 P(t-1) + p2 P(t-2)
        E = P(t) B B,  I = B Σ w B P(t-1), a mask for each of the 8 neighbours with `NEIGHBOURS` w
        S = E - w_i I,  G = S Ce / ω as in `LGMD2006`, 0 where G < t_s
        k = mean |G B|;  MP = 1 / (1 + exp(-k))

    The two masks of E are drawn as one of p². This is the authors' code (fuqinbing/pLGMD): p1 =
    p2 = 1 / (1 + exp(0)), t_s = 15 / 0.15, and P(t) is 0 before the third frame. As p1 + p2 = 1,
    two thirds of each change in P never decay, so that the response goes on after an object has
    moved: on the benchmark's receding squares, MP goes to 1 and stays there.

    The benchmark (MingshuoXu/BiSTS, `pLGMD`) has p1 = 1 / (1 + e), p2 = 1 / (1 + e²) and t_s = 30,
    and P from the second frame on: its changes decay. A run is repeated exactly by its seed;
    another seed is another run.
    """

    params_class = PLGMDParameters
    layer_units = ("grey levels", "grey levels", "grey levels")
    columns = ("k",)
    first_valid_frame = 0

    def reset(self) -> None:
        """Forget all earlier frames, and start the random numbers again."""
        super().reset()
        self._random = np.random.Generator(np.random.SFC64(self.params.seed))

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        params, receptors = self.params, self.receptors
        p = receptors.level_change()
        if receptors.frame == 0:
            self._p = [p, p]
        last, before = self._p
        if receptors.frame == 1 and params.formulation == "authors":
            p[:] = 0.0
        p = parts.added(parts.added(p, params.p1, last), params.p2, before)
        self._p = [p, last]
        if receptors.frame < 2:  # no P(t-1) yet
            return p, 0 * p, 0 * p, {"mp": 0.5}
        s = p * self.mask(params.p**2, p.shape)
        inhibited = parts.added(s, -params.w_i, self._inhibition(last))
        cv2.copyTo(inhibited, self.mask(params.p, p.shape), s)
        receptors.clear(s)
        g = parts.grouped(s, params.t_s, params.c_omega) * self.mask(params.p, p.shape)
        k = cv2.norm(g, cv2.NORM_L1) / self.n_cells
        return p, s, g, {"mp": parts.sigmoid(k), "more": {"k": k}}

    def mask(self, p: float, shape: tuple[int, ...]) -> npt.NDArray[np.uint8]:
        """A new mask, 1 with probability p to 16 bits, else 0."""
        n_cells = math.prod(shape)
        words = self._random.integers(0, 2**64, -(-n_cells // 4), np.uint64)
        numbers = words.view(np.uint16)[:n_cells].reshape(shape)
        return np.less(numbers, round(p * 2**16)).view(np.uint8)

    def _inhibition(self, p: FloatImage) -> FloatImage:
        """Σ w B P over the 8 neighbours of each cell."""
        wide = cv2.copyMakeBorder(p, 1, 1, 1, 1, parts.ZERO)
        sums = {weight: np.zeros_like(p) for weight in (0.25, 0.125)}
        for (row, column), weight in np.ndenumerate(parts.NEIGHBOURS):
            if weight:
                part = wide[row : row + p.shape[0], column : column + p.shape[1]]
                total = sums[float(weight)]
                cv2.add(total, part, dst=total, mask=self.mask(self.params.p, p.shape))
        return np.asarray(cv2.addWeighted(sums[0.25], 0.25, sums[0.125], 0.125, 0.0), np.float32)
