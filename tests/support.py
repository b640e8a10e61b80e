"""What several files of tests need, once: settings and networks of the learner, robots placed by
hand, run folders.
"""

import ctypes.util
import signal
import subprocess
import threading
from contextlib import contextmanager
from dataclasses import replace

import jax
import mujoco
import numpy as np

import eipo
import go1
import go1_env
import ppo
import tasks
from networks import MLP
from runtime import run_folder
from runtime.flags import settle

# ---- the learner ----

# gamma = gae_lambda = 1/2. JAX compiles each function once for all of tests/paper
EIPO = eipo.Config(
    lam=4.0,
    num_envs=32,
    num_steps=8,
    num_epochs=4,
    num_minibatches=2,
    lr=0.01,
    target_kl=0.0,
    gamma=0.5,
    gae_lambda=0.5,
    ent_coef=0.01,
    reward_scale=1.0,
    lr_alpha=1.0,
    momentum_alpha=0.9,
    hidden=(32,),
    hidden_estimator=(8,),
)


def dyadic(rng, *shape):
    """Random multiples of 1/8 between -1 and 1. Their sums and products are exact in float32."""
    return (rng.integers(-8, 9, shape) / 8).astype(np.float32)


def trees_equal(a, b):
    """Whether two trees of arrays agree in every number."""
    return jax.tree.all(jax.tree.map(np.array_equal, a, b))


def layer(weights, bias=0.0):
    """A layer of an MLP: weights (n, m), and the bias of all its units or of each."""
    weights = np.array(weights, np.float32)
    return weights, np.full(weights.shape[1], bias, np.float32)


def handmade(critic=((1.0,), (0.0,)), estimator=((0.0,),), actor=((0.0,), (0.0,))):
    """Parameters of networks without hidden layers, from a row of weights for each input.

    Inputs are obs first. By default an observation, the privileged part and an action are one
    number each, and V(obs) is obs, whatever is privileged.
    """
    log_std = np.zeros(len(actor[0]), np.float32)
    nets = dict(actor=actor, critic=critic, estimator=estimator)
    return {name: MLP([layer(weights)]) for name, weights in nets.items()} | dict(log_std=log_std)


def learner_of(params, lam=1.0):
    """The Learner of such parameters, from r and lam f. With one head it learns from r alone."""
    heads = len(params["critic"].layers[-1][1])
    return ppo.Learner(params, None, None, (("reward", 1.0), ("cost", lam))[:heads])


# ---- the environment ----

# rad, go1.Q_NOMINAL
NOMINAL = np.array([-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5])
LEGS = ("FR", "FL", "RR", "RL")
UPRIGHT, ON_ITS_BACK, ON_ITS_SIDE = (1, 0, 0, 0), (0, 1, 0, 0), (0.5**0.5, 0.5**0.5, 0, 0)
# nose up by 60 degrees, at 1 m/s ahead and 1 rad/s over ground; in the trunk's frame the latter is
# (sin 60, 0, cos 60)
NOSE_UP = dict(quaternion=(0.75**0.5, 0, -0.5, 0), velocity=(1, 0, 0), rates=(0.75**0.5, 0, 0.5))
# a physics step of a nanosecond, in which no state that a test writes can move
FROZEN = dict(timestep=1e-9)

QUIET = dict(  # what the curriculum draws at random, held still
    com=(0.0, 0.0),
    motor_strength=(1.0, 1.0),
    motor_offset=(0.0, 0.0),
    gravity=(0.0, 0.0),
    latency=0,
    friction=(0.8, 0.8),
    payload=(0.0, 0.0),
    roughness=(0.0, 0.0),
)
# the action (2, 12) that asks every joint for 0.25 rad more than the nominal pose
QUARTER = np.full((2, 12), 1.0) / np.tile([0.5, 1.0, 1.0], 4)


def make(num_envs=2, threads=1, seed=0, **fields):
    """An environment after a reset. It has no noise, and its first episodes start at age 0.

    fields: of tasks.Config; without a task it is flat ground
    """
    fields = dict(noise=0.0, stagger=False) | fields
    env = go1_env.Go1Env(num_envs, tasks.task_config(**fields), threads)
    env.reset(seed)
    return env


def place(env, q=NOMINAL, qd=0.0, height=1.0, quaternion=UPRIGHT, velocity=(0, 0, 0), rates=0.0):
    """Put every robot into the same state: joints, and height, pose, velocity, rates of the trunk.

    velocity: in the world's frame; rates: in the trunk's
    """
    env.qpos[:, 2], env.qpos[:, 3:7], env.qpos[:, 7:] = height, quaternion, q
    env.qvel[:, :3], env.qvel[:, 3:6], env.qvel[:, 6:] = velocity, rates, qd


