"""Left and right (D28): the map on physics, and the networks that keep to it."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from test_env import NOMINAL, make

import eipo
import energy
import go1
import networks

TRUNK = np.array([1, -1, 1])  # what a mirror does to a position or a velocity; to a rate or a rotation, the opposite
JOINTS = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]  # FL, FR, RL, RR for FR, FL, RR, RL
SIGNS = np.tile([-1, 1, 1], 4)  # hips


def mirrored(qpos, qvel):
    """A state seen in a mirror, without any of the project's matrices."""
    quaternion = qpos[3:7] * [1, -1, 1, -1]
    return (np.concatenate([TRUNK * qpos[:3], quaternion, SIGNS * qpos[7:][JOINTS]]),
            np.concatenate([TRUNK * qvel[:3], -TRUNK * qvel[3:6], SIGNS * qvel[6:][JOINTS]]))  # fmt: skip


@pytest.fixture
def symmetric_robot():
    """The model without its small asymmetries: the trunk is heavier on its left, calves are all bent to the left."""
    model = go1.build_model(0.005, None)
    trunk = model.body("trunk")
    trunk.ipos[1], trunk.iquat[:] = 0.0, (1, 0, 0, 0)
    for leg in ("FL", "RL"):
        calf = model.body(f"{leg}_calf")
        calf.ipos[:], calf.iquat[:] = TRUNK * calf.ipos, calf.iquat * [1, -1, 1, -1]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def test_mirror_on_physics(symmetric_robot):
    """A mirrored state under mirrored torques stays mirrored: half a second, fall and impact included."""
    rng, robots = np.random.default_rng(0), [mujoco.MjData(symmetric_robot) for _ in range(2)]
    qpos = np.concatenate([[0, 0, 0.4], [0.9, 0.3, -0.3, 0.1], NOMINAL + 0.1 * rng.normal(size=12)])
    qvel = 0.5 * rng.normal(size=18)
    for robot, state in zip(robots, ((qpos, qvel), mirrored(qpos, qvel)), strict=True):
        robot.qpos[:], robot.qvel[:] = state
    for _ in range(100):
        torque = rng.normal(size=12)
        robots[0].ctrl[:], robots[1].ctrl[:] = torque, torque @ go1.MIRROR
        for robot in robots:
            mujoco.mj_step(symmetric_robot, robot)
    assert robots[0].ncon > 0
    for there, here in zip(mirrored(robots[0].qpos, robots[0].qvel), (robots[1].qpos, robots[1].qvel), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-9)


def test_mirror_of_the_nominal_pose_and_of_the_energy():
    """The pose is its own image; Eq. (9) charges mirrored torques and speeds alike if it clips power, not torque."""
    assert np.array_equal(NOMINAL @ go1.MIRROR, NOMINAL)
    assert np.array_equal(np.arange(12.0) @ go1.MIRROR, SIGNS * np.arange(12.0)[JOINTS])
    torque, qd = 8 * np.random.default_rng(0).normal(size=(2, 12))
    for clip, alike in (("power", True), ("torque", False)):
        costs = [energy.energy_cost(*pair, clip) for pair in ((torque, qd), (torque @ go1.MIRROR, qd @ go1.MIRROR))]
        assert (costs[0] == pytest.approx(costs[1])) == alike


def test_mirror_of_an_observation():
    """Two robots, one the other's image and half a period of the clock later: their observations are mirrored.

    The clock turns by 5e6 Hz * 4 ns = 1/50 in a control step, so that 25 steps are half a period.
    """
    env = make(2, timestep=1e-9, clock_hz=5e6)
    rng = np.random.default_rng(1)
    qpos = np.concatenate([[0, 0, 1.0], [0.9, 0.3, -0.3, 0.1], NOMINAL + 0.1 * rng.normal(size=12)])
    (env.qpos[0], env.qvel[0]), env.state.command[0] = (qpos, rng.normal(size=18)), (0.5, 0.25, 1.0)
    env.qpos[1], env.qvel[1] = mirrored(env.qpos[0], env.qvel[0])
    env.state.command[1] = 0.5, -0.25, -1.0
    env.state.age[:] = 0, 25
    action = rng.normal(size=12)
    for _ in range(5):
        obs, reward, _, _, info = env.step(np.stack([action, action @ env.mirror["action"]]))
    np.testing.assert_allclose(obs[1], obs[0] @ env.mirror["obs"], atol=1e-5)
    np.testing.assert_allclose(info["privileged"][1], info["privileged"][0] @ env.mirror["privileged"], atol=1e-6)
    assert reward[0] == pytest.approx(reward[1])


def test_even_odd_by_hand():
    """(a, b, c) -> (b, a, -c): even (a + b) / sqrt 2; odd (a - b) / sqrt 2 and c."""
    basis, even = networks.even_odd(np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]))
    s = 0.5**0.5
    assert even == 1 and basis == pytest.approx(np.array([[s, s, 0], [s, -s, 0], [0, 0, 1]]))
    env = networks.EvenOdd(make())
    assert (env.obs_size, env.privileged_size, env.action_size) == ((5 * 21, 5 * 23), (2, 1), (6, 6))
    for basis in (env.obs, env.privileged, env.action):
        np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-6)


