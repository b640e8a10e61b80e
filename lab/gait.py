"""Footfalls: `python -m lab gait RUN...` says how a robot moves its feet, and draws it.

A stride is a period of the feet's contacts. The phase of a foot is the share of a stride, 0 to 1,
by which the middle of its stance follows that of the front right foot. A gait is named by the
phases alone, roughly as Hildebrand (1977) does. Two feet are together if their phases differ by at
most 1/8 of a stride, and they alternate from 3/8 on.

| gait   | right and left foot, in front and behind | and                                        |
|--------|------------------------------------------|--------------------------------------------|
| trot   | both pairs alternate                     | front follows hind foot by nearly 1/2      |
| pace   | both pairs alternate                     | front follows hind foot by nearly 0        |
| walk   | both pairs alternate                     | front follows hind foot by 1/4 or 3/4      |
| pronk  | both pairs are together                  | front and hind pair are together           |
| bound  | both pairs are together                  | front and hind pair are not                |
| gallop | neither alternates, not both together    | so that a pair lands one foot soon after   |
| none   | anything else                            | or strides differ, or a foot never touches |
"""

import sys
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy import signal

import energy
import evaluate
import go1
import go1_env
import tasks
import terrain
from runtime import run_folder

SETTLE = 200  # control steps, 4 s, before anything is recorded
WINDOW = 200  # control steps, 4 s, that are recorded
SHOWN = 2.0  # s, of which the feet are drawn
STRIDES = (1.0, 15.0)  # Hz, among which the stride frequency is looked for
LOCKED = 0.7  # the strides differ if a foot's agreement in `foot_phases` is less
COMMANDS = (0.3, 0.6, 1.0)  # m/s, v_x
COLOURS = ("#0072B2", "#56B4E9", "#D55E00", "#E69F00")  # of FR, FL, RR, RL


class Record(NamedTuple):
    """What N robots did in T physics steps, which are C control steps, after they had settled."""

    contact: np.ndarray  # (T, N, 4) bool, which feet are on the ground
    qd: np.ndarray  # (T, N, 12) [rad/s] mean of a physics step, as in the power
    torque: np.ndarray  # (T, N, 12) [N m]
    body: np.ndarray  # (C, N, 3) height of the trunk above the ground [m], pitch and roll [degrees]
    v_x: np.ndarray  # (C, N) [m/s] speed ahead over ground
    power: np.ndarray  # (C, N) [W] Eq. (9) without its bonus
    upright: np.ndarray  # (N,) bool, who has not fallen


class Watched:
    """A mujoco.batch.Batch, after each step of which look() is called."""

    def __init__(self, batch, look):
        self.batch = getattr(batch, "batch", batch)
        self.look = look

    def __getattr__(self, name):
        return getattr(self.batch, name)

    def step(self, *args, **options):
        """As mujoco.batch.Batch.step."""
        self.batch.step(*args, **options)
        self.look()


def record(policy, env, command):
    """The Record of the robots of env. Arguments are those of `evaluate.steps`."""
    physics = []
    control = []
    qd = env.qvel[:, 6:].copy()

    def look():  # after every physics step
        before = qd.copy()
        qd[:] = env.qvel[:, 6:]
        joints = (before + qd) / 2, env.ctrl
        physics.append((env.contacts[:, -4:] > 0, *(x.astype(np.float32) for x in joints)))

    env.batch = Watched(env.batch, look)
    for _, log, alive, fell in islice(evaluate.steps(policy, env, command), SETTLE + WINDOW):
        upright = alive & ~fell
        del physics[: -WINDOW * env.env_cfg.physics_steps]
        ground = 0.0 if env.ground is None else terrain.height(env.ground, env.qpos[:, :2])
        control.append(
            [env.qpos[:, 2] - ground, log["pitch"], log["roll"], log["v_x"], log["power"]]
        )
    height, pitch, roll, v_x, power = np.moveaxis(control[SETTLE:], 1, 0)
    body = np.stack([height, pitch, roll], -1)
    return Record(*(np.array(x) for x in zip(*physics, strict=True)), body, v_x, power, upright)


# ---- of one robot: from contacts to the name of a gait ----


def stride_frequency(contact, dt):
    """Strides per second [Hz]: where the power spectrum of the feet's contacts is highest.

    contact: (T, 4) bool; dt: [s] between two rows
    """
    window = min(len(contact), round(2 / dt))  # of 2 s, so that strides may drift
    hz, power = signal.welch(
        contact, 1 / dt, nperseg=window, nfft=round(50 / dt), detrend="constant", axis=0
    )
    among = (hz >= STRIDES[0]) & (hz <= STRIDES[1])
    return hz[among][np.argmax(power[among].sum(-1))]


