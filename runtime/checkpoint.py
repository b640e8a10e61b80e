"""checkpoint.npz: all that the next iteration depends on, and the settings to go on with."""

import json
from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np

import eipo
from runtime import jax_setup, robot, run_folder


def saved(env):
    """The arrays on which the next step of a Go1Env depends, by name."""
    return vars(env.state) | dict(rng=np.array(json.dumps(env.rng.bit_generator.state)))


def restore_env(env, arrays):
    """Put back what `saved` returned, so that env goes on with the same bits."""
    for name, x in vars(env.state).items():
        x[:] = arrays[name]
    env.batch.set_const()  # what MuJoCo derives from the masses
    env.rng.bit_generator.state = json.loads(str(arrays["rng"]))


def save(path, state, envs, cfg):
    """Write the State, the environments and the settings."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    arrays = {"state" + jax.tree_util.keystr(key): np.asarray(leaf) for key, leaf in leaves}
    for i, env in enumerate(envs):
        arrays |= {f"env{i}.{name}": x for name, x in saved(env).items()}
    settings = dict(env=asdict(envs[0].env_cfg), learner=asdict(cfg), robot=robot.digest())
    settings |= dict(jax=jax_setup.configuration() | jax_setup.numerics())
    arrays["settings"] = np.array(json.dumps(settings))
    run_folder.replace_file(path, lambda file: np.savez(file, **arrays))


def load_settings(path):
    """Both Configs of a checkpoint, and what JAX computed with, as `save` has it."""
    arrays = run_folder.read_npz(path)
    with run_folder.reading(path):
        kept = json.loads(str(arrays["settings"]))
        env_cfg = run_folder.read_config(kept["env"])
        cfg = run_folder.config_of(eipo.Config, kept["learner"])
        robot.refuse_other_digest(path, kept["robot"])
        return env_cfg, cfg, kept["jax"]


def load(path, template, envs):
    """The State in a checkpoint, of the same shape as template; envs are restored in place."""
    arrays = run_folder.read_npz(path)

    def restore(key, like):
        found = arrays["state" + (name := jax.tree_util.keystr(key))]
        if found.shape != np.shape(like):
            raise ValueError(f"{name} has the shape {found.shape}, and not {np.shape(like)}")
        return found.item() if isinstance(like, int | float) else jnp.asarray(found)

    with run_folder.reading(path):
        state = jax.tree_util.tree_map_with_path(restore, template)
        for i, env in enumerate(envs):
            restore_env(env, {x: arrays[f"env{i}.{x}"] for x in (*vars(env.state), "rng")})
    return state
