"""Between which values the settings of the world (`tasks.Config`) may lie, each with its reason; and the cores."""

import os

import tasks
import terrain

WORDS = dict(frame=("heading", "body"), clip=("torque", "power"), aux=("energy", "smooth"), reward=("paper", "shaped"))
LIMITS = {  # least and greatest value, or ends of a range, with unit and reason: no world beyond can be built or used
    "num_envs": (1, 2**16, ""),
    "threads": (1, 1024, ""),
    "history": (1, 100, ", because the matrix that mirrors it grows with its square"),
    "num_envs * history": (1, 2**19, ", because a rollout keeps so many frames for each of its steps"),
    "episode_steps": (1, 1e9, ""),
    "command_steps": (1, 1e9, ""),
    "timestep": (1e-9, 0.02, " s, because at 0.03 the motors' PD controllers blow up"),
    "physics_steps": (1, 100, ""),
    "clock_hz": (0, 1e9, " Hz"),
    "action_limit": (1e-9, 1e3, ""),
    "noise": (0, 100, ""),
    "roughness": (0, 1, " m, which is three times the height of the robot"),
    "cells_per_m": (1, 0.5 / terrain.SPACING, f" cells, because points of the ground are {terrain.SPACING} m apart"),
    "ground_seed": (0, 2**31 - 1, ""),
    "start_spread": (0, 10, ""),
    "tiles": (1, 1000, ", because that many take ten seconds to make"),
    "friction": (0, 1.5, ", because feet with more sink into the ground"),  # see test_no_foot_sinks_in (D24)
    "payload": (-4.9, 20, " kg, on a trunk of 5.6 kg"),
    "com": (-0.1, 0.1, " m"),
    "motor_strength": (0.01, 100, ""),
    "motor_offset": (-1, 1, " rad"),
    "gravity": (-5, 5, " m/s^2, so that things still fall"),
    "latency": (0, 1000, " physics steps"),
    "max_power": (1e-9, 1e6, " W"),
}


def check_world(num_envs, env_cfg, threads):
    """Raise ValueError, in one line, for settings from which no world can be built, or no useful one."""
    tasks.task_config(env_cfg.task)
    given = vars(env_cfg) | {"num_envs": num_envs, "num_envs * history": num_envs * env_cfg.history, "threads": threads}
    for name, choices in WORDS.items():
        if given[name] not in choices:
            raise ValueError(f"{name} is {given[name]!r}: it must be one of {', '.join(choices)}")
    for name, (low, high, why) in LIMITS.items():
        x, what = given[name], "a range, low end first, within" if isinstance(given[name], tuple) else "from"
        ends = x if isinstance(x, tuple) else (x, x)
        if x is not None and not (len(ends) == 2 and low <= ends[0] <= ends[1] <= high):  # nan as well
            raise ValueError(f"{name} is {x}: it must be {what} {low:g} to {high:g}{why}")


def cores():
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
