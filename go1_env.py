"""The Unitree Go1 as a batched Markov decision process: NumPy around `mujoco.batch`.

Sections IV-A to IV-C of the paper. `Go1Env` steps `num_envs` robots at once on C++ threads. The
results are the same bits for any number of threads. It follows Gymnasium's vector conventions
without the dependency:
`reset(seed) -> obs, info` and `step(action) -> obs, reward, terminated, truncated, info`, with
same-step autoreset: where an episode ended, `obs` is the first observation of the next one and
`info["final_obs"]` the last of the old.

The policy sees the last H frames, oldest first (D16). Right after a reset all of them are the first
one. A frame holds only what the robot can measure, in this order:

| entry               | width | unit       | scale      | noise +- (before scale)             |
|---------------------|-------|------------|------------|-------------------------------------|
| gravity, body frame | 3     | -          | 1          | 0.05                                |
| command             | 3     | m/s, rad/s | 2, 2, 0.25 | 0                                   |
| q - q_nominal       | 12    | rad        | 1          | 0.01                                |
| qd                  | 12    | rad/s      | 0.05       | 1.5                                 |
| previous action     | 12    | -          | 1          | 0                                   |
| timing reference    | 2     | -          | 1          | 0: sin and cos of one clock of 3 Hz |

Joints are FR, FL, RR, RL x hip, thigh, calf. Noise is uniform. Scales and noise are the lab's.
What differs between the tasks of Section IV-A is in `tasks.py`. This file knows nothing of
learning.
"""

import os
from types import SimpleNamespace

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

# how many cores this process may use
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2
ACTION_SCALE = 0.25 * np.tile([0.5, 1.0, 1.0], 4)  # rad per unit of action [lab code]
FRAME = dict(gravity=3, command=3, q=12, qd=12, previous_action=12, timing=2)
FRAME_WIDTH = sum(FRAME.values())
FRAME_SCALE = np.repeat([1, 2, 2, 0.25, 1, 0.05, 1, 1], [3, 1, 1, 1, 12, 12, 12, 2])
# the frame of the mirrored robot, as in go1.py; its clock is half a period later, as in a trot
FRAME_MIRROR = np.concatenate(
    [np.arange(6), 6 + go1.MIRROR, 18 + go1.MIRROR, 30 + go1.MIRROR, [42, 43]]
)
FRAME_SIGN = np.concatenate([[1, -1, 1], [1, -1, -1], np.tile(go1.MIRROR_SIGN, 3), [-1, -1]])
FRAME_NOISE = np.repeat([0.05, 0, 0.01, 1.5, 0], [3, 3, 12, 12, 14])


def mirror(history):
    """The mirror as {"obs", "privileged", "action"}, each a pair (index, sign) of tuples.

    Entry i of the mirrored robot's array is sign[i] x[index[i]].
    """
    index = [FRAME_WIDTH * frame + i for frame in range(history) for i in FRAME_MIRROR]
    spaces = dict(
        obs=(index, history * FRAME_SIGN.tolist()),
        privileged=([0, 1, 2], [1, -1, 1]),
        action=(go1.MIRROR, go1.MIRROR_SIGN),
    )
    return {name: tuple(tuple(map(int, x)) for x in pair) for name, pair in spaces.items()}


