"""One input through one model for the sake of its layers, at chosen frames or at all of them."""

import math
from collections.abc import Callable, Collection

from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.results.layers import Shot
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.runs.single import watch
from dlgmd_cli.video.frames import Frame, Video

LAYERS = ("p", "s", "g")


class LayerRecording:
    """What a pass gathers; an interrupt loses none of it.

    Parameters
    ----------
    wanted : collection of int
        Numbers of the frames whose layers are kept.
    whole : bool
        Go on to the end of the input, and measure the layers of every frame.

    Attributes
    ----------
    responses : Recording
        The numbers of every frame that was processed.
    shots : list of Shot
        The frames wanted, as far as they came.
    lowest, highest : dict of str to float
        For `p`, `s` and `g`, the extremes over all frames measured; infinite if there is none.
    last : Frame or None
        The last frame processed.
    """

    def __init__(self, wanted: Collection[int], *, whole: bool = False) -> None:
        self.wanted, self.whole = frozenset(wanted), whole
        self.responses = Recording()
        self.shots: list[Shot] = []
        self.lowest = dict.fromkeys(LAYERS, math.inf)
        self.highest = dict.fromkeys(LAYERS, -math.inf)
        self.last: Frame | None = None

    def wants(self, index: int) -> bool:
        """Whether the layers of that frame are needed."""
        return self.whole or index in self.wanted

    def take(self, frame: Frame, response: Response) -> bool:
        """Keep what is wanted of a frame; False if it was the last one needed."""
        if response.layers is not None:
            if frame.index in self.wanted:
                layers = response.layers
                self.shots.append(
                    Shot(frame.index, frame.time_s, frame.luminance, layers.p, layers.s, layers.g)
                )
            if self.whole:
                self._measure(response)
        self.responses.append(frame, response)
        self.last = frame
        return self.whole or frame.index < max(self.wanted)

    @property
    def has_all(self) -> bool:
        """Whether every frame wanted came."""
        return len(self.shots) == len(self.wanted)

    def _measure(self, response: Response) -> None:
        """Widen the extremes."""
        for name in LAYERS:
            layer = getattr(response.layers, name)
            if layer is not None:
                self.lowest[name] = min(self.lowest[name], float(layer.min()))
                self.highest[name] = max(self.highest[name], float(layer.max()))


def run_layers(
    source: Video,
    model: Model,
    recording: LayerRecording,
    on_frame: Callable[[int], None] = lambda n_decoded: None,
) -> None:
    """Feed `source` to `model` until `recording` has what it wants.

    Parameters
    ----------
    source : Video
        Where the frames come from. All before the last one wanted are processed, for the model
        lives on its history.
    model : Model
        Reset before the first frame.
    recording : LayerRecording
        Takes the layers. Whatever ends the run, it holds those that were computed.
    on_frame : callable, optional
        Called after each frame with the number of frames of the input that are done.
    """

    def visit(frame: Frame, response: Response) -> bool:
        goes_on = recording.take(frame, response)
        on_frame(frame.index + 1)
        return goes_on

    watch(source, model, visit, recording.wants)
