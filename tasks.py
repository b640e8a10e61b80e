"""The four tasks of Section IV-A, and every setting of the simulated world.

`task_config` makes the Config of the world with these values, and `runtime/flags.py` that of the learner:

|                   | flat              | rough      | velocity     | curriculum                  | source            |
|-------------------|-------------------|------------|--------------|-----------------------------|-------------------|
| reward            | Eq. (5)           | Eq. (6)    | Eq. (7)      | Eq. (8)                     | [IV-A]            |
| command v_x       | 0 to 1 m/s        | as flat    | 0            | `curriculum.py`             | [IV-A], [IV-C.a]  |
| history H         | 5                 | 10         | 10           | 5 (D24)                     | [V-A, B, D]       |
| roughness         | 0                 | 0 to 15 cm | 5 cm         | 0 to 5 cm                   | [IV-A]            |
| noise cells per m | -                 | 1 (D22)    | 4            | 4                           | [lab code]        |
| episode (D29)     | 250 steps         | as flat    | as flat      | 1000 steps                  | [ours], [lab code] |
| ends if it touches | trunk, hip, thigh | as flat   | all but feet | all but feet, or above 800 W | D13, [IV-A.3, 4] |
| motors            | PD                | PD         | PD, limit of V-D | model (D11), 30 ms late | [IV-A.4], [V-D]   |
| noise             | `go1_env.py`      | as flat    | as flat      | as flat                     | [lab code]        |
| friction of feet  | 0.5 to 1.25 (D34) | as flat    | as flat      | 0.1 to 1.25 (D24)           | [ours]            |
| payload on trunk  | +- 1 kg (D34)     | as flat    | as flat      | -1 to 3 kg                  | [ours], [lab code] |
| centre of mass    | 0                 | 0          | 0            | +- 5 cm                     | [ours]            |
| motor strength    | 1                 | 1          | 1            | 0.9 to 1.1                  | [lab code]        |
| motor offset      | 0                 | 0          | 0            | +- 0.02 rad                 | [lab code]        |
| added gravity     | 0                 | 0          | 0            | +- 1 m/s^2 along each axis  | [lab code]        |
| lambda_0          | 0.005             | 0.0002     | 0.0002       | 0.005                       | [V-A, B, D, E]    |
| iterations (D38)  | 600               | 600        | 1000         | 2000                        | [ours]            |
| the paper's       | 4000              | 4000       | 10 000       | not stated                  | [V-A, B, D]       |
| eta_alpha, momentum | 0.5, 0.99       | as flat    | 1, 0.9       | as flat                     | [ours]            |
| environments      | 256               | 256        | 128          | 256                         | [ours]            |

Our runs have 10 to 15 % of the paper's iterations, and alpha takes longer steps to make up for it (D38). The paper's
settings are `--iterations 4000 --lr-alpha 0.01 --momentum-alpha 0.99`, with 10000 iterations on `velocity`.

What has a range is drawn anew for each episode, and the command twice in each. `velocity` needs fewer environments,
because there a robot that stands still earns nothing (D9).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import curriculum
import rewards


class Task(NamedTuple):
    """What makes a task of Section IV-A that task, as in the table at the top of this file."""

    reward: Callable
    world: dict  # fields of Config that differ from their defaults
    learner: dict  # fields of eipo.Config that differ from their defaults
    command_high: tuple = (0.0, 0.0, 0.0)  # v_x, v_y [m/s], yaw rate [rad/s], drawn from 0 to this
    only_feet: bool = False  # whether the feet alone may touch the ground; otherwise the calves may, too (D13)
    torque_speed: bool = False  # whether the torque-speed limit of Section V-D holds
    curriculum: bool = False  # whether commands come from curriculum.py
    about: str = ""  # the task in a few words, for `train.py -h`


FORWARD = (1.0, 0.0, 0.0)
RANDOMISED = dict(friction=(0.1, 1.25), payload=(-1.0, 3.0), com=(-0.05, 0.05), motor_strength=(0.9, 1.1),
                  motor_offset=(-0.02, 0.02), gravity=(-1.0, 1.0))  # fmt: skip
TASKS = {
    "flat": Task(rewards.flat, dict(history=5), dict(lam=0.005, iterations=600), command_high=FORWARD,
                 about="walk at up to 1 m/s on flat ground"),
    "rough": Task(rewards.rough, dict(history=10, roughness=(0.0, 0.15), cells_per_m=1),
                  dict(lam=0.0002, iterations=600), command_high=FORWARD, about="the same on hills of up to 15 cm"),
    "velocity": Task(rewards.max_velocity, dict(history=10, roughness=(0.05, 0.05)),
                     dict(lam=0.0002, iterations=1000, num_envs=128, lr_alpha=1.0, momentum_alpha=0.9),
                     only_feet=True, torque_speed=True,
                     about="run as fast as possible on bumps of 5 cm"),
    "curriculum": Task(rewards.curriculum, dict(history=5, roughness=(0.0, 0.05), motor_model=True, latency=6,
                       max_power=800.0, episode_steps=1000, command_steps=500, **RANDOMISED),
                       dict(lam=0.005, iterations=2000), only_feet=True, curriculum=True,
                       about="walk, run and turn as commanded, with commands that grow"),
}  # fmt: skip


@dataclass(frozen=True)
class Config:
    """Settings of the world. A field's tag says where its value comes from; `task_config` sets what differs by task."""

    task: str = "flat"  # [IV-A] flat, rough, velocity or curriculum
    history: int = 5  # [V-A] H, number of the latest observations that the policy sees (D16)
    episode_steps: int = 250  # [ours] control steps, 5 s; the evaluation plays the paper's 1000 (D29)
    command_steps: int = 125  # [ours] control steps between two draws of the command, 2.5 s; the lab: 10 s (D29)
    timestep: float = 0.005  # [lab code] s, length of a physics step
    physics_steps: int = 4  # [lab code] physics steps per control step: 50 Hz
    clock_hz: float = 3.0  # [ours] Hz, frequency of the timing reference (D14)
    action_limit: float = 10.0  # [lab code] actions are clipped to +- this
    frame: str = "heading"  # [ours] of velocity in Eqs. (5) to (8): "heading", which is over ground, or "body" (D25)
    clip: str = "power"  # [ours] what Eq. (9) clips at -3: "torque" as printed, or each joint's "power" (D3)
    noise: float = 1.0  # [lab code] factor on the noise of the observation
    roughness: tuple = (0.0, 0.0)  # [IV-A] m, range over tiles of the height from lowest to highest point; 0: plane
    cells_per_m: int = 4  # [lab code] cells of the Perlin noise per metre (D22)
    ground_seed: int = 0  # [ours] seed of the Perlin noise; the evaluation has ground of its own
    start_spread: float = 0.5  # [lab code] spread of starting joint angles (relative), trunk m/s and rad/s (D35)
    tiles: int = 16  # [ours] number of tiles, from the least to the greatest roughness; an episode draws one
    friction: tuple = (0.5, 1.25)  # [ours] range of the feet's sliding friction, drawn per episode (D34)
    payload: tuple = (-1.0, 1.0)  # [ours] kg, range of the mass added to the trunk, drawn per episode (D34)
    com: tuple = (0.0, 0.0)  # [ours] m, range of a shift of the trunk's centre of mass along each axis
    motor_strength: tuple = (1.0, 1.0)  # [lab code] range of a factor on every torque of the robot
    motor_offset: tuple = (0.0, 0.0)  # [lab code] rad, range of an error in where each motor's zero is
    gravity: tuple = (0.0, 0.0)  # [lab code] m/s^2, range added to gravity along each axis (the lab: anew every 8 s)
    motor_model: bool = False  # [IV-A.4] a model of the real motors (D11), not an ideal PD controller
    latency: int = 0  # [lab code] physics steps by which a joint target reaches the motors late
    max_power: float | None = None  # [IV-A.4] W, more power in a control step ends the episode (D17); none: no limit
    reward: str = "paper"  # [V-E] the task reward: "paper", Eqs. (5) to (8), or "shaped", as in reference [5]
    aux: str = "energy"  # [V-E] the auxiliary cost: "energy", Eq. (9), or "smooth", Eq. (11)
    stagger: bool = True  # [lab code] first episodes start at random ages, so that they do not all end at once


