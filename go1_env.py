"""The Unitree Go1 as a batched Markov decision process: NumPy around `mujoco.batch`.

Sections IV-A to IV-C of the paper. `Go1Env` steps `num_envs` robots at once on C++ threads; the results are the
same bits for any number of threads. It follows Gymnasium's vector conventions without the dependency:
`reset(seed) -> obs, info` and `step(action) -> obs, reward, terminated, truncated, info`, with same-step autoreset:
where an episode ended, `obs` is the first observation of the next one and `info["final_obs"]` the last of the old.

One frame of the observation, in this order. The policy sees the last H frames, oldest first (D16); after a reset
all of them are the first one. Only quantities that the robot can measure:

| entry                | width | unit    | scale      | noise +- (before scale)                                  |
|----------------------|-------|---------|------------|----------------------------------------------------------|
| gravity, body frame  | 3     | -       | 1          | 0.05                                                     |
| command              | 3     | m/s, rad/s | 2, 2, 0.25 | 0                                                     |
| q - q_nominal        | 12    | rad     | 1          | 0.01                                                     |
| qd                   | 12    | rad/s   | 0.05       | 1.5                                                      |
| previous action      | 12    | -       | 1          | 0                                                        |
| timing reference     | 2     | -       | 1          | 0: sin and cos of one 3 Hz clock (D14), no gait prescribed |

Joints and legs: FR, FL, RR, RL x hip, thigh, calf. Scales and noise are the lab's (D5).

What differs between the tasks and what does not; `task_config` makes the Config with the paper's values:

|                   | flat                    | rough         | velocity     | source                               |
|-------------------|-------------------------|---------------|--------------|--------------------------------------|
| reward            | Eq. (5)                 | Eq. (6)       | Eq. (7)      | [IV-A]                               |
| command v_x       | 0 to 1 m/s              | 0 to 1 m/s    | 0            | [V-A]; velocity: [lab code]          |
| history H         | 5                       | 10            | 10           | [V-A], [V-B], [V-D]                  |
| roughness         | 0                       | 0 to 15 cm    | 5 cm         | [IV-A], drawn per episode            |
| a fall: ground at | trunk, hip, thigh       | as flat       | all but feet | D13; velocity: [IV-A.3]              |
| torque by speed   | no                      | no            | yes          | [V-D], before every physics step     |
| noise             | as above                | as flat       | as flat      | [lab code]                           |
| drawn per episode | friction 0.5 - 1.25, trunk +- 1 kg | as flat | as flat | [ours]                          |

This file knows nothing of learning, and nothing here depends on the learner.
"""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.spatial.transform import Rotation

import actuators
import energy
import go1
import rewards
import terrain

ACTION_SCALE = 0.25 * np.tile([0.5, 1.0, 1.0], 4)  # rad per unit of action, hips half [lab code]
FRAME = dict(gravity=3, command=3, q=12, qd=12, previous_action=12, timing=2)
FRAME_WIDTH = sum(FRAME.values())
FRAME_SCALE = np.repeat([1, 2, 2, 0.25, 1, 0.05, 1, 1], [3, 1, 1, 1, 12, 12, 12, 2])
FRAME_NOISE = np.repeat([0.05, 0, 0.01, 1.5, 0], [3, 3, 12, 12, 14])


class Task(NamedTuple):
    """What makes a task of Section IV-A that task, in the order of the table at the top of this file."""

    reward: Callable
    command_low: tuple = (0.0, 0.0, 0.0)  # v_x, v_y [m/s], yaw rate [rad/s]
    command_high: tuple = (0.0, 0.0, 0.0)
    only_feet: bool = False  # may touch the ground; if not, the calves may as well
    torque_speed: bool = False  # limit of Section V-D
    history: int = 5
    roughness: tuple = (0.0, 0.0)


FORWARD = (1.0, 0.0, 0.0)
TASKS = {
    "flat": Task(rewards.flat, command_high=FORWARD),
    "rough": Task(rewards.rough, command_high=FORWARD, history=10, roughness=(0.0, 0.15)),
    "velocity": Task(rewards.max_velocity, history=10, roughness=(0.05, 0.05), only_feet=True, torque_speed=True),
}


