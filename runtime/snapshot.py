"""What a checkpoint stores of a `go1_env.Go1Env`: everything that its next step depends on."""

import json

import numpy as np


def save(env):
    """The arrays of env.state, copied, and its random generator, as a dict of arrays."""
    rng = np.array(json.dumps(env.rng.bit_generator.state))
    return {name: x.copy() for name, x in vars(env.state).items()} | dict(rng=rng)


def load(env, saved):
    """Let env continue from what `save` returned, with the same bits as if never stopped."""
    for name, x in vars(env.state).items():
        x[:] = saved[name]
    env.batch.set_const()  # what MuJoCo derives from the masses
    env.rng.bit_generator.state = json.loads(str(saved["rng"]))
