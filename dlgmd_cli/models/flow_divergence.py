"""Divergence of optical flow: a simple looming detector, as a baseline."""

from typing import Any

import cv2
import numpy as np

from dlgmd_cli.models.base import (
    Grey,
    Layers,
    Model,
    Response,
    centroid_of,
)
from dlgmd_cli.parameters.presets import DEFAULT_MODEL_FPS, FlowDivergenceParameters


class FlowDivergence(Model):
    """Mean divergence of dense optical flow over the frame.

    The flow (u, v) from the previous frame, in px, is OpenCV's DIS (Kroeger et al. 2016) with its
    preset `fast`. For a frontal surface that approaches, the mean of ∂u/∂x + ∂v/∂y is two over the
    time to contact. K is the positive part of the sum over the cells, per second; frames without
    times count as 30 per second.

    Parameters
    ----------
    params : FlowDivergenceParameters, optional
        They affect only spikes and alarms.
    engine : str
        Not used; accepted by all models.
    """

    params_class = FlowDivergenceParameters
    layer_units = ("luminance", "px/frame", "1/frame")

    def __init__(self, params: FlowDivergenceParameters | None = None, **_: Any) -> None:
        super().__init__(params)
        self._flow: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
        self._time_s: float | None = None

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        receptors = self.receptors
        receptors.take(luminance)
        before_s, self._time_s = self._time_s, time_s
        if receptors.frame < self.first_valid_frame:
            return Response(layers=Layers() if layers else None)
        flow = self._flow.calc(_levels(receptors.previous), _levels(receptors.current), None)
        divergence = np.zeros(flow.shape[:2], np.float32)
        divergence[:, 1:-1] += (flow[:, 2:, 0] - flow[:, :-2, 0]) / 2
        divergence[1:-1] += (flow[2:, :, 1] - flow[:-2, :, 1]) / 2
        receptors.clear(divergence)
        duration_s = 1.0 / DEFAULT_MODEL_FPS
        if time_s is not None and before_s is not None and time_s > before_s:
            duration_s = time_s - before_s
        mp = max(float(divergence.sum(dtype=np.float64)), 0.0) / duration_s
        speed = np.hypot(flow[..., 0], flow[..., 1])
        receptors.clear(speed)
        g, shown = np.maximum(divergence, 0.0), None
        if layers:
            p = receptors.p(0).astype(np.float32) * np.float32(receptors.unit)
            shown = Layers(p, speed, g)
        p_sum, s_sum = receptors.p_sum(0), float(speed.sum(dtype=np.float64))
        return Response(p_sum, s_sum, mp, 0.0, 0.0, shown, *centroid_of(g))

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        self._time_s = None


def _levels(grey: Grey) -> Grey:
    """Luminance as uint8, the type that DIS accepts."""
    return grey if grey.dtype == np.uint8 else np.uint8(np.clip(grey, 0.0, 1.0) * 255.0 + 0.5)