@dataclass(frozen=True)
class Config:
    """What the world is like. Every field says where its value comes from."""

    task: str = "flat"  # [IV-A] one of TASKS
    history: int = 5  # [V-A] H, frames of observation that the policy sees
    episode_steps: int = 1000  # [V-A] control steps, 20 s
    command_steps: int = 500  # [lab code] control steps between two draws of the command, 10 s
    timestep: float = 0.005  # [lab code] s, one physics step
    physics_steps: int = 4  # [lab code] physics steps per control step: 50 Hz
    clock_hz: float = 3.0  # [ours] D14, frequency of the timing reference
    action_limit: float = 10.0  # [lab code] actions are clipped to +- this
    clip: str = "power"  # [ours] what Eq. (9) clips at -3: "torque" as printed, or each joint's "power" (D3)
    noise: float = 1.0  # [lab code] factor on the noise of the observation
    roughness: tuple = (0.0, 0.0)  # [IV-A] m, range of the ground's height from lowest to highest point; 0 is a plane
    cells_per_m: int = 4  # [lab code] of the Perlin noise (D22)
    octaves: int = 1  # [lab code] of the Perlin noise (D22)
    tiles: int = 16  # [ours] of the ground, from the least to the greatest roughness; an episode draws one
    friction: tuple = (0.5, 1.25)  # [ours] range of the feet's sliding friction, drawn per episode
    payload: tuple = (-1.0, 1.0)  # [ours] kg, range of the mass added to the trunk, drawn per episode
    stagger: bool = True  # [lab code] first episodes start at random ages, so that they do not all end at once


def task_config(task="flat", **changes):
    """The Config that the paper sets for a task, with changes. Raises ValueError for an unknown task."""
    if task not in TASKS:
        raise ValueError(f"unknown task {task!r}: choose one of {', '.join(TASKS)}")
    return Config(**dict(task=task, history=TASKS[task].history, roughness=TASKS[task].roughness) | changes)


