"""The base of models with the D-LGMD's distributed connections: kernels, engine, warm-up."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from dlgmd_cli.models.base import (
    AUTO,
    FloatImage,
    Grey,
    Layers,
    Model,
    Photoreceptors,
    Response,
    aligned,
    checked_params,
)
from dlgmd_cli.models.engines import choose_engine, create_engine
from dlgmd_cli.models.kernels import connect
from dlgmd_cli.parameters.presets import DistributedParameters

Images = tuple[FloatImage, FloatImage]


class Distributed(Model):
    """Base of the models whose S follows from P by [Zhao2023] Eqs. (2) to (7).

    `connections` are the kernels.
    """

    params_class: ClassVar[type[DistributedParameters]] = DistributedParameters
    params: DistributedParameters

    def __init__(self, params: DistributedParameters | None = None, engine: str = AUTO) -> None:
        self.params = checked_params(params, self.params_class)
        self.engine_name = self._asked_engine = engine
        choose_engine(engine)  # raises now, not at the first frame
        self.connections = connect(self.params)
        # P is defined from frame 1 on.
        self.first_valid_frame = 1 + max(self.connections.max_delay_frames, self.least_delay)
        self.receptors = Photoreceptors(self.first_valid_frame)
        self._engine_is_for: tuple[object, object] | None = None

    @property
    def least_delay(self) -> int:
        """Number of earlier P that the model needs even if its connections do not."""
        return 1

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        self._take(luminance)
        if self.receptors.frame == 0:
            self._prepare(luminance)
        if self.receptors.frame < self.first_valid_frame:
            p_sum = self.receptors.p_sum(0)
            return Response(p_sum, layers=Layers(self.p_layer()) if layers else None)
        if not layers:
            return self._respond(None)
        s, g = (aligned(luminance.shape) for _ in range(2))
        return replace(self._respond((s, g)), layers=Layers(self.p_layer(), s, g))

    def _respond(self, images: Images | None) -> Response:
        """The response once the history is full; S and G are written to `images`."""
        raise NotImplementedError

    def _take(self, luminance: Grey) -> None:
        self.receptors.take(luminance)

    def _prepare(self, luminance: Grey) -> None:
        """Create an engine for frames like the first; after a reset, keep one that fits."""
        kind, n_cells = (luminance.shape, luminance.dtype), luminance.size
        if kind == self._engine_is_for:
            return
        self._engine_is_for = kind
        self.engine_name = choose_engine(self._asked_engine, n_cells)
        self._engine = create_engine(self.engine_name, self.connections, self.receptors)

    def p_layer(self) -> FloatImage | None:
        """A copy of P(t) in luminance; None at the first frame."""
        if self.receptors.frame == 0:
            return None
        receptors = self.receptors
        p = np.subtract(receptors.p(0), receptors.floors[receptors.position(0)], dtype=np.float32)
        return np.maximum(p, 0.0, out=p) * np.float32(receptors.unit)
