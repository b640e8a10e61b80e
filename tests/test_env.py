"""The Go1 as a Markov decision process: what go1_env.py and Sections IV-A to IV-C promise.

Two tricks make hand values possible without touching the internals. In free fall, with the joints
where the action wants them, no motor pulls and nothing moves but the fall itself. And a physics
step of a nanosecond (FROZEN) keeps any state that a test writes still, so that the next observation
and cost are of that very state.
"""

from math import exp

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import (
    FROZEN,
    NOMINAL,
    ON_ITS_BACK,
    frames,
    make,
    place,
    random_actions,
    run,
    same_bits,
    soles,
    still,
)

import go1
import tasks
from runtime import checkpoint

TORQUE_LIMIT = np.tile([23.7, 23.7, 35.55], 4)
TO_THE_LEFT = (0.5**0.5, 0, 0, 0.5**0.5)
TINY = 1e-4  # what moves in some hundred nanoseconds nevertheless: the clock

# ---- the observation: gravity, command, joint angles and speeds, previous action, clock ----

SCALE = np.array([1, 1, 1, 2, 2, 0.25, *[1] * 12, *[0.05] * 12, *[1] * 12, 1, 1])
NOISE = np.array([*[0.05] * 3, *[0] * 3, *[0.01] * 12, *[1.5] * 12, *[0] * 14])
ACTION = slice(30, 42)  # the previous action within a frame of 44


@pytest.mark.go1
def test_observation():
    """IV-C.a. A state by hand, all of whose numbers differ, comes out in this order and scale.

    In this pose x, y, z of the trunk point along y, z, x of the world, so that gravity is along -y.
    """
    env = make(1, history=1, **FROZEN)
    q, qd, action = np.arange(12) / 64, np.arange(12) / 2, np.arange(12) / 4
    place(env, NOMINAL + q, qd, quaternion=(0.5, 0.5, 0.5, 0.5))
    env.state.command[:] = 0.5, 0.25, 2.0
    raw = [0, -1, 0, 0.5, 0.25, 2.0, *q, *qd, *action, 0, 1]
    assert env.step(action[None])[0][0] == pytest.approx(SCALE * raw, abs=1e-5)


@pytest.mark.parametrize("factor", [0.0, 1.0, 2.0])
def test_observation_noise(factor):
    """Uniform within +- NOISE, nearly reached in 300 draws (0.95^300 = 2e-7), and 0 elsewhere.

    Each robot, column and frame has its own draw, because shared noise would be a signal.
    """
    env = make(2, history=1, noise=factor, episode_steps=1000, command_steps=1000, **FROZEN)
    place(env)
    seen = np.array([still(env)[0] for _ in range(300)])
    error = seen[:, 0] - SCALE * [0, 0, -1, *env.state.command[0], *[0.0] * 37, 1]
    bound = factor * SCALE * NOISE
    assert (np.abs(error) <= bound + TINY).all()
    assert (error.max(0) >= 0.9 * bound - TINY).all()
    assert (error.min(0) <= -0.9 * bound + TINY).all()
    if factor:
        noisy = seen[:2][..., [0, 1, *range(6, 30)]].reshape(4, 26)
        assert len(np.unique(noisy[:, :2])) == 8 and len(np.unique(noisy[:, 2:])) == 96


def test_timing_reference():
    """D14. (sin, cos) of 3 Hz * 20 ms * 25 = 1.5 turns. It turns forward: a clock of 12.5 Hz makes
    a quarter turn in each 20 ms.
    """
    assert still(make(1, history=1), 25)[0][0, 42:] == pytest.approx((0, -1), abs=1e-6)
    obs, *_ = still(make(1, history=4, clock_hz=12.5), 3)
    quarters = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])
    assert frames(obs)[0, :, 42:] == pytest.approx(quarters, abs=1e-6)


# ---- physics, reward and cost ----


def test_standing():
    """Action 0 is a stance. From a random pose the robot stands up and stays up, for 20 s."""
    env = make(4, friction=(0.8, 0.8), payload=(0.0, 0.0), episode_steps=1000)
    for _ in range(999):
        _, _, terminated, truncated, _ = still(env)
        assert not terminated.any() and not truncated.any()
    assert (env.qpos[:, 2] > 0.2).all() and np.abs(env.qvel).max() < 0.05
    assert still(env)[3].all()