class Go1Env:
    """`num_envs` Go1 robots on one task.

    num_envs: N, at least 1
    config:   see Config
    threads:  C++ threads; 0 takes every core that this process may use
    Raises ValueError for an unknown task, a non-positive count or a malformed range.
    """

    action_size = 12
    privileged_size = 3  # true body velocity: the critic sees it, the estimator learns it

    def __init__(self, num_envs, config=Config(), threads=0):
        check(num_envs, config, threads)
        self.num_envs, self.config, self.task = num_envs, config, TASKS[config.task]
        self.obs_size = config.history * FRAME_WIDTH
        # MuJoCo would write MUJOCO_LOG.TXT into the user's folder; we count its warnings instead (see step)
        mujoco.set_mju_user_warning(lambda message: None)
        self.ground = None  # a plane
        if config.roughness[1] > 0:
            low, high = config.roughness
            levels = np.linspace(high, low, config.tiles)[::-1]  # a single tile is a rough one
            self.ground = terrain.make_ground(levels, cells_per_m=config.cells_per_m, octaves=config.octaves)
        model = go1.build_model(config.timestep, self.ground)
        self.joint_range = model.jnt_range[1:].T  # (2, 12) rad, without the free joint of the trunk
        self.trunk, self.trunk_mass = model.body("trunk").id, model.body("trunk").mass[0]
        self.feet = [model.geom(f"{leg}_foot").id for leg in go1.LEGS]
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        self.batch = batch = Batch(model, num_envs, threads or cores)
        self.qpos, self.qvel, self.ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self.contacts = batch.bind("sensordata")  # (N, 13) contacts of trunk, hips, thighs; calves with the ground
        self.forbidden = slice(None if self.task.only_feet else -4)
        self.friction, self.mass = batch.expand("geom_friction"), batch.expand("body_mass")
        self.frames = np.zeros((num_envs, config.history, FRAME_WIDTH), np.float32)
        self.action = np.zeros((num_envs, 12))
        self.command = np.zeros((num_envs, 3))
        self.age = np.zeros(num_envs, np.int64)  # control steps since the episode began
        self.tile = np.zeros(num_envs, np.int64)  # of the ground, where the episode takes place
        self.rng = np.random.default_rng(0)

    def reset(self, seed, command=None):
        """Start every episode anew; returns obs, info (see step).

        seed: int or numpy SeedSequence; command: (N, 3) [m/s, m/s, rad/s] of the first episodes instead of a draw
        """
        self.rng = np.random.default_rng(seed)
        everyone = np.arange(self.num_envs)
        self._reset(everyone)
        if self.config.stagger:
            self.age[:] = self.rng.integers(self.config.episode_steps, size=self.num_envs)
        if command is not None:
            self.command[:] = command
        if self.config.stagger or command is not None:
            self.frames[:] = self._frame(everyone)[:, None]
        return self._obs(), {"privileged": self._velocity()[0]}

    def step(self, action):
        """One control step of 20 ms for every robot.

        action:  (N, 12) [-] joint targets, as q_nominal + ACTION_SCALE * action
        returns  obs (N, obs_size), reward (N,) Eqs. (5)-(8), terminated (N,), truncated (N,), info:
                 cost (N,) [W] Eq. (9), mean of the physics steps (D17); privileged (N, 3) [m/s] body velocity;
                 final_obs, final_privileged: the same before autoreset, to be used where an episode ended;
                 log: what is worth a column in metrics.csv, floats to be averaged and booleans to be counted
        """
        self.action[:] = np.clip(action, -self.config.action_limit, self.config.action_limit)
        power, fell = self._physics(go1.Q_NOMINAL + ACTION_SCALE * self.action)
        self.age += 1
        linear, yaw_rate = self._velocity()
        # MuJoCo resets what is not finite and counts a warning
        diverged = self.batch.warning[..., 1].any(-1)
        self.action[diverged] = 0.0  # it may be what was not finite
        terminated = diverged | fell
        truncated = ~terminated & (self.age >= self.config.episode_steps)
        reward = np.where(diverged, 0.0, self.task.reward(np.column_stack([linear[:, :2], yaw_rate]), self.command))
        power = np.where(diverged, energy.SURVIVAL, power)  # a cost of 0
        self._stay_on_tile()
        log = dict(v_x=linear[:, 0], command_x=self.command[:, 0].copy(), power=power, ended_fall=fell & ~diverged,
                   ended_diverged=diverged, ended_limit=truncated)  # fmt: skip
        self._draw_commands(np.flatnonzero(self.age % self.config.command_steps == 0))
        self.frames[:, :-1] = self.frames[:, 1:]
        self.frames[:, -1] = self._frame(np.arange(self.num_envs))
        info = dict(cost=power - energy.SURVIVAL, log=log, final_obs=self._obs(), final_privileged=linear)
        ended = np.flatnonzero(terminated | truncated)
        if ended.size:
            self._reset(ended)
            linear, _ = self._velocity()
        return self._obs(), reward, terminated, truncated, info | {"privileged": linear}

    def state(self):
        """Everything that the next step depends on, as a dict of arrays: what a checkpoint stores."""
        rng = np.array(json.dumps(self.rng.bit_generator.state))
        return {name: getattr(self, name).copy() for name in self._state} | dict(sim=self.batch.state.copy(), rng=rng)

    def load(self, state):
        """Continue from `state()`, with the same bits as if never stopped."""
        for name in self._state:
            getattr(self, name)[:] = state[name]
        self.batch.state[:] = state["sim"]
        self.batch.set_const()  # what MuJoCo derives from the masses
        self.rng.bit_generator.state = json.loads(str(state["rng"]))

    _state = ("frames", "action", "command", "age", "tile", "friction", "mass")

    def _physics(self, target):
        """Apply joint targets for one control step: mean power of its physics steps [W], and who fell.

        To fall is to touch the ground with trunk, hip or thigh (D13), on the task `velocity` with anything but a foot.
        Contacts are those that a physics step started from, as MuJoCo reports them: the last state is not seen.
        """
        power, fell = np.zeros(self.num_envs), np.zeros(self.num_envs, bool)
        for _ in range(self.config.physics_steps):
            q, qd = self.qpos[:, 7:], self.qvel[:, 6:]
            torque = actuators.limit_torque(actuators.pd_torque(target, q, qd), qd, self.task.torque_speed)
            power += energy.total_power(torque, qd, self.config.clip)
            self.ctrl[:] = torque
            self.batch.step()
            fell |= (self.contacts[:, self.forbidden] > 0).any(-1)
        return power / self.config.physics_steps, fell

    def _stay_on_tile(self):
        """Who left the tile comes back on the other side, where the ground goes on: nothing else changes."""
        if self.ground is not None:
            self.qpos[:, :2] = terrain.wrap(self.qpos[:, :2], self.tile)

    def _velocity(self):
        """True velocity of the trunk in its own frame: linear (N, 3) [m/s] and yaw rate (N,) [rad/s]."""
        to_world = Rotation.from_quat(self.qpos[:, 3:7], scalar_first=True)
        return to_world.apply(self.qvel[:, :3], inverse=True), self.qvel[:, 5].copy()

    def _frame(self, ids):
        """One frame of the observation (n, FRAME_WIDTH), as in the table at the top of this file."""
        to_world = Rotation.from_quat(self.qpos[ids, 3:7], scalar_first=True)
        phase = 2 * np.pi * self.config.clock_hz * self.config.timestep * self.config.physics_steps * self.age[ids]
        frame = np.column_stack([
            to_world.apply([0.0, 0.0, -1.0], inverse=True),  # gravity
            self.command[ids],
            self.qpos[ids, 7:] - go1.Q_NOMINAL,  # q
            self.qvel[ids, 6:],  # qd
            self.action[ids],  # previous action
            np.sin(phase), np.cos(phase),  # timing reference
        ])  # fmt: skip
        noise = self.config.noise * FRAME_NOISE * self.rng.uniform(-1.0, 1.0, frame.shape)
        return FRAME_SCALE * (frame + noise)

    def _obs(self):
        """The policy's observation: a copy of the history, flattened, (N, H * FRAME_WIDTH) float32."""
        return self.frames.reshape(self.num_envs, -1).copy()

    def _draw_commands(self, ids):
        """New commands [m/s, m/s, rad/s] for the robots `ids`, uniform in the task's range."""
        self.command[ids] = self.rng.uniform(self.task.command_low, self.task.command_high, (len(ids), 3))

    def _reset(self, ids):
        """Begin new episodes for the robots `ids`: pose, velocity, physical parameters, command, history."""
        n, uniform = len(ids), self.rng.uniform
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        q = np.clip(go1.Q_NOMINAL * uniform(0.5, 1.5, (n, 12)), *self.joint_range)  # [lab code]
        yaw = Rotation.from_rotvec(uniform(-np.pi, np.pi, n)[:, None] * [0.0, 0.0, 1.0])
        points = np.einsum("nij,nkj->nki", yaw.as_matrix(), go1.leg_points(q))
        xy, ground = np.zeros((n, 2)), 0.0
        if self.ground is not None:
            self.tile[ids] = self.rng.integers(self.config.tiles, size=n)
            xy = terrain.origin(self.tile[ids]) + uniform(0.0, terrain.TILE, (n, 2))
            ground = terrain.height(self.ground, xy[:, None] + points[..., :2])
        self.qpos[ids, :2] = xy
        self.qpos[ids, 2] = go1.FOOT_RADIUS + (ground - points[..., 2]).max(-1)  # the lowest foot or knee touches
        self.qpos[ids, 3:7] = yaw.as_quat(scalar_first=True)
        self.qpos[ids, 7:] = q
        self.qvel[ids, :6] = uniform(-0.5, 0.5, (n, 6))  # m/s and rad/s [lab code]
        self.friction[np.ix_(ids, self.feet, [0])] = uniform(*self.config.friction, (n, 1, 1))
        self.mass[ids, self.trunk] = self.trunk_mass + uniform(*self.config.payload, n)
        self.batch.set_const(ids)  # what MuJoCo derives from the masses
        self.action[ids], self.age[ids] = 0.0, 0
        self._draw_commands(ids)
        self.frames[ids] = self._frame(ids)[:, None]


