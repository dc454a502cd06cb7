"""Models that process a clip together, and share what they compute alike.

All models with frames of one size have the same P. With or without limits, FFI-GD or the released
code's constants, a set has the same S, too, which takes most of the time. Here each is computed
once a frame.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from dlgmd_cli.frame import Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.models import base
from dlgmd_cli.models.base import FloatImage, Layers, Model, Photoreceptors, Response, aligned
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.engines.shared import SharedFilters, SharingEngine
from dlgmd_cli.models.on_off import OnOffDLGMD
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead
from dlgmd_cli.video.source import Video

Size = tuple[int, int]
# For each model by label: its parameters, and the width and height of its frames.
Sized = Mapping[str, tuple[Parameters, Size]]


def responses(
    video: Video, models: Sized, *, layers: bool = False
) -> Iterator[tuple[Frame, dict[str, Response]]]:
    """Step models through a clip without duplicates and gaps, which is read once.

    Frames have the video's size, and those of the models. Responses are those of each model by
    itself, but D-LGMDs have no centroid. With `layers`, theirs share P, and S if it is the same.
    Raises Interrupted if the user asks to stop.
    """
    siblings, others = _families(models)
    sizes = video.size_wh, *(size for _, size in models.values())
    # OpenCV's threads would only compete with that of the renderer.
    with opencv_threads(1), read_ahead(video.frames(*sizes)) as ahead:
        for frame in ahead:
            cancel.check()
            answers: dict[str, Response] = {}
            for (size, _), same in others.items():
                model = next(iter(same.values()))
                answers |= dict.fromkeys(same, model.step(frame.at(size), layers=layers))
            for size, families in siblings.items():
                receptors = families[0].receptors
                receptors.take(frame.at(size))
                p = families[0].first.p_layer() if layers else None
                for family in families:
                    answers |= family.respond(p, layers=layers)
            yield frame, answers


def _families(models: Sized) -> tuple[dict[Size, list["_Siblings"]], dict[Any, dict[str, Model]]]:
    """D-LGMDs by frame size, those with equal connections together; other models, if equal."""
    siblings: dict[Size, dict[Any, dict[str, DLGMD]]] = {}
    others: dict[Any, dict[str, Model]] = {}
    for label, (params, size) in models.items():
        model = base.create_model(params, engine="opencv")
        if isinstance(model, DLGMD) and not isinstance(model, OnOffDLGMD):
            alike = siblings.setdefault(size, {}).setdefault(_connections(model), {})
            alike[label] = model
        else:
            others.setdefault((size, params), {})[label] = model
    groups = {}
    for size, families in siblings.items():
        every = [model for alike in families.values() for model in alike.values()]
        shared = SharedFilters(Photoreceptors(max(model.first_valid_frame for model in every)))
        groups[size] = [_Siblings(alike, shared) for alike in families.values()]
    return groups, others


def _connections(model: DLGMD) -> tuple[Any, ...]:
    """All that S depends on, besides the frames."""
    connections = model.connections
    kernels = tuple((delay, k.tobytes()) for delay, k in sorted(connections.signed().items()))
    return kernels, tuple(k.tobytes() for k in connections.gaussians)


class _Siblings:
    """D-LGMDs with the same connections, which differ in the grouping layer."""

    def __init__(self, models: Mapping[str, DLGMD], shared: SharedFilters) -> None:
        self._models, self.first, self._shared = models, next(iter(models.values())), shared
        self.receptors = shared.receptors
        for model in models.values():
            model.receptors = shared.receptors

    def respond(self, p: FloatImage | None, *, layers: bool) -> dict[str, Response]:
        """The responses by label to the frame that the receptors took; P of their layers is `p`."""
        receptors = self.receptors
        if receptors.frame == 0:
            self._engine = SharingEngine(self.first.connections, self._shared)
        readouts = {
            label: model.grouping()
            for label, model in self._models.items()
            if receptors.frame >= model.first_valid_frame
        }
        groupings, p_sum = list(dict.fromkeys(readouts.values())), receptors.p_sum(0)
        answers = dict.fromkeys(self._models, Response(p_sum, layers=Layers(p) if layers else None))
        if not groupings:
            return answers
        images = [aligned(receptors.current.shape) for _ in (None, *groupings)] if layers else []
        s_sum, k = self._engine.respond_each(groupings, images)
        for label, grouping in readouts.items():
            place = groupings.index(grouping)
            shown = Layers(p, images[0], images[1 + place]) if layers else None
            ffi = receptors.p_sum(self._models[label].least_delay)
            answers[label] = Response(p_sum, s_sum, k[place], ffi, grouping.t_de, shown)
        return answers
