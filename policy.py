"""A trained policy in NumPy alone: what policy.npz promises, and how a robot runs it.

    pi = policy.load("policy.npz")
    target = pi.act(gravity, command, q, qd)  # 50 times a second

No policy of ours has run on a real robot. The arrays of `act`:

| array    | width | unit       | meaning                                                  |
|----------|-------|------------|----------------------------------------------------------|
| gravity  | 3     | -          | unit vector along gravity in the trunk's frame           |
| command  | 3     | m/s, rad/s | v_x forward, v_y to the left, yaw rate to the left       |
| q        | 12    | rad        | joint angles; 0: a straight leg, down from a level trunk |
| qd       | 12    | rad/s      | joint speeds                                             |
| estimate | 3     | m/s        | velocity of the trunk, which the robot cannot measure    |
| action   | 12    | -          | the actor's output, clipped at +- action_limit           |
| target   | 12    | rad        | joint targets: q_nominal + action_scale * action         |

The trunk's frame has x forward, y to the left, z up; its velocity is in this frame. A trunk with
its nose up has a negative gravity[0], one with its right side down a negative gravity[1]. Joints
are FR, FL, RR, RL x hip, thigh, calf. A positive hip angle moves the foot to the left, a positive
thigh angle moves it back, and a calf's is always negative. All hips turn about +x, all thighs and
calves about +y. A motor's torque in N m is kp * (target - q) - kd * qd, 200 times a second.

The file has `actor.0.W`, `actor.0.b` and so on, the layers (n_in, n_out) and (n_out,) of an MLP
with ELU between them; those of the estimator, likewise; and the other fields of `Policy` under
their own names, `config` as JSON, in which `about` is one entry more.
"""

import json
import math
from dataclasses import dataclass

import numpy as np

NUMBERS = ("frame_scale", "q_nominal", "action_scale", "kp", "kd")
# what lies beyond these is no measurement of a Go1, but a sensor that fails, or another unit
LENGTH = 0.8, 1.2  # [-] of gravity, which has length 1
REACH = np.tile([1.5, 4.0, 1.5], 4)  # [rad] of joint angles from q_nominal
FASTEST = 100.0  # [rad/s] of joints


@dataclass
class Policy:
    """A trained policy: `mean` takes observations, and `act` what one robot measures.

    `act` remembers what the robot has measured since `start`.
    """

    actor: list  # layers [(W, b), ...]: H frames and the estimate -> action (12,) [-]
    estimator: list  # layers: H frames of 44 -> velocity of the trunk (3,) [m/s]
    frame_scale: np.ndarray  # (44,) from a frame in SI units to what the networks see
    q_nominal: np.ndarray  # (12,) [rad] the pose of action 0
    action_scale: np.ndarray  # (12,) [rad] per unit of action
    kp: float  # [N m / rad] of the joints' PD controllers
    kd: float  # [N m s / rad]
    config: dict  # of the world in which it was trained: tasks.Config, as JSON has it
    about: dict  # iteration, algo, lam and seed of its training, and the digest of its robot

    def __post_init__(self):
        self.start()

    def start(self):
        """Forget what was seen, as at the start of an episode."""
        self.steps, self.frames, self.failed = 0, [], False
        self.action, self.estimate = np.zeros(12), np.zeros(3)

    def act(self, gravity, command, q, qd):
        """Joint targets (12,) [rad] for what a robot measures, in the units of the table above.

        It leaves `estimate`, `action` and `failed` behind. The networks see the last H frames, the
        oldest first; at the start all of them are the first one. If a number is not finite, or
        cannot be of a Go1, a sensor has `failed`, and the last frame is seen once more; until there
        is one, the target is the pose of action 0. Only a wrong shape is an error, a ValueError: a
        robot whose program stops falls.
        """
        given = dict(gravity=(gravity, 3), command=(command, 3), q=(q, 12), qd=(qd, 12))
        for name, (x, width) in given.items():
            if np.shape(x) != (width,):
                raise ValueError(f"{name} has the shape {np.shape(x)}, and not ({width},)")
        gravity, command, q, qd = (np.asarray(x, float) for x, _ in given.values())
        length, pose = math.hypot(*gravity), q - self.q_nominal
        gravity_fits = LENGTH[0] <= length <= LENGTH[1]  # no comparison holds for NaN
        joints_fit = (abs(pose) <= REACH).all() and (abs(qd) <= FASTEST).all()
        self.failed = not (gravity_fits and joints_fit and np.isfinite(command).all())
        if not self.failed:
            dt = self.config["timestep"] * self.config["physics_steps"]
            phase = 2 * np.pi * self.config["clock_hz"] * dt * self.steps
            clock = [np.sin(phase), np.cos(phase)]
            frame = np.concatenate([gravity / length, command, pose, qd, self.action, clock])
            seen = (frame * self.frame_scale).astype(np.float32)
        elif self.frames:
            seen = self.frames[-1]
        else:
            return self.q_nominal.copy()
        history = self.config["history"]
        self.frames = [*self.frames[1:], seen] if self.frames else [seen] * history
        self.steps += 1
        limit = self.config["action_limit"]
        action = self.mean(np.concatenate(self.frames)).clip(-limit, limit)
        self.action = np.where(np.isfinite(action).all(), action, 0.0)  # as in the simulator
        return self.q_nominal + self.action_scale * self.action

    def mean(self, obs):
        """Actions (..., 12) [-] without noise for obs (..., H * 44) of any number of robots.

        It leaves the `estimate` (..., 3) [m/s] behind.
        """
        self.estimate = mlp(self.estimator, obs)
        return mlp(self.actor, np.concatenate([obs, self.estimate], -1))


def mlp(layers, x):
    """Outputs (..., m) of an MLP for x (..., n), with ELU between its layers [(W, b), ...]."""
    for i, (weights, bias) in enumerate(layers):
        if i:
            x = np.where(x > 0, x, np.expm1(np.minimum(x, 0)))
        x = x @ weights + bias
    return x


def save(file, pi):
    """Write a Policy to a path or to a file that is open."""
    arrays = {name: getattr(pi, name) for name in NUMBERS}
    for net, layers in (("actor", pi.actor), ("estimator", pi.estimator)):
        for i, (weights, bias) in enumerate(layers):
            arrays |= {f"{net}.{i}.W": weights, f"{net}.{i}.b": bias}
    np.savez_compressed(file, **arrays, config=json.dumps(pi.config | dict(about=pi.about)))


def load(path):
    """The Policy in a file. If it is none, that raises ValueError, KeyError or something else."""
    with open(path, "rb") as file, np.load(file) as archive:
        arrays = dict(archive)
    config = json.loads(str(arrays.pop("config")))
    if not all(np.isfinite(x).all() for x in arrays.values()):
        raise ValueError("not all of its numbers are finite")
    layers = dict(actor=[], estimator=[])
    for net, found in layers.items():
        while (name := f"{net}.{len(found)}.") + "W" in arrays:
            found.append((arrays[name + "W"], arrays[name + "b"]))
    about = config.pop("about")
    pi = Policy(**layers, **{name: arrays[name] for name in NUMBERS}, config=config, about=about)
    pi.act([0, 0, -1], np.zeros(3), pi.q_nominal, np.zeros(12))  # do its layers fit?
    pi.start()
    return pi
