"""Section IV-C: actor, critic and estimator, the robot's left and right (D28), and the PPO that
trains them.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import optax
import pytest
from support import EIPO, NOMINAL, dyadic, handmade, make, plain, trees_equal

import eipo
import energy
import go1
import networks
import ppo
from eipo import Rollout
from networks import Mirror, reflect

KEY = jax.random.key(0)
policy = jax.jit(networks.policy)

# ---- IV-C.b: the networks ----


def test_networks_elu_between_the_layers_only():
    """One unit: ELU(2) = 2, ELU(-1) = 1/e - 1; a lone layer stays linear: 3 (-1) + 1 = -2."""
    unit, none = plain([[1.0]]), jnp.zeros((2, 0))
    hidden, _ = networks.mlp([unit, unit], jnp.array([[2.0], [-1.0]]), none)
    assert hidden.ravel().tolist() == pytest.approx([2, -0.63212056])
    assert networks.mlp([plain([[3.0]], jnp.ones(1))], jnp.array([-1.0]), none[0])[0].tolist() == [
        -2
    ]


def test_networks_init_range():
    """Uniform in +- 1 / sqrt(fan-in), which a product has for itself: 16 even inputs, +- 1/4; 4 odd
    ones, +- 1/2.

    17 * 64 and 4 * 256 draws come within 1 % of both ends.
    """
    first, last = jax.jit(networks.init_mlp, static_argnums=1)(KEY, ((16, 4), (64, 256), (4, 0)))
    assert [x.shape for x in (*first, *last)] == [
        (16, 64),
        (4, 256),
        (64,),
        (64, 4),
        (256, 0),
        (4,),
    ]
    for x, end in ((np.concatenate([first.even, first.bias[None]]), 0.25), (first.odd, 0.5)):
        assert (
            -end <= x.min() < -0.99 * end
            and 0.99 * end < x.max() <= end
            and abs(x.mean()) < 0.08 * end
        )
    assert abs(last.even).max() <= 0.125


def test_networks_who_sees_what():
    """The actor sees its estimate 2 obs: obs + 8 (2 obs) = 17 obs. The critic sees the truth: obs +
    8 privileged.

    obs = 3, privileged = 5: mean 51, estimate 6, value 3 + 40 = 43.
    """
    params = handmade(critic=((1.0,), (8.0,)), estimator=((2.0,),), actor=((1.0,), (8.0,)))
    mean, std, estimate = policy(params, jnp.array([3.0]))
    assert (mean.tolist(), std.tolist(), estimate.tolist()) == ([51], [1], [6])
    assert networks.value(params, jnp.array([3.0]), jnp.array([5.0])).tolist() == [43]


def test_networks_noise():
    """log_std = -1: the noise is exp(-1), the same for every observation."""
    params = handmade()
    params["actor"]["log_std"] = jnp.array([-1.0])
    assert policy(params, jnp.ones((2, 1)))[1] == pytest.approx(np.full((2, 1), 0.36787944))


def test_networks_log_prob():
    """Two independent normals at z = (0, 1), std = (1, 2): -0 - 1/2 - log 1 - log 2 - log(2 pi) =
    -3.0310242.
    """
    mean, std, action = jnp.array([3.0, 1.0]), jnp.array([1.0, 2.0]), jnp.array([3.0, 3.0])
    assert float(networks.log_prob(mean, std, action)) == pytest.approx(-3.0310242)


# ---- D28: the mirror, on physics ----


def reflected(x):
    """What go1.py makes of an array over the joints, (..., 12)."""
    return go1.MIRROR_SIGN * x[..., go1.MIRROR]


# what a mirror does to a position or a velocity; to a rate or a rotation, the opposite
TRUNK = np.array([1, -1, 1])
JOINTS = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]  # FL, FR, RL, RR for FR, FL, RR, RL
SIGNS = np.tile([-1, 1, 1], 4)  # hips


def mirrored(qpos, qvel):
    """A state seen in a mirror, without any of the project's matrices."""
    quaternion = qpos[3:7] * [1, -1, 1, -1]
    return (
        np.concatenate([TRUNK * qpos[:3], quaternion, SIGNS * qpos[7:][JOINTS]]),
        np.concatenate([TRUNK * qvel[:3], -TRUNK * qvel[3:6], SIGNS * qvel[6:][JOINTS]]),
    )


