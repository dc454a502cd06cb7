"""A flight on its stage: the model of MuJoCo, the camera's images, and the truth of each frame."""

import math
from dataclasses import dataclass, replace

import cv2
import mujoco
import numpy as np

from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.builder import HULL, SCENERY, TARGET, Builder, turned
from dlgmd_cli.lab.fly.motion import BRAKING_S, HULL_M, STEP_S, simulated
from dlgmd_cli.lab.fly.objects import KINDS
from dlgmd_cli.lab.fly.scripts import AHEAD, BESIDE, COMES, CROSSES, THROUGH, Script
from dlgmd_cli.lab.fly.textures import FloatArray, GreyImage
from dlgmd_cli.lab.fly.worlds import WORLDS, Area, doorway

# Standard deviation of the camera's noise, in grey levels.
_NOISE = 1.0
_SAMPLES = 4
# Rays of the course: the axis, and circles of a half and the whole radius of the hull.
_N_AROUND = 8
_FAR_M = 100.0
# A drone that is slower than that drifts, and flies nowhere.
_SLOW_M_S = 0.15
_SHIFTS_M = 6.0
# How long a film goes on after a stop or a contact.
_AFTER_S = 0.5


@dataclass(frozen=True)
class Target:
    """How the target moves: along a line, through `place` at `time_s`.

    Attributes
    ----------
    place, velocity : ndarray, shape (3,)
        In m and m/s.
    time_s, stops_s : float
        The time at `place`, and that at which it stops.
    yaw_deg : float
    """

    place: FloatArray
    velocity: FloatArray
    time_s: float
    yaw_deg: float
    stops_s: float = math.inf

    def at(self, time_s: float) -> FloatArray:
        """Its place at a time."""
        return self.place + self.velocity * (min(time_s, self.stops_s) - self.time_s)


