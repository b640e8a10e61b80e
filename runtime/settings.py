"""Whether the learner can train with its settings (`eipo.Config`), and how settings come back from JSON."""

from dataclasses import fields
from typing import get_args

from ppo import LOG_STD_RANGE, LR_RANGE


def check_learner(cfg, processes=1):
    """Raise ValueError, in one line, for an eipo.Config that cannot train, on so many processes."""
    policies, widths = 2 if cfg.algo == "eipo" else 1, cfg.hidden + cfg.hidden_estimator
    shares = policies * processes
    ranges = dict.fromkeys(("gamma", "gae_lambda", "momentum_alpha", "dampening_alpha"), (0, 1))
    ranges |= dict(lr_alpha=(0, 1e4), seed=(0, 2**31 - 1), log_std=LOG_STD_RANGE, num_epochs=(1, 1000))
    for field in fields(cfg):
        x, (low, high) = getattr(cfg, field.name), ranges.get(field.name, (int(field.type is int), 1e9))
        if type(x) in (int, float) and not low <= x <= high:  # nan as well
            raise ValueError(f"{field.name} is {x}: it must be from {low:g} to {high:g}")
    for wrong, message in (
        (cfg.algo not in ("eipo", "ppo"), f"unknown algo {cfg.algo!r}: choose eipo or ppo"),
        (not all(1 <= n <= 4096 for n in widths) or len(widths) > 8,  # of two policies, with Adam, they take 8 GB
         f"hidden layers are {cfg.hidden} and {cfg.hidden_estimator}: give at most 8, of 1 to 4096 units"),
        (cfg.mirror and any(n % 2 for n in widths), "a hidden layer of odd width has no halves: or give --no-mirror"),
        (cfg.target_kl and not LR_RANGE[0] <= cfg.lr <= LR_RANGE[1],
         f"lr is {cfg.lr}: with a target_kl it stays in {LR_RANGE[0]} to {LR_RANGE[1]}, give --target-kl 0"),
        (policies == 1 and cfg.alpha0 is not None, "PPO's alpha is 1 / lam: give --lam instead of alpha0"),
        (policies == 2 and cfg.lam == 0, "EIPO starts at alpha = 1 / lam, so lam must be positive: lam 0 is for ppo"),
        (cfg.num_envs % policies, f"num_envs is {cfg.num_envs}: EIPO gives half to each policy, so it must be even"),
        (cfg.num_envs % shares, f"num_envs is {cfg.num_envs}: {processes} processes have equal shares for each policy, "
                                f"so it must be a multiple of {shares}"),
        (cfg.num_steps * cfg.num_envs // shares < cfg.num_minibatches,
         "num_steps * num_envs gives each policy fewer samples than num_minibatches: raise num_envs"),
        (cfg.num_steps * cfg.num_envs > 2**21,  # a sample takes some kB
         f"num_steps is {cfg.num_steps} and num_envs {cfg.num_envs}: a rollout has at most {2**21} samples"),
    ):  # fmt: skip
        if wrong:
            raise ValueError(message)


def tuples(record):
    """The record with its lists turned back into tuples, which JSON does not have."""
    return {name: tuple(x) if isinstance(x, list) else x for name, x in record.items()}


def to_config(kind, record):
    """The dataclass `kind` of a record from JSON. TypeError for names and types that are not those of its fields."""
    config = kind(**tuples(record))
    for field in fields(kind):
        x, part = getattr(config, field.name), type(field.default[0]) if field.type is tuple else field.type
        kinds = get_args(part) or (part,)  # for `float | None` these are float and NoneType
        parts = x if field.type is tuple else (x,)
        if type(parts) is not tuple or not {type(y) for y in parts} <= {*kinds, *[int] * (float in kinds)}:
            what = "a list of " * (field.type is tuple) + " or ".join(k.__name__ for k in kinds)
            raise TypeError(f"{field.name} is {x!r}: it must be {what}")
    return config
