"""The four tasks of Section IV-A, and every setting of the simulated world.

`task_config` makes the Config of the world with these values, and `runtime/flags.py` that of the
learner:

|                  | flat         | rough    | velocity     | curriculum         | source         |
|------------------|--------------|----------|--------------|--------------------|----------------|
| reward           | Eq. (5)      | Eq. (6)  | Eq. (7)      | Eq. (8)            | [IV-A]         |
| command v_x      | 0 to 1 m/s   | as flat  | 0            | `curriculum.py`    | [IV-A]         |
| history H        | 5            | 10       | 10           | 5                  | [V-A, B, D]    |
| roughness        | 0            | to 15 cm | 5 cm         | to 5 cm            | [IV-A]         |
| noise cells / m  | -            | 1        | 4            | 4                  | [lab code]     |
| episode, steps   | 250          | 250      | 250          | 1000               | [ours] (D29)   |
| ends if touching | thigh and up | as flat  | all but feet | all but feet       | [ours, IV-A.3] |
| or on more than  | -            | -        | -            | 800 W              | [IV-A.4]       |
| motors           | PD           | PD       | PD, limit    | a model, 30 ms     | [IV-A.4], D11  |
| friction of feet | 0.5 to 1.25  | as flat  | as flat      | 0.1 to 1.25        | [ours]         |
| payload          | +- 1 kg      | as flat  | as flat      | -1 to 3 kg         | [ours]         |
| centre of mass   | 0            | 0        | 0            | +- 5 cm            | [ours]         |
| motor strength   | 1            | 1        | 1            | 0.9 to 1.1         | [lab code]     |
| motor offset     | 0            | 0        | 0            | +- 0.02 rad        | [lab code]     |
| added gravity    | 0            | 0        | 0            | +- 1 m/s^2         | [lab code]     |
| lambda_0         | 0.005        | 0.0002   | 0.0002       | 0.005              | [V-A, B, D, E] |
| iterations       | 600          | 600      | 1000         | 2000               | [ours] (D38)   |
| the paper's      | 4000         | 4000     | 10 000       | not stated         | [V-A, B, D]    |
| eta_alpha        | 0.5          | 0.01     | 0.01         | 0.5                | [IV-C] (D38)   |
| environments     | 256          | 256      | 128          | 256                | [ours]         |

"Thigh and up" are thighs, hips and trunk, which may not touch the ground, while calves and feet
may. The limit on the motors of `velocity` is that of Section V-D.

Our runs have 10 to 15 % of the paper's iterations. Where lambda_0 is large and pi would stand for
most of them, alpha takes longer steps than the paper's 0.01 (D38). The paper's settings are
`--iterations 4000 --lr-alpha 0.01`, with 10000 iterations on `velocity`.

What has a range is drawn anew for each episode, and the command twice in each. `velocity` needs
fewer environments, because there a robot that stands still earns nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import curriculum
import rewards


class Task(NamedTuple):
    """What makes a task of Section IV-A that task, as in the table at the top of this file."""

    reward: Callable  # of (velocity, command), Eqs. (5) to (8)
    world: dict  # fields of Config that differ from their defaults
    learner: dict  # fields of eipo.Config that differ from their defaults
    command_high: tuple = (0.0, 0.0, 0.0)  # v_x, v_y [m/s], yaw rate [rad/s], drawn from 0 to this
    # whether the feet alone may touch the ground; otherwise the calves may, too
    only_feet: bool = False
    torque_speed: bool = False  # whether the torque-speed limit of Section V-D holds
    curriculum: bool = False  # whether commands come from curriculum.py
    about: str = ""  # the task in a few words, for `train.py -h`


FORWARD = (1.0, 0.0, 0.0)
RANDOMISED = dict(
    friction=(0.1, 1.25),
    payload=(-1.0, 3.0),
    com=(-0.05, 0.05),
    motor_strength=(0.9, 1.1),
    motor_offset=(-0.02, 0.02),
    gravity=(-1.0, 1.0),
)
TASKS = {
    "flat": Task(
        rewards.flat,
        dict(history=5),
        dict(lam=0.005, iterations=600, lr_alpha=0.5),
        command_high=FORWARD,
        about="walk at up to 1 m/s on flat ground",
    ),
    "rough": Task(
        rewards.rough,
        dict(history=10, roughness=(0.0, 0.15), cells_per_m=1),
        dict(lam=0.0002, iterations=600),
        command_high=FORWARD,
        about="the same on hills of up to 15 cm",
    ),
    "velocity": Task(
        rewards.max_velocity,
        dict(history=10, roughness=(0.05, 0.05)),
        dict(lam=0.0002, iterations=1000, num_envs=128),
        only_feet=True,
        torque_speed=True,
        about="run as fast as possible on bumps of 5 cm",
    ),
    "curriculum": Task(
        rewards.curriculum,
        dict(
            history=5,
            roughness=(0.0, 0.05),
            motor_model=True,
            latency=6,
            max_power=800.0,
            episode_steps=1000,
            command_steps=500,
            **RANDOMISED,
        ),
        dict(lam=0.005, iterations=2000, lr_alpha=0.5),
        only_feet=True,
        curriculum=True,
        about="walk, run and turn as commanded, with commands that grow",
    ),
}


@dataclass(frozen=True)
class Config:
    """Settings of the world, with their sources. `task_config` sets what differs by task."""

    task: str = "flat"  # [IV-A] flat, rough, velocity or curriculum
    history: int = 5  # [V-A] H, how many of the latest frames the policy sees (D16)
    episode_steps: int = 250  # [ours] control steps, 5 s; evaluation: the paper's 1000 (D29)
    command_steps: int = 125  # [ours] control steps between two draws of the command (D29)
    timestep: float = 0.005  # [lab code] s, length of a physics step
    physics_steps: int = 4  # [lab code] physics steps per control step: 50 Hz
    clock_hz: float = 3.0  # [ours] Hz, frequency of the timing reference
    action_limit: float = 10.0  # [lab code] actions are clipped to +- this
    frame: str = "heading"  # [ours] of the velocity in Eqs. (5) to (8): "heading" or "body"
    clip: str = "power"  # [ours] what Eq. (9) clips at -3: "torque" as printed, or "power" (D3)
    noise: float = 1.0  # [lab code] factor on the noise of the observation
    roughness: tuple = (0.0, 0.0)  # [IV-A] m, from lowest to highest point: range over tiles
    cells_per_m: int = 4  # [lab code] cells of the Perlin noise per metre
    ground_seed: int = 0  # [ours] seed of the Perlin noise; evaluation has its own
    start_spread: float = 0.5  # [lab code] of the first joint angles and trunk velocity
    tiles: int = 16  # [ours] tiles of ground, from the least to the greatest roughness
    friction: tuple = (0.5, 1.25)  # [ours] sliding friction of the feet
    payload: tuple = (-1.0, 1.0)  # [ours] kg on the trunk
    com: tuple = (0.0, 0.0)  # [ours] m, shift of the trunk's centre of mass along each axis
    motor_strength: tuple = (1.0, 1.0)  # [lab code] factor on every torque of the robot
    motor_offset: tuple = (0.0, 0.0)  # [lab code] rad, error of each motor's zero
    gravity: tuple = (0.0, 0.0)  # [lab code] m/s^2, added to gravity along each axis
    motor_model: bool = False  # [IV-A.4] a model of the real motors instead of ideal PD (D11)
    latency: int = 0  # [lab code] physics steps by which a target reaches the motors late
    max_power: float | None = None  # [IV-A.4] W, above which an episode ends; none: no limit
    reward: str = "paper"  # [V-E] Eqs. (5) to (8), or "shaped", as in reference [5]
    aux: str = "energy"  # [V-E] the auxiliary cost: "energy", Eq. (9), or "smooth", Eq. (11)
    stagger: bool = True  # [lab code] first episodes start at random ages


def task_config(task="flat", **changes):
    """The Config of a task, with changes. Raises ValueError for an unknown task."""
    if task not in TASKS:
        raise ValueError(f"unknown task {task!r}: choose one of {', '.join(TASKS)}")
    return Config(**dict(task=task) | TASKS[task].world | changes)


def asks_speed(task):
    """Whether the commands of a task have a v_x."""
    return TASKS[task].curriculum or TASKS[task].command_high[0] > 0


def example(task):
    """A command (3,) to show a task with: its greatest one, on `curriculum` 1 m/s ahead."""
    return np.array(FORWARD if TASKS[task].curriculum else TASKS[task].command_high)


def trained(task):
    """The least and the greatest command (3,) [m/s, m/s, rad/s] that a task trains.

    On `curriculum` these are the ends of the grid, although no run has reached all of it.
    """
    if TASKS[task].curriculum:
        (x, yaw), (x_high, yaw_high), (y, y_high) = curriculum.LOW, curriculum.HIGH, curriculum.V_Y
        return np.array([x, y, yaw]), np.array([x_high, y_high, yaw_high])
    return np.zeros(3), np.array(TASKS[task].command_high)


def untrained(task, command):
    """What to say about a command (3,) that a task never trains, or "" about one that it trains."""
    low, high = trained(task)
    if ((low <= command) & (command <= high)).all():
        return ""
    ranges = ", ".join(
        f"{a:g} to {b:g}" if a < b else f"{a:g}" for a, b in zip(low, high, strict=True)
    )
    asked = ", ".join(f"{x:g}" for x in command)
    return f"the task {task} does not train the command {asked}, but {ranges}"
