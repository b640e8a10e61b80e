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
What differs between the tasks of Section IV-A is in `tasks.py`. This file knows nothing of learning.
"""

import json
import os

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.spatial.transform import Rotation

import curriculum
import energy
import go1
import rewards
import shaped
import tasks
import terrain

GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2
LEGS, FEET = [2, 4, 6, 8, 9, 10, 11, 12], slice(13, 17)  # contact sensors of go1.xml: thighs, calves; feet
ACTION_SCALE = 0.25 * np.tile([0.5, 1.0, 1.0], 4)  # rad per unit of action, hips half [lab code]
FRAME = dict(gravity=3, command=3, q=12, qd=12, previous_action=12, timing=2)
FRAME_WIDTH = sum(FRAME.values())
FRAME_SCALE = np.repeat([1, 2, 2, 0.25, 1, 0.05, 1, 1], [3, 1, 1, 1, 12, 12, 12, 2])
FRAME_NOISE = np.repeat([0.05, 0, 0.01, 1.5, 0], [3, 3, 12, 12, 14])


class Go1Env:
    """`num_envs` Go1 robots on one task.

    num_envs: N, at least 1
    env_cfg:  see tasks.Config
    threads:  C++ threads; None takes every core that this process may use
    Raises ValueError for an unknown task, a non-positive count or a malformed range.
    """

    action_size = 12
    privileged_size = 3  # true body velocity: the critic sees it, the estimator learns it

    def __init__(self, num_envs, env_cfg=tasks.Config(), threads=None):
        tasks.check(num_envs, env_cfg, threads)
        self.num_envs, self.env_cfg, self.task = num_envs, env_cfg, tasks.TASKS[env_cfg.task]
        self.obs_size = env_cfg.history * FRAME_WIDTH
        self.period = env_cfg.timestep * env_cfg.physics_steps  # s, of a control step
        # MuJoCo would write MUJOCO_LOG.TXT into the user's folder; we count its warnings instead (see step)
        mujoco.set_mju_user_warning(lambda message: None)
        self.ground = None  # a plane
        if env_cfg.roughness[1] > 0:
            low, high = env_cfg.roughness
            levels = np.linspace(high, low, env_cfg.tiles)[::-1]  # a single tile is a rough one
            self.ground = terrain.make_ground(levels, env_cfg.ground_seed, env_cfg.cells_per_m, env_cfg.octaves)
        model = go1.build_model(env_cfg.timestep, self.ground)
        self.joint_range = model.jnt_range[1:].T  # (2, 12) rad, without the free joint of the trunk
        self.trunk = model.body("trunk")
        self.feet = [model.geom(f"{leg}_foot").id for leg in go1.LEGS]
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        self.batch = batch = Batch(model, num_envs, threads or cores)
        self.qpos, self.qvel, self.ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self.contacts = batch.bind("sensordata")  # (N, 17) of the ground with trunk, hips, thighs; calves; feet
        self.forbidden = slice(13 if self.task.only_feet else 9)
        self.friction, self.mass = batch.expand("geom_friction"), batch.expand("body_mass")
        self.com, self.gravity = batch.expand("body_ipos"), batch.expand("opt.gravity")
        self.strength, self.offset = np.ones((num_envs, 1)), np.zeros((num_envs, 12))  # of the motors
        self.targets = np.zeros((env_cfg.latency + 1, num_envs, 12))  # rad, on their way to the motors
        self.frames = np.zeros((num_envs, env_cfg.history, FRAME_WIDTH), np.float32)
        self.action = np.zeros((num_envs, 12))
        self.command, self.given = np.zeros((num_envs, 3)), None
        self.age = np.zeros(num_envs, np.int64)  # control steps since the episode began
        self.tile = np.zeros(num_envs, np.int64)  # of the ground, where the episode takes place
        self.weights = curriculum.initial_weights()
        self.cell = np.zeros((num_envs, 2), np.int64)  # of the curriculum, where the command is from
        self.off_ground = np.ones((num_envs, 4), np.int64)  # control steps since each foot touched it, see shaped.py
        self.tracked = np.zeros((num_envs, 2))  # sums of the kernels of Eq. (8) since the command was drawn
        self.rng = np.random.default_rng(0)

    def reset(self, seed, command=None):
        """Start every episode anew; returns obs, info (see step).

        seed: int or numpy SeedSequence
        command: (N, 3) [m/s, m/s, rad/s] that the robots keep, also in later episodes; None: commands are drawn
        """
        self.given = None if command is None else np.broadcast_to(command, (self.num_envs, 3)).astype(float)
        self.rng = np.random.default_rng(seed)
        self.weights[:], self.tracked[:] = curriculum.initial_weights(), 0.0
        everyone = np.arange(self.num_envs)
        self._reset(everyone)
        if self.env_cfg.stagger:
            self.age[:] = self.rng.integers(self.env_cfg.episode_steps, size=self.num_envs)
            self.frames[:] = self._frame(everyone)[:, None]
        return self._obs(), {"privileged": self._velocity()}

    def step(self, action):
        """One control step of 20 ms for every robot.

        action:  (N, 12) [-] joint targets, as q_nominal + ACTION_SCALE * action
        returns  obs (N, obs_size), reward (N,) Eqs. (5)-(8), terminated (N,), truncated (N,), info:
                 cost (N,) [W] Eq. (9) or [-] Eq. (11), mean of the physics steps (D17);
                 privileged (N, 3) [m/s] body velocity;
                 final_obs, final_privileged: the same before autoreset, to be used where an episode ended;
                 log: what is worth a column in metrics.csv, floats to be averaged and booleans to be counted
        """
        before = self.action.copy(), self.qvel[:, 6:].copy()
        self.action[:] = np.clip(action, -self.env_cfg.action_limit, self.env_cfg.action_limit)
        power, cost, fell = self._physics(go1.Q_NOMINAL + ACTION_SCALE * self.action)
        self.age += 1
        linear, velocity = self._velocity(), self._tracked_velocity(self.env_cfg.frame)
        # MuJoCo resets what is not finite and counts a warning
        diverged = self.batch.warning[..., 1].any(-1) | ~np.isfinite(self.action).all(-1)
        self.action[diverged] = 0.0  # it may be what was not finite
        reward, extra = self._reward(velocity, *before)
        reward, cost = np.where(diverged, 0.0, reward), np.where(diverged, 0.0, cost)
        power = np.where(diverged, energy.SURVIVAL, power)
        overload = power > (self.env_cfg.max_power or np.inf)
        terminated = diverged | fell | overload
        truncated = ~terminated & (self.age >= self.env_cfg.episode_steps)
        self._stay_on_tile()
        log = dict(v_x=self._tracked_velocity("heading")[:, 0], command_x=self.command[:, 0].copy(), power=power,
                   ended_fall=fell & ~diverged, ended_diverged=diverged, ended_limit=truncated) | extra  # fmt: skip
        if self.task.curriculum or self.env_cfg.max_power:
            log |= dict(ended_power=overload & ~fell & ~diverged)
        self._draw_commands(np.flatnonzero(self.age % self.env_cfg.command_steps == 0))
        self.frames[:, :-1] = self.frames[:, 1:]
        self.frames[:, -1] = self._frame(np.arange(self.num_envs))
        info = dict(cost=cost, log=log, final_obs=self._obs(), final_privileged=linear)
        ended = np.flatnonzero(terminated | truncated)
        if ended.size:
            self._reset(ended)
            linear = self._velocity()
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

    _state = ("frames", "action", "command", "age", "tile", "friction", "mass", "com", "gravity", "strength", "offset",
              "targets", "weights", "cell", "tracked", "off_ground")  # fmt: skip

    def _physics(self, target):
        """Apply joint targets for one control step: mean power of its physics steps [W], their cost, and who fell.

        To fall is to touch the ground with trunk, hip or thigh (D13), on some tasks with anything but a foot.
        Contacts are those that a physics step started from, as MuJoCo reports them: the last state is not seen.
        """
        motor = go1.motor_model if self.env_cfg.motor_model else go1.pd_torque
        torques, speeds, fell = [], [self.qvel[:, 6:].copy()], np.zeros(self.num_envs, bool)
        for _ in range(self.env_cfg.physics_steps):
            self.targets[:-1], self.targets[-1] = self.targets[1:], target
            q, qd = self.qpos[:, 7:], speeds[-1]
            torque = self.strength * motor(self.targets[0], q + self.offset, qd)
            torque = go1.limit_torque(torque, qd, self.task.torque_speed or self.env_cfg.motor_model)
            self.ctrl[:] = torque
            self.batch.step()
            fell |= (self.contacts[:, self.forbidden] > 0).any(-1)
            torques.append(torque)
            speeds.append(self.qvel[:, 6:].copy())
        torques, speeds = np.array(torques), np.array(speeds)
        qdd = (speeds[-1] - speeds[0]) / self.period
        # Work is torque times the way: with the speed before the step alone, what a torque does to it is lost (D17)
        cost = energy.energy_cost(torques, (speeds[:-1] + speeds[1:]) / 2, self.env_cfg.clip).mean(0)
        power = cost + energy.SURVIVAL  # the bonus is not drawn from the battery
        if self.env_cfg.aux == "smooth":
            cost = energy.smoothness_cost(torques, self.action, qdd).mean(0)
        return power, cost, fell

    def _reward(self, velocity, action_before, qd_before):
        """The reward of a step (N,), and what it adds to the log; the curriculum keeps count of the tracking.

        velocity: (N, 3) as of `_tracked_velocity`; before: a control step ago, action and qd [rad/s], (N, 12) each
        """
        reward, log = self.task.reward(velocity, self.command), {}
        if self.task.curriculum:
            self.tracked += np.column_stack(rewards.kernels(velocity, self.command))
            log |= dict(command_area=np.full(self.num_envs, self.weights.mean()))
        if self.env_cfg.reward == "shaped":
            log |= dict(task_reward=reward)
            reward = shaped.reward(self._motion(velocity, action_before, qd_before))
        return reward, log

    def _motion(self, velocity, action_before, qd_before):
        """What the shaped reward looks at: shaped.Motion. Arguments as of `_reward`."""
        to_world = Rotation.from_quat(self.qpos[:, 3:7], scalar_first=True)
        ground = 0.0 if self.ground is None else terrain.height(self.ground, self.qpos[:, :2])
        return shaped.Motion(
            velocity=velocity, command=self.command, v_z=self._velocity()[:, 2], roll_pitch_rate=self.qvel[:, 3:5],
            gravity=to_world.apply(self._down(), inverse=True), torque=self.ctrl,
            qdd=(self.qvel[:, 6:] - qd_before) / self.period, height=self.qpos[:, 2] - ground,
            landed=shaped.landings(self.off_ground, self.contacts[:, FEET] > 0, self.period),
            collisions=(self.contacts[:, LEGS] > 0).sum(-1), action_change=self.action - action_before,
            q=self.qpos[:, 7:], joint_range=self.joint_range)  # fmt: skip

    def _stay_on_tile(self):
        """Who left the tile comes back on the other side, where the ground goes on: nothing else changes."""
        if self.ground is not None:
            self.qpos[:, :2] = terrain.wrap(self.qpos[:, :2], self.tile)

    def _down(self):
        """Unit vectors (N, 3) along gravity, as an accelerometer feels it: also the part that was added to it."""
        return self.gravity / np.linalg.norm(self.gravity, axis=-1, keepdims=True)

    def _velocity(self):
        """True linear velocity of the trunk in its own frame, (N, 3) [m/s]."""
        to_world = Rotation.from_quat(self.qpos[:, 3:7], scalar_first=True)
        return to_world.apply(self.qvel[:, :3], inverse=True)

    def _tracked_velocity(self, frame):
        """What Eqs. (5) to (8) compare with the command: v_x, v_y [m/s] and yaw rate [rad/s], (N, 3), D25.

        frame: "heading", which is horizontal and turned with the robot's yaw: the speed over ground; or the "body"'s
        """
        if frame == "body":
            return np.column_stack([self._velocity()[:, :2], self.qvel[:, 5]])
        to_world = Rotation.from_quat(self.qpos[:, 3:7], scalar_first=True).as_matrix()
        yaw = np.arctan2(to_world[:, 1, 0], to_world[:, 0, 0])
        (x, y), sin, cos = self.qvel[:, :2].T, np.sin(yaw), np.cos(yaw)
        return np.column_stack([cos * x + sin * y, cos * y - sin * x, (to_world[:, 2] * self.qvel[:, 3:6]).sum(1)])

    def _frame(self, ids):
        """One frame of the observation (n, FRAME_WIDTH), as in the table at the top of this file."""
        to_world = Rotation.from_quat(self.qpos[ids, 3:7], scalar_first=True)
        phase = 2 * np.pi * self.env_cfg.clock_hz * self.period * self.age[ids]
        frame = np.column_stack([
            to_world.apply(self._down()[ids], inverse=True),  # gravity
            self.command[ids],
            self.qpos[ids, 7:] - go1.Q_NOMINAL,  # q
            self.qvel[ids, 6:],  # qd
            self.action[ids],  # previous action
            np.sin(phase), np.cos(phase),  # timing reference
        ])  # fmt: skip
        noise = self.env_cfg.noise * FRAME_NOISE * self.rng.uniform(-1.0, 1.0, frame.shape)
        return FRAME_SCALE * (frame + noise)

    def _obs(self):
        """The policy's observation: a copy of the history, flattened, (N, H * FRAME_WIDTH) float32."""
        return self.frames.reshape(self.num_envs, -1).copy()

    def _draw_commands(self, ids):
        """New commands [m/s, m/s, rad/s] for the robots `ids`; the curriculum learns how they followed the old ones."""
        if self.given is not None:
            self.command[ids] = self.given[ids]
        elif self.task.curriculum:
            success = curriculum.succeeded(*(self.tracked[ids] / self.env_cfg.command_steps).T)
            self.weights[:] = curriculum.update(self.weights, self.cell[ids], success)  # in place: pi and pi' share it
            self.tracked[ids] = 0.0
            self.command[ids], self.cell[ids] = curriculum.sample(self.weights, self.rng, len(ids))
        else:
            self.command[ids] = self.rng.uniform(0.0, self.task.command_high, (len(ids), 3))

    def _reset(self, ids):
        """Begin new episodes for the robots `ids`: pose, velocity, physical parameters, command, history."""
        n, uniform = len(ids), self.rng.uniform
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        q = np.clip(go1.Q_NOMINAL * uniform(0.5, 1.5, (n, 12)), *self.joint_range)  # [lab code]
        yaw = Rotation.from_rotvec(uniform(-np.pi, np.pi, n)[:, None] * [0.0, 0.0, 1.0])
        points = np.einsum("nij,nkj->nki", yaw.as_matrix(), go1.leg_points(q))
        xy, ground = np.zeros((n, 2)), 0.0
        if self.ground is not None:
            self.tile[ids] = self.rng.integers(self.env_cfg.tiles, size=n)
            xy = terrain.origin(self.tile[ids]) + uniform(0.0, terrain.TILE, (n, 2))
            ground = terrain.height(self.ground, xy[:, None] + points[..., :2])
        self.qpos[ids, :2] = xy
        self.qpos[ids, 2] = go1.FOOT_RADIUS + (ground - points[..., 2]).max(-1)  # the lowest foot or knee touches
        self.qpos[ids, 3:7] = yaw.as_quat(scalar_first=True)
        self.qpos[ids, 7:] = q
        self.qvel[ids, :6] = uniform(-0.5, 0.5, (n, 6))  # m/s and rad/s [lab code]
        self.friction[np.ix_(ids, self.feet, [0])] = uniform(*self.env_cfg.friction, (n, 1, 1))
        self.mass[ids, self.trunk.id] = self.trunk.mass + uniform(*self.env_cfg.payload, n)
        self.com[ids, self.trunk.id] = self.trunk.ipos + uniform(*self.env_cfg.com, (n, 3))
        self.batch.set_const(ids)  # what MuJoCo derives from the masses
        self.gravity[ids] = GRAVITY + uniform(*self.env_cfg.gravity, (n, 3))
        self.strength[ids] = uniform(*self.env_cfg.motor_strength, (n, 1))
        self.offset[ids] = uniform(*self.env_cfg.motor_offset, (n, 12))
        self.targets[:, ids], self.off_ground[ids] = go1.Q_NOMINAL, 1
        self.action[ids], self.age[ids] = 0.0, 0
        self._draw_commands(ids)
        self.frames[ids] = self._frame(ids)[:, None]
