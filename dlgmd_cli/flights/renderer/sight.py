"""Which faces of many bodies the camera sees, and where in its picture."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.camera import Camera, FloatArray, Pose
from dlgmd_cli.flights.renderer.outline import EDGE_ON_M, NEAR_M, Outline, clip_near, to_picture
from dlgmd_cli.flights.renderer.solids import Face


class Sight:
    """The faces of bodies at rest, all looked at together.

    Parameters
    ----------
    bodies : sequence of sequence of Face
        The faces of each body.
    """

    def __init__(self, bodies: Sequence[Sequence[Face]]) -> None:
        self._faces = [face for faces in bodies for face in faces]
        self._owners = [owner for owner, faces in enumerate(bodies) for _ in faces]
        counts = [len(face.corners_m) for face in self._faces]
        self._starts = np.cumsum([0, *counts])
        self._corners = _stack([corner for face in self._faces for corner in face.corners_m])
        self._normals = _stack([face.normal for face in self._faces])
        self._origins = _stack([face.origin_m for face in self._faces])
        sides = [(face.right_m, face.down_m) for face in self._faces]
        # What gives a point's share of the way along each side of the texture.
        self._shares = np.array([np.linalg.pinv(np.array(pair)).T for pair in sides])
        self._texels_per_m = [
            max(
                texels / math.sqrt(side @ side)
                for texels, side in zip(face.texture.image.shape[::-1], pair, strict=True)
            )
            for face, pair in zip(self._faces, sides, strict=True)
        ]

    def outlines(self, camera: Camera, pose: Pose) -> dict[int, list[Outline]]:
        """What is in sight, by the number of its body."""
        found: dict[int, list[Outline]] = {}
        if not self._faces:
            return found
        seen = camera.view(self._corners, pose)
        origins = self._origins - pose.position_m
        heights = (self._normals * origins).sum(axis=1)  # of the faces above the eye
        is_seen = (heights < -EDGE_ON_M) & ~self._is_outside(camera, seen)
        chosen = np.flatnonzero(is_seen)
        heights, normals, shares = heights[chosen], self._normals[chosen], self._shares[chosen]
        rays = pose.camera_from_world.T @ camera.rays_from_xy
        planes = normals @ rays / heights[:, None]
        along = (shares * origins[chosen, None]).sum(axis=2)
        rows = heights[:, None, None] * shares - along[:, :, None] * normals[:, None]
        from_xy = np.concatenate([rows, normals[:, None]], axis=1) @ rays
        for place, index in enumerate(chosen):
            corners = clip_near(seen[self._starts[index] : self._starts[index + 1]])
            if len(corners) < 3:
                continue
            face = self._faces[index]
            outline = Outline(
                to_picture(corners, camera)[::-1],
                planes[place],
                -float(heights[place]),
                from_xy[place],
                self._texels_per_m[index],
                face.texture,
                face.gain,
            )
            found.setdefault(self._owners[index], []).append(outline)
        return found

    def _is_outside(self, camera: Camera, seen: FloatArray) -> npt.NDArray[np.bool_]:
        """Whether all corners of a face are beyond the same border of the picture."""
        right, down = camera.middle_xy / camera.focal_px
        x, y, depth = seen.T
        beyond = np.array(
            [
                x - right * depth,
                -x - right * depth,
                y - down * depth,
                -y - down * depth,
                NEAR_M - depth,
            ]
        )
        least = np.minimum.reduceat(beyond, self._starts[:-1], axis=1)
        return np.asarray((least >= 0.0).any(axis=0), np.bool_)


def _stack(vectors: Sequence[FloatArray]) -> FloatArray:
    """Vectors as the rows of a matrix, (n, 3)."""
    return np.array(vectors, float).reshape(-1, 3)
