"""What all models share: they are fed frame by frame, and may share what they look at."""

from abc import ABC, abstractmethod

from dlgmd_cli.models.base import Grey, Response
from dlgmd_cli.models.photoreceptors import Photoreceptors, View


class Detector(ABC):
    """A model on photoreceptors of its own, or, by `respond`, on those that others use too.

    Attributes
    ----------
    look_back : int
        How many P of the past, with the newest, it needs a `View` to hold.
    """

    def __init__(self, look_back: int) -> None:
        self.look_back = look_back
        self._receptors = Photoreceptors(look_back)

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame with a full history: P begins at 1."""
        return self.look_back

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        self._receptors.reset()

    def step(self, luminance: Grey, *, layers: bool = False) -> Response:
        """Take the next frame and answer to it.

        Parameters
        ----------
        luminance : ndarray, shape (H, W), float32 or uint8
            Luminance in 0..1, or grey levels in 0..255 that stand for it. The array may be reused
            by the caller afterwards.
        layers : bool
            Return copies of P, S and G as well.

        Returns
        -------
        Response
            NaN before `first_valid_frame` for all but `p_sum`, and for `p_sum` at the first frame.

        Raises
        ------
        FrameError
            If the frame is neither a float32 nor a uint8 image, or not of the same size and type
            as the one before.
        MissingExtraError
            If the engine asked for needs a package that is not installed.
        """
        self._receptors.take(luminance)
        return self.respond(self._receptors, layers=layers)

    @abstractmethod
    def respond(self, view: View, *, layers: bool = False) -> Response:
        """Answer to the newest frame of `view`; to be called once for every frame, in order."""
