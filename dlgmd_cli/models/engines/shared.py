"""The OpenCV engine for many D-LGMDs on the same frames, which share filtered images.

Models whose kernels are alike, such as the versions of a set and its ablations, apply many equal
filters to the same P. Here each is applied once a frame.
"""

from collections.abc import Sequence

import cv2

from dlgmd_cli.models.base import FloatImage, Photoreceptors, aligned
from dlgmd_cli.models.engines import Grouping, Images
from dlgmd_cli.models.engines.opencv import OpencvEngine, Window, apply, floats, group, sum_4x4
from dlgmd_cli.models.engines.plan import Filter, Source
from dlgmd_cli.models.kernels import Connections

# What to filter: the source, the window by its bounds, and the weights of the filter.
_Wanted = tuple[Source, tuple[int, ...], tuple[bytes, ...]]


class SharedFilters:
    """What the filters of some engines make of the newest P; each is applied once a frame.

    `receptors` are those of all engines.
    """

    def __init__(self, receptors: Photoreceptors) -> None:
        self.receptors = receptors
        self._images: dict[_Wanted, tuple[int, FloatImage]] = {}

    def image(self, wanted: _Wanted, taps: Filter, window: Window, spares: Images) -> FloatImage:
        """The filtered window, valid until the next frame; `spares` have its shape."""
        frame, image = self._images.get(wanted) or (-1, aligned(spares[0].shape))
        if frame != self.receptors.frame:
            apply(taps, floats(self.receptors, wanted[0], window, spares[0]), out=image)
            self._images[wanted] = self.receptors.frame, image
        return image


class SharingEngine(OpencvEngine):
    """Computes S and ΣG as `OpencvEngine` does, to the last bit, with `SharedFilters`."""

    def __init__(self, connections: Connections, shared: SharedFilters) -> None:
        super().__init__(connections, shared.receptors)
        self._shared = shared
        self._wanted = [self._wanted_in(tile.window) for tile in self.tiles]

    def _wanted_in(self, window: Window) -> list[tuple[_Wanted, Filter]]:
        rows, columns = window
        bounds = rows.start, rows.stop, columns.start, columns.stop
        return [
            ((source, bounds, tuple(side.tobytes() for side in taps)), taps)
            for source, filters in self.filters.items()
            for taps in filters
        ]

    def respond_each(
        self, groupings: Sequence[Grouping], layers: Sequence[FloatImage] = ()
    ) -> tuple[float, list[float]]:
        """ΣS of the newest frame, and ΣG with each grouping, as from `respond`.

        S, and then G with each grouping, are written to `layers`, each (H, W), if there are any.
        """
        s_sum, g_sums = 0.0, [0.0] * len(groupings)
        for tile, wanted in zip(self.tiles, self._wanted, strict=True):
            height, width = tile.shape
            s, part, g = (m[: height * width].reshape(height, width) for m in self.memory)
            images = (self._shared.image(key, taps, tile.window, (g, part)) for key, taps in wanted)
            self._sum_up(images, s)
            s_of_tile = cv2.sumElems(s[tile.core])[0]
            if s_of_tile == 0.0 and not layers:  # then G is 0 as well
                continue
            s_sum += s_of_tile
            if layers:
                layers[0][tile.target] = s[tile.core]
            sum_4x4(s, out=part)
            for place, grouping in enumerate(groupings):
                group(s[tile.core], part[tile.core], grouping, g[tile.core])
                g_sums[place] += cv2.sumElems(g[tile.core])[0]
                if layers:
                    layers[1 + place][tile.target] = g[tile.core]
        return s_sum, g_sums
