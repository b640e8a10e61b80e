"""The Unitree Go1 as a batched Markov decision process: NumPy around `mujoco.batch`.

Sections IV-A to IV-C of the paper. `Go1Env` steps `num_envs` robots at once on C++ threads. The
results are the same bits for any number of threads. It follows Gymnasium's vector conventions
without the dependency:
`reset(seed) -> obs, info` and `step(action) -> obs, reward, terminated, truncated, info`, with
same-step autoreset: where an episode ended, `obs` is the first observation of the next one and
`info["final_obs"]` the last of the old.

Joints are FR, FL, RR, RL x hip, thigh, calf. What differs between the tasks of Section IV-A is in
`tasks.py`. This file knows nothing of learning.
"""

import os
from types import SimpleNamespace
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.spatial.transform import Rotation

import energy
import go1
import rewards
import tasks
import terrain

# MuJoCo would write MUJOCO_LOG.TXT into the user's folder. `Go1Env` counts warnings instead.
mujoco.set_mju_user_warning(lambda message: None)
# how many cores this process may use
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2


class Part(NamedTuple):
    """A part of the observation, made of n numbers."""

    mirror: tuple  # (index, sign): number i of the mirrored robot is sign[i] x[index[i]] (D28)
    scale: float | list = 1.0  # factor with which the policy sees it [lab code]
    noise: float = 0.0  # uniform noise within +- this is added, before the scale [lab code]


# The observation, Section IV-C.a: the last H frames, oldest first, and right after a reset H times
# the first one (D16). A frame is what a robot measures at one moment, its command, its previous
# action and its clock. The mirrored robot's clock is half a period later, as in a trot.
FRAME = dict(
    gravity=Part(([0, 1, 2], [1, -1, 1]), noise=0.05),  # direction of gravity, in the trunk's frame
    command=Part(([0, 1, 2], [1, -1, -1]), scale=[2, 2, 0.25]),  # v_x, v_y [m/s], yaw rate [rad/s]
    q=Part(go1.MIRROR, noise=0.01),  # rad, joint angles less those of Q_NOMINAL
    qd=Part(go1.MIRROR, scale=0.05, noise=1.5),  # rad/s
    previous_action=Part(go1.MIRROR),
    timing=Part(([0, 1], [-1, -1])),  # sin and cos of the timing reference
)
WIDTHS = [len(part.mirror[0]) for part in FRAME.values()]
FRAME_WIDTH = sum(WIDTHS)
FRAME_SCALE = np.concatenate([np.ones(len(part.mirror[0])) * part.scale for part in FRAME.values()])
FRAME_NOISE = np.repeat([part.noise for part in FRAME.values()], WIDTHS)


class Substeps(NamedTuple):
    """What happened in the S physics steps of one control step."""

    torque: np.ndarray  # (S, N, 12) [N m] that was applied in each
    qd: np.ndarray  # (S + 1, N, 12) [rad/s] of the joints, before the first and after each
    touched: np.ndarray  # (N, 17) bool, which sensors of go1.xml touched the ground in any


class Outcome(NamedTuple):
    """What each of N robots earned in a control step, and why its episode may end: (N,) each."""

    reward: np.ndarray  # what is learned: task_reward, or the shaped one [-]
    task_reward: np.ndarray  # [-] Eqs. (5), (6), (8), or [m/s] Eq. (7)
    cost: np.ndarray  # [W] Eq. (9) or [-] Eq. (11)
    power: np.ndarray  # [W] Eq. (9) without its bonus
    contact: np.ndarray  # bool, it touched the ground with what must not touch it
    overload: np.ndarray  # bool, it drew more than max_power and had no such contact


# the Outcome of a robot whose numbers are not finite; at this power Eq. (9) is 0 (D36)
NOTHING = Outcome(0.0, 0.0, 0.0, power=energy.SURVIVAL, contact=False, overload=False)


