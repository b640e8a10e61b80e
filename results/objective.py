"""Which of our policies on `velocity` Eq. (2) prefers at each lambda: `python results/objective.py` prints a CSV.

The value of a policy is its task performance minus lambda times its power, both of episodes with random starts that
the folders in `velocity` keep. The bonus of Eq. (9) is left out, because it is the same for every robot that does not
fall. If PPO maximised Eq. (2), its own seeds would be as good as the best policy that any run has found.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from measure import Episodes
from studies import episodes, sweep


def kept(folder):
    """Task performance [-], power [W] and speed ahead [m/s] of each policy whose episodes are kept in a folder."""
    policies, columns = {}, (*episodes.ASKED, *Episodes._fields)
    for file in sorted(folder.glob("*/episodes.csv.gz")):
        table = dict(zip(columns, episodes.unpack(file).T, strict=True))
        mine = (table["start_spread"] > 0) & (table["torque_clip"] == 0)
        if mine.any():
            policies[file.parent.name] = [table[name][mine].mean() for name in ("performance", "power", "v_x")]
    return policies


def rows(policies):
    """A line for each lambda: the values of PPO's own seeds, then the best policy, its value, speed and power."""
    for lam in sweep.LAMBDAS:
        value = {name: performance - lam * power for name, (performance, power, _) in policies.items()}
        own = [f"{x:.3f}" for name, x in value.items() if name.startswith(f"velocity-ppo-lam{lam:g}-seed")]
        best = max(value, key=value.get)
        yield ",".join([f"{lam:g}", *own, best, f"{value[best]:.3f}", "{2:.2f},{1:.0f}".format(*policies[best])])


if __name__ == "__main__":
    print("lambda,seed 0,seed 1,seed 2,best,value,v_x,power")
    print(*rows(kept(Path(__file__).parent / "velocity")), sep="\n")