def test_action_is_clipped():
    """At +-10, and the robot is told what was applied, not what it asked for."""
    obs, *_ = make(1, history=1).step(np.array([[1e6, -1e6] * 6]))
    assert obs[0, ACTION].tolist() == [10.0, -10.0] * 6


@pytest.mark.parametrize(
    ("task", "command", "velocity", "expected"),
    [
        ("flat", (1, 0, 0), (1.0, 0.0, 0.0), 1.5),  # D10: not 0.02 * 1.5
        ("flat", (1, 0.5, 0.5), (2.0, 0.0, 0.0), exp(-1) + 0.5 * exp(-1)),
        ("rough", (1, 0, 0), (1.0, -0.5, 0.5), 1 + 0.15 * exp(-1)),
        ("velocity", (0, 0, 0), (-2.0, -0.5, 0.5), -2 * exp(-2)),
        ("curriculum", (1, 0, 0), (1.5, 0.0, 0.0), exp(-1) + 0.5),  # faster than asked: an error
    ],
)
def test_reward_of_a_task(task, command, velocity, expected):
    """Eqs. (5) to (8), not scaled, each error of 1/2 a factor 1/e, of a robot turned by 90 degrees.

    Its forward is the world's y and its left the world's -x. Rolling at 1 and pitching at 2 rad/s
    is no yawing.
    """
    env = make(task=task, max_power=None, **FROZEN)
    v_x, v_y, yaw_rate = velocity
    place(env, quaternion=TO_THE_LEFT, velocity=(-v_y, v_x, 0), rates=(1, 2, yaw_rate))
    env.state.command[:] = command
    _, reward, terminated, *_ = still(env)
    assert reward == pytest.approx([expected] * 2, abs=1e-6) and not terminated.any()
    assert env.observe()[1] == pytest.approx(np.array([[v_x, v_y, 0.0]] * 2), abs=1e-6)


@pytest.mark.go1
def test_batch_equals_a_plain_mujoco_loop():
    """The batch is no other simulator: one MjModel per robot, with its friction and mass, and PD by
    hand before each mj_step, give the same bits. These have the geoms that are only drawn, and the
    batch has not.
    """
    env = make(3, com=(-0.05, 0.05))
    models = [mujoco.MjModel.from_xml_path(str(go1.MODEL)) for _ in range(3)]
    robots = [mujoco.MjData(model) for model in models]
    for i, (model, robot) in enumerate(zip(models, robots, strict=True)):
        feet = [model.geom(f"{leg}_foot").id for leg in go1.LEGS]
        assert len(model.geom_friction) > len(env.state.friction[i])
        model.geom_friction[feet] = env.state.friction[i, env.feet]
        model.body_mass[:], model.body_ipos[:] = env.state.mass[i], env.state.com[i]
        mujoco.mj_setConst(model, robot)
        robot.qpos[:], robot.qvel[:] = env.qpos[i], env.qvel[i]
    for action in random_actions(env, 12):
        targets = NOMINAL + 0.25 * np.tile([0.5, 1.0, 1.0], 4) * action
        for model, robot, target in zip(models, robots, targets, strict=True):
            for _ in range(4):
                torque = 20 * (target - robot.qpos[7:]) - 0.5 * robot.qvel[6:]
                robot.ctrl[:] = np.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT)
                mujoco.mj_step(model, robot)
        _, _, terminated, _, _ = env.step(action)
        assert not terminated.any()  # else the comparison would end here
        assert [x.tobytes() for x in env.qpos] == [robot.qpos.tobytes() for robot in robots]
        assert [x.tobytes() for x in env.qvel] == [robot.qvel.tobytes() for robot in robots]


# ---- the end of an episode ----