class Go1Env:
    """`num_envs` Go1 robots on one task.

    num_envs: N, at least 1
    env_cfg:  see tasks.Config
    threads:  C++ threads; None takes every core that this process may use
    commands: the object of tasks.py that draws commands, which several environments may share;
              None: a new one of the task
    """

    action_size = 12
    # the trunk's true linear velocity [m/s] in its own frame, which the robot cannot measure; for
    # the critic and the estimator
    privileged_size = 3

    def __init__(self, num_envs, env_cfg=tasks.Config(), threads=None, commands=None):
        self.num_envs = num_envs
        self.env_cfg = env_cfg
        self.task = tasks.TASKS[env_cfg.task]
        self.commands = commands or self.task.commands()
        self.obs_size = env_cfg.history * FRAME_WIDTH
        self.mirror = dict(  # (index, sign) of each part, in the order of the parts
            obs=[part.mirror for part in FRAME.values()] * env_cfg.history,
            privileged=[([0, 1, 2], [1, -1, 1])],
            action=[go1.MIRROR],
        )
        self.dt = env_cfg.timestep * env_cfg.physics_steps  # s, of a control step
        low, high = env_cfg.roughness
        levels = np.linspace(low, high, env_cfg.tiles) if env_cfg.tiles > 1 else np.array([high])
        self.ground = None
        if levels.any():
            self.ground = terrain.make_ground(levels, env_cfg.ground_seed, env_cfg.cells_per_m)
        model = go1.build_model(env_cfg.timestep, self.ground, looks=False)
        self.joint_range = model.jnt_range[1:].T  # (2, 12) rad, without the free joint of the trunk
        self.trunk = model.body("trunk")
        self.feet = [model.geom(f"{leg}_foot").id for leg in go1.LEGS]
        self.batch = Batch(model, num_envs, threads or CORES)
        self.qpos = self.batch.bind("qpos")
        self.qvel = self.batch.bind("qvel")
        self.ctrl = self.batch.bind("ctrl")
        # (N, 17) of ground with trunk, hips and thighs (9), calves (4) and feet (4)
        self.contacts = self.batch.bind("sensordata")
        self.state = self._make_state()
        self.rng = np.random.default_rng(0)

    def _make_state(self):
        """All that the next step depends on, but for the rng: arrays that change only in place."""
        n = self.num_envs
        batch = self.batch
        return SimpleNamespace(
            sim=batch.state,  # MuJoCo's own: positions, velocities, warm start
            friction=batch.expand("geom_friction"),  # (N, geoms, 3) [-]
            mass=batch.expand("body_mass"),  # (N, bodies) [kg]
            com=batch.expand("body_ipos"),  # (N, bodies, 3) [m]
            gravity=batch.expand("opt.gravity"),  # (N, 3) [m/s^2]
            strength=np.ones((n, 1)),  # factor on the motors' torques
            offset=np.zeros((n, 12)),  # rad, by which each motor mistakes its joint's angle
            # rad, targets on their way to the motors, one for each physics step, oldest first
            targets=np.zeros((self.env_cfg.latency + 1, n, 12)),
            action=np.zeros((n, 12)),  # the previous one, clipped
            # the observation, oldest frame first
            frames=np.zeros((n, self.env_cfg.history, FRAME_WIDTH), np.float32),
            privileged=np.zeros((n, 3), np.float32),  # m/s, the trunk's linear velocity
            age=np.zeros(n, np.int64),  # control steps since the episode began
            tile=np.zeros(n, np.int64),  # of the ground, where the episode takes place
            # control steps since each foot last touched the ground; an episode starts with 1, as if
            # the foot had been in the air one step before
            off_ground=np.ones((n, 4), np.int64),
            command=np.zeros((n, 3)),  # m/s, m/s, rad/s
            kernels=np.zeros((n, 2)),  # sums of the kernels of Eq. (8) since the command was drawn
            planned=np.ones(n),  # control steps for which the command is to last
            episode_return=np.zeros(n),  # sum of the episode's rewards so far
            command_weights=self.commands.weights,
        )

    def reset(self, seed):
        """Start a new episode for every robot. Returns obs as `step` does, and an empty info.

        seed: what np.random.default_rng takes
        """
        self.rng = np.random.default_rng(seed)
        self.commands.start()
        everybody = np.arange(self.num_envs)
        self.state.kernels[:] = 0.0  # nothing from before the reset is credited
        self._start(everybody)
        if self.env_cfg.stagger:
            self.state.age[:] = self.rng.integers(self.env_cfg.episode_steps, size=self.num_envs)
            begun = self.state.age > 0
            self.state.episode_return[begun] = np.nan  # a part of it is unknown
            self._plan(everybody)
            # a command of which a part is over already can never be a success
            self.state.planned[self.state.age % self.env_cfg.command_steps > 0] = np.inf
            self._observe_first(everybody)  # again, because the clock shows the age
        return self.observe()[0], {}

    def observe(self):
        """What the robots see, (N, obs_size) float32, and the privileged part, (N, 3) [m/s]."""
        return self.state.frames.reshape(self.num_envs, -1).copy(), self.state.privileged.copy()

    def step(self, action):
        """One control step of 20 ms for every robot.

        action:  (N, 12) [-]; joint targets are q_nominal + action_scale * action
        returns  obs (N, obs_size), reward (N,) of Outcome, terminated (N,), truncated (N,), info:
                 privileged  (N, 3) [m/s], as `observe` returns it with obs
                 cost        (N,) [W] Eq. (9) or [-] Eq. (11), mean of the physics steps
                 final_obs, final_privileged  obs and privileged before any robot starts anew
                 log         {name: (N,)}, numbers whose means tell how training goes
        """
        state = self.state
        action_before = state.action.copy()
        limit = self.env_cfg.action_limit
        state.action[:] = np.clip(action, -limit, limit)
        substeps = self._simulate(go1.Q_NOMINAL + go1.ACTION_SCALE * state.action)
        motion = go1.motion(self.qpos, self.qvel)
        velocity = motion.planar
        if self.env_cfg.velocity_frame == "body":  # D25: in the trunk's frame, which may be tilted
            velocity = np.column_stack([motion.linear[:, :2], motion.rates[:, 2]])
        outcome = self._outcome(substeps, motion, velocity, action_before)
        diverged = self._diverged()
        if diverged.any():
            state.action[diverged] = 0.0  # the action may be what was not finite
            outcome = Outcome(*(np.where(diverged, *x) for x in zip(NOTHING, outcome, strict=True)))
        self._count(velocity, outcome)
        terminated = diverged | outcome.contact | outcome.overload
        truncated = ~terminated & (state.age >= self.env_cfg.episode_steps)
        ended = (terminated | truncated) & ~np.isnan(state.episode_return)
        log = self._log(motion, outcome) | dict(
            episode_return=np.where(ended, state.episode_return, np.nan),
            episode_length=np.where(ended, state.age, np.nan),
            ended_fall=outcome.contact,
            ended_diverged=diverged,
            ended_limit=truncated,  # of time
            ended_power=outcome.overload,
        )

        if self.ground is not None:  # a robot that left its tile comes back on the other side
            self.qpos[:, :2] = terrain.wrap(self.qpos[:, :2], state.tile)
        self._next_command(np.flatnonzero(state.age % self.env_cfg.command_steps == 0))
        state.frames[:, :-1] = state.frames[:, 1:]
        state.frames[:, -1] = self._frame(motion)
        state.privileged[:] = motion.linear
        final_obs, final_privileged = obs, privileged = self.observe()
        if (over := np.flatnonzero(terminated | truncated)).size:
            self._start(over)
            obs, privileged = self.observe()
        info = dict(cost=outcome.cost, log=log, privileged=privileged)
        info |= dict(final_obs=final_obs, final_privileged=final_privileged)
        return obs, outcome.reward, terminated, truncated, info

    # ---- one control step ----

    def _simulate(self, target):
        """Simulate a control step with joint targets (N, 12) [rad]. Returns Substeps.

        Contacts are those with which a physics step begins. Those after the last one show in the
        next control step.
        """
        motor = go1.motor_model if self.env_cfg.motor_model else go1.pd_torque
        torque_speed = self.task.torque_speed or self.env_cfg.motor_model
        state = self.state
        torques = []
        qds = [self.qvel[:, 6:].copy()]
        touched = np.zeros(self.contacts.shape, bool)
        for _ in range(self.env_cfg.physics_steps):
            state.targets[:-1] = state.targets[1:]
            state.targets[-1] = target
            torque = motor(state.targets[0], self.qpos[:, 7:] + state.offset, qds[-1])
            self.ctrl[:] = go1.limit_torque(state.strength * torque, qds[-1], torque_speed)
            torques.append(self.ctrl.copy())
            self.batch.step()
            touched |= self.contacts > 0  # each counts the contacts of its part
            qds.append(self.qvel[:, 6:].copy())  # nothing limits the speed (D7)
        return Substeps(np.array(torques), np.array(qds), touched)

    def _outcome(self, substeps, motion, velocity, action_before):
        """The Outcome of a control step; velocity: (N, 3), as rewards.py takes it."""
        reward = task_reward = self.task.reward(velocity, self.state.command)  # Eqs. (5) to (8)
        if self.env_cfg.reward == "shaped":
            reward = self._shaped_reward(substeps, motion, velocity, action_before)
        power, cost = self._power_and_cost(substeps)
        forbidden = go1.ALL_BUT_FEET if self.task.only_feet else go1.TRUNK_TO_THIGHS
        contact = substeps.touched[:, forbidden].any(-1)  # however lightly it touches
        overload = (power > (self.env_cfg.max_power or np.inf)) & ~contact
        return Outcome(reward, task_reward, cost, power, contact, overload)

    def _count(self, velocity, outcome):
        """Count this control step in all that is counted or summed over steps."""
        state = self.state
        state.age += 1
        state.episode_return += outcome.reward
        if self.commands.learns:
            state.kernels += np.column_stack(rewards.kernels(velocity, state.command))
        if self.env_cfg.reward == "shaped":
            on_ground = self.contacts[:, go1.FEET] > 0
            state.off_ground[:] = np.where(on_ground, 0, state.off_ground + 1)

    def _diverged(self):
        """Which robots have numbers that are not finite, (N,): their episodes end (D36).

        MuJoCo records a warning, and any warning ends the episode. With latency an action would
        reach it only later, so the action is looked at, too.
        """
        return self.batch.warning[..., 1].any(-1) | ~np.isfinite(self.state.action).all(-1)

    def _power_and_cost(self, substeps):
        """Power (N,) [W] and auxiliary cost f (N,), means over the physics steps."""
        # a torque changes the speed during a physics step, so take the mean of before and after
        # (D17)
        qd = (substeps.qd[:-1] + substeps.qd[1:]) / 2
        power = energy.total_power(substeps.torque, qd, self.env_cfg.clip)
        if self.env_cfg.aux == "smooth":
            qdd = self._acceleration(substeps)
            cost = energy.smoothness_cost(substeps.torque, self.state.action, qdd)
        else:
            cost = energy.energy_cost(power)
        return power.mean(0), cost.mean(0)

    def _acceleration(self, substeps):
        """Mean joint acceleration (N, 12) [rad/s^2] over a control step."""
        return (substeps.qd[-1] - substeps.qd[0]) / self.dt

    def _shaped_reward(self, substeps, motion, velocity, action_before):
        """The shaped reward (N,)."""
        state = self.state
        touch = self.contacts[:, go1.FEET] > 0
        landed = rewards.landings(state.off_ground, touch, self.dt)
        ground = 0.0 if self.ground is None else terrain.height(self.ground, self.qpos[:, :2])
        gait = rewards.Gait(
            v_z=motion.linear[:, 2],
            roll_pitch_rate=motion.rates[:, :2],
            gravity=go1.felt_gravity(motion.to_world, state.gravity),
            torque=substeps.torque[-1],
            qdd=self._acceleration(substeps),
            height=self.qpos[:, 2] - ground,
            landed=landed,
            collisions=(self.contacts[:, go1.THIGHS_AND_CALVES] > 0).sum(-1),
            action_change=state.action - action_before,
            q=self.qpos[:, 7:],
            joint_range=self.joint_range,
        )
        return rewards.shaped(velocity, state.command, gait)

    def _log(self, motion, outcome):
        """Numbers (N,) that tell how training goes: m/s, W, and shares of 1."""
        command_x = self.state.command[:, 0].copy()
        log = dict(v_x=motion.planar[:, 0], power=outcome.power, command_x=command_x)
        if self.env_cfg.reward == "shaped":
            log |= dict(task_reward=outcome.task_reward)
        if self.commands.learns:
            log |= dict(command_area=np.full(self.num_envs, self.commands.weights.mean()))
        return log

    def _frame(self, motion, ids=slice(None)):
        """A frame (n, FRAME_WIDTH) of the observation of the robots `ids`; motion: go1.Motion."""
        state = self.state
        phase = 2 * np.pi * self.env_cfg.clock_hz * self.dt * state.age[ids]
        entries = dict(
            gravity=go1.felt_gravity(motion.to_world, state.gravity[ids]),
            command=state.command[ids],
            q=self.qpos[ids, 7:] - go1.Q_NOMINAL,
            qd=self.qvel[ids, 6:],
            previous_action=state.action[ids],
            timing=np.column_stack([np.sin(phase), np.cos(phase)]),
        )
        frame = np.hstack([entries[name] for name in FRAME])
        noise = self.env_cfg.noise * FRAME_NOISE * self.rng.uniform(-1.0, 1.0, frame.shape)
        return FRAME_SCALE * (frame + noise)

    def _next_command(self, ids):
        """Record how the robots `ids` followed their commands, and draw new ones.

        A command is judged over the steps planned for it, so what a fall cuts off counts as 0.
        """
        state = self.state
        self.commands.record(state.command[ids], state.kernels[ids] / state.planned[ids, None])
        state.command[ids] = self.commands.draw(self.rng, ids)
        state.kernels[ids] = 0.0
        self._plan(ids)

    def _plan(self, ids):
        """Set for how long the commands of the robots `ids` are to last: until the next one or the
        limit of time. It is at least 1, because `_next_command` divides by it.
        """
        left = self.env_cfg.episode_steps - self.state.age[ids]
        self.state.planned[ids] = np.clip(left, 1, self.env_cfg.command_steps)

    # ---- new episodes ----

    def _start(self, ids):
        """Begin new episodes for the robots `ids`."""
        state = self.state
        self._place(ids)
        self._randomize(ids)
        state.targets[:, ids] = go1.Q_NOMINAL
        state.action[ids] = 0.0
        state.off_ground[ids] = 1
        state.age[ids] = 0
        state.episode_return[ids] = 0.0
        self._next_command(ids)
        self._observe_first(ids)

    def _observe_first(self, ids):
        """Let the robots `ids` see the present frame H times."""
        motion = go1.motion(self.qpos[ids], self.qvel[ids])
        self.state.frames[ids] = self._frame(motion, ids)[:, None]
        self.state.privileged[ids] = motion.linear

    def _place(self, ids):
        """Put the robots `ids` on the ground, in random poses around the nominal one."""
        n = len(ids)
        uniform = self.rng.uniform
        spread = self.env_cfg.start_spread  # of joint angles, relative; of velocities, m/s, rad/s
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        q = np.clip(go1.Q_NOMINAL * uniform(1 - spread, 1 + spread, (n, 12)), *self.joint_range)
        yaw = Rotation.from_rotvec(uniform(-np.pi, np.pi, n)[:, None] * [0.0, 0.0, 1.0])
        points = np.einsum("nij,nkj->nki", yaw.as_matrix(), go1.leg_points(q))
        xy = np.zeros((n, 2))
        ground = 0.0
        if self.ground is not None:
            self.state.tile[ids] = self.rng.integers(self.env_cfg.tiles, size=n)
            xy = terrain.origin(self.state.tile[ids]) + uniform(0.0, terrain.TILE, (n, 2))
            ground = terrain.height(self.ground, xy[:, None] + points[..., :2])
        # the height at which the first foot touches the ground, or a knee nearly does
        height = go1.FOOT_RADIUS + (ground - points[..., 2]).max(-1)
        self.qpos[ids] = np.column_stack([xy, height, yaw.as_quat(scalar_first=True), q])
        self.qvel[ids, :6] = uniform(-spread, spread, (n, 6))

    def _randomize(self, ids):
        """Draw friction, masses, gravity and motors of the robots `ids` (domain randomization)."""
        n = len(ids)
        uniform = self.rng.uniform
        state, env_cfg = self.state, self.env_cfg
        state.friction[np.ix_(ids, self.feet, [0])] = uniform(*env_cfg.friction, (n, 1, 1))
        state.mass[ids, self.trunk.id] = self.trunk.mass + uniform(*env_cfg.payload, n)
        state.com[ids, self.trunk.id] = self.trunk.ipos + uniform(*env_cfg.com, (n, 3))
        self.batch.set_const(ids)  # what MuJoCo derives from the masses
        state.gravity[ids] = GRAVITY + uniform(*env_cfg.gravity, (n, 3))
        state.strength[ids] = uniform(*env_cfg.motor_strength, (n, 1))
        state.offset[ids] = uniform(*env_cfg.motor_offset, (n, 12))