def task_config(task="flat", **changes):
    """The Config of a task, with changes. Raises ValueError for an unknown task."""
    if task not in TASKS:
        raise ValueError(f"unknown task {task!r}: choose one of {', '.join(TASKS)}")
    return Config(**dict(task=task) | TASKS[task].world | changes)


def asks_speed(task):
    """Whether the commands of a task have a v_x."""
    return TASKS[task].curriculum or TASKS[task].command_high[0] > 0


def example(task):
    """A command (3,) [m/s, m/s, rad/s] to show a task with: its greatest one, or 1 m/s ahead on `curriculum`."""
    return np.array(FORWARD if TASKS[task].curriculum else TASKS[task].command_high)


def untrained(task, command):
    """What to say about a command (3,) [m/s, m/s, rad/s] that a task never trains, or "" about one that it trains.

    On `curriculum` the whole grid counts as trained, although no run has reached all of it.
    """
    low, high = np.zeros(3), np.array(TASKS[task].command_high)
    if TASKS[task].curriculum:
        (x, yaw), (x_high, yaw_high), (y, y_high) = curriculum.LOW, curriculum.HIGH, curriculum.V_Y
        low, high = np.array([x, y, yaw]), np.array([x_high, y_high, yaw_high])
    if ((low <= command) & (command <= high)).all():
        return ""
    ranges = ", ".join(f"{a:g} to {b:g}" if a < b else f"{a:g}" for a, b in zip(low, high, strict=True))
    return f"the task {task} does not train the command {', '.join(f'{x:g}' for x in command)}, but {ranges}"
