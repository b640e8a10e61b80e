"""The Go1 as a Markov decision process: what the docstring of go1_env.py and Sections IV-A to IV-C promise.

Two tricks make hand values possible without touching the internals. In free fall, with the joints where the action
wants them, no motor pulls and nothing moves but the fall itself. And a physics step of a nanosecond keeps any state
that a test writes still, so that the next observation and cost are of that very state.
"""

from math import cos, exp, pi, sin

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import energy
import go1
import go1_env
import shaped
import tasks
import terrain
from go1_env import Go1Env
from tasks import Config

NOMINAL = np.array([-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5])
TORQUE_LIMIT = np.tile([23.7, 23.7, 35.55], 4)
UPRIGHT, ON_ITS_BACK, ON_ITS_SIDE = (1, 0, 0, 0), (0, 1, 0, 0), (0.5**0.5, 0.5**0.5, 0, 0)
FROZEN = dict(timestep=1e-9)
TINY = 1e-4  # what moves in some hundred nanoseconds nevertheless: the clock
ACTION = slice(30, 42)  # the previous action within a frame of 44


def make(num_envs=2, threads=1, seed=0, **fields):
    """A reset environment without noise and with first episodes that start at age 0; task="flat" if not told."""
    env = Go1Env(num_envs, tasks.task_config(**(dict(noise=0.0, stagger=False) | fields)), threads)
    env.reset(seed)
    return env


def place(env, q=NOMINAL, qd=0.0, height=1.0, quaternion=UPRIGHT, velocity=(0, 0, 0)):
    """Write the same state into every environment, where it is: joints, trunk pose, world velocity of the trunk."""
    env.qpos[:, 2], env.qpos[:, 3:7], env.qpos[:, 7:] = height, quaternion, q
    env.qvel[:, :3], env.qvel[:, 3:6], env.qvel[:, 6:] = velocity, 0.0, qd


def still(env, steps=1):
    """Step with action 0; the last result."""
    for _ in range(steps):
        result = env.step(np.zeros((env.num_envs, 12)))
    return result


def frames(obs):
    """Observations (N, H * 44) as (N, H, 44)."""
    return obs.reshape(len(obs), -1, 44)


def random_actions(env, steps, seed=0):
    """(steps, N, 12), of the size of a fresh policy's."""
    return np.random.default_rng(seed).normal(size=(steps, env.num_envs, 12))


def run(env, actions):
    """Everything that a learner gets to see over some steps, as one list of arrays to compare bit by bit."""
    seen = []
    for action in actions:
        obs, reward, terminated, truncated, info = env.step(action)
        seen += [obs, reward, terminated, truncated, *info.pop("log").values(), *info.values()]
    return seen


def same_bits(a, b):
    """Whether two lists of arrays agree in every bit."""
    return len(a) == len(b) and all(
        x.dtype == y.dtype and x.tobytes() == y.tobytes() for x, y in zip(a, b, strict=True)
    )


# ---- the observation ----


