"""Putting things along the walls of a room, one after the other, where there is room for them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dlgmd_cli.flights.places.pieces import PIECES, Piece
from dlgmd_cli.flights.places.rooms import Hall
from dlgmd_cli.flights.places.sheet import Rng
from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Body, Solid

_SPACE_M = 0.02  # between two things
_AXES = np.vstack([np.eye(3), -np.eye(3)])


@dataclass
class Furnishing:
    """What is in a room so far.

    Attributes
    ----------
    hall : Hall
    guests : sequence of Body
        What stands there already and is kept clear of.
    bodies : list of Solid
        What was added.
    """

    hall: Hall
    guests: Sequence[Body] = ()
    bodies: list[Solid] = field(default_factory=list)

    def add(self, bodies: Sequence[Solid]) -> bool:
        """Add a thing if all of it is clear of all others and inside the room; say whether."""
        boxes = np.array([body.reach(_AXES) for body in bodies])
        if not all(self.is_free(box) for box in boxes):
            return False
        self.bodies += bodies
        return True

    def is_free(self, box_m: FloatArray) -> bool:
        """Whether a box is inside the room and clear of all that is in it.

        Parameters
        ----------
        box_m : ndarray, shape (6,)
            Its upper ends along x, y and z, and its lower ends with the sign changed.
        """
        length, width, height = self.hall.size_m
        most = np.array([length, width / 2, height, 0.0, width / 2, 0.0])
        others = [body.reach(_AXES) for body in (*self.guests, *self.bodies)]
        is_inside = bool((box_m <= most + 1e-9).all())
        return is_inside and not any(_overlap(box_m, other) for other in others)

    def line(
        self,
        rng: Rng,
        side: str,
        names: Sequence[str],
        span_m: tuple[float, float],
        *,
        depth_m: float,
        gap_m: tuple[float, float] = (0.1, 0.4),
    ) -> None:
        """Put things along a wall from one end of a span to the other, as far as they go.

        Parameters
        ----------
        side : str
            The wall; see `Hall.stand`.
        names : sequence of str
            Keys of `PIECES`, in their order along the wall.
        span_m : (float, float)
            Where along the wall.
        depth_m : float
            What reaches farther into the room than this is left out.
        gap_m : (float, float)
            The least and the most space between two things.
        """
        at, end = span_m
        for name in names:
            piece = PIECES[name]
            if piece.depth_m > depth_m or at + piece.width_m > end:
                continue
            # What finds its place taken tries farther on.
            for middle in np.arange(at + piece.width_m / 2, end - piece.width_m / 2, 0.3):
                # Things are drawn as they are made, which takes long: first see whether they fit.
                if self.is_free(self._ground(side, float(middle), piece)) and self.add(
                    piece.made(rng, self.hall, side, float(middle))
                ):
                    at = float(middle) + piece.width_m / 2 + rng.uniform(*gap_m)
                    break

    def _ground(self, side: str, along_m: float, piece: Piece) -> FloatArray:
        """The box, from floor to ceiling, that a thing takes at a wall; see `is_free`."""
        (x, y), yaw_deg = self.hall.stand(side, along_m, piece.depth_m / 2)
        deep, wide = piece.depth_m / 2, piece.width_m / 2
        dx, dy = (deep, wide) if yaw_deg % 180.0 == 0.0 else (wide, deep)
        return np.array([x + dx, y + dy, self.hall.size_m[2], dx - x, dy - y, 0.0])


def _overlap(one: FloatArray, other: FloatArray) -> bool:
    """Whether the boxes around two bodies, by how far they reach both ways, nearly meet."""
    gaps = np.concatenate([one[:3] + other[3:], other[:3] + one[3:]])
    return bool((gaps > -_SPACE_M).all())
