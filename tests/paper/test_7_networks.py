"""Section IV-C: actor, critic and estimator, the robot's left and right (D28), and the PPO that
trains them.
"""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import optax
import pytest
from support import EIPO, NOMINAL, dyadic, handmade, layer, learner_of, make, trees_equal

import energy
import go1
import mirror
import networks
import ppo
from eipo import Transition
from networks import MLP
from policy import Policy
from runtime import run_folder

KEY = jax.random.PRNGKey(0)
policy, value, sample = (jax.jit(f) for f in (networks.policy, networks.value, networks.sample))

# ---- IV-C.b: the networks ----


def test_networks_elu_between_the_layers_only():
    """ELU(2) = 2 and ELU(-1) = 1/e - 1. A lone layer stays linear: 3 (-1) + 1 = -2."""
    unit, x = layer([[1.0]]), jnp.array([[2.0], [-1.0]])
    hidden = MLP([unit, unit])(x)
    assert hidden.ravel().tolist() == pytest.approx([2, -0.63212056])
    alone = MLP([layer([[3.0]], bias=1.0)])(jnp.array([-1.0]))
    assert alone.tolist() == [-2]


def test_networks_init_range():
    """Uniform within +- 1 / sqrt(fan-in): 16 inputs give +- 1/4, 64 give +- 1/8. So many draws come
    within 1 % of both ends.
    """
    first, last = networks.init_mlp(np.random.default_rng(0), [16, 64, 256]).layers
    for (weights, bias), n, m, end in ((first, 16, 64, 0.25), (last, 64, 256, 0.125)):
        assert (weights.shape, bias.shape) == ((n, m), (m,))
        assert -end <= weights.min() < -0.99 * end
        assert 0.99 * end < weights.max() <= end
        assert abs(weights.mean()) < 0.08 * end
        assert 0.9 * end < abs(bias).max() <= end


def test_networks_noise_at_the_start():
    """D39. Its logarithm is that of the settings, for each of two actions."""
    env = SimpleNamespace(obs_size=1, privileged_size=1, action_size=2)
    cfg = replace(EIPO, log_std=-1.0)
    params = networks.init_params(np.random.default_rng(0), env, 1, cfg)
    assert params["log_std"].tolist() == [-1, -1]


def test_networks_who_sees_what():
    """The actor sees the estimate, and the critic sees the truth. obs = 3, privileged = 5:

    estimate = 2 obs                         =  6
    mean     = obs + 8 estimate   = 3 + 48   = 51
    value    = obs + 8 privileged = 3 + 40   = 43
    """
    params = handmade(critic=((1.0,), (8.0,)), estimator=((2.0,),), actor=((1.0,), (8.0,)))
    mean, std, estimate = policy(params, jnp.array([3.0]))
    assert (mean.tolist(), std.tolist(), estimate.tolist()) == ([51], [1], [6])
    assert value(params, jnp.array([3.0]), jnp.array([5.0])).tolist() == [43]


def test_networks_log_prob():
    """Two independent normals at z = 0 and z = 1, with deviations 1 and 2:

    -0 - 1/2 - log 1 - log 2 - log(2 pi) = -3.0310242
    """
    mean, std, action = jnp.array([3.0, 1.0]), jnp.array([1.0, 2.0]), jnp.array([3.0, 3.0])
    assert float(networks.log_prob(mean, std, action)) == pytest.approx(-3.0310242)


# ---- D28: the mirror, on physics ----


def reflect(x, *mirrors):
    """The mirror image of x (..., n), from the mirrors of its parts, one after the other."""
    parts = np.split(x, np.cumsum([len(index) for index, _ in mirrors])[:-1], -1)
    images = [
        np.array(sign) * part[..., np.array(index)]
        for part, (index, sign) in zip(parts, mirrors, strict=True)
    ]
    return np.concatenate(images, -1)


# what a mirror does to a position or a velocity; to a rate or a rotation, the opposite
TRUNK = np.array([1, -1, 1])
JOINTS = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]  # FL, FR, RL, RR for FR, FL, RR, RL
SIGNS = np.tile([-1, 1, 1], 4)  # hips