def quiet(num_envs=2, **fields):
    """The curriculum's world, in which nothing is drawn and nothing moves from the nominal pose."""
    env = make(num_envs, **dict(task="curriculum") | QUIET | FROZEN | fields)
    place(env)
    return env


def still(env, steps=1):
    """What the last of some steps with action 0 returns."""
    for _ in range(steps):
        result = env.step(np.zeros((env.num_envs, 12)))
    return result


def frames(obs):
    """Observations (N, H * 44) as (N, H, 44)."""
    return obs.reshape(len(obs), -1, 44)


def soles(qpos):
    """Height of the four soles [m] of a robot at qpos (19,), by MuJoCo's kinematics."""
    model = mujoco.MjModel.from_xml_path(str(go1.MODEL))
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return np.array([data.geom(f"{leg}_foot").xpos[2] for leg in LEGS]) - 0.02


def random_actions(env, steps, seed=0):
    """Actions (steps, N, 12) as large as those of a policy that has not learned yet."""
    return np.random.default_rng(seed).normal(size=(steps, env.num_envs, 12))


def run(env, actions):
    """All that a learner sees of some steps, as one list of arrays to compare bit by bit."""
    seen = []
    for action in actions:
        obs, reward, terminated, truncated, info = env.step(action)
        seen += [obs, reward, terminated, truncated, *info.pop("log").values(), *info.values()]
        seen += env.observe()
    return seen


def same_bits(a, b):
    """Whether two lists of arrays agree in every bit."""
    return len(a) == len(b) and all(
        x.dtype == y.dtype and x.tobytes() == y.tobytes() for x, y in zip(a, b, strict=True)
    )


# ---- processes and signals ----

# in which any process of a test must have ended; on two idle cores it takes less than 60
SECONDS = 480


@contextmanager
def heard():
    """Meanwhile no signal that a test sends is ignored, neither here nor in a process that is
    started.

    In the background of a shell script SIGINT is ignored, and under nohup SIGHUP: children inherit
    that, and would go on for ever.
    """
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    ignored = [n for n in numbers if signal.getsignal(n) == signal.SIG_IGN]
    for number in ignored:  # a handler that does nothing; in a child it becomes the default
        signal.signal(number, lambda *_: None)
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def started(command, **options):
    """A process with pipes, which hears signals. It is killed where the context ends or, so that
    every wait for it has an end, after SECONDS.
    """
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with heard():
        process = subprocess.Popen([str(x) for x in command], **pipes, **options)
    late = threading.Timer(SECONDS, process.kill)
    late.daemon = True
    late.start()
    with process:
        try:
            yield process
        finally:
            late.cancel()
            process.kill()


# ---- run folders and commands ----

ROOT = go1.MODEL.parent  # of the repository
HAS_GL = bool(ctypes.util.find_library("EGL") or ctypes.util.find_library("OSMesa"))
TINY = ["--num-envs", "4", "--num-steps", "4", "--history", "2"]
TINY += ["--hidden", "8", "--hidden-estimator", "8"]


def make_run(folder, task="flat", **learner):
    """The path of a new run folder with an untrained policy, which claims 35 iterations."""
    env_cfg = tasks.task_config(task, history=2, tiles=2)
    small = dict(hidden=(8,), hidden_estimator=(8,))
    _, cfg = settle(dict(task=task), small | learner)
    env = go1_env.Go1Env(1, env_cfg, 1)
    pi = ppo.init_learner(np.random.default_rng(cfg.seed), env, dict(reward=1.0, cost=1.0), cfg)
    folder.mkdir(exist_ok=True)
    run_folder.save_config(folder, run_folder.record(env_cfg, cfg, [], dict(device="cpu")))
    about = dict(iteration=35, algo=cfg.algo, lam=cfg.lam, seed=cfg.seed)
    run_folder.save_policy(folder / "policy.npz", pi.params, env_cfg, about)
    return folder


def rewrite(file, about=(), **world):
    """Let a policy file of a run folder say what it is of, in a world with other settings."""
    pi, env_cfg = run_folder.load_policy(file)
    params = dict(actor=MLP(pi.actor), estimator=MLP(pi.estimator))
    run_folder.save_policy(file, params, replace(env_cfg, **world), pi.about | dict(about))


def error_of(capsys, main, *argv):
    """The one line that a failing command prints; its status is 2."""
    try:
        status = main([str(x) for x in argv])
    except SystemExit as end:  # by argparse
        status = end.code
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    name = main.__module__
    name = "python -m results" if name == "results.__main__" else f"{name}.py"
    assert line.startswith(f"{name}: ")
    return line
