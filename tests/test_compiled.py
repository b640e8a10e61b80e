"""What XLA compiles gives the numbers of the same code without it, in sizes that more cores reach.

jaxlib 0.10.2 returns wrong numbers for some programs above 32,768 rows on CPUs (jax issue 39103).
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eipo
import go1_env
import ppo
import tasks
from networks import Mirror

T, N = 24, 4096  # 98,304 rows


@pytest.fixture(scope="module", params=[(16, 8), pytest.param(None, marks=pytest.mark.slow)])
def sides(request):
    """Pairs (compiled, eager) of the estimate of a rollout, and of the loss's gradient and log.

    The second time everything is as wide as on the flat task, which takes a minute.
    """
    widths = dict(hidden=request.param, hidden_estimator=(8,)) if request.param else {}
    cfg = eipo.Config(lam=0.005, num_envs=N, num_steps=T, **widths)
    history = dict(history=1) if request.param else {}
    env = go1_env.Go1Env(1, tasks.task_config("flat", **history), threads=1)
    sizes = env.obs_size, env.privileged_size, env.action_size
    rng = np.random.default_rng(0)

    def draw(*shape):
        return rng.normal(size=shape).astype(np.float32)

    params = ppo.init_learner(jax.random.key(0), sizes, Mirror(**env.mirror), 2, cfg).params
    obs, privileged, action = (draw(T, N, n) for n in sizes)
    ends = rng.random((2, T, N)) < 0.01
    tau = eipo.Rollout(
        obs=obs,
        privileged=privileged,
        action=action,
        reward=draw(T, N, 2),
        terminated=ends[0],
        truncated=ends[1] & ~ends[0],
        after=(draw(N, sizes[0]), draw(N, sizes[1])),
        final=(draw(N, sizes[0]), draw(N, sizes[1])),
    )
    gradient = jax.grad(ppo.ppo_loss, has_aux=True)
    estimated = [eipo.estimate(params, tau, cfg)]
    with jax.disable_jit():
        estimated += [eipo.estimate(params, tau, cfg)]
    data = dict(obs=obs, privileged=privileged, action=action, advantage=draw(T, N))
    data |= dict(target=estimated[1].target, log_prob=estimated[1].log_prob + 0.1 * draw(T, N))
    batch = {name: jnp.asarray(x).reshape(T * N, *x.shape[2:]) for name, x in data.items()}
    learned = [jax.jit(gradient, static_argnums=2)(params, batch, cfg)]
    with jax.disable_jit():
        learned += [gradient(params, batch, cfg)]
    return estimated, learned


def test_compiled_is_eager_with_4096_robots(sides):
    """To 1e-5 of the largest number of each array, at 24 x 4096 = 98,304 rows."""
    for compiled, eager in sides:
        leaves = zip(jax.tree.leaves(compiled), jax.tree.leaves(eager), strict=True)
        for now, wanted in leaves:
            scale = np.abs(wanted).max(initial=0)
            np.testing.assert_allclose(now, wanted, rtol=0, atol=1e-5 * scale)
