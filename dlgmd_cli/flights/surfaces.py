"""Bodies as arrays: all their planar faces and all their round parts at once."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Body, Face, Round, Solid

IntArray = npt.NDArray[np.intp]

# Half the time over which a body's velocity is taken from its motion.
_HALF_S = 1e-4


class Surfaces:
    """The surfaces of some bodies, where they are before any motion.

    Parameters
    ----------
    bodies : sequence of Body
        Solids and Rounds.

    Attributes
    ----------
    corners_m : ndarray, shape (n_faces, n_corners, 3)
        A face with fewer corners than others repeats its last one.
    normals : ndarray, shape (n_faces, 3)
        Towards who sees the face.
    face_body : ndarray, shape (n_faces,)
        Which body a face belongs to; faces of a body follow each other.
    ends_m : ndarray, shape (n_rounds, 2, 3)
    radii_m : ndarray, shape (n_rounds,)
    round_body : ndarray, shape (n_rounds,)
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.bodies = tuple(bodies)
        faces: list[Face] = []
        face_body, rounds, round_body = [], [], []
        for index, body in enumerate(bodies):
            if isinstance(body, Solid):
                faces.extend(body.faces)
                face_body.extend([index] * len(body.faces))
            elif isinstance(body, Round):
                rounds.append(body)
                round_body.append(index)
        most = max((len(face.corners_m) for face in faces), default=3)
        self.corners_m = np.array([_padded(face.corners_m, most) for face in faces])
        self.corners_m = self.corners_m.reshape(len(faces), most, 3)
        self.normals = np.array([face.normal for face in faces]).reshape(-1, 3)
        self.face_body: IntArray = np.array(face_body, np.intp)
        self.ends_m = np.array([each.ends_m for each in rounds], float).reshape(-1, 2, 3)
        self.radii_m = np.array([each.radius_m for each in rounds], float)
        self.round_body: IntArray = np.array(round_body, np.intp)
        self._moving = [i for i, body in enumerate(bodies) if body.motion is not None]

    def offsets(self, time_s: float) -> FloatArray:
        """How far each body has moved, (n_bodies, 3), in m."""
        offsets = np.zeros((len(self.bodies), 3))
        for index in self._moving:
            motion = self.bodies[index].motion
            if motion is not None:
                offsets[index] = motion(time_s)
        return offsets

    def velocities(self, time_s: float) -> FloatArray:
        """How fast each body moves, (n_bodies, 3), in m/s.

        Motions must be known a little before and after any time that is asked for.
        """
        if not self._moving:
            return np.zeros((len(self.bodies), 3))
        later, earlier = self.offsets(time_s + _HALF_S), self.offsets(time_s - _HALF_S)
        velocities: FloatArray = (later - earlier) / (2.0 * _HALF_S)
        return velocities


def _padded(corners_m: FloatArray, n_corners: int) -> FloatArray:
    """Corners, with the last one repeated."""
    again = np.repeat(corners_m[-1:], n_corners - len(corners_m), axis=0)
    return np.concatenate([corners_m, again])
