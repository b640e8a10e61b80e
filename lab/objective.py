"""Which of our policies on `velocity` Eq. (2) prefers at each lambda: `python -m lab objective
'results/velocity/*'` prints a CSV.

The worth of a policy is its task performance minus lambda times its power, both of kept episodes
with random starts. Runs of 1000 iterations with the power clip take part, and EIPO may have 256
robots. So the best one proves that a better policy exists than PPO's own seeds have found.
Performance counts the time after a fall as 0, and power is a mean until then, without the bonus of
Eq. (9). So robots that fall often are worth slightly more or less than this says.
"""

from lab import episodes, sweep
from runtime import run_folder

ITERATIONS = 1000


def kept(folders):
    """Task performance [-], power [W] and speed ahead [m/s] of each policy that takes part."""
    policies = {}
    for folder in folders:
        env_cfg, cfg = run_folder.load_config(folder)
        table = dict(
            zip(episodes.COLUMNS, episodes.read(folder / run_folder.EPISODES).T, strict=True)
        )
        random = table["start_spread"] > 0
        if (env_cfg.clip, cfg.iterations) == ("power", ITERATIONS) and random.any():
            names = "performance", "power", "v_x"
            policies[folder.name] = [table[name][random].mean() for name in names]
    return policies


def rows(policies):
    """A line for each lambda: the worths of PPO's own seeds, and the best policy of all."""
    for lam in sweep.LAMBDAS:
        worth = {
            name: performance - lam * power for name, (performance, power, _) in policies.items()
        }
        own = [
            worth.get(f"velocity-ppo-lam{lam:g}-seed{seed}", float("nan"))
            for seed in range(sweep.SEEDS["table1"])
        ]
        best = max(worth, key=worth.get)
        _, power, speed = policies[best]
        own = ",".join(f"{x:.3f}" for x in own)
        yield f"{lam:g},{own},{best},{worth[best]:.3f},{speed:.2f},{power:.0f}"


def lines(folders):
    """The lines of objective.csv."""
    return ["lambda,seed 0,seed 1,seed 2,best,worth,v_x,power", *rows(kept(folders))]