def test_mirrored_layer_by_hand():
    """One pair of units, even weight 2, odd weight 4, bias 1, input even 1 and odd 1/2: coordinates 3 and 2.

    These are sum and difference of the units over sqrt 2: right = 5 / sqrt 2, left = 1 / sqrt 2, both positive, so ELU
    keeps them. With an odd input of -1, 3 and -4: right = -1 / sqrt 2 becomes exp(right) - 1, left = 7 / sqrt 2.
    """
    layer = networks.Layer(jnp.array([[2.0]]), jnp.array([[4.0]]), jnp.array([1.0]))
    last = networks.Layer(jnp.eye(1), jnp.eye(1), jnp.zeros(1))
    even, odd = networks.mlp([layer, last], jnp.array([[1.0], [1.0]]), jnp.array([[0.5], [-1.0]]))
    right, left = (even + odd) / 2**0.5, (even - odd) / 2**0.5
    assert right.ravel() == pytest.approx([5 / 2**0.5, np.exp(-(0.5**0.5)) - 1], rel=1e-6)
    assert left.ravel() == pytest.approx([1 / 2**0.5, 7 / 2**0.5], rel=1e-6)


@pytest.fixture(scope="module")
def learner():
    """A policy in even and odd coordinates, and the environment that has them. Noise makes every weight count."""
    env = networks.EvenOdd(make(8, noise=1.0))
    cfg = eipo.Config(num_envs=8, algo="ppo", hidden=(16, 8), hidden_estimator=(6, 4))
    params = eipo.init_state(env, None, cfg).pi.params
    params["actor"]["log_std"] += jnp.arange(6) / 8
    return env, params


def test_a_mirrored_observation_gets_a_mirrored_action(learner):
    """pi(M s) = M pi(s), V(M s) = V(s), estimate and noise mirrored as well; none of it by being 0."""
    env, params = learner
    first_obs, info = env.env.reset(1)
    first, image = info["privileged"], info["privileged"] @ env.mirror["privileged"]
    seen = []
    for obs, privileged in ((first_obs, first), (first_obs @ env.mirror["obs"], image)):
        mean, _, estimate = networks.policy(params, obs.astype(np.float32) @ env.obs)
        value = networks.value(params, obs.astype(np.float32) @ env.obs, privileged @ env.privileged)
        seen.append((mean @ env.action.T, estimate @ env.privileged.T, value))
    there = seen[0][0] @ env.mirror["action"], seen[0][1] @ env.mirror["privileged"], seen[0][2]
    for here, expected in zip(seen[1], there, strict=True):
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(here, expected, atol=1e-5)


@pytest.mark.parametrize("mirrored", [True, False])
def test_dense_is_the_same_policy(mirrored):
    """Expanded to a plain MLP of the same widths, with twice the weights: same means, estimates and noise."""
    env = networks.EvenOdd(make(8, noise=1.0), mirrored)
    cfg = eipo.Config(num_envs=8, algo="ppo", hidden=(16, 8), hidden_estimator=(6, 4))
    params = eipo.init_state(env, None, cfg).pi.params
    params["actor"]["log_std"] += jnp.arange(len(params["actor"]["log_std"])) / 8
    plain = env.dense(params)
    assert [layer.even.shape for layer in plain["actor"]["layers"]] == [(223, 16), (16, 8), (8, 12)]
    obs, _ = env.env.reset(1)
    mean, _, estimate = networks.policy(params, obs @ env.obs)
    there = networks.policy(plain, obs)
    np.testing.assert_allclose(there[0], mean @ env.action.T, atol=1e-5)
    np.testing.assert_allclose(there[2], estimate @ env.privileged.T, atol=1e-5)
    if mirrored:  # FR hip and FL hip share a pair, and so on
        assert plain["actor"]["log_std"] == pytest.approx(np.tile(np.arange(6).reshape(2, 1, 3) / 8, (1, 2, 1)).ravel())
    weights = [sum(x.size for x in jax.tree.leaves(p["actor"]["layers"])) for p in (params, plain)]
    assert weights[0] / weights[1] == pytest.approx(0.5 if mirrored else 1.0, abs=0.01)


def test_the_noise_is_as_likely_mirrored(learner):
    """Right and left are equally noisy, so the density of an action is that of its mirror image."""
    env, params = learner
    action = np.random.default_rng(0).normal(size=12).astype(np.float32)
    _, std, _ = networks.policy(params, np.zeros(220, np.float32))
    basis = env.action
    here, there = (networks.log_prob(0 * std, std, a @ basis) for a in (action, action @ env.mirror["action"]))
    assert float(here) == pytest.approx(float(there), rel=1e-6)