class Go1Env:
    """`num_envs` Go1 robots on one task.

    num_envs: N, at least 1
    env_cfg:  see tasks.Config
    threads:  C++ threads; None takes every core that this process may use
    stream:   which of the independent streams of random numbers a seed stands for, from 0;
              processes have one each
    command_weights: (22, 40) of curriculum.py, changed in place, if this environment shares its
              commands with another
    """

    action_size = 12
    # true body velocity [m/s], which the robot cannot measure; for the critic and the estimator
    privileged_size = 3

    def __init__(
        self, num_envs, env_cfg=tasks.Config(), threads=None, stream=0, command_weights=None
    ):
        self.stream = (stream,) if stream else ()
        self.num_envs = num_envs
        self.env_cfg = env_cfg
        self.rules = tasks.TASKS[env_cfg.task]
        self.obs_size = env_cfg.history * FRAME_WIDTH
        self.mirror = mirror(env_cfg.history)
        self.period = env_cfg.timestep * env_cfg.physics_steps  # s, of a control step
        # MuJoCo would write MUJOCO_LOG.TXT into the user's folder; we count its warnings instead
        # (see step)
        mujoco.set_mju_user_warning(lambda message: None)
        # from the greatest, which a single tile gets
        levels = np.linspace(*env_cfg.roughness[::-1], env_cfg.tiles)[::-1]
        self.ground = None
        if levels.any():
            self.ground = terrain.make_ground(levels, env_cfg.ground_seed, env_cfg.cells_per_m)
        model = self.build_model(self.ground)
        self.joint_range = model.jnt_range[1:].T  # (2, 12) rad, without the free joint of the trunk
        self.trunk = model.body("trunk")
        self.feet = [model.geom(f"{leg}_foot").id for leg in go1.LEGS]
        self.batch = batch = Batch(model, num_envs, threads or CORES)
        self.qpos = batch.bind("qpos")
        self.qvel = batch.bind("qvel")
        self.ctrl = batch.bind("ctrl")
        # (N, 17): ground with trunk, hips, thighs (9); calves (4); feet (4)
        self.contacts = batch.bind("sensordata")
        if command_weights is None:
            command_weights = curriculum.initial_weights()
        self.state = self._blank_state(command_weights)
        self.rng = np.random.default_rng(0)

    def build_model(self, ground):
        """The robot's model on heights (ny, nx) [m] or, if None, on a plane."""
        return go1.build_model(self.env_cfg.timestep, ground)

    def reset(self, seed, command=None):
        """Start a new episode for every robot. Returns obs as `step` does, and info["privileged"].

        seed: int
        command: (N, 3) or (3,) [m/s, m/s, rad/s] that the robots keep, also in later episodes;
            None: commands are drawn
        """
        self.state.given[:] = np.nan if command is None else command
        self.rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=self.stream))
        self.state.command_weights[:] = curriculum.initial_weights()
        self.state.tracked[:] = 0.0
        self._reset(np.arange(self.num_envs))
        if self.env_cfg.stagger:
            self.state.age[:] = self.rng.integers(self.env_cfg.episode_steps, size=self.num_envs)
            self.state.frames[:] = self._frame()[:, None]
        return self._obs(), {"privileged": self.body_velocity()}

    def step(self, action):
        """One control step of 20 ms for every robot.

        action:  (N, 12) [-]; joint targets are q_nominal + ACTION_SCALE * action
        returns  obs (N, obs_size), reward (N,) Eqs. (5)-(8), terminated (N,), truncated (N,), info:
                 cost        (N,) [W] Eq. (9) or [-] Eq. (11), mean of the physics steps
                 privileged  (N, 3) [m/s] body velocity
                 final_obs, final_privileged  the same of every robot, before any starts anew
                 log         {name: (N,)}: floats to be averaged, booleans to be counted
        """
        state = self.state
        before = state.action.copy(), self.qvel[:, 6:].copy()
        state.action[:] = np.clip(action, -self.env_cfg.action_limit, self.env_cfg.action_limit)
        power, cost, fell = self._physics(go1.Q_NOMINAL + ACTION_SCALE * state.action)
        state.age += 1
        linear = self.body_velocity()
        over_ground = self.tracked_velocity("heading")
        # MuJoCo resets a simulation that is not finite, and counts a warning. Any warning ends it
        diverged = self.batch.warning[..., 1].any(-1) | ~np.isfinite(state.action).all(-1)
        state.action[diverged] = 0.0  # the action may be what was not finite
        reward, log = self._reward(over_ground, *before)
        reward, cost = np.where(diverged, 0.0, [reward, cost])
        power = np.where(diverged, energy.SURVIVAL, power)
        overload = power > (self.env_cfg.max_power or np.inf)
        terminated = diverged | fell | overload
        truncated = ~terminated & (state.age >= self.env_cfg.episode_steps)
        if self.ground is not None:  # a robot that left its tile comes back on the other side
            self.qpos[:, :2] = terrain.wrap(self.qpos[:, :2], state.tile)
        log = self._motion(over_ground, power) | log
        log |= dict(ended_fall=fell & ~diverged, ended_diverged=diverged, ended_limit=truncated)
        if self.rules.curriculum or self.env_cfg.max_power:
            log |= dict(ended_power=overload & ~fell & ~diverged)
        self._draw_commands(np.flatnonzero(state.age % self.env_cfg.command_steps == 0))
        state.frames[:, :-1] = state.frames[:, 1:]
        state.frames[:, -1] = self._frame()
        info = dict(cost=cost, log=log, final_obs=self._obs(), final_privileged=linear)
        if (ended := np.flatnonzero(terminated | truncated)).size:
            self._reset(ended)
            linear = self.body_velocity()
        return self._obs(), reward, terminated, truncated, info | {"privileged": linear}

    def _motion(self, over_ground, power):
        """Attitude [degrees], speed ahead, the command for it [m/s], and power [W], for the log."""
        pitch, roll = self.attitude()
        asked = self.state.command[:, 0].copy()
        return dict(pitch=pitch, roll=roll, v_x=over_ground[:, 0], command_x=asked, power=power)

    def _blank_state(self, command_weights):
        """All that the next step depends on, but for the rng: arrays that change only in place."""
        n = self.num_envs
        batch = self.batch
        return SimpleNamespace(
            sim=batch.state,  # MuJoCo's own: positions, velocities, warm start
            # (N, geoms, 3) [-], in the simulations, as the next three
            friction=batch.expand("geom_friction"),
            mass=batch.expand("body_mass"),  # (N, bodies) [kg]
            com=batch.expand("body_ipos"),  # (N, bodies, 3) [m]
            gravity=batch.expand("opt.gravity"),  # (N, 3) [m/s^2]
            strength=np.ones((n, 1)),  # of the motors
            offset=np.zeros((n, 12)),  # rad, of the motors' encoders
            # rad, on their way to the motors, oldest first
            targets=np.zeros((self.env_cfg.latency + 1, n, 12)),
            action=np.zeros((n, 12)),  # the previous one, clipped
            # the observation, oldest first
            frames=np.zeros((n, self.env_cfg.history, FRAME_WIDTH), np.float32),
            age=np.zeros(n, np.int64),  # control steps since the episode began
            tile=np.zeros(n, np.int64),  # of the ground, where the episode takes place
            # control steps since each foot touched it, see shaped.py
            off_ground=np.ones((n, 4), np.int64),
            command=np.zeros((n, 3)),  # m/s, m/s, rad/s
            # the command that reset was told to keep; NaN: commands are drawn
            given=np.full((n, 3), np.nan),
            # of the curriculum's commands, perhaps shared with another environment
            command_weights=command_weights,
            cell=np.zeros((n, 2), np.int64),  # of the curriculum, where the command is from
            tracked=np.zeros((n, 2)),  # sums of the kernels of Eq. (8) since the command was drawn
        )

    def _physics(self, target):
        """A control step with joint targets (N, 12) [rad]: its power [W], its cost, and who fell.

        To fall is to touch the ground, however lightly, with trunk, hip or thigh, on some tasks
        with anything but a foot. Contacts are those with which a physics step begins: after the
        last one none is seen.
        """
        motor = go1.motor_model if self.env_cfg.motor_model else go1.pd_torque
        limited = self.rules.torque_speed or self.env_cfg.motor_model
        forbidden = go1.NO_FEET if self.rules.only_feet else go1.NO_LEGS
        state = self.state
        torques = []
        speeds = [self.qvel[:, 6:].copy()]
        fell = np.zeros(self.num_envs, bool)
        for _ in range(self.env_cfg.physics_steps):
            state.targets[:-1] = state.targets[1:]
            state.targets[-1] = target
            q = self.qpos[:, 7:]
            qd = speeds[-1]
            torque = state.strength * motor(state.targets[0], q + state.offset, qd)
            self.ctrl[:] = go1.limit_torque(torque, qd, limited)
            torques.append(self.ctrl.copy())
            self.batch.step()  # a joint may exceed the speed that the URDF gives for it
            fell |= (self.contacts[:, forbidden] > 0).any(-1)
            speeds.append(self.qvel[:, 6:].copy())
        torques, speeds = np.array(torques), np.array(speeds)
        # a torque changes the speed during a physics step: take the mean of before and after
        speed = (speeds[:-1] + speeds[1:]) / 2
        power = energy.total_power(torques, speed, self.env_cfg.clip).mean(0)
        cost = energy.energy_cost(torques, speed, self.env_cfg.clip).mean(0)
        if self.env_cfg.aux == "smooth":
            qdd = (speeds[-1] - speeds[0]) / self.period
            cost = energy.smoothness_cost(torques, state.action, qdd).mean(0)
        return power, cost, fell

    def _reward(self, over_ground, action_before, qd_before):
        """The reward (N,) of a step, and its part of the log.

        *_before: action and qd [rad/s], (N, 12), of a control step ago
        """
        in_body = self.env_cfg.frame == "body"
        velocity = self.tracked_velocity("body") if in_body else over_ground
        reward = self.rules.reward(velocity, self.state.command)
        log = {}
        if self.rules.curriculum:
            self.state.tracked += np.column_stack(rewards.kernels(velocity, self.state.command))
            log |= dict(command_area=np.full(self.num_envs, self.state.command_weights.mean()))
        if self.env_cfg.reward == "shaped":
            log |= dict(task_reward=reward)
            reward = shaped.reward(shaped.observe(self, velocity, action_before, qd_before))
        return reward, log

    def felt_gravity(self, ids=slice(None)):
        """Unit vectors (n, 3) along gravity in the trunk's frame, added gravity included."""
        gravity = self.state.gravity[ids]
        down = gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)
        return self._to_world(ids).apply(down, inverse=True)

    def attitude(self):
        """Pitch and roll (2, N) [degrees], positive with the nose up, the right side down."""
        x, y, z = self._to_world().as_matrix()[:, 2].T  # the vertical in the trunk's frame
        return np.degrees([np.arctan2(x, np.hypot(y, z)), np.arctan2(y, z)])

    def body_velocity(self):
        """True linear velocity of the trunk in its own frame, (N, 3) [m/s]."""
        return self._to_world().apply(self.qvel[:, :3], inverse=True).astype(np.float32)

    def tracked_velocity(self, frame):
        """v_x, v_y [m/s] and yaw rate [rad/s], (N, 3).

        frame: "body" is the trunk's; "heading" is level, and turned with the robot
        """
        if frame == "body":
            return np.column_stack([self.body_velocity()[:, :2], self.qvel[:, 5]])
        to_world = self._to_world().as_matrix()
        yaw = np.arctan2(to_world[:, 1, 0], to_world[:, 0, 0])
        x, y = self.qvel[:, :2].T
        sin = np.sin(yaw)
        cos = np.cos(yaw)
        yaw_rate = (to_world[:, 2] * self.qvel[:, 3:6]).sum(1)
        return np.column_stack([cos * x + sin * y, cos * y - sin * x, yaw_rate])

    def _to_world(self, ids=slice(None)):
        """Rotations from the trunk's frame to the world's, for the robots `ids`."""
        return Rotation.from_quat(self.qpos[ids, 3:7], scalar_first=True)

    def _frame(self, ids=slice(None)):
        """One frame of the observation (n, FRAME_WIDTH): the table at the top of this file."""
        phase = 2 * np.pi * self.env_cfg.clock_hz * self.period * self.state.age[ids]
        frame = np.column_stack(
            [
                self.felt_gravity(ids),
                self.state.command[ids],
                self.qpos[ids, 7:] - go1.Q_NOMINAL,
                self.qvel[ids, 6:],
                self.state.action[ids],
                np.sin(phase),
                np.cos(phase),
            ]
        )
        noise = self.env_cfg.noise * FRAME_NOISE * self.rng.uniform(-1.0, 1.0, frame.shape)
        return FRAME_SCALE * (frame + noise)

    def _obs(self):
        """The policy's observation (N, H * FRAME_WIDTH) float32: the frames, in a copy."""
        return self.state.frames.reshape(self.num_envs, -1).copy()

    def _draw_commands(self, ids):
        """New commands for the robots `ids`. The curriculum learns how they followed the old."""
        state = self.state
        if np.isfinite(state.given).all():
            state.command[ids] = state.given[ids]
        elif self.rules.curriculum:
            success = curriculum.succeeded(*(state.tracked[ids] / self.env_cfg.command_steps).T)
            weights = state.command_weights
            weights[:] = curriculum.update(weights, state.cell[ids], success)
            state.tracked[ids] = 0.0
            state.command[ids], state.cell[ids] = curriculum.sample(weights, self.rng, len(ids))
        else:
            state.command[ids] = self.rng.uniform(0.0, self.rules.command_high, (len(ids), 3))

    def _reset(self, ids):
        """Begin new episodes for the robots `ids`."""
        n = len(ids)
        uniform = self.rng.uniform
        state = self.state
        env_cfg = self.env_cfg
        # of joint angles, relative, and of the trunk's velocity, m/s and rad/s
        spread = env_cfg.start_spread
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        q = np.clip(go1.Q_NOMINAL * uniform(1 - spread, 1 + spread, (n, 12)), *self.joint_range)
        yaw = Rotation.from_rotvec(uniform(-np.pi, np.pi, n)[:, None] * [0.0, 0.0, 1.0])
        points = np.einsum("nij,nkj->nki", yaw.as_matrix(), go1.leg_points(q))
        xy = np.zeros((n, 2))
        ground = 0.0
        if self.ground is not None:
            state.tile[ids] = self.rng.integers(env_cfg.tiles, size=n)
            xy = terrain.origin(state.tile[ids]) + uniform(0.0, terrain.TILE, (n, 2))
            ground = terrain.height(self.ground, xy[:, None] + points[..., :2])
        # the lowest foot or knee touches
        height = go1.FOOT_RADIUS + (ground - points[..., 2]).max(-1)
        self.qpos[ids] = np.column_stack([xy, height, yaw.as_quat(scalar_first=True), q])
        self.qvel[ids, :6] = uniform(-spread, spread, (n, 6))
        state.friction[np.ix_(ids, self.feet, [0])] = uniform(*env_cfg.friction, (n, 1, 1))
        state.mass[ids, self.trunk.id] = self.trunk.mass + uniform(*env_cfg.payload, n)
        state.com[ids, self.trunk.id] = self.trunk.ipos + uniform(*env_cfg.com, (n, 3))
        self.batch.set_const(ids)  # what MuJoCo derives from the masses
        state.gravity[ids] = GRAVITY + uniform(*env_cfg.gravity, (n, 3))
        state.strength[ids] = uniform(*env_cfg.motor_strength, (n, 1))
        state.offset[ids] = uniform(*env_cfg.motor_offset, (n, 12))
        state.targets[:, ids] = go1.Q_NOMINAL
        state.action[ids] = 0.0
        state.age[ids] = 0
        state.off_ground[ids] = 1
        self._draw_commands(ids)
        state.frames[ids] = self._frame(ids)[:, None]