def mirrored(qpos, qvel):
    """A state seen in a mirror, without any of the project's tables."""
    quaternion = qpos[3:7] * [1, -1, 1, -1]
    return (
        np.concatenate([TRUNK * qpos[:3], quaternion, SIGNS * qpos[7:][JOINTS]]),
        np.concatenate([TRUNK * qvel[:3], -TRUNK * qvel[3:6], SIGNS * qvel[6:][JOINTS]]),
    )


def some_state(rng, height):
    """A robot that is tilted and moves, its joints near the nominal pose: qpos, qvel."""
    q = NOMINAL + 0.1 * rng.normal(size=12)
    qpos = np.concatenate([[0, 0, height], [0.9, 0.3, -0.3, 0.1], q])
    return qpos, 0.5 * rng.normal(size=18)


@pytest.fixture
def symmetric_robot():
    """The model without its small asymmetries: the trunk is heavier on its left, and the calves
    are all bent to the left.
    """
    model = go1.build_model(0.005, None)
    trunk = model.body("trunk")
    trunk.ipos[1], trunk.iquat[:] = 0.0, (1, 0, 0, 0)
    for leg in ("FL", "RL"):
        calf = model.body(f"{leg}_calf")
        calf.ipos[:], calf.iquat[:] = TRUNK * calf.ipos, calf.iquat * [1, -1, 1, -1]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def test_mirror_on_physics(symmetric_robot):
    """A mirrored state under mirrored torques stays mirrored for half a second, fall included."""
    rng, robots = np.random.default_rng(0), [mujoco.MjData(symmetric_robot) for _ in range(2)]
    start = some_state(rng, 0.4)
    for robot, state in zip(robots, (start, mirrored(*start)), strict=True):
        robot.qpos[:], robot.qvel[:] = state
    for _ in range(100):
        torque = rng.normal(size=12)
        robots[0].ctrl[:], robots[1].ctrl[:] = torque, reflect(torque, go1.MIRROR)
        for robot in robots:
            mujoco.mj_step(symmetric_robot, robot)
    assert robots[0].ncon > 0
    qpos, qvel = mirrored(robots[0].qpos, robots[0].qvel)
    np.testing.assert_allclose(robots[1].qpos, qpos, atol=1e-9)
    np.testing.assert_allclose(robots[1].qvel, qvel, atol=1e-9)


@pytest.mark.parametrize(("clip", "is_alike"), [("power", True), ("torque", False)])
def test_mirror_of_the_nominal_pose_and_of_the_energy(clip, is_alike):
    """The pose is its own image. Eq. (9) charges mirrored torques and speeds alike if it clips
    power, but not if it clips torque.
    """
    assert np.array_equal(reflect(NOMINAL, go1.MIRROR), NOMINAL)
    assert np.array_equal(reflect(np.arange(12.0), go1.MIRROR), SIGNS * np.arange(12.0)[JOINTS])
    torque, qd = 8 * np.random.default_rng(0).normal(size=(2, 12))
    power = energy.total_power(torque, qd, clip)
    image = energy.total_power(reflect(torque, go1.MIRROR), reflect(qd, go1.MIRROR), clip)
    assert (image == pytest.approx(power)) == is_alike


def test_mirror_of_an_observation():
    """Two robots, one the other's image and half a period of the clock later, see mirrored worlds.

    The clock turns by 5e6 Hz * 4 ns = 1/50 in a control step, so that 25 steps are half a period.
    """
    env = make(2, timestep=1e-9, clock_hz=5e6)
    rng = np.random.default_rng(1)
    env.qpos[0], env.qvel[0] = state = some_state(rng, 1.0)
    env.qpos[1], env.qvel[1] = mirrored(*state)
    env.state.command[:], env.state.age[:] = [[0.5, 0.25, 1.0], [0.5, -0.25, -1.0]], [0, 25]
    action = rng.normal(size=12)
    for _ in range(5):
        _, reward, *_ = env.step(np.stack([action, reflect(action, *env.mirror["action"])]))
    obs, privileged = env.observe()
    np.testing.assert_allclose(obs[1], reflect(obs[0], *env.mirror["obs"]), atol=1e-5)
    there = reflect(privileged[0], *env.mirror["privileged"])
    np.testing.assert_allclose(privileged[1], there, atol=1e-6)
    assert reward[0] == pytest.approx(reward[1])