class Stage:
    """A script with its world, at any time of the flight.

    Use it in a `with` block, which frees the memory of OpenGL.

    Parameters
    ----------
    script : Script
    seed : int
    size_wh : (int, int)
        Of the images.

    Attributes
    ----------
    path : Path
    target : Target or None
    contact_s : float or None
        When the target touches the hull.
    """

    def __init__(self, script: Script, seed: int, size_wh: tuple[int, int]) -> None:
        self.script, self._seed = script, seed
        self.seconds = sum(leg.seconds for leg in script.legs)
        self.path = simulated(script, seed)
        self.target = self._aimed()
        self.contact_s: float | None = None
        self._model = self._built(np.random.default_rng([seed, 2]), size_wh)
        self._data = mujoco.MjData(self._model)
        self._hull = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, "hull")
        groups = self._model.geom_group
        self._geoms = {group: np.flatnonzero(groups == group) for group in (SCENERY, TARGET)}
        self._settle()
        self._size_wh = size_wh
        self._renderer: mujoco.Renderer | None = None

    def __enter__(self) -> "Stage":
        return self

    def __exit__(self, *error: object) -> None:
        if self._renderer is not None:
            self._renderer.close()

    def image(self, frame: int, time_s: float) -> GreyImage:
        """What the camera sees, (H, W) uint8; the noise is that of the frame."""
        if self._renderer is None:
            self._renderer = self._opened()
        self._set(time_s)
        self._renderer.update_scene(self._data, "eye")
        grey = self._renderer.render()[:, :, 0].astype(np.float32)
        rng = np.random.default_rng([self._seed, 3, frame])
        grey += rng.normal(0.0, _NOISE, grey.shape)
        return np.asarray(cv2.convertScaleAbs(np.maximum(grey, 0.0)), np.uint8)

    def course(self, time_s: float) -> tuple[float, float]:
        """What would be hit first if drone and target flew on: distance in m, closing speed in m/s.

        Rays go out from a disc of the hull's radius about the camera, along the camera's velocity
        relative to the scenery and to the target; the least distance along a ray counts. Of the
        two, that with the higher rate, closing speed by distance, is returned. The distance is NaN
        if nothing is on the course within 100 m.
        """
        self._set(time_s)
        state, moving = self.path.at(time_s), np.zeros(3)
        if self.target is not None and time_s <= self.target.stops_s + 1e-9:
            moving = self.target.velocity
        best = math.nan, float(np.linalg.norm(state.velocity))
        rate = 0.0
        for group, velocity in ((SCENERY, np.zeros(3)), (TARGET, moving)):
            course = state.velocity - velocity
            closing = float(np.linalg.norm(course))
            if closing < _SLOW_M_S or not len(self._geoms[group]):
                continue
            distance = self._ray(state.position, course / closing, group)
            if distance < _FAR_M and closing / distance > rate:
                best, rate = (distance, closing), closing / distance
        return best

    def truth(self, time_s: float) -> tuple[float, ...]:
        """The columns of the truth after the time: course, time to contact, attitude, velocity."""
        state, left_s = self.path.at(time_s), math.nan
        if self.contact_s is not None and time_s <= self.contact_s + 1e-6:
            left_s = self.contact_s - time_s
        return *self.course(time_s), left_s, *state.attitude_deg, *state.velocity

    def clearance(self, time_s: float, *groups: int) -> float:
        """The space between the hull and the nearest geom of some groups, in m; negative inside."""
        self._set(time_s)
        near = (
            mujoco.mj_geomDistance(self._model, self._data, self._hull, int(geom), _FAR_M, None)
            for group in groups
            for geom in self._geoms[group]
        )
        return min(near, default=_FAR_M)

    def rebound(self, contact_s: float) -> None:
        """Let the drone and the target end at a contact: the drone is thrown back."""
        self.contact_s = contact_s
        pushed = np.zeros(3)
        if self.target is not None:
            pushed = self.target.velocity
            self.target = replace(self.target, stops_s=contact_s)
        self.path = self.path.rebounding(contact_s, pushed)

    def brake(self, time_s: float) -> None:
        """Let the drone brake from a time on; what it still hits, it hits."""
        self.path, self.contact_s = simulated(self.script, self._seed, time_s), None
        while time_s < self.seconds + BRAKING_S:
            if self.clearance(time_s, SCENERY, TARGET) <= 0.0:
                self.rebound(time_s)
                break
            if float(np.linalg.norm(self.path.at(time_s).velocity)) < _SLOW_M_S:
                break
            time_s += STEP_S
        self.seconds = time_s + _AFTER_S

    def _opened(self) -> mujoco.Renderer:
        """A renderer without shadows and reflections."""
        width, height = self._size_wh
        try:
            renderer = mujoco.Renderer(self._model, height, width)
        except Exception as error:  # each library of OpenGL has its own
            raise gl.unusable(error) from None
        for flag in (mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_SHADOW):
            renderer.scene.flags[flag] = 0
        return renderer

    def _set(self, time_s: float) -> None:
        """Move the drone and the target to where they are at a time."""
        model, data, state = self._model, self._data, self.path.at(time_s)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, state.rotation.flatten())
        drone = model.body("drone").mocapid[0]
        data.mocap_pos[drone], data.mocap_quat[drone] = state.position, quat
        if self.target is not None:
            body = model.body("target").mocapid[0]
            data.mocap_pos[body] = self.target.at(time_s)
            data.mocap_quat[body] = turned(self.target.yaw_deg)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)

    def _ray(self, start: FloatArray, way: FloatArray, group: int) -> float:
        """The least distance to a group along parallel rays as wide as the hull."""
        across = np.cross(way, [0.0, 0.0, 1.0] if abs(way[2]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        up, flags = np.cross(across, way), np.zeros(6, np.uint8)
        flags[group] = 1
        least, geom = math.inf, np.zeros(1, np.int32)
        for radius in (0.0, HULL_M / 2, HULL_M):
            for angle in np.arange(_N_AROUND if radius else 1) * 2 * math.pi / _N_AROUND:
                offset = radius * (math.cos(angle) * across + math.sin(angle) * up)
                distance = mujoco.mj_ray(
                    self._model, self._data, start + offset, way, flags, 1, -1, geom
                )
                if 0 <= distance < least:
                    least = distance
        return least

    def _aimed(self) -> Target | None:
        """The target near its final place; `_settle` finds that."""
        script = self.script
        if not script.meets:
            return None
        state = self.path.at(script.meets_s)
        heading = state.velocity if np.hypot(*state.velocity[:2]) > 0.3 else state.rotation[:, 0]
        ahead = heading * [1.0, 1.0, 0.0]
        ahead /= np.linalg.norm(ahead)
        left, turn = np.array([-ahead[1], ahead[0], 0.0]), math.radians(script.turned_deg)
        yaw = math.degrees(math.atan2(ahead[1], ahead[0])) + 180.0 + script.turned_deg
        velocity, place = np.zeros(3), state.position.copy()
        half = KINDS[script.target].half_m if script.target in KINDS else 1.0
        if script.meets in (AHEAD, THROUGH, COMES):
            place += left * script.aside * half
        if script.meets == COMES:
            velocity = -script.speed_m_s * (math.cos(turn) * ahead + math.sin(turn) * left)
        elif script.meets == CROSSES:
            side = math.copysign(1.0, script.aside)
            velocity = script.speed_m_s * side * (math.cos(turn) * left + math.sin(turn) * ahead)
            place += ahead * (abs(script.aside) + half + HULL_M)
            yaw = math.degrees(math.atan2(velocity[1], velocity[0]))
        if script.target == "door" or KINDS[script.target].stands:
            place[2] = 0.0
        return Target(place, velocity, script.meets_s, yaw)

    def _settle(self) -> None:
        """Shift the target so that it is touched, or passed, as the script says."""
        script, target = self.script, self.target
        if target is None or script.meets == THROUGH:
            return
        heading = self.path.at(script.meets_s)
        course = heading.velocity - target.velocity
        ahead = course * [1.0, 1.0, 0.0] / np.hypot(*course[:2])
        way, wanted = ahead, 0.0 if script.collides else abs(script.aside)
        if script.meets == BESIDE:
            way = math.copysign(1.0, script.aside) * np.array([-ahead[1], ahead[0], 0.0])
        elif script.meets == CROSSES:
            way = heading.rotation[:, 0] * [1.0, 1.0, 0.0]
        # Where clearance is less than wanted, the target has to go further; steps find the last
        # such place, as the target's parts may leave gaps.
        steps = np.arange(-1.5, _SHIFTS_M, 0.05)[::-1]
        free = next((s for s in steps if self._space(target, s * way) <= wanted), 0.0) + 0.05
        low, high = free - 0.05, free
        for _ in range(20):
            middle = (low + high) / 2
            if self._space(target, middle * way) <= wanted:
                low = middle
            else:
                high = middle
        self.target = replace(target, place=target.place + low * way)
        if script.collides:
            self.rebound(script.meets_s)

    def _space(self, target: Target, shift: FloatArray) -> float:
        """The clearance at the meeting, with the target shifted."""
        self.target = replace(target, place=target.place + shift)
        around_s = np.arange(-1.0, 1.01, 0.1) if not self.script.collides else [0.0]
        return min(self.clearance(self.script.meets_s + s, TARGET) for s in around_s)

    def _built(self, rng: np.random.Generator, size_wh: tuple[int, int]) -> mujoco.MjModel:
        """The model: scenery, target, and a hull with a camera."""
        script, builder = self.script, Builder(rng)
        WORLDS[script.world](builder, self._area())
        builder.group = TARGET
        if self.target is not None:
            body = builder.part("target")
            if script.target == "door":
                doorway(body, script.world)
            else:
                KINDS[script.target].build(body)
        drone = builder.part("drone").body
        drone.add_geom(
            name="hull", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[HULL_M, 0, 0], group=HULL
        )
        width, height = size_wh
        focal = 0.5 / math.tan(math.radians(script.fov_deg) / 2)
        half = math.radians(90.0 + script.camera_tilt_deg) / 2
        tilt, quat = np.array([math.cos(half), math.sin(half), 0.0, 0.0]), np.zeros(4)
        # x of the camera to the right, y upwards: a turn by -90 degrees about z, then by the tilt.
        mujoco.mju_mulQuat(quat, np.array([math.sqrt(0.5), 0, 0, -math.sqrt(0.5)]), tilt)
        drone.add_camera(
            name="eye", quat=quat, fovy=2 * math.degrees(math.atan(0.5 * height / width / focal))
        )
        visual = builder.spec.visual
        visual.global_.offwidth, visual.global_.offheight = width, height
        visual.quality.offsamples = _SAMPLES
        # In units of the model's extent, which is 1 m.
        builder.spec.stat.extent, visual.map.znear, visual.map.zfar = 1.0, 0.02, 150.0
        return builder.spec.compile()

    def _area(self) -> Area:
        """What the flight needs of the world."""
        script, target = self.script, self.target
        end_s = script.meets_s if script.collides else self.seconds
        times = np.linspace(0.0, end_s, 60)
        states = [self.path.at(time_s) for time_s in times]
        drone = np.array([state.position[:2] for state in states])
        future = np.array([s.position[:2] + script.ahead_s * s.velocity[:2] for s in states])
        needed, slabs, ways = [drone, future], [], [drone, future]
        if target is not None:
            radius = KINDS[script.target].radius_m if script.target in KINDS else 0.0
            way = np.array([target.at(time_s)[:2] for time_s in times])
            ways += [way - radius, way, way + radius]
            if script.target in ("door", "wall", "blank"):
                needed.append(way)
                slabs.append((float(way[0, 0]) - 0.6, float(way[0, 0]) + 0.3))
            else:
                needed += [way - radius, way + radius]
        corners = np.concatenate(needed)
        low, high = corners.min(axis=0), corners.max(axis=0)
        low -= [1.2, script.margin_m]
        high += [script.behind_m, script.margin_m]
        return Area(
            (float(low[0]), float(low[1])), (float(high[0]), float(high[1])),
            np.concatenate(ways), tuple(slabs),
        )  # fmt: skip
