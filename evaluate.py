"""Trained policies, measured as in Sections IV-D and V: `python evaluate.py RUN...` plays episodes
of 1000 control steps without exploration noise, and prints a line for each run folder: the score
with a 95 % interval, the share of episodes that ended early, v_x and peak [m/s], power [W] and J/m.

Each episode keeps one command. It starts from a random pose, and noise, friction and payload are
drawn, as in training, but the ground is new, and on `rough` all of it has 15 cm. Policies of a task
that play equally many episodes start from the same draws. `python -m results` draws figures.
"""

import math
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads only wait
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn, so nothing that draws needs to work

import numpy as np
from scipy import stats

import go1_env
import tasks
from runtime import run_folder
from runtime.cli import COUNT, Parser, a_path, misfit, program

# of the episodes and of their ground. The seeds of training, 2 * seed + 1 and --ground-seed, are
# below 2**33, so training never draws the same.
SEED = 2**64 + 2024
CLIP = "power"  # what Eq. (9) clips for every policy, whatever it was trained with (D3)
EPISODE_STEPS = 1000  # control steps, Section V-A
SLOW = 0.05  # m/s, robots that are no faster on average count as standing
ROUGHNESS = {"rough": (0.15, 0.15)}  # m, of the ground where it is not that of training [V-B]


class Episodes(NamedTuple):
    """What is measured of N episodes: one number of each, (N,). Speed ahead is over ground."""

    score: np.ndarray  # sum of task rewards / 1000; after an early end they are 0 [V-A]
    fell: np.ndarray  # bool, ended early: a fall, the limit of power, or numbers blew up
    v_x: np.ndarray  # [m/s] mean speed ahead while the episode lasted
    power: np.ndarray  # [W] mean of Eq. (9) without the survival bonus
    peak: np.ndarray  # [m/s] largest speed ahead


# ---- a policy and a world to try it in ----


def evaluation_config(env_cfg, clip=CLIP, nominal=False):
    """The Config in which a policy that was trained with env_cfg is evaluated, see `load`.

    nominal: start from the nominal pose at rest, not from random poses as in training
    """
    return replace(
        env_cfg,
        reward="paper",
        velocity_frame="heading",
        stagger=False,
        episode_steps=EPISODE_STEPS,
        command_steps=EPISODE_STEPS,
        start_spread=0.0 if nominal else env_cfg.start_spread,
        clip=clip,
        ground_seed=SEED,
        roughness=ROUGHNESS.get(env_cfg.task, env_cfg.roughness),
    )


def load(folder, clip=CLIP, prime=False):
    """The policy.Policy of a run folder, and the Config in which it is evaluated.

    clip:  of Eq. (9), "power" or "torque"
    prime: take pi', the rival, which only runs of EIPO have
    """
    name = "policy_prime.npz" if prime else "policy.npz"
    pi, env_cfg = run_folder.load_policy(Path(folder) / name)
    return pi, evaluation_config(env_cfg, clip)


# ---- episodes ----


def make_env(env_cfg, command):
    """An environment with a robot for each command (N, 3) [m/s, m/s, rad/s], which it keeps."""
    return go1_env.Go1Env(len(command), env_cfg, commands=tasks.Given(np.array(command, float)))


def run_episodes(policy, env):
    """Play one episode of every robot of env: the Episodes, and speed ahead (T, N) [m/s], NaN after
    the end.

    policy: function of obs (N, D) that returns actions (N, 12) [-], as Policy.mean
    """
    obs, _ = env.reset(SEED)
    alive, fell = np.ones(env.num_envs, bool), np.zeros(env.num_envs, bool)
    steps = []
    for _ in range(env.env_cfg.episode_steps):
        obs, reward, terminated, truncated, info = env.step(policy(obs))
        steps.append((alive, reward, info["log"]["v_x"], info["log"]["power"]))
        fell |= alive & terminated
        alive = alive & ~(terminated | truncated)  # a new array: `steps` holds the old one
    alive, *series = map(np.stack, zip(*steps, strict=True))  # (T, N) each
    reward, v_x, power = (np.where(alive, x, np.nan) for x in series)
    episodes = Episodes(
        score=np.nansum(reward, 0) / len(alive),
        fell=fell,
        v_x=np.nanmean(v_x, 0),
        power=np.nanmean(power, 0),
        peak=np.nanmax(v_x, 0),
    )
    return episodes, v_x