# ---- D28: the networks that keep to it ----


def test_parts_by_hand():
    """The mirror image of (a, b, c, d) is (b, a, -c, d), which is (1, 3, -5, 7) for (3, 1, 5, 7):

    even part   (2, 2, 0, 7)     b repeats a, and c is not even
    odd part    (1, -1, 5, 0)
    """
    even, odd = mirror.parts(np.array([3, 1, 5, 7]), ([1, 0, 2, 3], [1, 1, -1, 1]))
    assert (even.tolist(), odd.tolist()) == ([2, 7], [1, 5])


def test_tied_units_by_hand():
    """An MLP with one right unit, a + 3 b + c + 1, for (a, b, c). M swaps a and b and negates c, so
    the left unit is b + 3 a - c + 1. For (1, 2, 1) they are 9 and 5. The last layer says (2, 1) of
    the right unit and (5, 3) of the left one, and M negates its second output:

    first     mean of 2 (9) + 5 (5) = 43 and 2 (5) + 5 (9) = 55          49
    second    mean of 9 + 3 (5) = 24 and -(5 + 3 (9)) = -32              -4

    What the MLP has for its own left unit, 64, does not count.
    """
    hidden = np.array([[1.0, 64], [3, 64], [1, 64]]), np.array([1.0, 64])
    last = np.array([[2.0, 1], [5, 3]]), np.zeros(2)
    f = mirror.tied(MLP([hidden, last]), ((1, 0, 2), (1, 1, -1)), ((0, 1), (1, -1)))
    assert f(jnp.array([1.0, 2.0, 1.0])).tolist() == [49, -4]


def new_policy(init=mirror.init_params):
    """An environment of 8 robots with two frames each, and a policy in which noise makes every
    weight count.
    """
    env, rng = make(8, noise=1.0, history=2), np.random.default_rng(0)
    cfg = replace(EIPO, hidden=(16, 8), hidden_estimator=(6, 4))
    params = init(rng, env, 2, cfg)
    params = jax.tree.map(lambda x: np.float32(rng.normal(size=x.shape) / 8), params)
    params["log_std"] = np.arange(12) / np.float32(8)
    return env, params


def test_sample_is_the_mean_and_noise_of_every_joint():
    """Deviations 1, 2 and 1/2 of hip, thigh and calf, and no correlation. 4,000 draws have them
    within 5 %.
    """
    env, params = new_policy()
    params["log_std"] = np.float32(np.log(np.tile([1, 2, 0.5], 4)))
    obs = np.repeat(env.observe()[0][:1], 4000, 0)
    action, _ = sample(params, obs, KEY)
    mean, _, _ = policy(params, obs[:1])
    std_by_hand = np.tile([1, 2, 0.5], 4)
    np.testing.assert_allclose(np.std(action, 0), std_by_hand, rtol=0.05)
    np.testing.assert_allclose(np.mean(action, 0), mean[0], atol=0.15)
    assert np.abs(np.corrcoef(np.asarray(action).T) - np.eye(12)).max() < 0.1