def test_an_episode_ends_for_one_reason():
    """Time is up for all four, all but the last draw more than 100 W, the first two lie on their
    backs, and one number of robot 0 is NaN.

    A bootstrap would give a robot that falls on its very last step a future.
    """
    env, action = make(4, episode_steps=1, max_power=100.0), np.full((4, 12), 4.0)
    place(env, quaternion=ON_ITS_BACK)
    env.qpos[:2, 2], action[3] = 0.056, 0.0
    poison(env, action, "qpos", robot=0)
    _, _, terminated, truncated, info = env.step(action)
    ends = [info["log"][f"ended_{name}"] for name in ("diverged", "fall", "power", "limit")]
    assert np.array_equal(ends, np.eye(4))
    assert (terminated == ~truncated).all() and truncated.tolist() == [False] * 3 + [True]


def test_final_obs_at_a_time_limit():
    """D16. H = 5, and the time is up after the actions 1, 2, 3. final_obs remembers 0, 0, 1, 2, 3,
    oldest first, and obs has the first frame of the new episode alone, noise included. So has the
    privileged part: the critic starts from the truth.

    The most reported bug in the field is to bootstrap from obs, which takes the start of the next
    episode for the end of this one. Where no episode ended, both are the same.
    """
    env = make(episode_steps=3, noise=1.0)
    for k in (1, 2, 3):
        obs, _, _, truncated, info = env.step(np.full((2, 12), float(k)))
        assert same_bits([obs, info["privileged"]], env.observe())
        assert truncated.tolist() == info["log"]["ended_limit"].tolist() == [k == 3] * 2
        final = info["final_obs"], info["final_privileged"]
        alike = [same_bits([x], [now]) for x, now in zip(final, env.observe(), strict=True)]
        assert alike == [k < 3] * 2
    to_trunk = Rotation.from_quat(env.qpos[:, 3:7], scalar_first=True).inv()
    assert env.observe()[1] == pytest.approx(to_trunk.apply(env.qvel[:, :3]), abs=1e-6)
    assert frames(final[0])[:, :, 30].tolist() == [[0, 0, 1, 2, 3]] * 2
    assert (frames(obs) == frames(obs)[:, :1]).all() and not frames(obs)[:, :, ACTION].any()


def test_first_episodes_are_staggered():
    """Robots end their first episodes of 8 steps at all times, each once, not in a wave. Of 256
    none starts at one of 8 ages with a chance of 8 (7/8)^256 = 1e-14.

    The first observation shows the age of an episode: not all clocks stand at 0. A command that
    begins at age 4 of 6 is to last 2 steps.
    """
    env = make(256, stagger=True, episode_steps=8)
    assert set(env.state.age.tolist()) == set(range(8))
    assert len(np.unique(env.reset(0)[0][:, -1])) >= 4
    cut = make(256, stagger=True, episode_steps=6, command_steps=4)
    assert (cut.state.planned[cut.state.age == 4] == 2).all()
    ends = np.array([still(env)[3] for _ in range(8)])
    assert (ends.sum(0) == 1).all() and ends.any(1).all()


def test_return_and_length_of_the_episodes_that_end():
    """On `velocity` a step pays v_x: 3 steps at 1 m/s are 3 in an episode of 3 steps. The second
    robot falls in step 2, after 1 and 1. NaN where no episode ends.
    """
    env = make(task="velocity", episode_steps=3, **FROZEN)
    env.contacts, returns, lengths = np.zeros((2, 17)), [], []
    for step in range(1, 4):
        place(env, velocity=(1, 0, 0))
        env.contacts[1] = step == 2
        log = still(env)[4]["log"]
        returns.append(log["episode_return"].tolist())
        lengths.append(log["episode_length"].tolist())
    nan = float("nan")
    expected = np.array([[nan, nan], [nan, 2.0], [3.0, nan]])
    assert np.array(returns) == pytest.approx(expected, nan_ok=True)
    assert np.array(lengths) == pytest.approx(expected, nan_ok=True)


def test_an_episode_that_began_before_the_run_has_no_return():
    """With random first ages nobody has seen the start of most of the first episodes. Of 16 robots
    each ends its first one within 8 steps, and its next one 8 steps later.
    """
    env = make(16, stagger=True, episode_steps=8)
    begun = env.state.age > 0
    ended = np.array([~np.isnan(still(env)[4]["log"]["episode_length"]) for _ in range(16)])
    assert (ended[:8].sum(0) == ~begun).all() and (ended[8:].sum(0) == 1).all()


