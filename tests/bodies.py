"""Simple bodies for tests of the renderer and of the truth."""

import numpy as np

from dlgmd_cli.scenes.flights.solids import Capsule, Solid, Texture, quad
from dlgmd_cli.scenes.flights.visibility import PaintOrder


def plain(level):
    return Texture(np.float32(level))


def box(low, high, level=0.5, name="box", *, inwards=False, motion=None, textures=None):
    """An upright box, seen from outside or from inside; `textures` are those of its six faces."""
    (x, y, z), (x2, y2, z2) = low, high
    dx, dy, dz = np.diag(np.subtract(high, low).astype(float))
    corners = [
        ([x, y2, z2], dx, -dy),  # from above
        ([x, y, z], dx, dy),  # from below
        ([x, y, z2], dx, -dz),  # from where y is less
        ([x2, y2, z2], -dx, -dz),
        ([x, y2, z2], -dy, -dz),  # from where x is less
        ([x2, y, z2], dy, -dz),
    ]
    faces = []
    for index, (origin, right, down) in enumerate(corners):
        if inwards:
            origin, right = np.add(origin, right), -right
        faces.append(quad(origin, right, down, textures[index] if textures else plain(level)))
    return Solid(name, faces, motion)


def board(x, side, level=0.5, name="board", *, z=0.0):
    """A square that looks back along x, its middle at (x, 0, z)."""
    texture = level if isinstance(level, Texture) else plain(level)
    return Solid(name, [quad((x, side / 2, z + side / 2), (0, -side, 0), (0, 0, -side), texture)])


def capsule(first, last, radius, level=0.5, name="capsule", *, motion=None):
    texture = level if isinstance(level, Texture) else plain(level)
    return Capsule(name, np.array([first, last], float), radius, texture, motion=motion)


def ball(at, radius, level=0.5, name="ball", *, motion=None):
    return capsule(at, at, radius, level, name, motion=motion)


def project(camera, points_m, pose):
    """World points, (..., 3), in front of the camera, in its image, (..., 2) in px."""
    return camera.flatten(camera.view(points_m, pose))


def rays_of(camera, points_xy, pose):
    """Lines of sight through points of the image, in the world; 1 long along the optical axis."""
    ends = np.concatenate([points_xy, np.ones((*points_xy.shape[:-1], 1))], axis=-1)
    return ends @ camera.rays_from_xy.T @ pose.camera_from_world


def are_apart(bodies):
    """Whether a plane separates every pair of bodies, so that the order to paint them is exact."""
    planes = PaintOrder(bodies)._planes
    return np.count_nonzero(planes.any(axis=(2, 3))) == len(bodies) * (len(bodies) - 1)
