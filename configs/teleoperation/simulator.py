"""The simulated arm of the teleoperation experiment: physics, pictures of two cameras, and the teacher.

The arm is in arm.xml, for MuJoCo (Todorov et al., MuJoCo: A physics engine for model-based control, IROS 2012). requirements.txt says
how to install it.
"""

from __future__ import annotations

import os
from pathlib import Path

# MuJoCo reads this variable once, while it is imported. OSMesa renders on the processor and needs neither a screen nor a GPU.
os.environ.setdefault("MUJOCO_GL", "osmesa")

import numpy as np

REQUIREMENTS = Path(__file__).with_name("requirements.txt")
RENDERING_HINT = "set MUJOCO_GL=osmesa and install OSMesa, on Debian: apt-get install libosmesa6"
try:
    import mujoco
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        f"cannot import {missing.name}, which the simulated arm needs; install it: pip install -r {REQUIREMENTS}, and name that "
        "Python in the key python of the sensor or in the variable PEERNET_PYTHON"
    ) from missing
except (ImportError, AttributeError, OSError) as failure:
    # PyOpenGL raises an AttributeError if the library is missing.
    raise ImportError(
        f"cannot load the library that renders the pictures (MUJOCO_GL={os.environ['MUJOCO_GL']}): {failure}; {RENDERING_HINT}"
    ) from failure

CAMERAS = ("tripod", "wrist")
# Time for which the arm follows a new action before the next pictures, seconds. A controller without any delay thus runs at 20 Hz.
PERIOD = 0.05
# Largest speed of the tip, m/s.
SPEED_LIMIT = 0.5
# The teacher's gain, 1/s. If the delay is longer than about 1 / GAIN, the loop of arm and policy is unstable: the arm oscillates.
GAIN = 4.0
# An episode is a success if the tip is closer to the target, and slower, than this; metres and m/s.
TOLERANCE, RESTING_SPEED = 0.025, 0.1
# Position of the tip at the start of an episode, and corners of the rectangle of the table in which the cup stands; metres.
START = np.array([0.45, 0.0, 0.5])
CUP_RANGE = np.array([[0.30, -0.20], [0.60, 0.20]])
# Opposite corners of the box in which the tip stays, like the safety limits of a real arm; metres.
WORKSPACE = np.array([[0.2, -0.4, 0.02], [0.75, 0.4, 0.6]])
# Joint angles at which the hand points down near START, radians.
POSTURE = np.array([0.0, -1.0, 1.6, -0.6, 0.0])
# Damping of the least-squares inverse of the Jacobian, and gain that keeps the hand pointing down, 1/s.
DAMPING, ORIENTATION_GAIN = 1e-3, 5.0

# Seed of the targets. An experiment sets another seed for each repeat and user, but the same seed in all configurations.
EPISODE_SEED = int(os.environ.get("PEERNET_SEED", 9_100_000))


def episode_rng(episode: int) -> np.random.Generator:
    """Returns the random number generator of an episode, which depends only on EPISODE_SEED and the number of the episode, from 0 on."""
    return np.random.default_rng([EPISODE_SEED, episode])


def teacher(error: np.ndarray) -> np.ndarray:
    """Returns the velocity that the policy learns to output, m/s, from the vector from the tip to the target, metres."""
    return clip_length(GAIN * error, SPEED_LIMIT)


def clip_length(vector: np.ndarray, length: float) -> np.ndarray:
    """Returns the vector, shortened to at most that length."""
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-9))


