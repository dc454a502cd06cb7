"""What the simulation knows of the drone at an instant, and the physics of it."""

from dataclasses import dataclass

GRAVITY_M_S2 = 9.81
# Speed lost to the air, in 1/s: 12 degrees of pitch lead to about 6 m/s.
DRAG_1_S = 0.35
# Of a drone of 0.3 to 0.5 m: how fast its attitude follows, critically damped, and its motors.
ATTITUDE_RAD_S = 10.0
YAW_LAG_S = 0.15
MOTOR_LAG_S = 0.04
MAX_THRUST_M_S2 = 2.5 * GRAVITY_M_S2


@dataclass(slots=True)
class Craft:
    """Position and velocity in the world, attitude, and thrust per mass; m, rad and s.

    Plain numbers, since the simulation takes thousands of small steps.
    """

    x: float
    y: float
    z: float
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    roll_rate: float = 0.0
    pitch_rate: float = 0.0
    yaw_rate: float = 0.0
    thrust: float = 0.0
    stands: bool = False

    def sample(self) -> tuple[float, ...]:
        """Position, velocity, attitude and its rates: what a path keeps."""
        return (
            *(self.x, self.y, self.z),
            *(self.vx, self.vy, self.vz),
            *(self.roll, self.pitch, self.yaw),
            *(self.roll_rate, self.pitch_rate, self.yaw_rate),
        )
