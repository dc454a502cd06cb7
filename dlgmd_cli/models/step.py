"""One step: a model that goes through the frames of a source."""

import math

from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Flags, Model, Response, create_model
from dlgmd_cli.parameters.presets import Parameters


class Stepper:
    """A model that goes through the frames of a source.

    The model does not see repeats, and restarts after a gap in time: it has no response until its
    history is full again. Nothing else resets a model.

    Parameters
    ----------
    params : Parameters
        Parameters of any model.
    engine : str
        See `DLGMD`.
    size_wh : (int, int), optional
        Width and height of the model's frames, where a source gives several sizes.

    Attributes
    ----------
    model : Model
        The model.
    """

    def __init__(
        self, params: Parameters, *, engine: str = "auto", size_wh: tuple[int, int] | None = None
    ) -> None:
        self.model: Model = create_model(params, engine=engine)
        self.params, self.size_wh = params, size_wh
        self._last, self._restarts = Response(), False

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self.model.reset()
        self._last, self._restarts = Response(), False

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells of all frames from now on, see `Model.ignore`."""
        self.model.ignore(hidden)

    def step(self, frame: Frame, *, layers: bool = False) -> Response:
        """The model's response to the next frame; to a repeat, the response to the frame before.

        Parameters
        ----------
        frame : Frame
            The frame, with its time, and whether it is a repeat or follows a gap.
        layers : bool
            Also return copies of P, S and G, unless the frame is a repeat.

        Raises
        ------
        FrameError, MissingExtraError
            As `Model.step`.
        """
        self._restarts = self._restarts or frame.after_gap
        if frame.is_repeat:
            return self._last
        if self._restarts:
            self.reset()
        time_s = None if math.isnan(frame.time_s) else frame.time_s
        self._last = self.model.step(frame.at(self.size_wh), time_s, layers=layers)
        return self._last
