"""Footfalls: which foot is on the ground when, at several commands."""

import numpy as np
from matplotlib.figure import Figure

import evaluate
import go1

SETTLE, SHOWN = 4.0, 1.5  # s: before anything is recorded, and recorded
COLORS = ("#0072B2", "#56B4E9", "#D55E00", "#E69F00")  # of FR, FL, RR, RL


def watch(policy, env):
    """Contacts of the feet FR, FL, RR, RL (T, N, 4) bool after T control steps, and mean speeds
    (N,) [m/s]. Recording begins when SETTLE has passed.

    Arguments are those of `evaluate.play_episode`.
    """
    contacts = []
    speeds = []
    first, last = (round(time / env.period) for time in (SETTLE, SETTLE + SHOWN))
    for i, (_, log, _, _) in enumerate(evaluate.play_episode(policy, env)):
        if i >= first:
            contacts.append(env.contacts[:, -4:] > 0)
            speeds.append(log["v_x"])
        if i + 1 == last:
            return np.array(contacts), np.mean(speeds, 0)


def draw(axes, contact, period, title):
    """Draw the contacts (T, 4) of a robot as a bar for each foot; period: [s] of a row."""
    for j, on_ground in enumerate(contact.T):
        changes = np.flatnonzero(np.diff(np.concatenate([[0], on_ground, [0]])))
        first, end = period * changes.reshape(-1, 2).T
        bars = np.column_stack([first, end - first])
        axes.broken_barh(bars, (-j - 0.4, 0.8), color=COLORS[j])
    axes.set(yticks=-np.arange(4), yticklabels=go1.LEGS, title=title)
    axes.set_xlim(0, period * len(contact))


def footfalls(folder, speeds):
    """Bars where the feet of a folder's robots touch the ground, which began in the nominal pose.

    speeds: [m/s] ahead, asked for, a robot each; a task without such commands has one robot
    """
    pi, env_cfg = evaluate.load(folder, nominal=True)
    env = evaluate.make_env(env_cfg, np.outer(speeds, [1.0, 0.0, 0.0]))
    contacts, reached = watch(pi.mean, env)
    asks = len(evaluate.commands_of(env_cfg.task)) > 1
    speeds = speeds if asks else speeds[:1]
    figure = Figure(figsize=(6, 1.3 * len(speeds) + 0.4), layout="constrained")
    panels = figure.subplots(len(speeds), 1, sharex=True, squeeze=False)[:, 0]
    for i, axes in enumerate(panels):
        asked = f"asked for {speeds[i]:g} m/s, " if asks else ""
        draw(axes, contacts[:, i], env.period, f"{asked}moves at {reached[i]:.2f} m/s")
    panels[-1].set_xlabel("time [s]")
    return figure
