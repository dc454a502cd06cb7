"""The D-LGMD with ON and OFF pathways, as proposed in the last section of [Zhao2023]."""

import cv2
import numpy as np

from dlgmd_cli.models.base import AUTO, Flags, Grey, Photoreceptors, Response, aligned, centroid_of
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.engines import Images
from dlgmd_cli.models.engines.opencv import group, sum_4x4
from dlgmd_cli.parameters.presets import OnOffParameters


class OnOffDLGMD(DLGMD):
    """D-LGMD in which brightening and darkening cells do not inhibit each other.

    ::

        P_on(t) = max(L(t) - L(t-1), 0),  P_off(t) = max(L(t-1) - L(t), 0)
        S_on(t), S_off(t)  from P_on and P_off, each by [Zhao2023] Eqs. (2) to (7)
        S(t) = S_on(t) + S_off(t)

    Everything else is as in the D-LGMD: P = P_on + P_off, and G, its threshold and K follow from S
    and P by Eqs. (8) to (13).

    Parameters
    ----------
    params : OnOffParameters, optional
        The published defaults unless given.
    engine
        See `DLGMD`. The engine computes S_on and S_off; the grouping always uses OpenCV.
    """

    params_class = OnOffParameters
    params: OnOffParameters

    def __init__(self, params: OnOffParameters | None = None, engine: str = AUTO) -> None:
        super().__init__(params, engine)
        self._pathways = [Pathway(self.first_valid_frame, is_on) for is_on in (True, False)]

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        for pathway in self._pathways:
            pathway.reset()

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells, see `Model.ignore`."""
        super().ignore(hidden)
        for pathway in self._pathways:
            pathway.hide(hidden)

    def _take(self, luminance: Grey) -> None:
        super()._take(luminance)
        for pathway in self._pathways:
            pathway.take(luminance)

    def _prepare(self, luminance: Grey) -> None:
        super()._prepare(luminance)
        self._images = [aligned(luminance.shape) for _ in range(4)]

    def _respond(self, images: Images | None) -> Response:
        s, g = images or self._images[:2]
        s_off, around = self._images[2:]
        for pathway, s_of_it in zip(self._pathways, (s, s_off), strict=True):
            self._engine.respond(pathway, None, (s_of_it, around))
        cv2.add(s, s_off, dst=s)
        grouping = self.grouping()
        sum_4x4(s, out=around)
        group(s, around, grouping, g)
        p_sum, ffi = (self.receptors.p_sum(delay) for delay in (0, self.least_delay))
        g_x, g_y = centroid_of(g)
        s_sum, mp = cv2.sumElems(s)[0], cv2.sumElems(g)[0]
        return Response(p_sum, s_sum, mp, ffi, grouping.t_de, g_x=g_x, g_y=g_y)


class Pathway(Photoreceptors):
    """The part of each P that brightened (ON) or darkened (OFF)."""

    def __init__(self, depth: int, is_on: bool) -> None:
        self._is_on = is_on
        super().__init__(depth)

    def _compute_p(self, out: Grey) -> float:
        """Write P_on or P_off of the newest frame to `out`; returns its sum."""
        pair = (self.current, self.previous) if self._is_on else (self.previous, self.current)
        cv2.subtract(*pair, dst=out)  # saturates at 0 for uint8
        if out.dtype == np.float32:
            cv2.threshold(out, 0.0, 0.0, cv2.THRESH_TOZERO, dst=out)
        return float(cv2.sumElems(out)[0])