def test_a_mirrored_observation_gets_a_mirrored_action():
    """pi(M s) = M pi(s) and V(M s) = V(s). The estimate is mirrored as well. None of it is so
    because it is 0.
    """
    env, params = new_policy()
    obs, privileged = env.observe()
    image = reflect(obs, *env.mirror["obs"]).astype(np.float32)
    mean, _, estimate = policy(params, obs)
    there = reflect(mean, *env.mirror["action"]), reflect(estimate, *env.mirror["privileged"])
    mean, _, estimate = policy(params, image)
    values = value(params, obs, privileged)
    image_values = value(params, image, reflect(privileged, *env.mirror["privileged"]))
    for x, expected in zip((mean, estimate, image_values), (*there, values), strict=True):
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(x, expected, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize("init", [mirror.init_params, networks.init_params])
def test_policy_npz_is_the_same_policy(init):
    """policy.py has the same means and estimates, without noise (D32), and the mirror has about
    half of its weights. It is in single precision, as in training: in double, NumPy takes more than
    twice as long. IV-C.b: actor and critic have the same hidden widths.
    """
    env, params = new_policy(init)
    whole = {net: params[net].layers for net in ("actor", "estimator", "critic")}
    shapes = {net: [weights.shape for weights, _ in layers] for net, layers in whole.items()}
    assert shapes["actor"] == [(91, 16), (16, 8), (8, 12)]
    assert shapes["critic"] == [(91, 16), (16, 8), (8, 2)]
    assert shapes["estimator"] == [(88, 6), (6, 4), (4, 3)]
    assert {x.dtype.name for layers in whole.values() for x in sum(layers, ())} == {"float32"}
    obs, privileged = env.observe()
    mean, _, estimate = policy(params, obs)
    pi = Policy(
        whole["actor"], whole["estimator"], **run_folder.of_the_robot(), config={}, about={}
    )
    np.testing.assert_allclose(pi.mean(obs), mean, atol=1e-5)
    np.testing.assert_allclose(pi.estimate, estimate, atol=1e-5)
    values = value(params | dict(critic=MLP(whole["critic"])), obs, privileged)
    np.testing.assert_allclose(value(params, obs, privileged), values, atol=1e-5)
    sizes = [sum(x.size for x in jax.tree.leaves(p["actor"])) for p in (params, whole)]
    # an output has weights of its own on either side
    share = 0.5 if init is mirror.init_params else 1.0
    assert sizes[0] / sizes[1] == pytest.approx(share, abs=0.04)


# ---- IV-C.c: PPO, lines 9 and 11 ----


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected"),
    [(1.5, 1, 1.25), (0.5, 1, 0.5), (1.5, -1, -1.5), (0.5, -1, -0.75)],
)
def test_algorithm1_line09_ppo_clip_four_cases(ratio, advantage, expected):
    """eps = 1/4. The ratio counts up to 1.25 if the action was good, and at least 0.75 if not."""
    assert ppo.clipped_surrogate(ratio, advantage, 0.25) == expected


def test_algorithm1_line09_ppo_loss():
    """The action is 1.5 times likelier than when it was taken, and was good. V = obs = 1:

    surrogate   min(1.5, 1.2)                   = 1.2
    entropy     log(2 pi e) / 2                 = 1.4189385
    value       (V - target)^2     = (1 - 3)^2  = 4
    estimator   (0 - privileged)^2 = 1/2^2      = 0.25
    loss        -1.2 - 0.01 * 1.4189385 + 4.25  = 3.0358106
    KL          1.5 - 1 - log 1.5               = 0.0945349

    All of the batch is beyond the clip range. Ratios of 0.5 and 2 are, 1 and 1.1 are not.
    """
    then = -0.91893853 - np.log(1.5)  # log density of a normal at its mean, less log 1.5
    batch = dict(obs=1.0, privileged=0.5, action=0.0, target=3.0)
    batch = {name: jnp.full((4, 1), x) for name, x in batch.items()}
    batch |= dict(log_prob=jnp.full(4, then), advantage=jnp.ones(4))
    pi = learner_of(handmade())
    loss, log = ppo.ppo_loss(pi.params, batch, EIPO)
    assert float(loss) == pytest.approx(3.0358106, rel=1e-6)
    assert float(log["kl"]) == pytest.approx(0.0945349, rel=1e-5)
    assert float(log["policy_loss"]) == pytest.approx(-1.2) and log["clip_fraction"] == 1.0
    batch |= dict(log_prob=-0.91893853 - np.log([0.5, 2, 1, 1.1]))
    assert ppo.ppo_loss(pi.params, batch, EIPO)[1]["clip_fraction"] == 0.5