def check(num_envs, config, threads):
    """Raise ValueError, in one line, for what no world can be built from."""
    task_config(config.task)
    if config.clip not in ("torque", "power"):
        raise ValueError(f'clip is {config.clip!r}: it must be "torque" or "power"')
    for name, x in (vars(config) | dict(num_envs=num_envs, threads=threads)).items():
        if isinstance(x, tuple) and not (len(x) == 2 and -np.inf < x[0] <= x[1] < np.inf):
            raise ValueError(f"{name} is {x}: it must be a finite range, low end first")
        least = 0 if name in ("threads", "noise", "clock_hz") else 1 if isinstance(x, int) else 1e-9
        if not isinstance(x, bool | str | tuple) and not least <= x < np.inf:
            raise ValueError(f"{name} is {x}: it must be a finite number, at least {least}")
    for name in ("friction", "roughness"):
        if getattr(config, name)[0] < 0:
            raise ValueError(f"{name} is {getattr(config, name)}: it must not be negative")
    if config.cells_per_m * 2.0 ** min(config.octaves - 1, 99) * terrain.SPACING > 0.5:
        raise ValueError(
            f"cells_per_m {config.cells_per_m} with octaves {config.octaves} is too fine for a ground of points"
            f" {terrain.SPACING} m apart: cells_per_m * 2**(octaves - 1) can be {0.5 / terrain.SPACING:.0f} at most"
        )
    if config.payload[0] <= -5:
        raise ValueError(f"payload is {config.payload}: a trunk of 5.6 kg cannot lose 5 kg or more")