# ---- what an episode begins with; what it draws of the world is in test_world.py ----


@pytest.mark.parametrize("task, high", [("flat", 1), ("rough", 1), ("velocity", 0)])
def test_commands(task, high):
    """IV-A.1. v_x is from all of [0, 1] m/s, and on `velocity` 0. v_y and the yaw rate are 0.

    Commands are drawn anew at every reset and in between.
    """
    env = make(256, task=task, command_steps=2, episode_steps=5)
    for _ in range(7):
        command = frames(still(env)[0])[:, -1, 3:6]
        v_x = command[:, 0] / 2  # scale 2
        assert 0 <= v_x.min() < 0.05 and 0.95 * high <= v_x.max() <= high
        assert not command[:, 1:].any() and len(np.unique(v_x)) > 250 * high


def test_commands_change():
    """command_steps = 3. Steps 1 to 3 are rewarded by the first command, 4 to 6 by the next, and
    the observation shows it in time.
    """
    env = make(2, command_steps=3)
    told, obeyed = [frames(env.reset(0)[0])[:, -1, 3] / 2], []
    for _ in range(6):
        obs, _, _, _, info = still(env)
        told.append(frames(obs)[:, -1, 3] / 2)
        obeyed.append(info["log"]["command_x"])
    assert np.array(told[:6]) == pytest.approx(np.array(obeyed), abs=1e-6)
    changes = (np.diff(np.array(told), axis=0) != 0).tolist()
    assert changes == [[False] * 2, [False] * 2, [True] * 2] * 2


@pytest.mark.go1
def test_reset_pose():
    """D35. Joints are at 0.5 to 1.5 times nominal, within the URDF's range, and the trunk moves by
    +- 0.5 m/s and rad/s with any yaw. Without spread all is nominal and at rest.

    By MuJoCo's own kinematics the lowest foot is on the ground: no robot is thrown up by contact,
    or falls first. With twice the spread some have a knee below their feet, 2 cm above the ground.
    """
    env = make(64)
    low, high = np.tile([[-0.863, -0.686, -2.818], [0.863, 4.501, -0.888]], 4)
    q, yaw = env.qpos[:, 7:], env.qpos[:, 6]
    assert (low <= q).all() and (q <= high).all() and not env.qvel[:, 6:].any()
    ratio = q / NOMINAL
    assert 0.5 <= ratio.min() < 0.55 and 1.45 < ratio.max() <= 1.5 and ratio.std() > 0.2
    assert 0.45 < np.abs(env.qvel[:, :6]).max() <= 0.5 and len(np.unique(env.qvel[:, :6])) == 64 * 6
    assert yaw.min() < -0.9 and yaw.max() > 0.9 and not env.qpos[:, [0, 1, 4, 5]].any()
    for qpos in env.qpos[:8]:
        assert soles(qpos).min() == pytest.approx(0.0, abs=1e-12)
    wide = make(256, start_spread=1.0).qpos
    lowest = wide[:, 2] + go1.leg_points(wide[:, 7:])[..., 2].min(-1)
    assert lowest == pytest.approx(np.full(256, 0.02))
    calm = make(start_spread=0.0)
    assert (calm.qpos[:, 7:] == NOMINAL).all() and not calm.qvel.any()


# ---- the same bits ----


@pytest.mark.parametrize("task", tasks.TASKS)
def test_seeds(task):
    """Same seed, same bits, in a new environment and in a used one; another seed, another world."""
    env, used, other = (make(3, task=task, seed=seed, noise=1.0) for seed in (7, 1, 8))
    still(used, 3)
    used.state.kernels[:] = 1000.0
    if task == "curriculum":
        used.commands.weights[:] = 1.0
    used.reset(7)
    actions = random_actions(env, 4)
    ours = run(env, actions)
    assert same_bits(ours, run(used, actions)) and not same_bits(ours, run(other, actions))


