"""checkpoint.npz: all that the next iteration depends on, and the settings to go on with."""

import json
import os
from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np

import eipo
import tasks
from runtime import jax_setup, parallel, run_folder


def saved(env):
    """What a checkpoint stores of a Go1Env: all that its next step depends on, by name."""
    # padded, because `everyone` needs one length on all processes
    rng = np.array(json.dumps(env.rng.bit_generator.state), "U256")
    return vars(env.state) | dict(rng=rng)


def restore_env(env, arrays):
    """Let env continue from what `saved` returned, with the same bits as if never stopped."""
    for name, x in vars(env.state).items():
        x[:] = arrays[name]
    env.batch.set_const()  # what MuJoCo derives from the masses
    env.rng.bit_generator.state = json.loads(str(arrays["rng"]))


def save(path, state, envs, cfg):
    """Write the State, the settings, and the environments of every process, which all call this."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    arrays = {"state" + jax.tree_util.keystr(key): np.asarray(leaf) for key, leaf in leaves}
    for i, env in enumerate(envs):
        of_all = parallel.everyone({name: x[None] for name, x in saved(env).items()})
        for name, each in of_all.items():
            arrays |= {f"process{p}.env{i}.{name}": x for p, x in enumerate(each)}
    settings = dict(env=asdict(envs[0].env_cfg), learner=asdict(cfg))
    settings |= dict(jax_threads=os.environ.get(jax_setup.THREADS), processes=jax.process_count())
    arrays["settings"] = np.array(json.dumps(settings))
    if jax.process_index() == 0:
        run_folder.replace_file(path, lambda file: np.savez(file, **arrays))


def load_settings(path):
    """Both Configs of a checkpoint, the threads that JAX had, and the number of processes."""
    arrays = run_folder.read_npz(path)
    with run_folder.reading(path):
        kept = json.loads(str(arrays["settings"]))
        env_cfg, cfg = tasks.read_config(kept["env"]), tasks.tuples(kept["learner"])
        return env_cfg, eipo.Config(**cfg), kept["jax_threads"], kept["processes"]


def load(path, template, envs):
    """The State in a checkpoint, of the same shape as template; envs are restored in place.

    Of several processes each reads it, and restores its own environments.
    """
    process = jax.process_index()
    arrays = run_folder.read_npz(path)

    def restore(key, like):
        found = arrays["state" + (name := jax.tree_util.keystr(key))]
        if found.shape != np.shape(like):
            raise ValueError(f"{name} has the shape {found.shape}, and not {np.shape(like)}")
        return found.item() if isinstance(like, int | float) else jnp.asarray(found)

    with run_folder.reading(path):
        state = jax.tree_util.tree_map_with_path(restore, template)
        for i, env in enumerate(envs):
            prefix = f"process{process}.env{i}."
            restore_env(env, {x: arrays[prefix + x] for x in (*vars(env.state), "rng")})
    return state
