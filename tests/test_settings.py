"""Settings: those of the paper, and those that are beyond their limits or do not fit together."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from support import error_of

import eipo
import evaluate
import go1_env
import rewards
import tasks
import train
from runtime import flags, start
from runtime.cli import Refused
from runtime.flags import Options, parse, settle


@pytest.mark.parametrize(
    "task, history, roughness, cells_per_m, lam, iterations, step",
    [
        ("flat", 5, (0.0, 0.0), 4, 0.005, 600, (0.444, 0.933)),
        ("rough", 10, (0.0, 0.15), 1, 0.0002, 600, (0.444, 0.933)),
        ("velocity", 10, (0.05, 0.05), 4, 0.0002, 1000, (1.0, 0.9)),
    ],
)
def test_paper_settings_of_a_task(task, history, roughness, cells_per_m, lam, iterations, step):
    """V-A, V-B, V-D: H and the first lambda; IV-A: roughness in m; D22. D38: k = 4000 / 600 and
    10 000 / 1000; alpha's learning rate is 0.01 k^2 = 0.444 and 1, its momentum 1 - 0.01 k.

    All else of the world is as on flat ground, and whatever is given wins over the paper.
    """
    env_cfg, cfg = settle(dict(task=task), {})
    same = dict(task=task, history=history, roughness=roughness, cells_per_m=cells_per_m)
    assert env_cfg == tasks.task_config(task) == tasks.Config(**same)
    assert (cfg.lam, cfg.iterations, (cfg.lr_alpha, cfg.momentum_alpha)) == (lam, iterations, step)
    changed = dict(task=task, history=3, roughness=(0.0, 0.01), cells_per_m=2, noise=0.5)
    env_cfg, cfg = settle(changed, dict(lam=0.5))
    assert env_cfg == tasks.Config(**changed) and (cfg.lam, cfg.iterations) == (0.5, iterations)


def test_paper_settings_of_every_task():
    """IV-C: networks, 24 steps a rollout, 5 epochs, 4 minibatches, clipping; alpha's 0.01, 1
    and 0.99; V-A: 1000 steps. D5, D10: discount, GAE's lambda, PPO's clip range and the scale are
    the lab's. D20, D21, D39: Adam's step and the KL at which it aims, no entropy bonus, and noise
    with a deviation of exp(0) at the start.
    """
    cfg = eipo.Config()
    assert (cfg.hidden, cfg.hidden_estimator) == ((512, 256, 128), (256, 128))
    assert (cfg.num_steps, cfg.num_epochs, cfg.num_minibatches, cfg.max_grad_norm) == (24, 5, 4, 1)
    assert (cfg.lr_alpha, cfg.clip_alpha, cfg.momentum_alpha) == (0.01, 1, 0.99)
    assert (cfg.gamma, cfg.gae_lambda, cfg.clip_eps, cfg.reward_scale) == (0.99, 0.95, 0.2, 0.02)
    assert (cfg.lr, cfg.target_kl, cfg.ent_coef, cfg.log_std) == (3e-4, 0.03, 0, 0)
    assert evaluate.EPISODE_STEPS == 1000


@pytest.mark.parametrize("task, robots", [("flat", 256), ("rough", 256), ("velocity", 128)])
def test_our_settings_of_a_task(task, robots):
    """D29: episodes of 250 steps, a command for 125. D35: first episodes begin at random ages, and
    joints at 0.5 to 1.5 of the nominal angles. D34: the lab's noise. D3: our clip. D9: robots.
    D28: tied weights.
    """
    env_cfg, cfg = settle(dict(task=task), {})
    assert (env_cfg.episode_steps, env_cfg.command_steps) == (250, 125)
    assert (env_cfg.stagger, env_cfg.start_spread, env_cfg.noise) == (True, 0.5, 1.0)
    assert (env_cfg.clip, cfg.num_envs, cfg.mirror) == ("power", robots, True)


def test_paper_settings_of_curriculum():
    """IV-A.4 and V-E: ground up to 5 cm, a motor model, an end above 800 W, feet alone on the
    ground, five frames, lambda_0 = 0.005 and alpha's clock as on flat ground (D38). The lab's:
    30 ms of latency, and a command every ten of 20 s. What is randomised is in test_world.py.
    """
    env_cfg, cfg = settle(dict(task="curriculum"), {})
    assert (env_cfg.roughness, env_cfg.motor_model, env_cfg.max_power) == ((0, 0.05), True, 800)
    assert (env_cfg.history, cfg.lam, cfg.algo) == (5, 0.005, "eipo")
    assert (cfg.lr_alpha, cfg.momentum_alpha) == (0.444, 0.933)
    assert env_cfg.latency * env_cfg.timestep == 0.03
    assert (env_cfg.episode_steps, env_cfg.command_steps) == (1000, 500)
    assert tasks.TASKS["curriculum"].only_feet


@pytest.mark.parametrize("algo, robots", [("eipo", [4, 4]), ("ppo", [8])])
def test_policies_have_equal_shares_of_the_robots(algo, robots):
    """D9: EIPO and PPO simulate as many in all."""
    cfg = eipo.Config(algo=algo, num_envs=8)
    assert [env.num_envs for env in train.make_envs(tasks.Config(), cfg, 1)] == robots


def test_what_is_typed_is_read():
    """IV-A.4: the curriculum ends an episode at 800 W, unless told otherwise."""
    argv = "--max-power inf --friction 0.5 1 --hidden 8 --no-mirror --seed 0 --threads 2"
    options, world, learner = parse(argv.split())
    assert options == dict(threads=2)
    assert world == dict(max_power=np.inf, friction=(0.5, 1.0))
    assert learner == dict(hidden=(8,), mirror=False, seed=0)
    assert settle(dict(task="curriculum"), {})[0].max_power == 800.0
    assert settle(dict(task="curriculum") | world, {})[0].max_power == np.inf


@pytest.mark.parametrize("given", ["--num-envs many", "--iter 2", "--friction 1", "--out ''"])
def test_flags_that_do_not_parse_are_one_line(capsys, given):
    assert given.split()[0] in error_of(capsys, train.main, *shlex.split(given))


# ---- limits of numbers, and what does not fit together ----


def test_limits_are_of_numbers():
    """A row that no field has would limit nothing."""
    assert flags.LIMITS.keys() <= flags.limits().keys()


@pytest.mark.parametrize(
    "given",
    [
        "timestep 0", "timestep 0.03", "motor-strength 0 1", "action-limit 0", "clip-eps 0",
        "max-grad-norm 0", "reward-scale 0", "num-epochs 0", "num-minibatches 0",
    ],
)  # fmt: skip
def test_with_these_nothing_is_learned(given):
    options, *settings = parse(f"--{given}".split())
    with pytest.raises(Refused, match=f"^--{given.split()[0]} is "):
        flags.check(Options(**options), *settle(*settings))


def of_the_trunk(*case):
    """A case of the Go1: with a trunk of another mass it would be decided otherwise."""
    return pytest.param(*case, marks=pytest.mark.go1)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        # a limit of each kind: a type's own or another, open or closed, of a number or of several
        ("--checkpoint-every 0", "--checkpoint-every is 0: it must be at least 1 and at most 10"),
        ("--noise inf", "--noise is inf: it must be at least 0 and at most 1000000000"),
        ("--noise nan", "--noise is nan: it must be at least 0"),
        ("--clip-alpha 0", "--clip-alpha is 0.0: it must be at least 1e-09"),
        ("--momentum-alpha 1", "--momentum-alpha is 1.0: it must be at least 0 and below 1"),
        ("--max-power -inf", "--max-power is -inf: it must be above 0"),
        ("--log-std 2", "--log-std is 2.0: it must be at least -4.0 and at most 1.0"),
        ("--seed 4294967296", "at most 4294967295"),
        ("--cells-per-m 11", "at most 10"),
        ("--hidden 64 0 64", "--hidden is 0: it must be at least 1"),
        ("--friction 0.5 nan", "--friction is nan: it must be at least 0.001 and at most 100"),
        ("--gravity -1e1 0.", "--gravity is -10.0: it must be at least -9"),
        # a rule each
        ("--com 0.1 -0.1", "--com is 0.1 -0.1: the lower end comes first"),
        of_the_trunk("--payload -6 0", "--payload is -6.0: the trunk has 5.56 kg"),
        ("--physics-steps 101 --clock-hz 0", "of at most 0.5 s"),
        ("--clock-hz 50", "a clock of at most 25 Hz"),
        ("--lam 0", "--lam is 0: it must be at least 1e-09"),
        ("--lam 1e-300 --algo ppo", "--lam is 1e-300: it must be at least 1e-09"),
        ("--lr 0.01", "or give --target-kl 0"),
        ("--hidden-estimator 8 3", "is odd"),
        ("--num-envs 3", "a multiple of 2"),
        ("--num-envs 2 --num-steps 1", "a policy needs two samples"),
        ("--algo ppo --num-envs 3 --num-steps 1 --num-minibatches 4", "--num-minibatches is"),
    ],
)
def test_what_is_senseless_is_one_line_and_leaves_nothing_behind(tmp_path, capsys, given, says):
    line = error_of(capsys, train.main, *given.split(), "--out", tmp_path / "run")
    assert says in line and not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "given",
    [
        *[f"--task {task}" for task in tasks.TASKS],
        "--clock-hz 25 --max-power inf --com -1. -1e-2 --gravity -9 9 --seed 4294967295",
        "--timestep 0.02 --physics-steps 1 --lr 0.1 --target-kl 0 --gamma 1 --log-std -4",
        "--hidden 1 --hidden-estimator 1 --no-mirror --iterations 1000000000000 --lam 1e-9",
        "--algo ppo --lam 0 --num-envs 3 --num-steps 1 --num-minibatches 3",
        of_the_trunk("--payload -5 20"),
    ],
)
def test_what_is_extreme_has_its_sense(given):
    options, *settings = parse(given.split())
    flags.check(Options(**options), *settle(*settings))


def test_a_run_that_goes_on_is_checked_as_well(capsys, monkeypatch):
    was = tasks.Config(), eipo.Config(gamma=1.5), None
    monkeypatch.setattr(start.checkpoint, "load_settings", lambda *_: was)
    assert "--gamma is 1.5" in error_of(capsys, train.main, "--resume")
    assert "--threads is 0" in error_of(capsys, train.main, "--resume", "--threads", "0")


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("", "flat-eipo-lam0.005-seed0"),
        ("--aux smooth --seed 12", "flat-eipo-lam0.005-smooth-seed12"),
        (
            "--task curriculum --algo ppo --lam 0 --reward shaped",
            "curriculum-ppo-lam0-shaped-seed0",
        ),
    ],
)
def test_a_run_is_named_by_what_it_trains(given, name):
    options, *settings = parse(given.split())
    assert start.run_path(Options(**options), *settle(*settings)) == Path("runs") / name


def test_help_says_each_default(capsys):
    with pytest.raises(SystemExit, match="0"):
        train.main(["-h"])
    text = " ".join(capsys.readouterr().out.split())
    assert "(default: 256, velocity 128)" in text
    assert "(default: 5, flat 5, rough 10, velocity 10, curriculum 5" in text


# ---- a task of one's own ----


@pytest.mark.parametrize(
    ("greatest", "low", "high"),
    [
        ((1.0, 0.0, 0.0), [0, 0, 0], [1, 0, 0]),
        ((-1.0, 0, 0), [-1, 0, 0], [0, 0, 0]),
        ((0.5, -0.25, -2), [0, -0.25, -2], [0.5, 0, 0]),
    ],
)
def test_commands_lie_between_0_and_the_greatest(greatest, low, high):
    """Whatever its signs, and the viewer's sliders reach from the lower end to the upper one."""
    commands = tasks.Range(*greatest)
    drawn = commands.draw(np.random.default_rng(0), np.arange(1000))
    assert (commands.low.tolist(), commands.high.tolist()) == (low, high)
    assert drawn.min(0) == pytest.approx(low, abs=0.01) and (drawn >= low).all()
    assert drawn.max(0) == pytest.approx(high, abs=0.01) and (drawn <= high).all()
    assert commands.example.tolist() == list(greatest)


def test_a_task_may_go_backwards(monkeypatch):
    """It is simulated, and evaluated at 0, 0.1, ..., 1 m/s backwards. At 0.5 m/s, 100 W are 200
    J/m.
    """
    back = tasks.Task("walk back", rewards.curriculum, lambda: tasks.Range(-1.0, 0, 0), {}, {})
    monkeypatch.setitem(tasks.TASKS, "back", back)
    env = go1_env.Go1Env(8, tasks.task_config("back"), threads=1)
    env.reset(0)
    env.step(np.zeros((8, 12)))
    assert (env.state.command[:, 0] < 0).all() and (env.state.command[:, 1:] == 0).all()
    asked = evaluate.commands_of("back")
    assert asked[:, 0] == pytest.approx(-np.arange(11) / 10)
    names = ("score", "fell", "v_x", "peak", "power", "asked_v_x")
    played = dict.fromkeys(names, asked[:, 0]) | dict(power=np.full(11, 100.0))
    assert evaluate.numbers(played)["v_x"] == pytest.approx(-0.5)
    assert evaluate.numbers(played | dict(v_x=np.full(11, -0.5)))["J/m"] == pytest.approx(200)