def some_state(rng, height):
    """A robot that is tilted and moves, its joints near the nominal pose: qpos, qvel."""
    qpos = np.concatenate(
        [[0, 0, height], [0.9, 0.3, -0.3, 0.1], NOMINAL + 0.1 * rng.normal(size=12)]
    )
    return qpos, 0.5 * rng.normal(size=18)


@pytest.fixture
def symmetric_robot():
    """The model without its small asymmetries: the trunk is heavier on its left, calves are all
    bent to the left.
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
    """A mirrored state under mirrored torques stays mirrored: half a second, fall and impact
    included.
    """
    rng, robots = np.random.default_rng(0), [mujoco.MjData(symmetric_robot) for _ in range(2)]
    start = some_state(rng, 0.4)
    for robot, state in zip(robots, (start, mirrored(*start)), strict=True):
        robot.qpos[:], robot.qvel[:] = state
    for _ in range(100):
        torque = rng.normal(size=12)
        robots[0].ctrl[:], robots[1].ctrl[:] = torque, reflected(torque)
        for robot in robots:
            mujoco.mj_step(symmetric_robot, robot)
    assert robots[0].ncon > 0
    for there, here in zip(
        mirrored(robots[0].qpos, robots[0].qvel), (robots[1].qpos, robots[1].qvel), strict=True
    ):
        np.testing.assert_allclose(here, there, atol=1e-9)


def test_mirror_of_the_nominal_pose_and_of_the_energy():
    """The pose is its own image; Eq. (9) charges mirrored torques and speeds alike if it clips
    power, not torque.
    """
    assert np.array_equal(reflected(NOMINAL), NOMINAL)
    assert np.array_equal(reflected(np.arange(12.0)), SIGNS * np.arange(12.0)[JOINTS])
    torque, qd = 8 * np.random.default_rng(0).normal(size=(2, 12))
    for clip, alike in (("power", True), ("torque", False)):
        costs = [
            energy.energy_cost(*pair, clip)
            for pair in ((torque, qd), (reflected(torque), reflected(qd)))
        ]
        assert (costs[0] == pytest.approx(costs[1])) == alike


def test_mirror_of_an_observation():
    """Two robots, one the other's image and half a period of the clock later: their observations
    are mirrored.

    The clock turns by 5e6 Hz * 4 ns = 1/50 in a control step, so that 25 steps are half a period.
    """
    env = make(2, timestep=1e-9, clock_hz=5e6)
    rng = np.random.default_rng(1)
    env.qpos[0], env.qvel[0] = state = some_state(rng, 1.0)
    env.qpos[1], env.qvel[1] = mirrored(*state)
    env.state.command[:], env.state.age[:] = [[0.5, 0.25, 1.0], [0.5, -0.25, -1.0]], [0, 25]
    action = rng.normal(size=12)
    for _ in range(5):
        obs, reward, _, _, info = env.step(
            np.stack([action, reflect(action, env.mirror["action"])])
        )
    np.testing.assert_allclose(obs[1], reflect(obs[0], env.mirror["obs"]), atol=1e-5)
    there = reflect(info["privileged"][0], env.mirror["privileged"])
    np.testing.assert_allclose(info["privileged"][1], there, atol=1e-6)
    assert reward[0] == pytest.approx(reward[1])


# ---- D28: the networks that keep to it ----


def test_even_odd_by_hand():
    """(a, b, c, d) -> (b, a, -c, d): even (a + b) / sqrt 2 and d; odd (a - b) / sqrt 2 and c.

    With a = 3, b = 1: 4 / sqrt 2 = 2 sqrt 2, and 2 / sqrt 2 = sqrt 2.
    """
    mirror = (1, 0, 2, 3), (1, 1, -1, 1)
    x = jnp.array([3.0, 1.0, 5.0, 7.0])
    even, odd = networks.even_odd(x, mirror)
    assert even.tolist() == pytest.approx([2 * 2**0.5, 7])
    assert odd.tolist() == pytest.approx([2**0.5, 5])
    assert networks.joined(even, odd, mirror).tolist() == pytest.approx([3, 1, 5, 7])
    assert [part.tolist() for part in networks.even_odd(x, None)] == [[3, 1, 5, 7], []]
    assert networks.widths(4, mirror) == (2, 2) and networks.widths(4, None) == (4, 0)


def test_even_odd_of_the_robot():
    """5 frames of 21 even and 23 odd entries, a velocity of 2 and 1, 6 pairs of joints. A pair with
    a changed sign, the hips: even (a - b) / sqrt 2, which M keeps.
    """
    mirror = make().mirror
    sizes = [networks.widths(len(m[0]), m) for m in mirror.values()]
    assert sizes == [(5 * 21, 5 * 23), (2, 1), (6, 6)]
    hips = jnp.zeros(12).at[:6].set(jnp.array([3.0, 0, 0, 1.0, 0, 0]))
    even, odd = networks.even_odd(hips, mirror["action"])
    assert (even[0], odd[0]) == (pytest.approx(2**0.5), pytest.approx(2 * 2**0.5))
    for m in mirror.values():
        x = jax.random.normal(KEY, (3, len(m[0])))
        np.testing.assert_allclose(networks.joined(*networks.even_odd(x, m), m), x, atol=1e-6)


def test_sample_is_the_mean_and_noise_of_every_joint():
    """Standard deviations 1, 2 and 1 / 2 of hip, thigh and calf, right and left: 4,000 draws
    have them within 5 %, whatever the mirror does to the coordinates in which they are drawn.
    """
    env, params = new_policy()
    params["actor"]["log_std"] = np.float32(np.log([1, 2, 0.5, 1, 2, 0.5]))
    obs = np.repeat(env.reset(0)[0][:1], 4000, 0)
    drawn = networks.sample(params, obs, KEY)
    mean, _, _ = policy(params, obs[:1])
    np.testing.assert_allclose(np.std(drawn, 0), np.tile([1, 2, 0.5], 4), rtol=0.05)
    np.testing.assert_allclose(np.mean(drawn, 0), mean[0], atol=0.15)
    correlation = np.corrcoef(np.asarray(drawn).T)
    assert np.abs(correlation - np.eye(12)).max() < 0.1


def test_mirrored_layer_by_hand():
    """One pair of units, even weight 2, odd weight 4, bias 1, input even 1 and odd 1/2: coordinates
    3 and 2.

    These are sum and difference of the units over sqrt 2: right = 5 / sqrt 2, left = 1 / sqrt 2,
    both positive, so ELU keeps them. With an odd input of -1, 3 and -4: right = -1 / sqrt 2 becomes
    exp(right) - 1, left = 7 / sqrt 2.
    """
    layer = networks.Layer(jnp.array([[2.0]]), jnp.array([[4.0]]), jnp.array([1.0]))
    last = networks.Layer(jnp.eye(1), jnp.eye(1), jnp.zeros(1))
    even, odd = networks.mlp([layer, last], jnp.array([[1.0], [1.0]]), jnp.array([[0.5], [-1.0]]))
    right, left = (even + odd) / 2**0.5, (even - odd) / 2**0.5
    assert right.ravel() == pytest.approx([5 / 2**0.5, np.exp(-(0.5**0.5)) - 1], rel=1e-6)
    assert left.ravel() == pytest.approx([1 / 2**0.5, 7 / 2**0.5], rel=1e-6)


def new_policy(is_mirrored=True):
    """An environment and a policy for it, of which noise makes every weight count."""
    env, rng = make(8, noise=1.0), np.random.default_rng(0)
    cfg = replace(EIPO, hidden=(16, 8), hidden_estimator=(6, 4))
    sizes = env.obs_size, env.privileged_size, env.action_size
    mirror = Mirror(**env.mirror) if is_mirrored else None
    # nothing to compile
    shapes = jax.eval_shape(lambda key: ppo.init_learner(key, sizes, mirror, 2, cfg).params, KEY)
    params = jax.tree.map(lambda x: np.float32(rng.normal(size=x.shape) / 8), shapes)
    params["actor"]["log_std"] = np.arange(len(params["actor"]["log_std"])) / np.float32(8)
    return env, params


def test_a_mirrored_observation_gets_a_mirrored_action():
    """pi(M s) = M pi(s), V(M s) = V(s), estimate and noise mirrored as well; none of it by being 0.

    The density of an action is that of its mirror image: right and left are equally noisy.
    """
    env, params = new_policy()
    obs, info = env.reset(1)
    action = np.random.default_rng(0).normal(size=12).astype(np.float32)
    scene = dict(obs=obs, privileged=info["privileged"], action=action)

    def answers(obs, privileged, action):
        mean, std, estimate = policy(params, obs)
        value = networks.value(params, obs, privileged)
        return mean, estimate, value, networks.log_prob(mean, std, mean + action)

    mean, estimate, *even = answers(**scene)
    there = reflect(mean, env.mirror["action"]), reflect(estimate, env.mirror["privileged"]), *even
    image = answers(**{name: reflect(x, env.mirror[name]) for name, x in scene.items()})
    for here, expected in zip(image, there, strict=True):
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(here, expected, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize("is_mirrored", [True, False])
def test_dense_is_the_same_policy(is_mirrored):
    """Expanded to a plain MLP of the same widths, with twice the weights: same means, estimates and
    noise.
    """
    env, params = new_policy(is_mirrored)
    dense = networks.dense(params)
    assert [layer.even.shape for layer in dense["actor"]["layers"]] == [(223, 16), (16, 8), (8, 12)]
    obs, _ = env.reset(1)
    for here, there in zip(policy(params, obs), policy(dense, obs), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-5)
    if is_mirrored:  # FR hip and FL hip share a pair, and so on
        assert dense["actor"]["log_std"] == pytest.approx(
            np.tile(np.arange(6).reshape(2, 1, 3) / 8, (1, 2, 1)).ravel()
        )
    weights = [sum(x.size for x in jax.tree.leaves(p["actor"]["layers"])) for p in (params, dense)]
    assert weights[0] / weights[1] == pytest.approx(0.5 if is_mirrored else 1.0, abs=0.01)


# ---- IV-C.c: PPO, lines 9 and 11 ----


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected"),
    [(1.5, 1, 1.25), (0.5, 1, 0.5), (1.5, -1, -1.5), (0.5, -1, -0.75)],
)
def test_algorithm1_line09_ppo_clip_four_cases(ratio, advantage, expected):
    """eps = 1/4: the ratio counts up to 1.25 if the action was good, down to 0.75 if it was bad;
    never for free.
    """
    assert ppo.clipped_surrogate(ratio, advantage, 0.25) == expected


def test_algorithm1_line09_ppo_loss():
    """The action was likelier by 1.5 than when it was taken, and good: the surrogate counts 1 +
    0.2.

    obs = V = 1, target 3: (1 - 3)^2 = 4. The estimate is 0, the truth 1/2: 1/4. Entropy at std 1:
    1.4189385.
    Loss -1.2 - 0.01 * 1.4189385 + 4 + 1/4 = 3.0358106; KL 1.5 - 1 - log 1.5 = 0.0945349.
    """
    then = -0.91893853 - np.log(1.5)  # log density of a normal at its mean, less log 1.5
    batch = dict(obs=1.0, privileged=0.5, action=0.0, target=3.0)
    batch = {name: jnp.full((4, 1), x) for name, x in batch.items()} | dict(
        log_prob=jnp.full(4, then)
    )
    loss, log = ppo.ppo_loss(handmade(), batch | dict(advantage=jnp.ones(4)), EIPO)
    assert float(loss) == pytest.approx(3.0358106, rel=1e-6)
    assert float(log["kl"]) == pytest.approx(0.0945349, rel=1e-5)


def test_algorithm1_line09_ppo_loss_sums_over_outputs_and_averages_over_samples():
    """Two heads say V = (1, 1): targets (3, 2) cost 4 + 1 = 5, targets (1, 1) nothing: 5/2 a
    sample.

    The estimate is (0, 0, 0): truths (1, 1/2, 2) cost 1 + 1/4 + 4 = 21/4, truths (0, 0, 0) nothing,
    21/8 a sample. At A = 0 only the entropy is beside them: 5/2 + 21/8 - 0.01 * 1.4189385.
    """
    heads, none = [[1.0, 1.0], *[[0.0, 0.0]] * 3], [[0.0]] * 4
    params = handmade(critic=heads, estimator=[[0.0] * 3], actor=none)
    batch = dict(
        obs=jnp.ones((2, 1)),
        privileged=jnp.array([[1.0, 0.5, 2.0], [0.0, 0.0, 0.0]]),
        action=jnp.zeros((2, 1)),
        target=jnp.array([[3.0, 2.0], [1.0, 1.0]]),
        advantage=jnp.zeros(2),
        log_prob=jnp.full(2, -0.91893853),  # of a normal at its mean
    )
    loss, log = ppo.ppo_loss(params, batch, EIPO)
    assert (log["value_loss"], log["estimator_loss"]) == (5 / 2, 21 / 8)
    assert float(loss) == pytest.approx(5 / 2 + 21 / 8 - 0.014189385, rel=1e-6)


def advantages(seed):
    return dyadic(np.random.default_rng(seed), 8, 16)


def one_update(cfg=EIPO, lr=None, log_std=0.0, key=KEY, **changes):
    """One ppo_update of a new learner, always the same but for `changes` of target, advantage, obs
    or likelier: by which factor (8, 16) the actions are likelier than when they were taken.

    returns params, log, params before
    """
    learner = ppo.init_learner(KEY, (2, 1, 1), None, 2, EIPO)
    learner = learner._replace(lr=jnp.float32(cfg.lr if lr is None else lr))
    learner.params["actor"]["log_std"] += log_std
    rng = np.random.default_rng(2)
    obs, privileged, action, target = (dyadic(rng, 8, 16, width) for width in (2, 1, 1, 2))
    never, none = np.zeros((8, 16), bool), (obs[0, :0], privileged[0, :0])
    tau = Rollout(obs, privileged, action, target, never, never, (obs[0], privileged[0]), none)
    estimate = eipo.estimate(learner.params, tau, EIPO)._replace(
        target=changes.get("target", target)
    )
    if "likelier" in changes:
        then = estimate.log_prob - np.log(changes["likelier"])
        estimate = estimate._replace(log_prob=then.astype(np.float32))
    tau = tau._replace(obs=changes.get("obs", obs))
    before = jax.tree.map(np.array, learner.params)
    learner, log = ppo.ppo_update(
        learner, tau, estimate, changes.get("advantage", advantages(3)), key, cfg
    )
    return learner.params, log | dict(next_lr=learner.lr), before


@pytest.mark.parametrize(
    ("log_std", "std"), [(-10.0, 0.018), (10.0, 2.7), (-3.9, 0.020), (0.9, 2.5)]
)
def test_algorithm1_line09_ppo_keeps_the_noise_in_its_range(log_std, std):
    """D40: a standard deviation from 0.018 to 2.7. lr = 0 moves nothing but what is out of range.

    It is put back after the step, not in the forward pass: there it would stop the gradient that
    leads back.
    """
    assert float(
        jnp.exp(one_update(lr=0.0, log_std=log_std)[0]["actor"]["log_std"][0])
    ) == pytest.approx(std, rel=0.03)


def test_algorithm1_line09_ppo_normalises_the_advantage():
    """4 A + 1 has the mean 4 m + 1 and the deviation 4 s: normalised it is A again, so the update
    is the same one.

    A / 1024 as well, but for the 1e-8 beside its deviation. Without the division its surrogate
    would be nothing beside the entropy bonus of 1/100, whatever Adam and the clipping of gradients
    make of its scale.
    """
    usual = one_update()[0]
    assert trees_equal(usual, one_update(advantage=4 * advantages(3) + 1)[0])
    assert not trees_equal(usual, one_update(advantage=-advantages(3))[0])
    small = one_update(advantage=advantages(3) / 1024)[0]["actor"]["log_std"]
    assert float(small[0]) == pytest.approx(float(usual["actor"]["log_std"][0]), abs=1e-3)


def test_algorithm1_line09_ppo_shuffles_the_minibatches():
    """Another key draws other minibatches from the same data; the same key draws the same ones."""
    assert trees_equal(one_update()[0], one_update()[0])
    assert not trees_equal(one_update()[0], one_update(key=jax.random.key(1))[0])


def test_algorithm1_line09_ppo_trains_the_estimator_by_its_own_error_alone():
    """D19: other advantages train another actor; the estimator, and the critic, do not notice."""
    one, other = (one_update(advantage=advantages(seed))[0] for seed in (3, 4))
    assert not trees_equal(one["actor"], other["actor"])
    assert trees_equal([one["estimator"], one["critic"]], [other["estimator"], other["critic"]])


def test_algorithm1_line09_ppo_entropy_bonus_widens_the_noise():
    """Equal advantages normalise to 0, so that the bonus alone moves log_std: up, from 0."""
    assert one_update(advantage=np.ones((8, 16), np.float32))[0]["actor"]["log_std"] > 0


def test_algorithm1_line09_ppo_clips_gradients_per_network():
    """Targets of a million want a huge step of the critic; the other two networks do not notice."""
    usual, huge = one_update()[0], one_update(target=np.full((8, 16, 2), 1e6, np.float32))[0]
    assert trees_equal([usual["actor"], usual["estimator"]], [huge["actor"], huge["estimator"]])
    assert not trees_equal(usual["critic"], huge["critic"])


def test_algorithm1_line09_ppo_clips_the_norm_at_max_grad_norm():
    """Gradients (3, 4) of norm 5 and (3/8, 4/8) of norm 5/8: clipped to (0.6, 0.8), and untouched.

    Adam's mean starts at 1/10 of that, its mean square at 1/1000, and its first direction is 1 up
    every slope.
    """
    gradient = dict(
        actor=jnp.array([3.0, 4.0]), critic=jnp.array([0.375, 0.5]), estimator=jnp.zeros(2)
    )
    step, state = ppo.optimizer(EIPO).update(gradient, ppo.optimizer(EIPO).init(gradient))
    mean, square = (optax.tree_utils.tree_get(state, name) for name in ("mu", "nu"))
    assert mean["actor"].tolist() == pytest.approx([0.06, 0.08])
    assert mean["critic"].tolist() == pytest.approx([0.0375, 0.05])
    assert square["actor"].tolist() == pytest.approx([0.36e-3, 0.64e-3])
    assert step["actor"].tolist() == pytest.approx([1.0, 1.0], rel=1e-4)


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
def test_lr_follows_the_kl_of_an_iteration(lr, kl, target_kl, then):
    """D20: in a range of [1e-5, 1e-3]."""
    assert float(
        ppo.adapt_lr(jnp.float32(lr), kl, replace(EIPO, target_kl=target_kl))
    ) == pytest.approx(then)


def test_lr_is_the_learner_s_and_adapts_after_the_update():
    """lr = 0 goes nowhere. lr = 1e-5 moves the policy by hardly any KL: the next iteration has
    1.5e-5.
    """
    params, log, before = one_update(lr=0.0)
    assert trees_equal(params, before) and log["next_lr"] == 0
    log = one_update(lr=1e-5, cfg=replace(EIPO, target_kl=1 / 64))[1]
    assert (float(log["lr"]), float(log["next_lr"])) == pytest.approx((1e-5, 1.5e-5))


def test_lr_follows_the_mean_kl_of_the_minibatches():
    """One action of 128 is 6 times likelier by now: 6 - 1 - log 6 = 3.208 in a minibatch of 64,
    0.0501, and 0 in the other one; it meets either by chance. Their mean is 0.0251.

    Twice the target of 1/64 is 0.0313, half of it 0.0078: by the mean lr stays; by the greatest it
    would be 2e-5, by the least or the last 4.5e-5. With lr = 3e-5 the policy hardly moves.
    """
    likelier = np.ones((8, 16), np.float32)
    likelier[1, 2] = 6
    log = one_update(lr=3e-5, cfg=replace(EIPO, target_kl=1 / 64), likelier=likelier)[1]
    assert float(log["kl"]) == pytest.approx(0.0251, abs=5e-4)
    assert float(log["next_lr"]) == pytest.approx(3e-5)


def test_algorithm1_line09_ppo_skips_a_minibatch_that_is_not_finite():
    """One nan among the samples is in one of the two minibatches of every epoch: of 4 x 2 steps, 4
    are skipped.
    """
    target = np.zeros((8, 16, 2), np.float32)
    target[1, 2, 0] = np.nan
    params, log, before = one_update(target=target)
    assert log["skipped"] == 4
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(params))
    assert not trees_equal(params["critic"], before["critic"])


def test_algorithm1_line09_ppo_shuffles_anew_in_every_epoch():
    """D41. Two nans spoil one minibatch of an epoch, if they meet, or two. One order for all 4
    epochs: 4 or 8.
    """
    target = np.zeros((8, 16, 2), np.float32)
    target[[1, 6], [2, 9]] = np.nan
    assert 4 < one_update(target=target)[1]["skipped"] < 8


def test_algorithm1_line09_ppo_keeps_the_parameters_when_nothing_is_finite():
    """All 4 x 2 steps are skipped: what is left is what was there, bit by bit."""
    params, log, before = one_update(target=np.full((8, 16, 2), np.inf, np.float32))
    assert log["skipped"] == 8 and trees_equal(params, before)
    assert one_update()[1]["skipped"] == 0
