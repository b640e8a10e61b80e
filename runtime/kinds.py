"""What runs are called in tables, figures and pictures: their kind, and what they share."""

from typing import NamedTuple


class Group(NamedTuple):
    """What runs must share to be compared: "flat, 600 iterations"."""

    task: str
    iterations: int

    def __str__(self):
        return f"{self.task}, {self.iterations} iterations"


class Kind(NamedTuple):
    """What runs that differ in no more than their seed are: "PPO(0.005)", "EIPO from 0.02"."""

    algo: str  # "eipo" or "ppo"
    lam: float  # the weight of PPO, or that from which EIPO starts
    aux: str = "energy"
    reward: str = "paper"
    other: tuple = ()  # words for further settings that are not the usual ones
    prime: bool = False  # pi' of a run of EIPO

    @property
    def is_plain(self):
        """Whether it has the paper's reward, Eq. (9) and the usual settings."""
        return (self.aux, self.reward, self.other) == ("energy", "paper", ())

    def __str__(self):
        name = f"PPO({self.lam:g})" if self.algo == "ppo" else f"EIPO from {self.lam:g}"
        name += "".join(f" {x}" for x in (self.aux, self.reward) if x not in ("energy", "paper"))
        name = ", ".join([name, *self.other])
        return f"pi' of {name}" if self.prime else name
