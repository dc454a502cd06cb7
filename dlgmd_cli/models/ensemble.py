"""Several models on the same frames: P is computed once, and kept once."""

from collections.abc import Sequence

from dlgmd_cli.models.base import Grey, Model, Response
from dlgmd_cli.models.photoreceptors import Photoreceptors


class Ensemble:
    """Models that look through the same photoreceptors.

    Parameters
    ----------
    models : sequence of Model
        At least one. They must not be fed otherwise meanwhile.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = models
        self._receptors = Photoreceptors(max(model.look_back for model in models))

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame at which any of them has a full history."""
        return min(model.first_valid_frame for model in self.models)

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        self._receptors.reset()

    def step(self, luminance: Grey) -> list[Response]:
        """What every model answers to the next frame, see `Model.step`."""
        self._receptors.take(luminance)
        return [model.respond(self._receptors) for model in self.models]
