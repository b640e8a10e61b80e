"""The runs behind each figure and Table I: the `train.py` commands that are still to be given. Section IV-D, Eq. (10).

`python evaluate.py --commands table1` prints them, a line each, for xargs, GNU parallel or a SLURM array.
"""

import shlex
from dataclasses import asdict

import train

LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10)
EIPO = ("--algo", "eipo")
PPO = {lam: ("--algo", "ppo", "--lam", f"{lam:g}") for lam in LAMBDAS}
SWEEPS = dict(  # task, flags
    fig2=[("flat", flags) for flags in (EIPO, PPO[0.005], PPO[0])],
    fig3=[("rough", flags) for flags in (EIPO, PPO[0.005], PPO[0])],
    fig4=[(task, flags) for task in ("flat", "rough") for flags in (EIPO, *PPO.values())],
    fig5=[("curriculum", flags)
          for flags in (EIPO, (*EIPO, "--aux", "smooth"), PPO[0.005], (*PPO[0], "--reward", "shaped"))],
    fig6=[("velocity", flags) for flags in (EIPO, PPO[0.01])],
    table1=[("velocity", flags) for flags in (EIPO, *PPO.values())])  # fmt: skip


def commands(what, flags):
    """The train.py commands that a figure or the table still lacks, three seeds each; flags: to be added to each."""
    if what not in SWEEPS:
        raise ValueError(f"--commands takes one of {', '.join(SWEEPS)}, and flags of train.py")
    own = {"--task", "--algo", "--lam", "--seed", "--out", "--resume"}
    taken = [flag for flag in flags if flag.split("=")[0] in own]
    if taken:
        raise ValueError(f"--commands sets {taken[0]} itself")
    for task, setting in SWEEPS[what]:
        for seed in range(3):
            argv = ["--task", task, *setting, "--seed", str(seed), *flags]
            if (so_far := progress(argv)) != "done":
                yield shlex.join(["python", "train.py", *argv, *(["--resume"] if so_far else [])])


def progress(argv):
    """How far the run of these train.py arguments is: "", "started" or "done"."""
    options, given_env, given_learner = train.parse(argv)
    env_cfg, cfg = train.settle(given_env, given_learner)
    folder = train.run_path(train.Options(**options), env_cfg, cfg)
    if not (folder / "checkpoint.npz").exists():
        return ""
    train.settle_resumed(folder, asdict(env_cfg), asdict(cfg))  # raises if it is a run of other settings
    return "done" if len((folder / "metrics.csv").read_text().splitlines()) > cfg.iterations else "started"