def foot_phases(contact, frequency, dt):
    """Phases (4,) [strides] of the feet behind FR, and how well the strides agree on each, 0 to 1.

    A foot's stance in a stride is the sum of exp(2 pi i frequency t) over its contacts, a vector
    that points at its middle. Phases are circular means over whole strides. contact, dt: as for
    `stride_frequency`; frequency: [Hz]
    """
    turns = np.arange(len(contact)) * dt * frequency
    stride = turns.astype(int)
    stances = np.zeros((stride[-1] + 1, 4), complex)
    np.add.at(stances, stride, contact * np.exp(2j * np.pi * turns)[:, None])
    stances = stances[: max(1, int(len(contact) * dt * frequency + 1e-6))]
    common = (stances * stances[:, :1].conj()).sum(0)
    size = np.square(np.abs(stances)).sum(0)
    common[0] = size[0]  # without the rounding that would make its phase almost 1
    return np.angle(common) / (2 * np.pi) % 1, np.abs(common) / np.sqrt(size * size[0])


def gait_name(phases):
    """The gait by the table at the top of this file; phases: (4,) [strides] of FR, FL, RR, RL."""
    lag = lambda a, b: abs((a - b + 0.5) % 1 - 0.5)  # noqa: E731  [strides], 0 to 1/2
    fr, fl, rr, rl = phases
    pairs = lag(fr, fl), lag(rr, rl)
    front, hind = np.exp(2j * np.pi * np.reshape(phases, (2, 2)))
    if min(pairs) >= 3 / 8:
        # by which the front feet follow the hind feet
        quarters = np.angle((front * hind.conj()).sum()) / (np.pi / 2)
        return ("pace", "walk", "trot", "walk")[round(quarters) % 4]
    if max(pairs) <= 1 / 8:
        return "pronk" if abs(np.angle(front.sum() * hind.sum().conj())) <= np.pi / 4 else "bound"
    return "gallop" if max(pairs) < 3 / 8 else "none"


def strides(contact, dt):
    """Gait, stride frequency [Hz] and phases (4,) of a robot. Arguments: `stride_frequency`."""
    if contact.all(0).any() or not contact.any(0).all():
        return "none", np.nan, np.full(4, np.nan)
    frequency = stride_frequency(contact, dt)
    phases, agreement = foot_phases(contact, frequency, dt)
    return gait_name(phases) if agreement.min() >= LOCKED else "none", frequency, phases


# ---- of many robots: gait.csv and gait.png ----


def leg_power(seen, clip):
    """Power of each leg's motors, Eq. (9) without constants, (T, N, 4) [W]; clip: see energy.py."""
    torque, qd = (x.reshape(*x.shape[:2], 4, 3) for x in (seen.torque, seen.qd))
    return energy.mechanical_power(torque, qd, clip) + energy.heating_power(
        torque, energy.GEAR_RATIO[:3]
    )


def gait_row(seen, weight, env_cfg):
    """Columns of gait.csv, means over the robots that did not fall, and which robot is drawn.

    Stride frequency, phases and the robot are of those with the commonest gait. weight: (N,) [N] of
    each robot
    """
    up = np.flatnonzero(seen.upright)
    found = [strides(seen.contact[:, i], env_cfg.timestep) for i in up]
    names = [name for name, _, _ in found]
    gait = max(names, key=names.count, default="none")
    same = [i for i, name in enumerate(names) if name == gait]
    hz = np.array([found[i][1] for i in same])
    phases = np.array([found[i][2] for i in same]).reshape(-1, 4)
    phases = np.round(np.angle(np.exp(2j * np.pi * phases).sum(0)) / (2 * np.pi), 6) % 1
    contact = seen.contact[:, up]
    v_x = seen.v_x[:, up].mean(0)
    power = seen.power[:, up].mean(0)
    energy_per_m = float(evaluate.energy_per_metre(power, v_x)) if len(up) else np.nan
    row = dict(
        gait=gait,
        share=len(same) / max(1, len(up)),
        stride_hz=hz,
        v_x=v_x,
        power=power,
        energy=energy_per_m,
        cost_of_transport=energy_per_m / evaluate.finite_mean(weight[up]),
        flight=~contact.any(-1),
    )
    legs = leg_power(seen, env_cfg.clip)[:, up]
    for prefix, x in dict(duty=contact, phase=phases, power=legs).items():
        row |= {f"{prefix}_{leg}": x[..., i] for i, leg in enumerate(go1.LEGS)}
    row |= {name: seen.body[:, up, i] for i, name in enumerate(("height", "pitch", "roll"))}
    for name, x in dict(stride_hz=hz, v_x=v_x, duty=contact.mean((0, 2))).items():
        row[f"{name}_sd"] = float(np.std(x)) if len(x) else np.nan  # over robots
    for name, x in row.items():
        row[name] = x if isinstance(x, str | float) else evaluate.finite_mean(x)
    return row, up[same[0]] if same else 0


