"""What XLA compiles gives the numbers of the same code without it, and takes no products from a
library that was seen to get them wrong.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support import EIPO

import eipo
import go1_env
import ppo
import tasks


def draw(rng, *shape):
    return rng.normal(size=shape).astype(np.float32)


def learner_of(cfg, **fields):
    """A random Learner for flat ground, and the widths of obs, privileged and action."""
    env = go1_env.Go1Env(1, tasks.task_config(**fields), threads=1)
    pi = ppo.init_learner(np.random.default_rng(0), env, 2, True, cfg)
    return pi, (env.obs_size, env.privileged_size, env.action_size)


# ---- jaxlib 0.10.2 has wrong numbers in some programs above 32,768 rows (jax issue 39103) ----

T, N = 24, 4096  # 98,304 rows


@pytest.fixture(scope="module", params=[(16, 8), pytest.param(None, marks=pytest.mark.slow)])
def sides(request):
    """Pairs (compiled, eager) of the estimate of a rollout, and of the loss's gradient and log.

    The second time everything is as wide as on the flat task, which takes a minute.
    """
    widths = dict(hidden=request.param, hidden_estimator=(8,)) if request.param else {}
    cfg = ppo.PPOConfig(**widths)
    pi, sizes = learner_of(cfg, **dict(history=1) if request.param else {})
    rng = np.random.default_rng(0)
    obs, privileged, action = (draw(rng, T, N, n) for n in sizes)
    next_obs, next_privileged = (draw(rng, T, N, n) for n in sizes[:2])
    log_prob, reward, cost, advantage = draw(rng, 4, T, N)
    ends = rng.random((2, T, N)) < 0.01
    results = log_prob, reward, cost, ends[0], ends[1] & ~ends[0]
    tau = eipo.Transition(obs, privileged, action, *results, next_obs, next_privileged)
    estimated = [eipo.estimate(pi, tau, 0.005, cfg)]
    with jax.disable_jit():
        estimated += [eipo.estimate(pi, tau, 0.005, cfg)]
    data = dict(obs=obs, privileged=privileged, action=action, advantage=advantage)
    data |= dict(target=estimated[1].target, log_prob=log_prob / 10 - 17)  # ratios around 1
    batch = {name: jnp.asarray(x).reshape(T * N, *x.shape[2:]) for name, x in data.items()}
    gradient = jax.grad(ppo.ppo_loss, has_aux=True)
    learned = [jax.jit(gradient, static_argnums=3)(pi.params, batch, pi.bases, cfg)]
    with jax.disable_jit():
        learned += [gradient(pi.params, batch, pi.bases, cfg)]
    return estimated, learned


def test_compiled_is_eager_with_4096_robots(sides):
    """To 1e-5 of the largest number of each array, at 24 x 4096 = 98,304 rows."""
    for compiled, eager in sides:
        leaves = zip(jax.tree.leaves(compiled), jax.tree.leaves(eager), strict=True)
        for now, wanted in leaves:
            scale = np.abs(wanted).max(initial=0)
            np.testing.assert_allclose(now, wanted, rtol=0, atol=1e-5 * scale)


# ---- YNNPACK (runtime/__init__.py) ----


def compiled_update():
    """An update of a policy, as XLA compiles it for this processor, as text."""
    cfg = EIPO.ppo
    pi, sizes = learner_of(cfg, history=1)
    rng = np.random.default_rng(0)
    data = {
        name: draw(rng, 8, 16, n)
        for name, n in zip(("obs", "privileged", "action"), sizes, strict=True)
    }
    data |= dict(log_prob=draw(rng, 8, 16), target=draw(rng, 8, 16, 2), advantage=draw(rng, 8, 16))
    minibatches = ppo.shuffled(jax.random.PRNGKey(0), 8 * 16, cfg)
    return ppo.ppo_epochs.lower(pi, data, minibatches, cfg).compile().as_text()


def test_products_are_not_ynnpack_s():
    text = compiled_update()
    assert "dot(" in text and "__ynn_fusion" not in text