def arrays(thing, name=""):
    """Every array that an object holds, in whatever it holds it, by name."""
    if isinstance(thing, np.ndarray):
        return {name: thing}
    parts = thing._asdict() if hasattr(thing, "_asdict") else getattr(thing, "__dict__", thing)
    if isinstance(parts, list):
        parts = dict(enumerate(parts))
    if not isinstance(parts, dict):
        return {}
    found = [arrays(part, f"{name}.{key}") for key, part in parts.items()]
    return {path: x for each in found for path, x in each.items()}


@pytest.mark.parametrize("reward", ["paper", "shaped"])
@pytest.mark.parametrize("task", tasks.TASKS)
def test_the_next_step_depends_on_nothing_but_the_state(task, reward, tmp_path):
    """Resume is exact: through a file, into another world, over new episodes and commands.

    All arrays of that world, in the state and beside it, are filled with garbage, but for what two
    worlds agree in after steps from different seeds, as the ground. And what is no array, as a
    counter would be, must not have changed by then.
    """
    fields = dict(task=task, reward=reward, stagger=True, noise=1.0)
    fields |= dict(episode_steps=6, command_steps=4)
    env, other, fresh = (make(3, seed=seed, threads=1 + seed // 2, **fields) for seed in (0, 1, 2))
    actions = random_actions(env, 12)
    run(env, actions[:3]), run(other, actions[:3])
    env.state.kernels[:] = 3.5  # of 4 steps, so that the next step ends in a success
    numbers = [
        {k: x for k, x in vars(e).items() if isinstance(x, bool | int | float | str | None)}
        for e in (env, fresh)
    ]
    assert numbers[0] == numbers[1]
    ours, others = arrays(env), arrays(other)
    agreed = {name for name in ours if same_bits([ours[name]], [others[name]])}
    for name, x in arrays(fresh).items():
        if x.flags.writeable and (name.startswith(".state") or name not in agreed):
            x[:] = np.nan if x.dtype.kind == "f" else 77
    np.savez(tmp_path / "state.npz", **checkpoint.saved(env))
    with np.load(tmp_path / "state.npz", allow_pickle=False) as state:
        checkpoint.restore_env(fresh, state)
    assert same_bits(run(env, actions[3:]), run(fresh, actions[3:]))


# ---- a simulation that blows up (D36) ----


def poison(env, action, what, robot=1):
    """Set one number of a robot to NaN, as a contact or a policy that diverges does."""
    dict(qpos=env.qpos, qvel=env.qvel, action=action)[what][robot, 8] = np.nan


@pytest.mark.parametrize("poisoned", ["qpos", "qvel", "action"])
@pytest.mark.parametrize(
    "fields", [dict(), dict(reward="shaped"), dict(aux="smooth", latency=6)], ids=str
)
def test_divergence_ends_one_episode(poisoned, fields, tmp_path, monkeypatch):
    """Robot 1 of 3 is lost, says so, earns 0 at a cost of 0, and begins anew. The others, whose
    targets may be on their way, have the same bits, now and later, as without it. What the learner
    gets is finite.

    MuJoCo writes no MUJOCO_LOG.TXT into the working folder.
    """
    monkeypatch.chdir(tmp_path)
    env, twin, others = make(3, **fields), make(3, **fields), [0, 2]
    for step, action in enumerate(random_actions(env, 4)):
        theirs = twin.step(action)
        if step == 0:
            poison(env, action, poisoned)
        ours = env.step(action)
        if step == 0:
            assert (ours[1][1], ours[4]["cost"][1]) == (0.0, 0.0)
            assert ours[4]["log"]["power"][1] == 200  # of which Eq. (9) makes a cost of 0
            assert env.state.age.tolist() == [1, 0, 1]
        assert ours[2].tolist() == ours[4]["log"]["ended_diverged"].tolist()
        assert ours[2].tolist() == [False, step == 0, False]
        for log in (ours[4]["log"], theirs[4]["log"]):
            del log["episode_return"], log["episode_length"]  # NaN where none ended
        ours, theirs = ([*x[:4], *x[4].pop("log").values(), *x[4].values()] for x in (ours, theirs))
        assert all(np.isfinite(x).all() for x in (*ours, *env.observe()))
        assert same_bits([x[others] for x in ours], [x[others] for x in theirs])
    assert list(tmp_path.iterdir()) == []