def table():
    """The docstring's table of the observation: width per entry; scale and noise per column."""
    rows = go1_env.__doc__.split("\n\n| entry")[1].split("\n\n")[0].splitlines()[2:]
    rows = [row.split("|")[1:-1] for row in rows]
    widths = [int(row[1]) for row in rows]
    scales = [[float(x) for x in row[3].split(",")] for row in rows]
    scales = [scale * (width // len(scale)) for scale, width in zip(scales, widths, strict=True)]
    noise = np.repeat([float(row[4].split(":")[0]) for row in rows], widths)
    return widths, np.concatenate(scales), noise


def test_observation_widths():
    """The table that a reader believes is what the code does: 3 + 3 + 12 + 12 + 12 + 2 = 44, five times."""
    widths, scales, noise = table()
    assert widths == list(go1_env.FRAME.values()) and sum(widths) == len(scales) == len(noise) == 44
    obs, _ = (env := Go1Env(3)).reset(0)
    assert obs.shape == (3, env.obs_size) == (3, 5 * 44) and obs.dtype == np.float32


def test_observation_scales():
    """A state by hand, all numbers different, comes out in the table's order, times the table's scales."""
    env = make(1, history=1, **FROZEN)
    q, qd, action = np.arange(12) / 64, np.arange(12) / 2, np.arange(12) / 4
    place(env, NOMINAL + q, qd, quaternion=(0.5, 0.5, 0.5, 0.5))  # x, y, z of the body point along y, z, x of the world
    env.state.command[:] = 0.5, 0.25, 2.0
    raw = [0, -1, 0, 0.5, 0.25, 2.0, *q, *qd, *action, 0, 1]
    assert env.step(action[None])[0][0] == pytest.approx(table()[1] * raw, abs=1e-5)


@pytest.mark.parametrize(
    ("quaternion", "gravity"),
    [
        (UPRIGHT, (0, 0, -1)),
        (ON_ITS_BACK, (0, 0, 1)),
        ((0.5**0.5, 0, 0.5**0.5, 0), (1, 0, 0)),  # pitched by 90 degrees: nose down
        ((0.5**0.5, 0.5**0.5, 0, 0), (0, -1, 0)),  # rolled by 90 degrees: on the right side, which is -y
        ((0.5**0.5, 0, 0, 0.5**0.5), (0, 0, -1)),  # yawed: the robot cannot feel that
    ],
)
def test_observation_gravity(quaternion, gravity):
    """Down, as the robot feels it: a unit vector along whichever body axis points down."""
    env = make(1, history=1)
    place(env, quaternion=quaternion)
    assert still(env)[0][0, :3] == pytest.approx(gravity, abs=1e-6)


@pytest.mark.parametrize("factor", [0.0, 1.0, 2.0])
def test_observation_noise(factor):
    """Uniform within +- the table's noise, nearly reached in 300 draws (0.95^300 = 2e-7), and only where it says so."""
    env = make(1, history=1, noise=factor, episode_steps=1000, command_steps=1000, **FROZEN)
    place(env)
    seen = np.array([still(env)[0][0] for _ in range(300)])
    _, scales, noise = table()
    error = seen - scales * [0, 0, -1, *env.state.command[0], *[0.0] * 37, 1]
    bound = factor * scales * noise
    assert (np.abs(error) <= bound + TINY).all()
    assert (error.max(0) >= 0.9 * bound - TINY).all() and (error.min(0) <= -0.9 * bound + TINY).all()


def test_observation_noise_differs():
    """Each robot, column and frame has its own draw: shared noise would be a signal."""
    env = make(2, history=1, noise=1.0, **FROZEN)
    place(env)
    noisy = np.concatenate([still(env)[0][:, [0, 1, *range(6, 30)]] for _ in range(2)])
    assert len(np.unique(noisy[:, :2])) == noisy[:, :2].size
    assert len(np.unique(noisy[:, 2:])) == noisy[:, 2:].size


def test_history():
    """D16, H = 5: after actions 1, 2, 3 the previous actions read 0, 0, 1, 2, 3: filled at reset, oldest first."""
    env = make()
    for k in (1, 2, 3):
        obs, *_ = env.step(np.full((2, 12), float(k)))
    assert frames(obs)[:, :, ACTION].tolist() == [[[k] * 12 for k in (0.0, 0.0, 1.0, 2.0, 3.0)]] * 2


def test_history_after_reset():
    """A new episode begins with its first frame five times, noise included: nothing of another robot's past."""
    env = Go1Env(2, threads=1)
    for obs, _ in (env.reset(0), env.reset(1)):
        assert (frames(obs) == frames(obs)[:, :1]).all()
        still(env, 3)


def test_timing_reference():
    """D14: 3 Hz * 20 ms * 25 = 1.5 turns, (sin, cos) = (0, -1); after 50 steps 3 turns, (0, 1)."""
    env = make(1, history=1)
    assert still(env, 25)[0][0, 42:] == pytest.approx((0, -1), abs=1e-6)
    assert still(env, 25)[0][0, 42:] == pytest.approx((0, 1), abs=1e-6)


def test_timing_reference_turns_forward():
    """A clock of 12.5 Hz makes a quarter turn in 20 ms: (0, 1) at reset, then (1, 0), (0, -1), (-1, 0)."""
    obs, *_ = still(make(1, history=4, clock_hz=12.5), 3)
    assert frames(obs)[0, :, 42:] == pytest.approx(np.array([[0, 1], [1, 0], [0, -1], [-1, 0]]), abs=1e-6)


def test_observations_are_copies():
    """A rollout stores what step returns: the next step must not write over it."""
    env = make(3, episode_steps=2)
    first = run(env, random_actions(env, 1))
    kept = [x.copy() for x in first]
    run(env, random_actions(env, 4, seed=1))
    assert same_bits(first, kept)


# ---- physics, reward and cost ----


def test_standing():
    """Action 0 is a stance: from a random pose the PD controller stands up and stays up for 20 s."""
    env = make(4, friction=(0.8, 0.8), payload=(0.0, 0.0), episode_steps=1000)
    for _ in range(999):
        _, _, terminated, truncated, _ = still(env)
        assert not terminated.any() and not truncated.any()
    assert (env.qpos[:, 2] > 0.2).all() and np.abs(env.qvel).max() < 0.05
    assert still(env)[3].all()


def test_action_is_an_offset_from_the_nominal_pose():
    """Action 2: hips 0.25 * 0.5 * 2 = 0.25, others 0.25 * 2 = 0.5 rad. A robot there needs no torque: 42 - 200."""
    env = make(1)
    place(env, NOMINAL + np.tile([0.25, 0.5, 0.5], 4))
    assert env.step(np.full((1, 12), 2.0))[4]["cost"] == pytest.approx([-158.0], abs=1e-9)


def test_action_is_clipped():
    """At +-10, and the robot is told what was applied, not what it asked for."""
    env = make(1, history=1)
    obs, *_ = env.step(np.array([[1e6, -1e6] * 6]))
    assert obs[0, ACTION].tolist() == [10.0, -10.0] * 6


@pytest.mark.parametrize(
    ("command", "expected"),
    [((1, 0, 0), 1.5), ((2, 0, 0), exp(-4) + 0.5), ((0.5, 0, 0), 1.5), ((1, 0.5, 0.5), exp(-1) + 0.5 * exp(-1))],
)
def test_reward_is_eq05_unscaled_and_ahead_is_where_the_robot_heads(command, expected):
    """Turned by 90 degrees, 1 m/s along the world's y is 1 m/s forward. D10: 1.5 for a met command, not 0.02 * 1.5."""
    env = make()
    place(env, quaternion=(0.5**0.5, 0, 0, 0.5**0.5), velocity=(0, 1, 0))
    env.state.command[:] = command
    _, reward, _, _, info = still(env)
    assert reward == pytest.approx([expected] * 2, abs=1e-9)
    assert info["privileged"] == pytest.approx(np.array([[1.0, 0.0, -9.81 * 0.02]] * 2), abs=1e-6)


def test_reward_sees_the_yaw_rate():
    """Rolling at 1, pitching at 2 and yawing at 1/2 rad/s, asked for none: only the last counts, 1 + 0.5 / e."""
    env = make(1, **FROZEN)
    place(env)
    env.state.command[:], env.qvel[:, 3:6] = 0.0, [1, 2, 0.5]
    assert still(env)[1] == pytest.approx([1 + 0.5 * exp(-1)], abs=1e-6)


@pytest.mark.parametrize(("clip", "expected"), [("torque", -170.8), ("power", -149.8)])
def test_eq09_cost_of_a_step(clip, expected):
    """A hip on target at 8 rad/s: tau = -0.5 * 8 = -4; (-3) 8 = -24, or by power -3; + 0.7 * 16 + 42 - 200."""
    env = make(1, clip=clip, **FROZEN)
    place(env, qd=[8.0] + [0.0] * 11)
    _, _, _, _, info = still(env)
    assert info["cost"] == pytest.approx([expected], abs=1e-3)
    assert info["log"]["power"] == pytest.approx([expected + 200], abs=1e-3)


def test_eq09_cost_at_the_torque_limit():
    """Action 10 asks for 20 * 1.25 = 25 (hips) and 50 N m and gets 23.7, calves 35.55, of which 2/3 is 23.7 again.

    12 * 0.7 * 23.7^2 = 4718.196, + 42 - 200: the torque of Eq. (9) is the one applied, not the one asked for.
    """
    env = make(1, **FROZEN)
    place(env)
    assert env.step(np.full((1, 12), 10.0))[4]["cost"] == pytest.approx([4560.196], abs=0.01)


def test_batch_equals_a_plain_mujoco_loop():
    """The batch is no other simulator: one MjModel per robot, PD by hand before each mj_step, the same bits.

    D17: the cost is the mean of Eq. (9) over the four physics steps, with the mean speed of each. Friction and mass are
    those of the robots.
    """
    env = make(3, clip="torque")
    actions = random_actions(env, 12)
    models = [mujoco.MjModel.from_xml_path(str(go1.MODEL)) for _ in range(3)]
    robots = [mujoco.MjData(model) for model in models]
    for i, (model, robot) in enumerate(zip(models, robots, strict=True)):
        model.geom_friction[:], model.body_mass[:] = env.state.friction[i], env.state.mass[i]
        mujoco.mj_setConst(model, robot)
        robot.qpos[:], robot.qvel[:] = env.qpos[i], env.qvel[i]
    for action in actions:
        costs = [plain_step(*pair) for pair in zip(models, robots, action, strict=True)]
        _, _, terminated, _, info = env.step(action)
        assert not terminated.any()  # else the comparison would end here
        assert info["cost"] == pytest.approx(costs, rel=1e-12)
        assert [x.tobytes() for x in env.qpos] == [robot.qpos.tobytes() for robot in robots]
        assert [x.tobytes() for x in env.qvel] == [robot.qvel.tobytes() for robot in robots]


def plain_step(model, robot, action):
    """One control step of one robot, without any of go1_env.py; its mean cost."""
    target, costs = NOMINAL + 0.25 * np.tile([0.5, 1.0, 1.0], 4) * action, []
    for _ in range(4):
        q, qd = robot.qpos[7:], robot.qvel[6:].copy()
        robot.ctrl[:] = np.clip(20 * (target - q) - 0.5 * qd, -TORQUE_LIMIT, TORQUE_LIMIT)
        mujoco.mj_step(model, robot)
        costs.append(energy.energy_cost(robot.ctrl, (qd + robot.qvel[6:]) / 2, "torque"))
    return np.mean(costs)


# ---- the end of an episode ----


@pytest.mark.parametrize(
    ("quaternion", "height", "thigh", "terminates"),
    [
        (ON_ITS_BACK, 0.056, 0.8, True),
        (UPRIGHT, 0.056, 3.0, True),
        (ON_ITS_SIDE, 0.14, 0.8, True),
        (UPRIGHT, 0.4, 0.8, False),
    ],
    ids=["back", "belly, legs up", "side, on the hips", "in the air"],
)
def test_a_fall_terminates(quaternion, height, thigh, terminates):
    """D13: the trunk's half height is 0.057 m, a hip reaches 0.147 m to the side; 1 mm into the ground is a fall."""
    env = make()
    place(env, np.tile([0.0, thigh, -1.5], 4), height=height, quaternion=quaternion)
    _, _, terminated, truncated, info = still(env)
    assert terminated.tolist() == info["log"]["ended_fall"].tolist() == [terminates] * 2
    assert not truncated.any() and not info["log"]["ended_diverged"].any()


def test_terminated_and_truncated_exclude_each_other():
    """A robot that falls on its very last step has fallen: a bootstrap would credit it with a future."""
    env = make(episode_steps=1)
    place(env, height=0.056, quaternion=ON_ITS_BACK)
    env.qpos[1, 2] = 1.0  # the other one is in the air
    _, _, terminated, truncated, _ = still(env)
    assert (terminated.tolist(), truncated.tolist()) == ([True, False], [False, True])


def test_final_obs_at_a_time_limit():
    """H = 5, 3 steps with actions 1, 2, 3: final_obs remembers 0, 0, 1, 2, 3, obs the new episode's first frame alone.

    The most reported bug in the field: bootstrapping from obs would take the next episode's start for this one's end.
    """
    env = make(episode_steps=3)
    for k in (1, 2, 3):
        obs, _, _, truncated, info = env.step(np.full((2, 12), float(k)))
        assert truncated.tolist() == info["log"]["ended_limit"].tolist() == [k == 3] * 2
    assert frames(info["final_obs"])[:, :, 30].tolist() == [[0, 0, 1, 2, 3]] * 2
    assert (frames(obs) == frames(obs)[:, :1]).all() and not frames(obs)[:, :, ACTION].any()


def test_final_obs_is_of_the_old_pose():
    """Upside down in the air at the time limit: final gravity +1 and fall 0.1962 m/s; upright in the new episode."""
    env = make(episode_steps=1)
    place(env, quaternion=ON_ITS_BACK)
    obs, _, _, _, info = still(env)
    assert frames(info["final_obs"])[:, -1, 2] == pytest.approx([1.0] * 2)
    assert info["final_privileged"] == pytest.approx(np.array([[0.0, 0.0, 9.81 * 0.02]] * 2), abs=1e-6)
    assert frames(obs)[:, -1, 2] == pytest.approx([-1.0] * 2)
    assert np.abs(info["privileged"][:, 2]).max() <= 0.5 and (info["privileged"] != info["final_privileged"]).all()


def test_final_obs_is_obs_where_no_episode_ended():
    """So that a learner may use final_obs everywhere."""
    obs, _, _, _, info = still(make(noise=1.0), 3)
    assert same_bits([info["final_obs"], info["final_privileged"]], [obs, info["privileged"]])


def test_autoreset_leaves_the_others_alone():
    """Robot 1 of 3 reaches its time limit: the others go on, bit for bit, as in a world where it did not."""
    env, twin = make(3), make(3)
    actions, others = random_actions(env, 6), [0, 2]
    run(env, actions[:2]), run(twin, actions[:2])
    env.state.age[1] = 999
    for action in actions[2:]:
        ours, theirs = env.step(action), twin.step(action)
        assert same_bits([x[others] for x in ours[:4]], [x[others] for x in theirs[:4]])
    assert env.state.age.tolist() == [6, 3, 6]
    assert not np.isclose(env.qpos[1], twin.qpos[1]).all()


def test_first_episodes_are_staggered():
    """16 robots end their first episodes of 8 steps at several times, each once: no wave of simultaneous resets."""
    env = make(16, stagger=True, episode_steps=8)
    ends = np.array([still(env)[3] for _ in range(8)])
    assert ends.sum(0).tolist() == [1] * 16 and (ends.sum(1) > 0).sum() >= 4


def test_staggered_clock_is_seen():
    """The first observation of a staggered episode shows its age: not all clocks stand at 0."""
    obs, _ = Go1Env(16, threads=1).reset(0)
    assert len(np.unique(obs[:, -1])) >= 4


# ---- what an episode draws ----


def test_commands():
    """IV-A.1: v_x from [0, 1] m/s, all of it, and no command of v_y and of the yaw rate; drawn anew at every reset."""
    obs, _ = Go1Env(256, Config(stagger=False), threads=1).reset(0)
    v_x = frames(obs)[:, -1, 3] / 2  # scale 2
    assert 0 <= v_x.min() < 0.05 and 0.95 < v_x.max() <= 1
    assert len(np.unique(v_x)) > 250
    assert not frames(obs)[:, :, 4:6].any()


def test_commands_change():
    """command_steps = 3: steps 1 to 3 are rewarded by the first command, 4 to 6 by the next; obs shows it in time."""
    env = make(2, command_steps=3)
    told = [frames(env.reset(0)[0])[:, -1, 3] / 2]
    obeyed = []
    for _ in range(6):
        obs, _, _, _, info = still(env)
        told.append(frames(obs)[:, -1, 3] / 2)
        obeyed.append(info["log"]["command_x"])
    assert np.array(told[:6]) == pytest.approx(np.array(obeyed), abs=1e-6)
    changes = (np.diff(np.array(told), axis=0) != 0).tolist()
    assert changes == [[False] * 2, [False] * 2, [True] * 2] * 2


def test_reset_pose():
    """[lab code]: joints at 0.5 to 1.5 times nominal, within the URDF's range; trunk +- 0.5 m/s and rad/s; any yaw."""
    env = make(64)
    low, high = np.tile([[-0.863, -0.686, -2.818], [0.863, 4.501, -0.888]], 4)
    q = env.qpos[:, 7:]
    assert (low <= q).all() and (q <= high).all() and not env.qvel[:, 6:].any()
    assert (q / NOMINAL >= 0.5).all() and (q / NOMINAL <= 1.5).all() and (q / NOMINAL).std() > 0.2
    assert 0.4 < np.abs(env.qvel[:, :6]).max() <= 0.5 and len(np.unique(env.qvel[:, :6])) == 64 * 6
    assert not env.qpos[:, [0, 1, 4, 5]].any() and env.qpos[:, 6].min() < -0.9 and env.qpos[:, 6].max() > 0.9


def test_reset_tells_the_velocity():
    """The critic and the estimator start from the truth: a robot that is merely turned keeps its vertical velocity."""
    env = Go1Env(4, threads=1)
    _, info = env.reset(0)
    assert info["privileged"][:, 2] == pytest.approx(env.qvel[:, 2])
    assert np.hypot(*info["privileged"].T[:2]) == pytest.approx(np.hypot(*env.qvel.T[:2]))
    assert not np.isclose(info["privileged"][:, 0], env.qvel[:, 0]).any()


def test_reset_puts_the_lowest_foot_on_the_ground():
    """By MuJoCo's own kinematics: no robot starts under the ground, where contact would throw it up, or falls first."""
    env = make(8)
    for qpos in env.qpos:
        assert soles(qpos).min() == pytest.approx(0.0, abs=1e-12)


def physical(env):
    """What an episode draws of the physics: friction of the four feet (N, 4), payload [kg] (N,)."""
    model = mujoco.MjModel.from_xml_path(str(go1.MODEL))
    feet = [model.geom(f"{leg}_foot").id for leg in ("FR", "FL", "RR", "RL")]
    others = [i for i in range(model.nbody) if model.body(i).name != "trunk"]
    assert (env.state.mass[:, others] == model.body_mass[others]).all()
    return env.state.friction[:, feet, 0].copy(), env.state.mass[:, model.body("trunk").id] - 5.560


def test_friction_and_payload_are_in_range():
    """Feet alike in one episode, 0.5 to 1.25, trunk +- 1 kg, and the robots differ."""
    friction, payload = physical(make(64))
    assert (friction == friction[:, :1]).all() and len(np.unique(friction)) == len(np.unique(payload)) == 64
    assert 0.5 <= friction.min() < 0.55 and 1.2 < friction.max() <= 1.25
    assert -1 <= payload.min() < -0.9 and 0.9 < payload.max() <= 1


def test_friction_and_payload_last_one_episode():
    """Robot 0 ends its episode at step 2 and gets a new ground and load, robot 1 keeps its own."""
    env = make(episode_steps=4)
    env.state.age[0] = 2
    before = physical(env)
    still(env)
    assert same_bits(before, physical(env))
    assert still(env)[3].tolist() == [True, False]
    assert [(a != b).ravel().tolist() for a, b in zip(before, physical(env), strict=True)] == [
        [True] * 4 + [False] * 4,
        [True, False],
    ]


# ---- the same bits ----


@pytest.mark.parametrize("task", tasks.TASKS)
@pytest.mark.parametrize("threads", [2, None])
def test_threads_do_not_change_the_bits(threads, task):
    """A laptop and a server train the same policy. Crosses resets and draws of commands."""
    one, many = (make(5, threads=n, task=task, stagger=True, noise=1.0, episode_steps=5) for n in (1, threads))
    assert same_bits(run(one, random_actions(one, 8)), run(many, random_actions(many, 8)))


@pytest.mark.parametrize("task", tasks.TASKS)
def test_seeds(task):
    """Same seed, same bits, in a new environment and in a used one; another seed, another world."""
    env, used, other = (make(3, task=task, seed=seed, noise=1.0) for seed in (7, 1, 8))
    still(used, 3)
    used.state.weights[:], used.state.tracked[:] = 1.0, 1000.0
    used.reset(np.random.SeedSequence(7))
    env.reset(np.random.SeedSequence(7))
    actions = random_actions(env, 4)
    ours = run(env, actions)
    assert same_bits(ours, run(used, actions)) and not same_bits(ours, run(other, actions))


@pytest.mark.parametrize("task", tasks.TASKS)
def test_state_continues_with_the_same_bits(tmp_path, task):
    """Resume is exact: through a file without pickles, into a fresh object, over resets and new commands."""
    env = make(3, task=task, stagger=True, noise=1.0, episode_steps=6, command_steps=4)
    env.state.weights[4, 22], env.state.tracked[:] = 0.5, 3.5  # the next segment ends in a success
    actions = random_actions(env, 12)
    run(env, actions[:3])
    np.savez(tmp_path / "state.npz", **env.save())
    fresh = Go1Env(3, env.env_cfg, threads=2)
    with np.load(tmp_path / "state.npz", allow_pickle=False) as state:
        fresh.load(state)
    assert same_bits(run(env, actions[3:]), run(fresh, actions[3:]))


def arrays(thing, name=""):
    """Every array that an object holds, in whatever it holds it, by name."""
    if isinstance(thing, np.ndarray):
        return {name: thing}
    parts = thing if isinstance(thing, dict) else thing._asdict() if hasattr(thing, "_asdict") else None
    parts = dict(enumerate(thing)) if isinstance(thing, list) else parts or getattr(thing, "__dict__", {})
    return {found: x for key, part in parts.items() for found, x in arrays(part, f"{name}.{key}").items()}


@pytest.mark.parametrize("reward", ["paper", "shaped"])
@pytest.mark.parametrize("task", tasks.TASKS)
def test_the_next_step_depends_on_nothing_but_the_state(task, reward):
    """All arrays of a fresh world are filled with garbage, in the state and beside it; after load it has the same bits.

    But for constants, as the ground: what two worlds agree in after steps from different seeds. And what is no array,
    as a counter would be, must not have changed by then.
    """
    fields = dict(task=task, reward=reward, stagger=True, noise=1.0, episode_steps=6, command_steps=4)
    env, other, fresh = (make(3, seed=seed, **fields) for seed in (0, 1, 2))
    actions = random_actions(env, 12)
    run(env, actions[:3]), run(other, actions[:3])
    env.state.weights[4, 22], env.state.tracked[:] = 0.5, 3.5  # the next segment ends in a success
    plain = [{k: x for k, x in vars(e).items() if isinstance(x, bool | int | float | str | None)} for e in (env, fresh)]
    assert plain[0] == plain[1]
    ours, others = arrays(env), arrays(other)
    constant = {name for name in ours if not name.startswith(".state") and same_bits([ours[name]], [others[name]])}
    for x in (x for name, x in arrays(fresh).items() if name not in constant and x.flags.writeable):
        x[:] = np.nan if x.dtype.kind == "f" else 77
    fresh.load(env.save())
    assert same_bits(run(env, actions[3:]), run(fresh, actions[3:]))


def test_state_is_a_copy():
    """A checkpoint in memory must not move on with the simulation."""
    env = make()
    state = env.save()
    kept = [x.copy() for x in state.values()]
    still(env, 3)
    assert same_bits(list(state.values()), kept)


# ---- a simulation that blows up ----


def poison_velocity(env, action):
    """What a diverging contact leaves behind."""
    env.qvel[1, 8] = np.nan


def poison_position(env, action):
    """A robot that has left for infinity."""
    env.qpos[1, 0] = np.inf


def poison_action(env, action):
    """What a diverging policy asks for."""
    action[1, 3] = np.nan


POISONS = pytest.mark.parametrize("poison", [poison_velocity, poison_position, poison_action])


@POISONS
@pytest.mark.parametrize(
    "fields", [dict(), dict(latency=6), dict(reward="shaped"), dict(aux="smooth", latency=6)], ids=str
)
def test_divergence_resets_one_robot(poison, fields):
    """Robot 1 of 3 is lost, says so, and earns 0 at a cost of 0; what the learner gets is finite."""
    env = make(3, **fields)
    poison(env, action := np.zeros((3, 12)))
    obs, reward, terminated, truncated, info = env.step(action)
    assert terminated.tolist() == info["log"]["ended_diverged"].tolist() == [False, True, False]
    assert not truncated.any() and not info["log"]["ended_fall"].any()
    sane = (obs, reward, info["cost"], info["privileged"], info["log"]["power"], info["final_obs"])
    assert all(np.isfinite(x).all() for x in sane)
    assert (reward[1], info["cost"][1]) == (0.0, 0.0)
    assert env.state.age.tolist() == [1, 0, 1] and (frames(obs)[1] == frames(obs)[1, 0]).all()


@POISONS
def test_divergence_leaves_the_others_alone(poison):
    """The other robots have the same bits, now and later, as in a world without the poison; robot 1 lives on."""
    env, twin = make(3), make(3)
    poison(env, action := np.zeros((3, 12)))
    for step in range(4):
        ours, theirs = env.step(action if step == 0 else np.zeros((3, 12))), still(twin)
        assert ours[2].tolist() == [False, step == 0, False]
        for a, b in zip((*ours[:4], ours[4]["cost"]), (*theirs[:4], theirs[4]["cost"]), strict=True):
            assert a[[0, 2]].tobytes() == b[[0, 2]].tobytes() and np.isfinite(a).all()


def test_no_litter(tmp_path, monkeypatch):
    """MuJoCo writes MUJOCO_LOG.TXT into the working folder at a warning: a user's folder stays clean."""
    monkeypatch.chdir(tmp_path)
    env = make()
    env.qvel[1, 8] = np.nan
    assert still(env)[4]["log"]["ended_diverged"].any()
    assert list(tmp_path.iterdir()) == []


# ---- kinematics and configuration ----


def soles(qpos):
    """Height of the four soles [m] at qpos, by MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(go1.MODEL))
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return np.array([data.geom(f"{leg}_foot").xpos[2] for leg in ("FR", "FL", "RR", "RL")]) - 0.02


def lowest(q):
    """Height of the lowest point of each leg relative to the trunk [m], from the centres of knee and foot."""
    return go1.leg_points(q)[..., 2].reshape(*q.shape[:-1], 4, 2).min(-1) - 0.02


@pytest.mark.parametrize(
    ("hip", "thigh", "calf", "right", "left"),
    [
        (0, 0, 0, -0.446, -0.446),  # straight: -0.213 - 0.213 - 0.02
        (0, pi / 2, -pi / 2, -0.233, -0.233),  # thigh horizontal, calf down: -0.213 - 0.02
        (0, pi / 3, -2 * pi / 3, -0.233, -0.233),  # -0.213 (1/2 + 1/2) - 0.02
        (pi / 2, 0, 0, -0.1, 0.06),  # legs out to the left: the hip's 0.08 is down on the right, up on the left
    ],
)
def test_leg_heights_by_hand(hip, thigh, calf, right, left):
    """Links of 0.213 m, 0.08 m from hip to thigh, soles of 0.02 m; order FR, FL, RR, RL."""
    heights = lowest(np.tile([hip, thigh, calf], 4).astype(float))
    assert heights == pytest.approx([right, left, right, left], abs=1e-12)


def test_leg_heights_of_a_leg_that_kneels():
    """Thigh straight down, shin straight up: the knee is lowest, 0.213 + 0.02 m below the hip."""
    assert lowest(np.tile([0.0, 0.0, -np.pi], 4)) == pytest.approx([-0.233] * 4)


def test_leg_heights_are_those_of_the_model():
    """The formula and go1.xml are the same robot: twelve joint angles at random, shins pointing down, any shape."""
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 3, 12))
    q[..., 1::3], q[..., 2::3] = abs(q[..., 1::3]), -abs(q[..., 2::3])
    heights = lowest(q)
    assert heights.shape == (2, 3, 4)
    for i in np.ndindex(2, 3):
        assert heights[i] == pytest.approx(soles([0, 0, 0, 1, 0, 0, 0, *q[i]]), abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (dict(task="hover"), ["task", "hover"]),
        (dict(num_envs=0), ["num_envs", "0"]),
        (dict(threads=0), ["threads", "0"]),
        (dict(threads=-1), ["threads", "-1"]),
        (dict(history=0), ["history", "0"]),
        (dict(episode_steps=-5), ["episode_steps", "-5"]),
        (dict(command_steps=0), ["command_steps", "0"]),
        (dict(physics_steps=0), ["physics_steps", "0"]),
        (dict(timestep=0.0), ["timestep", "0.0"]),
        (dict(clock_hz=float("inf")), ["clock_hz", "inf"]),
        (dict(action_limit=-10.0), ["action_limit", "-10.0"]),
        (dict(max_power=0.0), ["max_power", "0.0"]),
        (dict(noise=float("nan")), ["noise", "nan"]),
        (dict(clip="speed"), ["clip", "speed"]),
        (dict(friction=(1.25, 0.5)), ["friction", "1.25", "0.5"]),
        (dict(friction=(0.5, float("inf"))), ["friction", "0.5", "inf"]),
        (dict(friction=(-0.5, 0.5)), ["friction"]),
        (dict(friction=(0.5, 2.0)), ["friction", "2.0"]),
        (dict(payload=(float("nan"), 1.0)), ["payload", "nan", "1.0"]),
        (dict(payload=(-6.0, 0.0)), ["trunk"]),  # no mass would be left
        (dict(roughness=(-0.05, 0.05)), ["roughness", "-0.05"]),
        (dict(roughness=(0.15, 0.05)), ["roughness", "0.15", "0.05"]),
        (dict(roughness=(float("nan"), 0.15)), ["roughness", "nan"]),
        (dict(roughness=(0.0, float("inf"))), ["roughness", "inf"]),
        (dict(cells_per_m=0), ["cells_per_m", "0"]),
        (dict(tiles=0), ["tiles", "0"]),
        (dict(cells_per_m=11), ["cells_per_m", "11"]),  # fewer than 2 points per cell: the noise would not be seen
    ],
    ids=str,
)
def test_bad_config(arguments, named):
    """One line that names the field and its value: a typo on the command line is found by reading the message."""
    counts = dict(num_envs=1, threads=1)
    fields = {name: value for name, value in arguments.items() if name not in counts}
    with pytest.raises(ValueError) as error:
        Go1Env(env_cfg=Config(**fields), **{name: arguments.get(name, count) for name, count in counts.items()})
    assert "\n" not in (message := str(error.value)) and all(part in message for part in named)


@pytest.mark.parametrize(
    "fields",
    [
        dict(stagger=False),
        dict(noise=0.0),
        dict(clock_hz=0.0),
        dict(payload=(0.0, 0.0)),
        dict(roughness=(0.0, 0.0)),
        dict(roughness=(0.05, 0.05), cells_per_m=10),  # the finest
    ],
    ids=str,
)
def test_good_config(fields):
    """The values that switch something off, or are just allowed, are no mistakes."""
    Go1Env(1, Config(**fields))


# ---- rough ground and maximum velocity ----


@pytest.mark.parametrize(
    ("task", "history", "roughness", "cells_per_m"),
    [("flat", 5, (0.0, 0.0), 4), ("rough", 10, (0.0, 0.15), 1), ("velocity", 10, (0.05, 0.05), 4)],
)
def test_paper_settings_of_a_task(task, history, roughness, cells_per_m):
    """V-A, V-B, V-D: H; IV-A: roughness in m; D22. All else is as on flat ground, and a change wins over the paper."""
    assert tasks.task_config(task) == Config(task=task, history=history, roughness=roughness, cells_per_m=cells_per_m)
    changed = dict(task=task, history=3, roughness=(0.0, 0.01), cells_per_m=2, noise=0.5)
    assert tasks.task_config(**changed) == Config(**changed)


def test_no_ground_is_too_steep_to_stand_on():
    """Feet of friction 0.5 hold up to arctan 0.5 = 26.6 degrees: not a point of the roughest tile is steeper.

    15 cm with 4 cells per metre, as in other code of the lab, would have a fifth of its points steeper (D22).
    """
    for task in ("rough", "velocity", "curriculum"):
        slopes = np.gradient(make(1, task=task, tiles=1).ground, terrain.SPACING)
        assert np.hypot(*slopes).max() < 0.5
    slopes = np.gradient(make(1, task="rough", tiles=1, cells_per_m=4).ground, terrain.SPACING)
    assert (np.hypot(*slopes) > 0.5).mean() == pytest.approx(0.2, abs=0.05)


def test_unknown_task():
    """One line with the name and what there is to choose from."""
    with pytest.raises(ValueError, match=r"^unknown task 'moon'.* flat, rough, velocity, curriculum$"):
        tasks.task_config("moon")


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_observation_of_ten_frames(task):
    """H = 10: 10 * 44 = 440 numbers; after actions 1, 2, 3 there are 7 older frames without any."""
    env = make(task=task)
    for k in (1, 2, 3):
        obs, *_ = env.step(np.full((2, 12), float(k)))
    assert obs.shape == (2, env.obs_size) == (2, 440) and obs.dtype == np.float32
    assert frames(obs)[:, :, ACTION].tolist() == [[[k] * 12 for k in (*[0.0] * 7, 1.0, 2.0, 3.0)]] * 2


@pytest.mark.parametrize(
    ("task", "v_x", "v_y", "yaw_rate", "expected"),
    [
        ("rough", 1.5, 0.0, 0.0, 1.15),  # faster than asked: no error
        ("rough", 0.5, 0.0, 0.0, exp(-1) + 0.15),
        ("rough", 1.0, -0.5, 0.0, 1.1 + 0.05 * exp(-1)),
        ("rough", 1.0, 0.0, 0.5, 1.05 + 0.1 * exp(-1)),
        ("rough", 0.5, 0.5, -0.5, 1.15 * exp(-1)),
        ("velocity", 3.0, 0.0, 0.0, 3.0),
        ("velocity", -2.0, 0.0, 0.0, -2.0),  # running backwards costs
        ("velocity", 3.0, 0.5, 0.0, 3 * exp(-1)),
        ("velocity", 3.0, 0.0, -0.5, 3 * exp(-1)),
        ("velocity", -2.0, -0.5, 0.5, -2 * exp(-2)),
    ],
)
def test_reward_of_a_task(task, v_x, v_y, yaw_rate, expected):
    """Eq. (6) for a command of 1 m/s, Eq. (7) for none, each error of 1/2 is a factor 1/e; turned by 90 degrees.

    Then the robot's forward is the world's y and its left the world's -x.
    """
    env = make(task=task, **FROZEN)
    place(env, quaternion=(0.5**0.5, 0, 0, 0.5**0.5), velocity=(-v_y, v_x, 0))
    env.qvel[:, 5] = yaw_rate
    if task == "rough":
        env.state.command[:] = 1, 0, 0
    _, reward, terminated, _, _ = still(env)
    assert reward == pytest.approx([expected] * 2, abs=1e-6) and not terminated.any()


def test_velocity_has_no_command():
    """[lab code]: whatever is drawn, at resets and in between, is 0; on rough ground it is 0 to 1 m/s forward."""
    velocity, rough = (make(64, task=task, command_steps=2, episode_steps=5) for task in ("velocity", "rough"))
    for _ in range(7):
        obs, _, _, _, info = still(velocity)
        assert not frames(obs)[:, :, 3:6].any() and not info["log"]["command_x"].any()
        obs, *_ = still(rough)
        assert 0 <= frames(obs)[:, -1, 3].min() < 0.2 and 1.8 < frames(obs)[:, -1, 3].max() <= 2  # scale 2
        assert not frames(obs)[:, :, 4:6].any()


def test_roughness_of_the_tiles():
    """16 tiles: 0, 1, ... 15 cm for `rough`, 5 cm each for `velocity`; 4 tiles: 0, 5, 10, 15 cm; none on the plane.

    Measured on the heights.
    """
    for fields, expected in [
        (dict(task="rough"), [k / 100 for k in range(16)]),
        (dict(task="rough", tiles=4), [0.0, 0.05, 0.1, 0.15]),
        (dict(task="velocity"), [0.05] * 16),
    ]:
        ground = (env := make(64, **fields)).ground
        tiles = ground.reshape(120, len(expected), 120)
        assert tiles.max((0, 2)) - tiles.min((0, 2)) == pytest.approx(expected, abs=1e-12)
        assert (env.state.tile.min(), env.state.tile.max()) == (0, len(expected) - 1)
    assert make(1).ground is None


def test_settings_of_the_noise_reach_the_ground():
    """2 cells per metre: 0 every 10th point from the tile's corner, not every 5th as with 4."""
    coarse, fine = (
        make(1, task="velocity", **fields).ground[20:100, 20:100] for fields in (dict(cells_per_m=2), dict())
    )
    assert not coarse[::10, ::10].any() and coarse[5::10, 5::10].all()
    assert not fine[::5, ::5].any()


def rays(env, points):
    """Height of the ground [m] under the points (n, 2), by MuJoCo: a ray straight down on the floor alone."""
    model = go1.build_model(0.005, env.ground)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    floor, hit = [1, 0, 0, 0, 0, 0], np.zeros(1, np.int32)
    return np.array([5 - mujoco.mj_ray(model, data, [*xy, 5], [0, 0, -1], floor, 1, -1, hit) for xy in points])


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_mujoco_sees_the_same_ground(task):
    """Point (i, j) of the heights is at x = 0.05 j, y = 0.05 i: not mirrored, not turned, not shifted, right scale.

    2 um beside the point, so that no ray slips between two triangles.
    """
    env = make(1, task=task)
    i, j = np.random.default_rng(0).integers([[119], [1919]], size=(2, 200))
    seen = rays(env, np.stack([0.05 * j + 1e-6, 0.05 * i + 1e-6], -1))
    assert seen == pytest.approx(env.ground[i, j], abs=1e-5)


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_start_touches_rough_ground(task):
    """By MuJoCo's kinematics and rays: the lowest foot or knee, a ball of 2 cm, ends within 5 mm of the ground below.

    Not exactly there, because MuJoCo's ground is made of triangles. No contact is deeper than 5 mm.
    """
    env = make(32, task=task)
    model = go1.build_model(0.005, env.ground)
    data, centres = mujoco.MjData(model), []
    for qpos in env.qpos:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        assert data.contact.dist.min(initial=0.0) > -0.005
        for leg in ("FR", "FL", "RR", "RL"):
            centres += [data.geom(f"{leg}_foot").xpos.copy(), data.body(f"{leg}_calf").xpos.copy()]
    gaps = np.array(centres)[:, 2] - 0.02 - rays(env, np.array(centres)[:, :2])
    assert np.abs(gaps.reshape(32, 8).min(1)).max() < 0.005


def test_start_is_anywhere_on_the_tile():
    """The tile `index` reaches from 6 index + 1 to 6 index + 5 m in x and from 1 to 5 m in y; all 16 are used."""
    env = make(256, task="rough")
    xy = env.qpos[:, :2] - np.stack([6.0 * env.state.tile + 1, np.ones(256)], -1)
    assert ((xy >= 0) & (xy < 4)).all() and (xy.min(0) < 0.1).all() and (xy.max(0) > 3.9).all()
    assert sorted(set(env.state.tile)) == list(range(16))


def test_tile_lasts_one_episode():
    """IV-A.2: 16 of 32 robots end their episode at step 2 and get another ground, friction and load; 16 keep theirs."""
    env = make(32, task="rough", episode_steps=4)
    env.state.age[:16] = 2
    tile, before = env.state.tile.copy(), physical(env)
    still(env)
    assert same_bits([tile, *before], [env.state.tile, *physical(env)])
    assert still(env)[3].tolist() == [True] * 16 + [False] * 16
    assert (env.state.tile[16:] == tile[16:]).all() and (
        env.state.tile[:16] != tile[:16]
    ).sum() >= 10  # 1 in 16 draws the same
    for old, new in zip(before, physical(env), strict=True):
        assert (old[16:] == new[16:]).all() and (old[:16] != new[:16]).all() and len(np.unique(old)) == 32


@pytest.mark.parametrize("roughness", [(0.0, 0.0), (1e-6, 1e-6)], ids=["plane", "height field"])
@pytest.mark.parametrize(
    ("height", "ends"),
    [(0.44, []), (0.41, ["velocity", "curriculum"]), (0.21, list(tasks.TASKS))],
    ids=["feet", "shins", "thighs"],
)
@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_may_touch_the_ground(task, height, ends, roughness):
    """IV-A.3, D13. Legs straight, down from the trunk: soles 0.446 m, shins 0.413 m, thighs 0.217 m."""
    env = make(task=task, roughness=roughness, max_power=None, **FROZEN)
    place(env, np.zeros(12), height=height)
    _, _, terminated, truncated, info = still(env)
    assert terminated.tolist() == info["log"]["ended_fall"].tolist() == [task in ends] * 2
    assert not truncated.any() and not info["log"]["ended_diverged"].any()


@pytest.mark.parametrize("task", tasks.TASKS)
def test_self_contact_ends_nothing(task):
    """Hips 0.863 rad inward: right and left thigh cross at y = 0, 0.0988 / sin(0.863) = 0.13 m down their 0.2 m.

    0.04675 + 0.08 cos(0.863) = 0.0988 m is how far out a thigh begins.
    """
    env = make(task=task, max_power=None, **FROZEN)
    place(env, np.tile([0.863, 0.8, -1.5, -0.863, 0.8, -1.5], 2))
    _, _, terminated, _, info = still(env)
    assert not terminated.any() and not info["log"]["ended_diverged"].any()


@pytest.mark.parametrize(
    ("task", "expected"), [("flat", [17.475, 23.7, 35.55]), ("rough", [17.475, 23.7, 35.55]), ("velocity", [16.5] * 3)]
)
def test_torque_speed_limit_by_task(task, expected):
    """V-D: at half its largest speed, 30.1 / 2 or 20.06 / 2 rad/s, a joint gives 33 / 2 N m, on `velocity` alone.

    Action 10 asks for 20 * 1.25 - 0.5 * 15.05 = 17.475 (hips), 50 - 7.525 (thighs) and 50 - 5.015 N m (calves).
    """
    env = make(task=task, **FROZEN)
    place(env, qd=np.tile([15.05, 15.05, 10.03], 4))
    env.step(np.full((2, 12), 10.0))
    assert env.ctrl == pytest.approx(np.tile(expected, (2, 4)), abs=1e-3)


def test_torque_speed_limit_before_every_physics_step():
    """Four physics steps are four times one, bit by bit, while the limit sinks with each as the joints speed up."""
    four, one = (make(task="velocity", roughness=(0.0, 0.0), physics_steps=n) for n in (4, 1))
    place(four), place(one)
    action = np.full((2, 12), 4.0)
    four.step(action)
    for _ in range(4):
        one.step(action)
    assert same_bits([four.qpos, four.qvel, four.ctrl], [one.qpos, one.qvel, one.ctrl])


@pytest.mark.parametrize(("speed", "steps"), [(3.0, 10), (1.0, 20)])
def test_the_seam(monkeypatch, speed, steps):
    """A robot that leaves its tile is put back and does not notice: its twin, on the same ground, stays on its own.

    The twin's tiles begin 2 m further on in x and in y, as periodic ground may, so that the edge is amid the twin's
    tile. Four robots on 5 cm run over the far and the near edge in x, the far one in y, and over a corner.
    """
    env = make(4, task="velocity", roughness=(0.05, 0.05))
    amid = 20 + (np.arange(120) + 20) % 80  # 20 points of apron, 80 of tile, each 40 points on
    heights = env.ground.reshape(120, 16, 120)[amid][:, :, amid].reshape(120, -1)
    monkeypatch.setattr(go1_env.terrain, "make_ground", lambda *_, **__: heights)
    twin = make(4, task="velocity", roughness=(0.05, 0.05))
    heading = np.array([[1, 0], [-1, 0], [0, 1], [-(0.5**0.5), -(0.5**0.5)]])
    corner = np.stack([6.0 * env.state.tile + 1, np.ones(4)], -1)
    for world, start in (
        (env, [[3.9, 3.0], [0.1, 3.0], [3.0, 3.9], [0.1, 0.1]]),
        (twin, [[1.9, 1.0], [2.1, 1.0], [1.0, 1.9], [2.1, 2.1]]),
    ):
        place(world, height=0.34, quaternion=np.array([[1, 0, 0, 0], [0, 0, 0, 1], [0.5**0.5, 0, 0, 0.5**0.5],
                                                       [cos(5 * pi / 8), 0, 0, sin(5 * pi / 8)]]))  # fmt: skip
        world.qpos[:, :2], world.qvel[:, :2] = corner + start, speed * heading
    for action in random_actions(env, steps) / 2:
        (obs, reward, ended, _, info), (twins_obs, twins_reward, _, _, twins_info) = env.step(action), twin.step(action)
        assert not ended.any()
        assert obs == pytest.approx(twins_obs, abs=1e-6) and reward == pytest.approx(twins_reward, abs=1e-6)
        assert info["cost"] == pytest.approx(twins_info["cost"], abs=1e-3)
        assert env.qpos[:, 2:] == pytest.approx(twin.qpos[:, 2:], abs=1e-6)
        assert env.qvel == pytest.approx(twin.qvel, abs=1e-6)
    moved = env.qpos[:, :2] - twin.qpos[:, :2]
    assert moved == pytest.approx(np.array([[-2, 2], [2, 2], [2, -2], [2, 2]]), abs=1e-6)  # 2 m before, all in x or y


def test_standing_on_a_height_field():
    """Ground of 1 um carries like a plane: soles sink in by 1 mm or, being stiffer there, less; the trunk is as high.

    Within 1 cm: a foot has more contacts with triangles than the one with a plane, and so slides apart more slowly.
    """
    plane, field = (
        make(2, task="rough", roughness=(high, high), friction=(0.8, 0.8), payload=(0.0, 0.0)) for high in (0.0, 1e-6)
    )
    for env in (plane, field):
        place(env, height=0.34)
        still(env, 200)
        assert np.abs(env.qvel).max() < 0.1
    for a, b in zip(plane.qpos, field.qpos, strict=True):
        assert -0.0015 < soles(a).min() < soles(a).max() < 0 and soles(a) == pytest.approx(soles(b), abs=1e-3)
    assert (plane.qpos[:, 2] > 0.2).all() and plane.qpos[:, 2] == pytest.approx(field.qpos[:, 2], abs=0.01)


@pytest.mark.parametrize("task", tasks.TASKS)
def test_no_foot_sinks_in(task):
    """With the most friction and the most payload of a task, the soles of a robot that stands are 5 mm deep at most.

    MuJoCo's pyramidal contacts give way the more friction they have: at 2 the soles are more than 1 cm deep, and at 3,
    as in the lab's code, the shins touch the ground, which is a fall (D24).
    """
    settings = tasks.task_config(task)
    env = make(1, task=task, roughness=(0.0, 0.0), friction=settings.friction[1:] * 2, payload=settings.payload[1:] * 2)
    place(env, height=0.31)
    assert not any(still(env)[2] for _ in range(100))
    assert -0.005 < soles(env.qpos[0]).min() < 0
    env.state.friction[:, env.feet, 0] = 2.0  # which no setting allows
    still(env, 50)
    assert soles(env.qpos[0]).min() < -0.01
    if env.task.only_feet:
        env.state.friction[:, env.feet, 0] = 3.0
        assert any(still(env)[2] for _ in range(100))


@pytest.mark.parametrize("roughness", [(0.0, 0.0), (1e-6, 1e-6)], ids=["plane", "height field"])
def test_no_foot_is_caught_in_the_ground(roughness):
    """The centre of a foot that is pressed into the ground comes out again within 0.1 s, from a height field as well.

    There a centre below the surface may be nearer to the side of a prism than to its top, and is pushed along, not up.
    """
    env, below = make(64, task="rough", roughness=roughness), np.zeros((64, 4), int)
    for action in random_actions(env, 100):
        ended = env.step(action)[2]
        up = Rotation.from_quat(env.qpos[:, 3:7], scalar_first=True).as_matrix()[:, 2]
        centres = env.qpos[:, 2:3] + np.einsum("nj,nkj->nk", up, go1.leg_points(env.qpos[:, 7:])[:, 1::2])
        below = np.where((centres < 0) & ~ended[:, None], below + 1, 0)
        assert below.max() <= 5


# ---- the curriculum's world ----

QUIET = dict(com=(0.0, 0.0), motor_strength=(1.0, 1.0), motor_offset=(0.0, 0.0), gravity=(0.0, 0.0), latency=0,
             friction=(0.8, 0.8), payload=(0.0, 0.0), roughness=(0.0, 0.0))  # fmt: skip


def test_latency_in_steps():
    """Six physics steps are one control step of four and a half: the motors feel a new target in the second one only.

    The joints rest at the old target, so that the torque is 20 * 0.25 N m once the new one arrives and 0 before.
    """
    env = make(task="curriculum", **QUIET | dict(latency=6), **FROZEN)
    place(env)
    action = np.full((2, 12), 1.0) / np.tile([0.5, 1.0, 1.0], 4)
    torques, step = [], env.batch.step
    env.batch.step = lambda: (torques.append(env.ctrl.copy()), step())
    for _ in range(2):
        env.step(action)
    assert np.array(torques)[:, 0, 0] == pytest.approx([0.0] * 6 + [5.0] * 2, abs=1e-6)


def test_motor_strength_and_offset():
    """Half the torque from motors of half strength; an encoder that reads 0.125 rad too much costs 20 * 0.125 N m."""
    env = make(task="curriculum", **QUIET | dict(motor_strength=(0.5, 0.5), motor_offset=(0.125, 0.125)), **FROZEN)
    place(env)
    env.step(np.full((2, 12), 1.0) / np.tile([0.5, 1.0, 1.0], 4))
    assert env.ctrl == pytest.approx(np.full((2, 12), 0.5 * 20 * (0.25 - 0.125)), abs=1e-6)


def test_motor_model_of_the_curriculum():
    """D11 with the torque-speed line: at 10 rad/s and no error -0.7 * 10; at half its top speed 16.5 N m for a calf."""
    env = make(task="curriculum", max_power=None, **QUIET, **FROZEN)
    place(env, qd=10.0)
    still(env)
    assert env.ctrl == pytest.approx(np.full((2, 12), -7.0), abs=1e-4)
    place(env, NOMINAL - 1.5, qd=20.06 / 2)  # PD alone would pull with 30 - 7 N m
    still(env)
    assert env.ctrl[0, 2] == pytest.approx(16.5, abs=1e-4)


def test_added_gravity_makes_things_fall_elsewhere():
    """In the air for one control step of 20 ms: the trunk gains what gravity was drawn as, times 0.02 s."""
    env = make(8, task="curriculum", **QUIET | dict(gravity=(-1.0, 1.0)))
    place(env, height=2.0)
    still(env)
    assert (np.abs(env.state.gravity - [0, 0, -9.81]) <= 1).all() and len(np.unique(env.state.gravity)) == 24
    assert env.qvel[:, :3] == pytest.approx(0.02 * env.state.gravity, abs=1e-9)


def test_centre_of_mass_moves_by_what_was_drawn():
    """Only the trunk's, within +- 5 cm along each axis, other for every robot."""
    env = make(32, task="curriculum")
    model = mujoco.MjModel.from_xml_path(str(go1.MODEL))
    shift = env.state.com - model.body_ipos
    trunk = model.body("trunk").id
    assert 0.04 < np.abs(shift[:, trunk]).max() <= 0.05 and len(np.unique(shift[:, trunk])) == 96
    assert not np.delete(shift, trunk, axis=1).any()


@pytest.mark.parametrize(("limit", "ends"), [(800.0, False), (100.0, True), (None, False)])
def test_power_limit(limit, ends):
    """D17, IV-A.4: 12 joints that rest at 5 N m heat with 0.7 * 25 * (8 + 4 * 4 / 9) W = 171 W, and 42 W go elsewhere.

    A limit of 800 W lets that pass, one of 100 W ends the episode, and None is no limit.
    """
    env = make(task="curriculum", **QUIET | dict(max_power=limit), **FROZEN)
    place(env)
    _, _, terminated, truncated, info = env.step(np.full((2, 12), 1.0) / np.tile([0.5, 1.0, 1.0], 4))
    assert info["log"]["power"] == pytest.approx([0.7 * 25 * (8 + 16 / 9) + 42] * 2, abs=1e-3)
    assert terminated.tolist() == info["log"]["ended_power"].tolist() == [ends] * 2
    assert not truncated.any() and not info["log"]["ended_fall"].any()


def test_eq11_smoothness_is_the_cost_of_a_step():
    """Eq. (11) in the loop. At rest: 12 torques of 5 N m, 12 actions of 1 or 2, no acceleration worth mentioning.

    2e-4 * 12 * 25 + 1e-2 * (4 * 4 + 8 * 1) = 0.06 + 0.24; no survival bonus, and the power is logged all the same.
    """
    env = make(task="curriculum", aux="smooth", **QUIET, **FROZEN)
    place(env)
    info = env.step(np.full((2, 12), 1.0) / np.tile([0.5, 1.0, 1.0], 4))[4]
    qdd = (env.qvel[0, 6:]) / 4e-9
    assert info["cost"] == pytest.approx(0.3 + 2.5e-7 * np.square(qdd).sum(), rel=1e-6)
    assert info["log"]["power"][0] > 200


def test_curriculum_grows_where_the_robot_succeeds():
    """A robot that is commanded and tracks 0 succeeds after command_steps; one that falls has not, and nothing grows.

    Ten steps per command: sums of 10 * 1 are means of 1 > 0.8 and 0.5, and one of 10 * 0.5 is not.
    """
    env = make(task="curriculum", **QUIET, **FROZEN, command_steps=10)
    place(env)
    env.state.cell[:], env.state.weights[:] = [[2, 19], [2, 19]], 0.0
    env.state.weights[2, 19] = 0.5
    env.state.command[:] = 0.0
    for _ in range(10):
        still(env)
    assert (
        env.state.weights[2, 19] == 1.0
        and env.state.weights[1, 18] == pytest.approx(0.4)
        and not env.state.tracked.any()
    )
    grown = env.state.weights.copy()
    env.state.command[:] = 1.0  # far from what the robot does
    for _ in range(10):
        info = still(env)[4]
    assert (env.state.weights == grown).all() and info["log"]["command_area"] == pytest.approx(np.full(2, grown.mean()))


def test_shaped_reward_replaces_the_task_reward_and_keeps_it_in_the_log():
    """V-E. A robot that hangs still 10 cm too high: 1.5 for the command 0, less 30 * 0.1^2 for its height."""
    env = make(task="curriculum", reward="shaped", **QUIET, **FROZEN)
    place(env, height=0.44)
    env.state.command[:] = 0.0
    still(env)
    env.state.command[:] = 0.0
    _, reward, _, _, info = still(env)
    assert reward == pytest.approx([1.5 - 30 * 0.01] * 2, abs=1e-3)
    assert info["log"]["task_reward"] == pytest.approx([1.5] * 2, abs=1e-6)


def test_air_time_counts_from_take_off_to_landing(monkeypatch):
    """After three steps in the air feet that land were up for 4 * 20 ms; then the clock starts anew, a step late.

    A foot that is off the ground for one step only has not left it [lab code].
    """
    env = make(task="curriculum", reward="shaped", max_power=None, **QUIET)
    seen, observe = [], shaped.observe
    monkeypatch.setattr(shaped, "observe", lambda *x: seen.append(observe(*x)) or seen[-1])
    for height in (1.0, 1.0, 1.0, 0.305, 1.0, 0.305, 1.0, 1.0):
        place(env, height=height)
        still(env)
    landed = np.array([m.landed[0] for m in seen])
    assert landed == pytest.approx(np.array([[0.0] * 4] * 3 + [[0.08] * 4] + [[0.0] * 4] * 4))
    assert env.state.off_ground[0].tolist() == [2] * 4


def test_curriculum_counts_whole_segments_and_both_kernels():
    """A perfect tracker whose episode ends after 5 of 10 steps has a mean of 0.5; one that turns wrongly fails too."""
    env = make(task="curriculum", **QUIET, **FROZEN, command_steps=10, episode_steps=5)
    place(env)
    env.state.command[:], env.state.weights[:], env.state.cell[:] = 0.0, 0.5, 5
    still(env, 5)
    assert (env.state.weights == 0.5).all() and not env.state.tracked.any()
    env = make(task="curriculum", **QUIET, **FROZEN, command_steps=10)
    place(env)
    env.state.command[:], env.state.weights[:], env.state.cell[:] = [0.0, 0.0, 2.0], 0.5, 5
    still(env, 10)
    assert (env.state.weights == 0.5).all()


def test_commands_of_the_curriculum_come_from_its_weights():
    """All the weight on cell (20, 5), v_x of 9 to 9.5 m/s and yaw of -7.5 to -7 rad/s: so are the next commands."""
    env = make(8, task="curriculum", **QUIET, **FROZEN, command_steps=1)
    env.state.weights[:] = 0.0
    env.state.weights[20, 5] = 1.0
    still(env)
    assert (
        (env.state.cell == [20, 5]).all()
        and (env.state.command[:, 0] >= 9).all()
        and (env.state.command[:, 2] <= -7).all()
    )


@pytest.mark.parametrize("task", tasks.TASKS)
def test_given_commands_last(task):
    """Over redraws and resets, on every task: the evaluation relies on it."""
    env = make(task=task, command_steps=2, episode_steps=3)
    given = np.array([[0.25, 0.5, -1.0], [1.0, 0.0, 0.5]])
    env.reset(0, given)
    for _ in range(4):
        still(env)
        assert (env.state.command == given).all()


def test_gravity_is_seen_as_it_is_felt():
    """Gravity of (1, 1, -8.81) m/s^2 points along that, over its length: what an accelerometer tells a level robot."""
    env = make(history=1, gravity=(1.0, 1.0), **FROZEN)
    place(env)
    assert still(env)[0][0, :3] == pytest.approx(np.array([1.0, 1.0, -8.81]) / (2 + 8.81**2) ** 0.5, abs=1e-6)
