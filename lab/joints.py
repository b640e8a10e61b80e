"""What the joints do: `python -m lab joints RUN...`. Look at it when a robot overheats, or before a
policy goes on a real one.

The CSV is of all robots that did not fall, the picture of one stride of one robot. Limits are those
of the Go1's URDF.
"""

import numpy as np
from matplotlib.figure import Figure

import energy
import go1
from lab import gait

NAMES = [f"{leg}_{joint}" for leg in go1.LEGS for joint in ("hip", "thigh", "calf")]


def joint_rows(seen, joint_range):
    """A row for each joint: its extremes and limits, the share of the time at its limits, and what
    heats it [W].

    seen: gait.Record, of which robots that fell do not count; joint_range: (2, 12) [rad]
    """
    q, qd, torque = (x[:, seen.upright].reshape(-1, 12) for x in (seen.q, seen.qd, seen.torque))
    if not len(q):
        q = qd = torque = np.full((1, 12), np.nan)
    columns = dict(
        q_least=q.min(0),
        q_most=q.max(0),
        q_low=joint_range[0],
        q_high=joint_range[1],
        at_stop=((q < joint_range[0]) | (q > joint_range[1])).mean(0),
        qd_most=np.abs(qd).max(0),
        qd_limit=go1.VELOCITY_LIMIT,
        torque_most=np.abs(torque).max(0),
        torque_limit=go1.TORQUE_LIMIT,
        at_limit=(np.abs(torque) > 0.999 * go1.TORQUE_LIMIT).mean(0),
        torque_rms=np.sqrt(np.square(torque).mean(0)),
        # Eq. (9), joint by joint
        heat=energy.heating_power(torque[..., None], energy.GEAR_RATIO[:, None]).mean(0),
    )
    return [
        dict(joint=name) | {c: float(x[j]) for c, x in columns.items()}
        for j, name in enumerate(NAMES)
    ]


def stride_of(contact, dt):
    """The rows of one stride, a slice that begins where FR touches down. contact: (T, 4) bool of
    one robot; dt: [s].

    Without a rhythm the stride is a second long.
    """
    _, frequency, _ = gait.strides(contact, dt)
    down = np.flatnonzero(contact[1:, 0] & ~contact[:-1, 0]) + 1
    start = down[0] if len(down) else 0
    return slice(start, start + round(1 / dt / (frequency if np.isfinite(frequency) else 1.0)))


def draw(figure, seen, joint_range, dt):
    """Draw angle with target, speed and torque of the first robot's joints over a stride: a column
    for each kind.
    """
    stride = stride_of(seen.contact[:, 0], dt)
    target, q, qd, torque = (x[stride, 0] for x in (seen.target, seen.q, seen.qd, seen.torque))
    time = 1000 * dt * np.arange(len(q))
    axes = figure.subplots(3, 3, sharex=True)
    for j, name in enumerate(NAMES):
        leg, kind = divmod(j, 3)
        style = dict(color=gait.COLOURS[leg], linewidth=1)
        axes[0, kind].plot(time, target[:, j], linestyle=":", drawstyle="steps-mid", **style)
        for panel, x in zip(axes[:, kind], (q, qd, torque), strict=True):
            panel.plot(time, x[:, j], label=name[:2], **style)
    limits = joint_range, go1.VELOCITY_LIMIT * [[-1], [1]], go1.TORQUE_LIMIT * [[-1], [1]]
    for kind, name in enumerate(("hip", "thigh", "calf")):
        axes[0, kind].set_title(name, fontsize=9)
        seen_angles = axes[0, kind].get_ylim()
        for panel, limit in zip(axes[:, kind], limits, strict=True):
            for x in limit[:, kind]:
                panel.axhline(x, color="black", linestyle="--", linewidth=0.8)
        axes[0, kind].set_ylim(seen_angles)  # its limits may be far away
    axes[2, 1].set_xlabel("time [ms]")
    axes[2, 0].legend(fontsize=7, ncols=2, loc="lower right")
    for panel, label in zip(
        axes[:, 0], ("angle, target [rad]", "speed [rad/s]", "torque [N m]"), strict=True
    ):
        panel.set_ylabel(label)


def joints(folders, args):
    """Angle, speed and torque of every joint against its limits, and what heats it, by command."""
    rows = []
    drawn = []
    for folder, v_x, env, seen in gait.played(folders, args):
        about = dict(run=folder.name, v_x_asked=v_x)
        rows += [about | row for row in joint_rows(seen, env.joint_range)]
        one = gait.one_robot(seen, np.argmax(seen.upright))
        drawn.append(
            (f"{folder.name}, asked for {v_x:g} m/s", one, env.joint_range, env.env_cfg.timestep)
        )
    figure = Figure(figsize=(9, 6.5 * len(drawn)), layout="constrained")
    for part, (title, *what) in zip(np.ravel(figure.subfigures(len(drawn))), drawn, strict=True):
        part.suptitle(title, fontsize=10)
        draw(part, *what)
    return rows, figure