def test_algorithm1_line09_ppo_loss_sums_over_outputs_and_averages_over_samples():
    """Two heads say V = (1, 1), and the estimate is (0, 0, 0). The second sample costs nothing. Two
    joints have the deviations 2 and 4:

    value       ((1 - 3)^2 + (1 - 2)^2) / 2    = 5/2
    estimator   (1 + 1/4 + 4) / 2              = 21/8
    entropy     log(2 pi e) + log 2 + log 4    = 2.8378771 + 2.0794415 = 4.9173186
    loss        5/2 + 21/8 - 0.01 * 4.9173186    at an advantage of 0
    """
    heads, none = [[1.0, 1.0], *[[0.0, 0.0]] * 3], [[0.0, 0.0]] * 4
    params = handmade(critic=heads, estimator=[[0.0] * 3], actor=none)
    params |= dict(log_std=np.log([2.0, 4.0]))
    batch = dict(
        obs=jnp.ones((2, 1)),
        privileged=jnp.array([[1.0, 0.5, 2.0], [0.0, 0.0, 0.0]]),
        action=jnp.zeros((2, 2)),
        target=jnp.array([[3.0, 2.0], [1.0, 1.0]]),
        advantage=jnp.zeros(2),
        log_prob=jnp.zeros(2),
    )
    loss, log = ppo.ppo_loss(params, batch, EIPO)
    assert (log["value_loss"], log["estimator_loss"]) == (5 / 2, 21 / 8)
    assert float(log["std"]) == pytest.approx((2 + 4) / 2)
    assert float(loss) == pytest.approx(5 / 2 + 21 / 8 - 0.049173186, rel=1e-6)


def advantages(seed):
    return dyadic(np.random.default_rng(seed), 8, 16)


def one_update(cfg=EIPO, lr=None, log_std=0.0, key=KEY, advantage=None, target=None, likelier=1.0):
    """Params, log and params before one ppo_update of a new learner, always on the same rollout.

    advantage, target: others than usual
    likelier: by which factor (8, 16) the actions are likelier now than when they were taken
    """
    env = SimpleNamespace(obs_size=2, privileged_size=1, action_size=1)
    heads = dict(reward=1.0, cost=1.0)
    learner = ppo.init_learner(np.random.default_rng(0), env, heads, EIPO)
    learner = replace(learner, lr=np.float32(cfg.lr if lr is None else lr))
    learner.params["log_std"] += np.float32(log_std)
    rng = np.random.default_rng(2)
    obs, privileged, action, usual = (dyadic(rng, 8, 16, width) for width in (2, 1, 1, 2))
    mean, std, _ = policy(learner.params, obs)
    log_prob = np.asarray(networks.log_prob(mean, std, action)) - np.log(likelier)
    tau = Transition(obs, privileged, action, log_prob.astype(np.float32), *[None] * 6)
    target = usual if target is None else target
    advantage = advantages(3) if advantage is None else advantage
    before = jax.tree.map(np.array, learner.params)
    learner, log = ppo.ppo_update(learner, tau, target, advantage, key, cfg)
    return learner.params, log | dict(next_lr=learner.lr), before


@pytest.mark.parametrize(
    ("log_std", "std"), [(-10.0, 0.018), (10.0, 2.7), (-3.9, 0.020), (0.9, 2.5)]
)
def test_algorithm1_line09_ppo_keeps_the_noise_in_its_range(log_std, std):
    """D39. Deviations stay within 0.018 and 2.7. lr = 0 moves nothing but what is out of range.

    It is put back after the step. In the forward pass that would stop the gradient that leads back.
    """
    params, _, _ = one_update(lr=0.0, log_std=log_std)
    assert float(np.exp(params["log_std"][0])) == pytest.approx(std, rel=0.03)


def test_algorithm1_line09_ppo_normalises_the_advantage():
    """4 A + 1 has the mean 4 m + 1 and the deviation 4 s. Normalised it is A again, so the update
    is the same one.

    A / 1024 as well, but for the 1e-8 beside its deviation. Without the division its surrogate
    would be nothing beside the entropy bonus of 1/100, whatever Adam and the clipping of gradients
    make of its scale.
    """
    usual = one_update()[0]
    assert trees_equal(usual, one_update(advantage=4 * advantages(3) + 1)[0])
    assert not trees_equal(usual, one_update(advantage=-advantages(3))[0])
    small = one_update(advantage=advantages(3) / 1024)[0]["log_std"]
    assert float(small[0]) == pytest.approx(float(usual["log_std"][0]), abs=1e-3)


