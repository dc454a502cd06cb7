"""One step: a model, or the expansion, that goes through the frames of a source."""

import math
from typing import Any, Generic, TypeVar

from dlgmd_cli.frame import Flags, Frame
from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.models.expansion import Expansion, Measured

SteppedT = TypeVar("SteppedT", Model, Expansion)


class Stepper(Generic[SteppedT]):
    """What goes through the frames of a source: a model, or the measurement beside it.

    It skips duplicates, and restarts after a gap in time. Nothing else resets it.

    Parameters
    ----------
    model : Model or Expansion
        What steps.
    size_wh : (int, int), optional
        Width and height of its frames, where a source gives several sizes.
    """

    def __init__(self, model: SteppedT, size_wh: tuple[int, int] | None = None) -> None:
        self.model: SteppedT = model
        self.size_wh = size_wh
        self._nothing: Any = Response() if isinstance(model, Model) else Measured()
        self._last, self._restarts = self._nothing, False

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self.model.reset()
        self._last, self._restarts = self._nothing, False

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells of all frames from now on, see `Model.ignore`."""
        self.model.ignore(hidden)

    def step(self, frame: Frame, **options: Any) -> Any:
        """The answer to the next frame; to a duplicate, the answer to the frame before.

        Parameters
        ----------
        frame : Frame
            The frame, with its time, and whether it is a duplicate or follows a gap.
        options
            As of the model's own `step`: `layers`, unless the frame is a duplicate.

        Returns
        -------
        Response or Measured
            Of a model, or of an `Expansion`.

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
        self._last = self.model.step(frame.at(self.size_wh), time_s, **options)
        return self._last
