"""The four tasks of Section IV-A, their commands, and every setting of the simulated world.

`TASKS` says what makes a task that task, `Config` holds the world's settings with their defaults,
and `task_config` puts both together. A setting that is a range is drawn anew for each episode, but
for `roughness`, which goes from tile to tile.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.ndimage import convolve

import rewards

# ---- commands ----


class Commands:
    """What robots are asked to do."""

    example = np.zeros(3)  # play.py gives this command, evaluate.py 0, 1/10, ... 1 of it
    low = high = np.zeros(3)  # ends of commands, and of the viewer's sliders
    learns = False  # whether `record` does anything
    weights = np.zeros(0)  # what was learned

    def start(self):
        """Forget what was learned."""

    def draw(self, rng, robots):
        """New commands (n, 3) [m/s, m/s, rad/s] for n robots, which are given by their numbers."""

    def record(self, command, kernels):
        """Learn how well n commands were followed; kernels: (n, 2) means of those of Eq. (8)."""


class Range(Commands):
    """Commands that are drawn uniformly, each component between 0 and its greatest value."""

    def __init__(self, *greatest):
        """greatest: v_x, v_y [m/s] and yaw rate [rad/s]"""
        self.example = np.array(greatest, float)
        self.low, self.high = np.minimum(self.example, 0), np.maximum(self.example, 0)

    def draw(self, rng, robots):
        """As in `Commands`."""
        return rng.uniform(self.low, self.high, (len(robots), 3))


class Given(Commands):
    """Commands that somebody gives, one for each robot."""

    def __init__(self, command):
        """command: (N, 3) [m/s, m/s, rad/s]. It may be changed in place."""
        self.command = command

    def draw(self, rng, robots):
        """The commands (n, 3) of these robots."""
        return self.command[robots]


class Grid(Commands):
    """Commands that grow with what the robot can do: Section IV-A.4, after reference [5].

    Each cell of a grid over forward velocity and yaw rate has a weight. At first it is 1 where both
    are within [-1, 1], and 0 elsewhere. Commands are drawn from the cells in proportion to their
    weights. A robot that followed its command well for ten seconds raises the weight of the
    command's cell and of the eight around it. (After a fall nothing more is earned, and what was
    earned may suffice.) So the region of commands grows at its edge, in the directions in which the
    robot is already good. Weights never fall.
    """

    # ends of v_x [m/s], v_y [m/s] and yaw rate [rad/s]; v_y is drawn from all of it from the start
    low, high = np.array([-1.0, -0.6, -10.0]), np.array([10.0, 0.6, 10.0])
    learns = True
    START = 1.0  # m/s and rad/s: commands within +- this at first
    CELL = 0.5  # m/s and rad/s, side of a cell [ours; the lab has 0.4]
    # a success adds this to its cell and the neighbours, and once more to its cell [lab code]
    BONUS = 0.2
    # in a success the means of the two kernels of Eq. (8) are above these [lab code]
    LINEAR, ANGULAR = 0.8, 0.5
    SMALL = 0.2  # m/s, a shorter command (v_x, v_y) becomes 0 [lab code]
    example = np.array([1.0, 0.0, 0.0])

    def __init__(self):
        self.weights = np.zeros((22, 40))  # [-] of the cells: 11 m/s and 20 rad/s over CELL
        self.start()

    def start(self):
        """Set the weights to 1 within +- START and to 0 elsewhere."""
        x, yaw = (np.arange(self.low[i], self.high[i], self.CELL) + self.CELL / 2 for i in (0, 2))
        self.weights[:] = (np.abs(x)[:, None] < self.START) & (np.abs(yaw) < self.START)

    def draw(self, rng, robots):
        """New commands (n, 3) [m/s, m/s, rad/s] for n robots.

        A cell is drawn in proportion to its weight, then v_x and yaw rate uniformly within the
        cell, and v_y from all of its range.
        """
        n = len(robots)
        index = rng.choice(self.weights.size, n, p=self.weights.ravel() / self.weights.sum())
        cell = np.column_stack(np.unravel_index(index, self.weights.shape))
        x, yaw = (self.low[[0, 2]] + self.CELL * (cell + rng.uniform(size=(n, 2)))).T
        planar = np.column_stack([x, rng.uniform(self.low[1], self.high[1], n)])
        planar[np.linalg.norm(planar, axis=1) < self.SMALL] = 0.0
        return np.column_stack([planar, yaw])

    def record(self, command, kernels):
        """Raise the weights, up to 1, of commands (n, 3) that were followed well, and around them.

        kernels: (n, 2) means of both kernels of Eq. (8) over the time that a command was to last
        """
        success = (kernels > [self.LINEAR, self.ANGULAR]).all(-1)
        cell = np.floor((command[success][:, [0, 2]] - self.low[[0, 2]]) / self.CELL).astype(int)
        hits = np.zeros_like(self.weights)
        np.add.at(hits, tuple(cell.T), 1.0)
        gain = self.BONUS * (hits + convolve(hits, np.ones((3, 3)), mode="constant"))
        self.weights[:] = np.minimum(self.weights + gain, 1.0)


# ---- the tasks ----


class Task(NamedTuple):
    """What makes a task of Section IV-A that task."""

    about: str  # the task in a few words, for `train.py -h`
    reward: Callable  # of (velocity, command), Eqs. (5) to (8)
    commands: Callable  # makes the object that draws commands
    world: dict  # fields of Config that the task sets
    learner: dict  # fields of eipo.Config that the task sets
    # whether the feet alone may touch the ground; otherwise the calves may, too
    only_feet: bool = False
    # whether the torque-speed limit of Section V-D holds; with motor_model it does anyway
    torque_speed: bool = False


LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10), the weights of PPO
ITERATIONS = dict(flat=4000, rough=4000, velocity=10_000)  # of the paper's runs [V-A], [V-B], [V-D]


def alpha_clock(k):
    """Alpha's step and momentum in a run that is k times shorter than the paper's, which has 0.01
    and 0.99: the clock runs k times faster (D38).
    """
    return dict(lr_alpha=round(0.01 * k**2, 3), momentum_alpha=round(1 - 0.01 * k, 3))


TASKS = {
    "flat": Task(
        "walk at up to 1 m/s on flat ground",
        reward=rewards.flat,  # Eq. (5)
        commands=lambda: Range(1.0, 0.0, 0.0),  # [IV-A.1]
        world=dict(history=5),  # [V-A]
        learner=dict(
            lam=0.005,  # [V-A]
            iterations=600,  # [ours]
            **alpha_clock(ITERATIONS["flat"] / 600),  # [V-A]
        ),
    ),
    "rough": Task(
        "the same on hills of up to 15 cm",
        reward=rewards.rough,  # Eq. (6)
        commands=lambda: Range(1.0, 0.0, 0.0),  # [IV-A.2]
        world=dict(
            history=10,  # [V-B]
            roughness=(0.0, 0.15),  # [IV-A.2]
            cells_per_m=1,  # [lab code] (D22)
        ),
        learner=dict(
            lam=0.0002,  # [V-B]
            iterations=600,  # [ours]
            **alpha_clock(ITERATIONS["rough"] / 600),  # [V-B]
        ),
    ),
    "velocity": Task(
        "run as fast as possible on bumps of 5 cm",
        reward=rewards.max_velocity,  # Eq. (7)
        commands=lambda: Range(0.0, 0.0, 0.0),  # [IV-C.a]
        world=dict(
            history=10,  # [V-D]
            roughness=(0.05, 0.05),  # [IV-A.3]
        ),
        learner=dict(
            lam=0.0002,  # [V-D]
            iterations=1000,  # [ours]
            **alpha_clock(ITERATIONS["velocity"] / 1000),  # [V-D]
            num_envs=128,  # [ours] (D9)
        ),
        only_feet=True,  # [IV-A.3]
        torque_speed=True,  # [V-D]
    ),
    "curriculum": Task(
        "walk, run and turn as commanded, with commands that grow",
        reward=rewards.curriculum,  # Eq. (8)
        commands=Grid,  # [IV-A.4]
        world=dict(
            history=5,  # [ours] that of `flat`
            roughness=(0.0, 0.05),  # [IV-A.4]
            motor_model=True,  # [IV-A.4], D11
            latency=6,  # [lab code] 30 ms
            max_power=800.0,  # [IV-A.4]
            episode_steps=1000,  # [V-A]
            command_steps=500,  # [lab code] ten seconds
            # "increased domain randomization" [IV-A.4], which prints no ranges (D24)
            friction=(0.55, 1.25),  # [ours] (D43)
            payload=(-1.0, 3.0),  # [lab code]
            com=(-0.05, 0.05),  # [ours] the lab has up to 0.2
            motor_strength=(0.9, 1.1),  # [lab code]
            motor_offset=(-0.02, 0.02),  # [lab code]
            gravity=(-1.0, 1.0),  # [lab code]
        ),
        learner=dict(
            lam=0.005,  # [V-E]
            iterations=2000,  # [ours]
            **alpha_clock(ITERATIONS["flat"] / 600),  # [ours] as no length is printed
        ),
        only_feet=True,  # [IV-A.4]
    ),
}


@dataclass(frozen=True)
class Config:
    """Settings of the world, with their sources. `task_config` sets what differs by task."""

    task: str = "flat"  # [IV-A] flat, rough, velocity or curriculum
    history: int = 5  # [V-A] H, how many of the latest frames the policy sees (D16)
    episode_steps: int = 250  # [ours] control steps of 20 ms after which an episode is over (D29)
    command_steps: int = 125  # [ours] control steps after which a robot gets another command (D29)
    timestep: float = 0.005  # [lab code] s, length of a physics step
    physics_steps: int = 4  # [lab code] physics steps in a control step, which makes 50 Hz
    clock_hz: float = 3.0  # [ours] Hz, frequency of the timing reference that the policy sees
    action_limit: float = 10.0  # [lab code] the policy's actions are clipped to +- this
    velocity_frame: Literal["heading", "body"] = "heading"  # [ours] level, or the trunk's own (D25)
    clip: Literal["power", "torque"] = "power"  # [ours] what Eq. (9) clips at -3 (D3)
    noise: float = 1.0  # [lab code] factor on the noise of the observation
    roughness: tuple = (0.0, 0.0)  # [IV-A] m, from lowest to highest point: range over the tiles
    cells_per_m: int = 4  # [lab code] cells of the Perlin noise per metre; fewer make wider hills
    ground_seed: int = 0  # [ours] seed of the Perlin noise; evaluation has its own
    start_spread: float = 0.5  # [lab code] of the start: share of joint angles, m/s and rad/s (D35)
    tiles: int = 16  # [ours] tiles of ground, from the least to the greatest roughness
    friction: tuple = (0.5, 1.25)  # [lab code] range of the sliding friction of the feet (D43)
    payload: tuple = (-1.0, 1.0)  # [lab code] kg, range of the load on the trunk
    com: tuple = (0.0, 0.0)  # [ours] m, range of the shift of the trunk's centre of mass in x, y, z
    motor_strength: tuple = (1.0, 1.0)  # [lab code] range of the factor on all torques of a robot
    motor_offset: tuple = (0.0, 0.0)  # [lab code] rad, range of the error of each motor's zero
    gravity: tuple = (0.0, 0.0)  # [lab code] m/s^2, range of what is added to gravity in x, y, z
    motor_model: bool = False  # [IV-A.4] a model of the real motors instead of ideal PD (D11)
    latency: int = 0  # [lab code] physics steps until a joint target reaches the motors
    max_power: float | None = None  # [IV-A.4] W, an episode ends above it; inf: no limit
    reward: Literal["paper", "shaped"] = "paper"  # [V-E] Eqs. (5) to (8), or that of [5]
    aux: Literal["energy", "smooth"] = "energy"  # [V-E] auxiliary cost: Eq. (9), or Eq. (11)
    stagger: bool = True  # [lab code] first episodes start at random ages, so that few end at once


def task_config(task="flat", **changes):
    """The Config of a task, with changes."""
    return Config(**dict(task=task) | TASKS[task].world | changes)