class Simulator:
    """An arm whose tip moves with the velocity of the last action until it gets another one."""

    def __init__(self, width: int, height: int) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("arm.xml")))
        self.data = mujoco.MjData(self.model)
        self.size = (width, height)
        self.tip_id = self.model.site("tip").id
        self.target_id = self.model.site("target").id
        self.target_height = float(self.model.site("target").pos[2])
        self.renderer: mujoco.Renderer | None = None
        self.velocity = np.zeros(3)

    def reset(self, rng: np.random.Generator) -> None:
        """Begins an episode: the arm at rest at START, the cup at a random place on the table."""
        self.place(START, rng.uniform(*CUP_RANGE))

    def place(self, tip: np.ndarray, cup: np.ndarray) -> None:
        """Sets the positions of the tip and the cup and stops the arm, without simulating a movement."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.mocap_pos[0, :2] = cup
        self.data.qpos[:] = POSTURE
        self.velocity = np.zeros(3)
        # Newton's method: each pass moves the joints by the Jacobian's estimate for the remaining distance, which is
        # passed as a velocity for 1 s.
        for _ in range(100):
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            rest = tip - self.tip
            if np.linalg.norm(rest) < 1e-4 and np.linalg.norm(self.orientation_error()) < 1e-3:
                break
            self.data.qpos += self.joint_velocities(clip_length(rest, 0.1), orientation_gain=1.0)
        mujoco.mj_forward(self.model, self.data)

    def turn_joints(self, angles: np.ndarray) -> None:
        """Adds these angles to those of the joints, radians, without simulating a movement."""
        self.data.qpos += angles
        mujoco.mj_forward(self.model, self.data)

    def act(self, velocity: np.ndarray) -> None:
        """Sets the action: the velocity of the tip, m/s, limited to SPEED_LIMIT. The arm follows it until the next one."""
        self.velocity = clip_length(np.asarray(velocity, float), SPEED_LIMIT)

    def advance(self, seconds: float) -> None:
        """Simulates this time, in seconds, while the arm follows the last action. The time is rounded to whole steps of 2 ms."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            velocity = self.velocity.copy()
            # At the edge of the workspace, components of the velocity that lead outside become zero; the others stay.
            velocity[(self.tip <= WORKSPACE[0]) & (velocity < 0)] = 0
            velocity[(self.tip >= WORKSPACE[1]) & (velocity > 0)] = 0
            self.data.ctrl[:] = self.joint_velocities(velocity, ORIENTATION_GAIN)
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def joint_velocities(self, velocity: np.ndarray, orientation_gain: float) -> np.ndarray:
        """Returns the speeds of the joints, rad/s, that move the tip with this velocity and turn the hand so that it points down."""
        jacobian = np.zeros((6, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian[:3], jacobian[3:], self.tip_id)
        wanted = np.concatenate([velocity, orientation_gain * self.orientation_error()])
        # Damped least squares (Nakamura and Hanafusa 1986): near a singular posture the joints stay slow.
        damped = jacobian @ jacobian.T + DAMPING * np.eye(6)
        return jacobian.T @ np.linalg.solve(damped, wanted)

    def orientation_error(self) -> np.ndarray:
        """Returns the rotation that turns the hand until it points down and faces forward: a vector in radians, for small angles."""
        axes = self.data.site_xmat[self.tip_id].reshape(3, 3)
        return 0.5 * np.cross(axes.T, np.eye(3)).sum(axis=0)

    def render(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the pictures of the two cameras, [height, width, 3] of bytes in the order red, green, blue."""
        if self.renderer is None:
            # Created with the first picture, because an OpenGL context belongs to the thread that creates it.
            width, height = self.size
            self.model.vis.global_.offwidth, self.model.vis.global_.offheight = width, height
            try:
                self.renderer = mujoco.Renderer(self.model, height, width)
            except Exception as failure:
                raise RuntimeError(
                    f"cannot render pictures with MUJOCO_GL={os.environ['MUJOCO_GL']}: {failure}; {RENDERING_HINT}"
                ) from failure
        pictures = []
        for camera in CAMERAS:
            self.renderer.update_scene(self.data, camera)
            pictures.append(self.renderer.render().copy())
        return pictures[0], pictures[1]

    @property
    def tip(self) -> np.ndarray:
        """Position of the pen's tip, metres."""
        return self.data.site_xpos[self.tip_id].copy()

    @property
    def target(self) -> np.ndarray:
        """Position that the tip has to reach, above the middle of the cup's opening, metres."""
        return self.data.site_xpos[self.target_id].copy()

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, self.tip_id)
        return float(np.linalg.norm(jacobian @ self.data.qvel))

    @property
    def distance(self) -> float:
        """Distance from the tip to the target, metres."""
        return float(np.linalg.norm(self.target - self.tip))

    @property
    def success(self) -> bool:
        """Whether the tip rests at the target. A tip that only passes the target is too fast, so an oscillating arm has no success."""
        return self.distance < TOLERANCE and self.speed < RESTING_SPEED