def played(folders, args):
    """Yields run folder, v_x [m/s] asked for, env and Record, for every run and every command.

    A run plays about args.episodes robots, equally many of each command: args.command, or COMMANDS.
    On a task without a command of v_x, this is 0. Ground and starts are random, as in training.
    """
    if not np.isfinite(args.command or 0.0).all():
        raise ValueError(f"--command is {args.command}: it takes finite numbers")
    for folder in map(Path, folders):
        task = run_folder.load_config(folder)[0].task
        speeds = args.command or (COMMANDS if tasks.asks_speed(task) else (0.0,))
        robots = max(1, args.episodes // len(speeds))
        policy, env = evaluate.load(folder, robots, args.clip, args.roughness, world=args.world)
        for v_x in speeds:
            command = np.array([v_x, 0.0, 0.0])
            if warning := tasks.untrained(task, command):
                print(f"lab: {folder}: {warning}", file=sys.stderr)
            yield folder, v_x, env, record(policy, env, np.tile(command, (env.num_envs, 1)))


def one_robot(seen, i):
    """The Record of robot i alone; a copy, so that those of the others need no memory."""
    return Record(*(x[..., [i]] if x.ndim == 1 else x[:, [i]] for x in seen))


def draw(axes, seen, env_cfg):
    """Draw the first robot on four axes: contacts, height, attitude, and power of its legs."""
    feet, height, attitude, power = axes
    steps = env_cfg.physics_steps
    n = round(SHOWN / env_cfg.timestep)
    contact = seen.contact[:n, 0]
    legs = leg_power(seen, env_cfg.clip)[:n, 0]
    time = env_cfg.timestep * np.arange(len(contact))
    body = seen.body[: len(contact) // steps, 0]
    for j, (leg, colour) in enumerate(zip(go1.LEGS, COLOURS, strict=True)):
        feet.fill_between(
            time, -j - 0.4, -j + 0.4, where=contact[:, j], step="post", color=colour, linewidth=0
        )
        power.plot(
            time[::steps],
            legs[:, j].reshape(-1, steps).mean(1),
            color=colour,
            linewidth=0.8,
            label=leg,
        )
    feet.set(yticks=-np.arange(4), yticklabels=go1.LEGS)
    height.plot(time[::steps], body[:, 0], color="black", linewidth=0.8)
    for x, name, colour in zip(body.T[1:], ("pitch", "roll"), ("black", "gray"), strict=True):
        attitude.plot(time[::steps], x, color=colour, linewidth=0.8, label=name)
    power.set(xlabel="time [s]", xlim=(0, SHOWN), xticks=np.arange(0, SHOWN, 0.5))


def gait(folders, args):
    """The footfalls of each run at each command. One robot of each is drawn."""
    rows = []
    drawn = []
    for folder, v_x, env, seen in played(folders, args):
        row, i = gait_row(seen, -go1_env.GRAVITY[2] * env.state.mass.sum(1), env.env_cfg)
        about = dict(run=folder.name, v_x_asked=v_x, episodes=env.num_envs)
        rows.append(about | dict(fell=1 - seen.upright.mean()) | row)
        drawn.append((one_robot(seen, i), env.env_cfg))
    figure = Figure(figsize=(4 * len(rows) + 0.5, 7), layout="constrained")
    axes = figure.subplots(4, len(rows), sharex="col", sharey="row", squeeze=False)
    for column, row, (seen, env_cfg) in zip(axes.T, rows, drawn, strict=True):
        draw(column, seen, env_cfg)
        asked = f", asked for {row['v_x_asked']:g} m/s" if tasks.asks_speed(env_cfg.task) else ""
        walks = f"{row['v_x']:.2f} m/s, {row['gait']}, {row['stride_hz']:.1f} strides/s"
        column[0].set_title(f"{row['run']}{asked}:\n{walks}", fontsize=9)
    for panel, label in zip(
        axes[:, 0], ("feet", "height [m]", "attitude [degrees]", "power of legs [W]"), strict=True
    ):
        panel.set_ylabel(label)
    for panel in axes[2:, 0]:
        panel.legend(fontsize=7, ncols=4, loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return rows, figure
