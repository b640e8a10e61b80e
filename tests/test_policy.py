"""policy.py: what policy.npz promises, kept by every committed file."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import DAMAGES, ROOT, change_npz, error_of, make_run

import evaluate
import go1
import go1_env
import networks
import policy
import ppo
import tasks
from mirror import Mirrored, plain_policy
from runtime import run_folder

COMMITTED = sorted((ROOT / "results").rglob("policy*.npz"))
CONFIG = dict(history=2, timestep=0.005, physics_steps=4, clock_hz=12.5, action_limit=10.0)


def test_all_four_tasks_have_a_committed_policy():
    """The tests below would pass on nothing."""
    assert {run_folder.load_policy(path)[1].task for path in COMMITTED} == set(tasks.TASKS)


@pytest.mark.parametrize("path", COMMITTED, ids=lambda path: str(path.parent.relative_to(ROOT)))
def test_act_is_mean_of_what_a_robot_measures(path):
    """For 50 steps of each committed policy: from sensors alone the same actions as from what the
    environment shows. A run of older code has more arrays in its file, which are ignored.
    """
    pi, env_cfg = run_folder.load_policy(path)
    env_cfg = replace(env_cfg, noise=0.0, stagger=False, tiles=1)
    asked = np.array([[0.5, 0.0, 0.25]])
    env = evaluate.make_env(env_cfg, asked)
    obs, _ = env.reset(0)
    for _ in range(50):
        action = pi.mean(obs)
        seen = go1.motion(env.qpos, env.qvel).to_world
        gravity = go1.felt_gravity(seen, env.state.gravity)[0]
        pi.act(gravity, asked[0], env.qpos[0, 7:], env.qvel[0, 6:])
        np.testing.assert_allclose(pi.action, action[0].clip(-10, 10), rtol=1e-4, atol=1e-4)
        obs, _, terminated, _, _ = env.step(action)
        assert not terminated.any()


def handmade():
    """A policy of 2 frames without hidden layers. Action 0 is the sum of q of the older frame less
    its estimate; action 1 the clock's sine now; action 2 the action 1 before; action 3 is 40.
    """
    actor, bias = np.zeros((91, 12), np.float32), np.zeros(12, np.float32)
    actor[6:18, 0], actor[88, 0] = 1, -1
    actor[44 + 42, 1] = 1
    actor[44 + 31, 2] = 1
    bias[3] = 40
    estimator = np.zeros((88, 3), np.float32)
    estimator[44, 0] = 1  # the gravity[0] of the newer frame
    ones = np.ones(12)
    return policy.Policy(
        actor=[(actor, bias)],
        estimator=[(estimator, np.zeros(3, np.float32))],
        frame_scale=np.where(np.arange(44) < 3, 4.0, 1.0),
        q_nominal=np.full(12, 0.5),
        action_scale=np.full(12, 0.25),
        kp=20.0,
        kd=0.5,
        config=CONFIG,
    ), dict(gravity=[0.5, 0, 0], command=np.zeros(3), q=ones, qd=np.zeros(12))


def test_act_by_hand():
    """The estimate is 4 * 0.5 = 2. The first frame stands for both, so action 0 is 12 * 0.5 - 2 = 4
    and its target 0.5 + 0.25 * 4; then q changes, and is seen a step later. A clock of 12.5 Hz has
    turned by a quarter after a step of 20 ms. Action 3 is clipped at 10.
    """
    pi, seen = handmade()
    for _ in range(2):
        target = pi.act(**seen)
        assert pi.estimate.tolist() == [2, 0, 0]
        assert target[:4].tolist() == [1.5, 0.5, 0.5, 3.0]
        target = pi.act(**seen | dict(q=1.5 * np.ones(12)))
        assert pi.action[:4] == pytest.approx([4, 1, 0, 10])
        pi.act(**seen)
        assert pi.action[:4] == pytest.approx([10, 0, 1, 10], abs=1e-6)
        pi.start()


def test_mean_is_that_of_the_learner():
    """networks.policy in the robot's own coordinates, for 50 random observations."""
    env = Mirrored(go1_env.Go1Env(1, tasks.task_config(history=2)))
    cfg = ppo.PPOConfig(hidden=(8, 8), hidden_estimator=(8,))
    learner = ppo.init_learner(np.random.default_rng(0), env, ("reward", "cost"), cfg)
    pi = policy.Policy(**plain_policy(learner.params, env), **run_folder.robot(), config=CONFIG)
    obs = np.random.default_rng(1).normal(size=(50, 88)).astype(np.float32)
    mean, _, velocity = networks.policy(learner.params, env.turned(obs, np.zeros((50, 3)))[0])
    np.testing.assert_allclose(pi.mean(obs), mean @ env.action.T, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(pi.estimate, velocity @ env.privileged.T, rtol=1e-4, atol=1e-5)


# ---- what is read ----


NO_POLICY = {
    "missing": DAMAGES["missing"],
    "truncated": DAMAGES["truncated"],
    "nan": lambda path: change_npz(path, actor__0__b=np.full(8, np.nan)),
    "a layer that does not fit": lambda path: change_npz(path, actor__0__W=np.ones((90, 8))),
}


def with_settings(path, change):
    """Other settings in a policy.npz."""
    config = json.loads(str(run_folder.read_npz(path)["config"]))
    change_npz(path, config=json.dumps(change(config)))


OF_ANOTHER_WORLD = {
    "kp": lambda path: change_npz(path, kp=21.0),
    "q_nominal": lambda path: change_npz(path, q_nominal=np.zeros(12)),
    "friction": lambda path: with_settings(path, lambda c: c.pop("friction") and c),
    "moonlight": lambda path: with_settings(path, lambda c: c | dict(moonlight=1)),
    "moon": lambda path: with_settings(path, lambda c: c | dict(task="moon")),
}


@pytest.mark.parametrize("name", OF_ANOTHER_WORLD)
def test_a_policy_of_another_robot_or_world_is_refused(tmp_path, capsys, name):
    OF_ANOTHER_WORLD[name](make_run(tmp_path) / "policy.npz")
    said = error_of(capsys, evaluate.main, tmp_path)
    assert name in said and "policy.npz" in said


@pytest.mark.parametrize("damage", NO_POLICY.values(), ids=NO_POLICY)
def test_what_is_no_policy_is_one_line_that_names_it(tmp_path, capsys, damage):
    path = make_run(tmp_path) / "policy.npz"
    damage(path)
    assert error_of(capsys, evaluate.main, tmp_path).count(str(path)) == 1


def test_the_lines_of_deploy_md_run(tmp_path, monkeypatch):
    make_run(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/deploy.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    exec(code, names := {})
    assert names["target"].shape == names["torque"].shape == (12,)


# ---- frames and signs ----


@pytest.mark.parametrize("turn, entry", [([0, -0.3, 0], 0), ([0.3, 0, 0], 1), ([0, 0, 0.3], 2)])
def test_signs_of_gravity(turn, entry):
    """Turned about -y the nose goes up, about +x the right side down."""
    gravity = go1.felt_gravity(Rotation.from_rotvec([turn]).as_matrix(), go1_env.GRAVITY[None])[0]
    assert gravity[entry] < 0 and np.delete(gravity, [entry, 2]) == pytest.approx(0)


def test_signs_of_joints():
    """A positive hip moves a foot to the left (+y), a positive thigh moves it back (-x)."""
    feet = lambda q: go1.leg_points(np.tile(q, 4)).reshape(4, 2, 3)[:, 1]  # noqa: E731
    straight = feet([0.0, 0, 0])
    np.testing.assert_allclose(straight[:, 2], -2 * go1.LINK)
    assert (feet([0.1, 0, 0])[:, 1] > straight[:, 1]).all()
    assert (feet([0, 0.1, 0])[:, 0] < straight[:, 0]).all()
