"""Which of our policies on `velocity` Eq. (2) prefers at each lambda: `python results/objective.py` prints a CSV.

The worth of a policy is its task performance minus lambda times its power, both of the episodes with random starts that
the folders in `velocity` keep. Runs of 1000 iterations with the power clip take part, and EIPO may have 256 robots. So
the best one proves that a better policy exists than PPO's own seeds have found. Performance counts the time after a
fall as 0, and power is a mean until then, without the bonus of Eq. (9). So robots that fall often are worth slightly
more or less than this says.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from measure import Episodes
from runtime import run_folder
from studies import episodes, sweep

ITERATIONS = 1000


def kept(folder):
    """Task performance [-], power [W] and speed ahead [m/s] of each policy whose episodes are kept in a folder."""
    policies, columns = {}, (*episodes.ASKED, *Episodes._fields)
    for file in sorted(folder.glob("*/episodes.csv.gz")):
        env_cfg, cfg = run_folder.load_config(file.parent)
        if (env_cfg.clip, cfg.iterations) == ("power", ITERATIONS):
            table = dict(zip(columns, episodes.unpack(file).T, strict=True))
            random = table["start_spread"] > 0
            policies[file.parent.name] = [table[name][random].mean() for name in ("performance", "power", "v_x")]
    return policies


def rows(policies):
    """A line for each lambda: the worths of PPO's own seeds, then the best policy, its worth, speed and power."""
    for lam in sweep.LAMBDAS:
        worth = {name: performance - lam * power for name, (performance, power, _) in policies.items()}
        own = [worth.get(f"velocity-ppo-lam{lam:g}-seed{seed}", float("nan")) for seed in range(sweep.SEEDS["table1"])]
        best = max(worth, key=worth.get)
        _, power, speed = policies[best]
        yield ",".join([f"{lam:g}", *(f"{x:.3f}" for x in own), best, f"{worth[best]:.3f},{speed:.2f},{power:.0f}"])


if __name__ == "__main__":
    print("lambda,seed 0,seed 1,seed 2,best,worth,v_x,power")
    print(*rows(kept(Path(__file__).parent / "velocity")), sep="\n")