# ---- numbers ----


def energy_per_metre(power, v_x):
    """Energy per metre [J/m] of robots: mean power [W] over mean speed [m/s], ahead or backwards.

    power, v_x: (..., N), averaged over the last axis. Robots that stand spend infinitely much.
    """
    power, speed = np.mean(power, -1), np.abs(np.mean(v_x, -1))
    return np.where(speed > SLOW, power / np.maximum(speed, SLOW), np.inf)


def iqm(x, axis=None):
    """Interquartile mean of x, as in Table I. It ignores the lowest and the highest quarter."""
    return stats.trim_mean(x, 0.25, axis=axis)


def commands_of(task):
    """The commands (n, 3) [m/s, m/s, rad/s] of an evaluation [Figs. 2 to 4].

    They are 0, 1/10, ..., 1 of the task's example, or a single 0 if the task asks for nothing.
    """
    example = tasks.TASKS[task].commands().example
    return np.arange(11)[:, None] / 10 * example if example.any() else np.zeros((1, 3))


def numbers(e):
    """The numbers by which runs are compared, from columns (N,) of episodes or of commands.

    e: the fields of Episodes, and asked_v_x [m/s]. Energy per metre leaves out what asks for less
        than 0.1 m/s, unless all of it does.
    """
    moving = e["asked_v_x"] >= 0.1
    moving |= not moving.any()
    return {
        "score": float(e["score"].mean()),  # task performance of V-A; on `velocity` [m/s]
        "fell": float(e["fell"].mean()),  # share of episodes that ended early
        "v_x": float(e["v_x"].mean()),  # [m/s]
        "peak": float(iqm(e["peak"])),  # [m/s] interquartile mean, as in Table I
        "power": float(e["power"].mean()),  # [W] Eq. (9) without its bonus
        "J/m": float(energy_per_metre(e["power"][moving], e["v_x"][moving])),
    }


def interval(x):
    """95 % interval (low, high) of the mean of x (n, commands), n episodes of each, by Student's t.

    The commands are fixed, so differences between them are not due to chance. Only the variance
    within a command counts, with commands * (n - 1) degrees of freedom. The ends are NaN if n is 1.
    """
    n, commands = x.shape
    if n < 2:
        return np.nan, np.nan
    error = np.sqrt((x.var(0, ddof=1) / n).sum()) / commands
    half = stats.t.ppf(0.975, commands * (n - 1)) * error
    return x.mean() - half, x.mean() + half


def evaluate(pi, env_cfg, episodes):
    """Play episodes of a policy, and return the numbers that `main` prints, by name.

    pi, env_cfg: of `load`

    The 95 % interval is of the score.
    """
    commands = commands_of(env_cfg.task)
    each = math.ceil(episodes / len(commands))  # equally many of each command
    asked = np.tile(commands, (each, 1))
    played, _ = run_episodes(pi.mean, make_env(env_cfg, asked))
    low, high = interval(played.score.reshape(each, -1))
    found = numbers(played._asdict() | dict(asked_v_x=asked[:, 0]))
    row = dict(episodes=len(asked), score=found["score"])
    return row | {"95 % from": low, "to": high} | found


@program("evaluate.py")
def main(argv):
    """Evaluate and print; returns the exit status."""
    parser = Parser("evaluate.py", __doc__)
    add = parser.add_argument
    add("runs", nargs="+", type=a_path, metavar="RUN", help="run folders with a policy.npz")
    add("--episodes", type=int, default=1000, help="of each run, at least (default: 1000)")
    add("--clip", choices=("torque", "power"), default=CLIP, help="of Eq. (9), D3 (default: power)")
    add("--prime", action="store_true", help="pi', the rival in EIPO, instead of pi")
    args = parser.parse_args(argv)
    if line := misfit(vars(args), dict(episodes=COUNT)):
        parser.error(line)
    names = [folder.resolve().name for folder in args.runs]
    if len({*names}) < len(names):  # two folders have one name: show their paths
        names = args.runs
    loaded = [load(folder, args.clip, prime=args.prime) for folder in args.runs]
    for i, (pi, env_cfg) in enumerate(loaded):
        row = evaluate(pi, env_cfg, args.episodes)
        if i == 0:
            print("| run |", " | ".join(row), "|\n|---" + "|---" * len(row) + "|")
        cells = " | ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row.values())
        print(f"| {names[i]} | {cells} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