def test_algorithm1_line09_ppo_normalises_no_minibatch_by_itself():
    """A minibatch of one sample still teaches the actor. By itself it would be normalised to 0."""
    params, _, before = one_update(cfg=replace(EIPO, num_minibatches=8 * 16, ent_coef=0.0))
    assert not trees_equal(params["actor"], before["actor"])


@pytest.mark.parametrize("axis", [0, 1])
def test_algorithm1_line09_ppo_normalises_over_steps_and_robots_together(axis):
    """Advantages of 1 and -1, alike in all steps or for all robots, have mean 0 and deviation 1
    already. Normalised over steps or robots alone they would be 0, and teach the actor nothing.
    """
    signs = np.where(np.indices((8, 16))[axis] % 2, 1, -1).astype(np.float32)
    learned, nothing = (one_update(advantage=x)[0]["actor"] for x in (signs, 0 * signs))
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), learned, nothing)
    assert max(jax.tree.leaves(moved)) > 0.01


def test_algorithm1_line09_ppo_shuffles_the_minibatches():
    """D31. Of 131 samples each of 4 epochs puts 130 into 2 minibatches, none twice and in an order
    of its own. Another key draws other minibatches.
    """
    orders = np.asarray(ppo.shuffled(KEY, 131, EIPO))
    assert orders.shape == (4 * 2, 65)
    epochs = orders.reshape(4, 130)
    assert all(
        len(set(epoch)) == 130 and set(epoch) <= set(range(131)) for epoch in epochs.tolist()
    )
    assert len({frozenset(first) for first in orders[::2].tolist()}) == 4
    params = one_update()[0]
    assert trees_equal(params, one_update()[0])
    assert not trees_equal(params, one_update(key=jax.random.PRNGKey(1))[0])


def test_algorithm1_line09_ppo_trains_the_estimator_by_its_own_error_alone():
    """D19. Other advantages train another actor. Estimator and critic do not notice."""
    one, other = (one_update(advantage=advantages(seed))[0] for seed in (3, 4))
    assert not trees_equal(one["actor"], other["actor"])
    assert trees_equal([one["estimator"], one["critic"]], [other["estimator"], other["critic"]])


def test_algorithm1_line09_line11_a_step_has_the_size_lr():
    """Adam's first step is lr, the paper's eta, for each number, however steep the slope. Here lr
    is 1/1024, and there is one minibatch. Targets of 64 are above every value, so the critic learns
    to say more.
    """
    cfg = replace(EIPO, num_epochs=1, num_minibatches=1)
    high = np.full((8, 16, 2), 64, np.float32)
    params, _, before = one_update(cfg=cfg, lr=2.0**-10, target=high)
    (_, after), (_, bias) = (net["critic"].layers[-1] for net in (params, before))
    assert np.asarray(after) - bias == pytest.approx(np.full(2, 2.0**-10), rel=1e-3)


def test_algorithm1_line09_ppo_clips_the_norm_at_max_grad_norm():
    """The gradient of each network is clipped by itself, where actor and noise count as one. By the
    beta_1 = 0.9 and beta_2 = 0.999 of Section IV-C.c Adam's mean starts at 1/10 of the clipped
    gradient, and its mean square at 1/1000 of that gradient's square:

    network     gradient   norm    clipped     mean          mean square
    actor       3, 4       5       0.6, 0.8    0.06, 0.08    0.36e-3, 0.64e-3
    critic      6, 8       10      0.6, 0.8    0.06, 0.08
    estimator   9, 12      15      0.6, 0.8    0.06, 0.08

    Adam's first direction is 1 up every slope. A sixteenth of these gradients, with norms of 5/16,
    10/16 and 15/16, is not clipped, and a tenth of 3/16 is 0.01875.
    """
    gradient = dict(actor=[3.0], log_std=[4.0], critic=[6.0, 8.0], estimator=[9.0, 12.0])
    gradient = {name: jnp.array(x) for name, x in gradient.items()}
    optimizer = ppo.optimizer(EIPO)
    step, state = optimizer.update(gradient, optimizer.init(gradient))
    mean, square = (optax.tree_utils.tree_get(state, name) for name in ("mu", "nu"))
    for each in ([*mean["actor"], *mean["log_std"]], [*mean["critic"]], [*mean["estimator"]]):
        assert each == pytest.approx([0.06, 0.08])
    assert [*square["actor"], *square["log_std"]] == pytest.approx([0.36e-3, 0.64e-3])
    assert [*step["actor"], *step["log_std"]] == pytest.approx([1.0, 1.0], rel=1e-4)
    small = {name: x / 16 for name, x in gradient.items()}
    mean = optax.tree_utils.tree_get(optimizer.update(small, optimizer.init(small))[1], "mu")
    assert [*mean["actor"], *mean["log_std"]] == pytest.approx([0.01875, 0.025])
    assert mean["critic"].tolist() == pytest.approx([0.0375, 0.05])
    assert mean["estimator"].tolist() == pytest.approx([0.05625, 0.075])


