"""Settings: those of the paper, and those that are beyond their limits or do not fit together."""

from pathlib import Path

import numpy as np
import pytest
from support import error_of

import eipo
import evaluate
import go1_env
import rewards
import tasks
import terrain
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


@pytest.mark.parametrize(
    "given, says",
    [
        ("--lam 0", "lam is 0"),
        ("--lr 0.01", "--target-kl 0"),
        ("--hidden 8 3", "odd"),
        ("--num-envs 3", "multiple of 2"),
        ("--num-envs 2 --num-steps 1 --num-minibatches 2", "--num-minibatches"),
    ],
)
def test_what_does_not_fit_is_one_line_and_leaves_nothing_behind(tmp_path, capsys, given, says):
    assert says in error_of(capsys, train.main, *given.split(), "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("given", ["--num-envs many", "--iter 2", "--friction 1"])
def test_flags_that_do_not_parse_are_one_line(capsys, given):
    with pytest.raises(SystemExit, match="2"):
        train.main(given.split())
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("train.py: ") and given.split()[0] in line


def test_settings_of_ppo_are_checked_as_ppo():
    """One policy takes an odd number of environments, and one sample per minibatch is enough."""
    few = dict(algo="ppo", num_envs=3, num_steps=1)

    def check(**settings):
        flags.check(Options(), tasks.Config(), eipo.Config(**settings))

    check()
    check(**few, num_minibatches=3)
    with pytest.raises(Refused, match="--num-minibatches"):
        check(**few, num_minibatches=4)


# ---- limits of numbers ----


def test_limits_are_of_numbers():
    """A row that no field has would limit nothing."""
    assert flags.LIMITS.keys() <= flags.limits().keys()


SENSELESS = """
--threads 0
--checkpoint-every 0
--checkpoint-every -1
--history 0
--episode-steps 0
--command-steps 0
--timestep 0
--timestep -0.005
--timestep nan
--timestep 0.03
--physics-steps 0
--physics-steps 101 --clock-hz 0
--clock-hz nan
--clock-hz -1
--clock-hz 50
--action-limit 0
--noise -1
--noise inf
--roughness -0.05 0.05
--roughness 0.15 0.05
--roughness 0 nan
--cells-per-m 0
--cells-per-m 11
--cells-per-m 20
--ground-seed -1
--ground-seed 4294967296
--start-spread nan
--start-spread -0.5
--tiles 0
--friction -1 0
--friction 0 1
--friction 1.25 0.5
--payload -20 -15
--payload -6 -6
--payload -5.56 0
--com nan 0
--com 0.1 0
--motor-strength 0 1
--motor-strength 1 inf
--motor-offset 0 nan
--gravity -10 0
--gravity -1e1 0.
--latency -1
--max-power 0
--max-power nan
--max-power -inf
--num-epochs 0
--num-epochs 1000000000000
--num-minibatches 0
--lr 0 --target-kl 0
--lr inf --target-kl 0
--lr nan
--target-kl -0.01
--gamma nan
--gamma 1.5
--gamma -0.1
--gae-lambda 1.01
--clip-eps -0.1
--clip-eps 0
--ent-coef -0.01
--max-grad-norm 0
--reward-scale 0
--log-std 1.5
--log-std nan
--hidden 0
--hidden 64 0 64
--hidden-estimator -2
--lam -1
--lam -1 --algo ppo
--lam inf
--lam 1e-300
--lam 1e-300 --algo ppo
--seed -1
--seed 4294967296
--num-envs 0
--num-envs -4
--num-envs 5000000000
--iterations 0
--iterations -1
--num-steps 0
--lr-alpha nan
--lr-alpha -0.1
--clip-alpha 0
--momentum-alpha 1.5
--momentum-alpha 1
""".strip().splitlines()


def of_the_trunk(given):
    """A case, of the Go1 if a trunk of another mass would decide otherwise."""
    return pytest.param(given, marks=pytest.mark.go1) if "--payload -" in given else given


@pytest.mark.parametrize("given", [of_the_trunk(x) for x in SENSELESS])
def test_a_senseless_number_is_one_line_and_leaves_nothing_behind(
    tmp_path, capsys, monkeypatch, given
):
    """It names the flag and the first number that is wrong, before anything is simulated."""
    monkeypatch.setattr(train, "make_envs", None)
    line = error_of(capsys, train.main, *given.split(), "--out", tmp_path / "run")
    assert line.startswith(f"train.py: {given.split()[0]} is ")
    assert not (tmp_path / "run").exists()


@pytest.mark.go1
def test_a_line_says_what_a_number_may_be(capsys, tmp_path):
    says = {
        "--checkpoint-every 0": "--checkpoint-every is 0: it must be at least 1 and at most 10",
        "--momentum-alpha 1.5": "--momentum-alpha is 1.5: it must be at least 0 and below 1",
        "--friction 0.5 nan": "--friction is nan: it must be at least 0.001 and at most 100",
        "--com 0.1 -0.1": "--com is 0.1 -0.1: the lower end comes first",
        "--payload -20 -15": "--payload is -20.0: the trunk has 5.56 kg",
        "--log-std 2": "--log-std is 2.0: it must be at least -4.0 and at most 1.0",
    }
    for given, line in says.items():
        assert line in error_of(capsys, train.main, *given.split(), "--out", tmp_path / "run")


SOUND = """
--threads 64
--checkpoint-every 1000000000
--history 1
--episode-steps 1
--episode-steps 1000000000000 --command-steps 1000000000000
--timestep 0.001 --physics-steps 20
--timestep 0.02 --physics-steps 1
--clock-hz 0
--clock-hz 25
--action-limit 1000000
--noise 0
--noise 10
--roughness 0 0
--roughness 0.15 0.15 --cells-per-m 10
--cells-per-m 1 --tiles 1
--ground-seed 4294967295
--start-spread 0
--friction 0.01 0.01
--friction 2 5
--payload -5 20
--com -0.1 -0.1
--com -1. -1e-2
--motor-strength 0.001 10
--motor-offset -0.5 -0.2
--gravity -9 9
--latency 0
--latency 100
--max-power inf
--max-power 0.5
--num-minibatches 1 --num-epochs 1
--lr 1e-9 --target-kl 0
--lr 0.1 --target-kl 0
--target-kl 100
--gamma 0
--gamma 1 --gae-lambda 1
--gae-lambda 0
--clip-eps 5
--ent-coef 0
--max-grad-norm 1000000000
--reward-scale 1
--log-std -4
--log-std 1
--hidden 1 --hidden-estimator 1 --no-mirror
--hidden 2 2 2 2 2 2
--lam 0 --algo ppo
--lam 1e-9
--lam 1000
--seed 0
--seed 4294967295
--num-envs 2
--num-envs 1 --algo ppo
--iterations 1
--iterations 1000000000000
--num-steps 1
--lr-alpha 0
--lr-alpha 1000
--clip-alpha 1000
--momentum-alpha 0
--momentum-alpha 0.999999
""".strip().splitlines()


def test_a_run_that_goes_on_is_checked_as_well(capsys, monkeypatch):
    was = tasks.Config(), eipo.Config(gamma=1.5), None, None
    monkeypatch.setattr(start.checkpoint, "load_settings", lambda *_: was)
    monkeypatch.setattr(start.run_folder, "starts", lambda *_: [])
    assert "--gamma is 1.5" in error_of(capsys, train.main, "--resume")
    assert "--threads is 0" in error_of(capsys, train.main, "--resume", "--threads", "0")


@pytest.mark.parametrize(
    "given", [f"--task {task}" for task in tasks.TASKS] + [of_the_trunk(x) for x in SOUND]
)
def test_what_is_extreme_has_its_sense(given):
    options, *settings = parse(given.split())
    flags.check(Options(**options), *settle(*settings))


def test_code_may_do_what_it_likes():
    """Exercise 1 of the tutorial: the printed sign is a negative step of alpha."""
    dual = eipo.step_alpha(eipo.Dual(2.0, 0.0), 0.5, eipo.Config(lr_alpha=-1.0))
    assert dual == eipo.Dual(2.5, -0.5)


@pytest.mark.parametrize("cells_per_m", range(1, 11))
def test_a_ground_of_any_cells_is_as_rough_as_asked(cells_per_m):
    """Points of the ground are 0.05 m apart. With 20 cells per metre all are corners of cells,
    where Perlin noise is 0, and with more than 10 some cells have no point of their own.
    """
    assert flags.LIMITS["cells_per_m"] == {"at least": 1, "at most": 10}
    ground = terrain.make_ground([0.1, 0.1], 3, cells_per_m)
    assert np.ptp(ground) > 0.09 and np.isfinite(ground).all()


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


@pytest.mark.parametrize(
    ("given", "says"), [("--hidden-estimator 8 3", "odd"), ("--lr 1e-6", "--target-kl 0")]
)
def test_what_cannot_be_halved_or_adapted_is_refused(given, says):
    options, *settings = parse(given.split())
    with pytest.raises(Refused, match=says):
        flags.check(Options(**options), *settle(*settings))


def test_help_says_each_default(capsys):
    with pytest.raises(SystemExit, match="0"):
        train.main(["-h"])
    text = " ".join(capsys.readouterr().out.split())
    assert "(default: 256, velocity 128)" in text
    assert "(default: 5, flat 5, rough 10, velocity 10, curriculum 5)" in text


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
    names = ("performance", "fell", "v_x", "peak", "power", "asked_v_x")
    played = dict.fromkeys(names, asked[:, 0]) | dict(power=np.full(11, 100.0))
    assert evaluate.numbers(played)["v_x"] == pytest.approx(-0.5)
    assert evaluate.numbers(played | dict(v_x=np.full(11, -0.5)))["J/m"] == pytest.approx(200)