@pytest.mark.parametrize(
    "lr, kl, target_kl, then",
    [
        (3e-4, 0.0321, 1 / 64, 2e-4),  # beyond twice the target: 3e-4 / 1.5
        (3e-4, 0.0312, 1 / 64, 3e-4),  # 2/64 = 0.03125 is the bound
        (3e-4, 0.0079, 1 / 64, 3e-4),
        (3e-4, 0.0078, 1 / 64, 4.5e-4),  # below half of it, 0.0078125: 3e-4 * 1.5
        (1e-5, 9.0, 1 / 64, 1e-5),  # never below the lab's floor
        (1e-3, 0.0, 1 / 64, 1e-3),  # nor above the paper's step size
        (0.25, 9.0, 0.0, 0.25),  # without a target nothing changes
    ],
)
def test_algorithm1_line09_lr_follows_the_kl_of_an_iteration(lr, kl, target_kl, then):
    """D20: in a range of [1e-5, 1e-3]."""
    cfg = replace(EIPO, target_kl=target_kl)
    assert float(ppo.adapt_lr(jnp.float32(lr), kl, cfg)) == pytest.approx(then)


def test_algorithm1_line09_lr_is_the_learner_s_and_adapts_after_the_update():
    """lr = 0 goes nowhere. lr = 1e-5 moves the policy by hardly any KL: the next iteration has
    1.5e-5.
    """
    params, log, before = one_update(lr=0.0)
    assert trees_equal(params, before) and log["next_lr"] == 0
    log = one_update(lr=1e-5, cfg=replace(EIPO, target_kl=1 / 64))[1]
    assert (float(log["lr"]), float(log["next_lr"])) == pytest.approx((1e-5, 1.5e-5))


def test_algorithm1_line09_lr_follows_the_mean_kl_of_the_minibatches():
    """One action of 128 is 6 times likelier by now. It is in one of two minibatches of 64:

    KL of it       (6 - 1 - log 6) / 64 = 3.208 / 64 = 0.0501
    KL of both     (0.0501 + 0) / 2                  = 0.0251
    lr stays       between 1/2 and 2 times the target of 1/64, 0.0078 and 0.0313

    By the greatest or the last KL lr would be 2e-5, by the least 4.5e-5. With lr = 3e-5 the policy
    hardly moves.
    """
    likelier = np.ones((8, 16), np.float32)
    likelier[1, 2] = 6
    log = one_update(lr=3e-5, cfg=replace(EIPO, target_kl=1 / 64), likelier=likelier)[1]
    assert float(log["kl"]) == pytest.approx(0.0251, abs=5e-4)
    assert float(log["next_lr"]) == pytest.approx(3e-5)


def test_algorithm1_line09_ppo_skips_a_minibatch_that_is_not_finite():
    """One nan among the samples is in one of the two minibatches of each of the 4 epochs."""
    target = np.zeros((8, 16, 2), np.float32)
    target[1, 2, 0] = np.nan
    params, log, before = one_update(target=target)
    assert log["skipped"] == 4
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(params))
    assert not trees_equal(params["critic"], before["critic"])
