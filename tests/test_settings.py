"""Settings: those of the paper, those that cannot be, and that the command line tells them apart in
one line.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from support import error_of, make, still

import eipo
import evaluate
import go1_env
import rewards
import tasks
import train
from runtime import flags
from runtime.flags import parse, settle


@pytest.mark.parametrize(
    "task, history, roughness, cells_per_m, lam, iterations",
    [
        ("flat", 5, (0.0, 0.0), 4, 0.005, 600),
        ("rough", 10, (0.0, 0.15), 1, 0.0002, 600),
        ("velocity", 10, (0.05, 0.05), 4, 0.0002, 1000),
    ],
)
def test_paper_settings_of_a_task(task, history, roughness, cells_per_m, lam, iterations):
    """V-A, V-B, V-D: H and the first lambda; IV-A: roughness in m; D22. D38: a tenth of the paper's
    4000 and 10 000.

    All else of the world is as on flat ground, and whatever is given wins over the paper.
    """
    env_cfg, cfg = settle(dict(task=task), {})
    same = dict(task=task, history=history, roughness=roughness, cells_per_m=cells_per_m)
    assert env_cfg == tasks.task_config(task) == tasks.Config(**same)
    assert (cfg.lam, cfg.iterations) == (lam, iterations)
    changed = dict(task=task, history=3, roughness=(0.0, 0.01), cells_per_m=2, noise=0.5)
    env_cfg, cfg = settle(changed, dict(lam=0.5))
    assert env_cfg == tasks.Config(**changed) and (cfg.lam, cfg.iterations) == (0.5, iterations)


def test_paper_settings_of_every_task():
    """IV-C: networks, 24 steps a rollout, 5 epochs, 4 minibatches, clipping; alpha's 0.01, 1
    and 0.99; V-A: 1000 steps.
    """
    cfg = eipo.Config()
    assert (cfg.hidden, cfg.hidden_estimator) == ((512, 256, 128), (256, 128))
    assert (cfg.num_steps, cfg.num_epochs, cfg.num_minibatches, cfg.max_grad_norm) == (24, 5, 4, 1)
    assert (cfg.lr_alpha, cfg.clip_alpha, cfg.momentum_alpha) == (0.01, 1, 0.99)
    assert evaluate.EPISODE_STEPS == 1000


def test_alpha_moves_by_at_most_50_in_an_iteration():
    """D38. Of gradients of 1 momentum adds up 1, 1.99, ... and 1 / (1 - 0.99) = 100 in the end,
    times a step of 0.5.
    """
    cfg = settle({}, {})[1]
    dual = eipo.Dual(200.0, 0.0)
    for alpha in (200.5, 201.495):
        dual = eipo.step_alpha(dual, -7.0, cfg)
        assert dual.alpha == pytest.approx(alpha, rel=1e-12)
    assert eipo.step_alpha(eipo.Dual(200.0, 100.0), -7.0, cfg) == pytest.approx(
        eipo.Dual(250.0, 100.0), rel=1e-12
    )


def test_alpha_takes_longer_steps_where_lambda_0_is_large():
    """D38. 0.5 where it is 0.005, and the paper's 0.01 where it is 0.0002, all with 0.99."""
    steps = {task: settle(dict(task=task), {})[1] for task in tasks.TASKS}
    steps = {task: (cfg.lr_alpha, cfg.momentum_alpha) for task, cfg in steps.items()}
    long, paper = (0.5, 0.99), (0.01, 0.99)
    assert steps == dict(flat=long, rough=paper, velocity=paper, curriculum=long)


def test_help_says_how_to_train_as_long_as_the_paper(capsys):
    """The numbers of V-A, V-D and IV-C stand beside ours, as flags that can be typed."""
    with pytest.raises(SystemExit):
        parse(["-h"])
    shown = " ".join(capsys.readouterr().out.split())
    typed = "--iterations 4000 --lr-alpha 0.01"
    assert typed in shown and "--iterations 10000" in shown
    cfg = settle(*parse(typed.split())[1:])[1]
    assert (cfg.iterations, cfg.lr_alpha, cfg.clip_alpha, cfg.momentum_alpha) == (
        4000,
        0.01,
        1,
        0.99,
    )


def test_none_switches_off_what_a_task_sets():
    """IV-A.4: the curriculum ends an episode at 800 W, unless told otherwise."""
    limits = [
        settle(*parse(["--task", "curriculum", *flags])[1:])[0].max_power
        for flags in ([], ["--max-power", "none"], ["--max-power", "700"])
    ]
    assert limits == [800.0, None, 700.0]


OUT_OF_RANGE = [
    # the learner's
    "--num-envs -4",
    "--num-envs 0",
    "--num-steps 0",
    "--num-epochs 0",
    "--iterations 0",
    "--seed -1",
    "--seed 5000000000",
    "--lam nan",
    "--lam -0.1",
    "--lam 0",
    "--lr inf",
    "--lr -1",
    "--lr 0.01",
    "--gamma 1.5",
    "--momentum-alpha 2",
    "--target-kl -1",
    "--clip-eps -0.2",
    "--lr-alpha -1",
    "--lr-alpha nan",
    "--lr-alpha 10001",
    "--alpha0 -1",
    "--log-std 2",
    "--hidden 1000000 1000000",
    "--hidden 64 64 64 64 64 64 64",
    "--num-steps 1000000",
    "--num-epochs 1000000000",
    # the world's
    "--task hover",
    "--history 0",
    "--episode-steps -5",
    "--command-steps 0",
    "--physics-steps 0",
    "--timestep 0",
    "--clock-hz inf",
    "--action-limit -10",
    "--max-power 0",
    "--noise nan",
    "--clip speed",
    "--friction 1.25 0.5",
    "--friction 0.5 inf",
    "--friction -0.5 0.5",
    "--friction 1",
    "--payload nan 1",
    "--roughness -0.05 0.05",
    "--roughness 0.15 0.05",
    "--roughness nan 0.15",
    "--roughness 0 inf",
    "--cells-per-m 0",
    "--tiles 0",
    "--motor-strength -1 -1",
    "--motor-strength 0 1",
    "--num-envs 100000",
    "--num-envs 1000000000000",
    "--history 1000",
    "--tiles 100000",
    "--physics-steps 1000000000",
    "--latency 1000000000",
    "--timestep 0.03",
    "--timestep 1",
    "--payload 1000 1000",
    "--roughness 0 1000000",
    "--com -1 1",
    "--motor-offset 0 7",
    "--gravity -20 0",
    "--noise 1000",
    "--noise inf",
    # the command's
    "--algo sac",
    "--checkpoint-every 0",
    "--threads -1",
    "--threads 0",
    "--threads 1000000",
]


@pytest.mark.parametrize("flags", OUT_OF_RANGE)
def test_bad_settings_are_one_line_and_leave_nothing_behind(tmp_path, capsys, flags):
    """It names the field and its value: a typo is found by reading the message."""
    flag, *values = flags.split()
    says = error_of(capsys, train.main, flag, *values, "--out", tmp_path / "run")
    assert flag[2:].replace("-", "_") in says and all(value in says for value in values)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "flags, says",
    [
        ("--hidden 8 0", "hidden"),
        ("--hidden-estimator -1", "hidden"),
        ("--hidden 8 3", "odd"),
        ("--num-envs 2 --num-steps 1 --num-minibatches 2", "num_minibatches"),
        ("--algo ppo --alpha0 100", "alpha0"),
        ("--payload -6 0", "trunk"),  # no mass would be left
        ("--num-envs 3", "even"),
        # fewer than 2 points per cell: the noise would not be seen
        ("--cells-per-m 11", "10 cells"),
        ("--friction 0.5 2", "1.5"),
        ("--task moon", "flat, rough, velocity, curriculum"),
        ("--num-envs 32768 --history 100", "num_envs * history"),  # 14 GB for a rollout
        ("--num-envs 4096 --num-steps 1000", "samples"),
    ],
)
def test_what_is_said_of_bad_settings(capsys, tmp_path, flags, says):
    assert says in error_of(capsys, train.main, *flags.split(), "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "flags", ["--num-envs many", "--threads many", "--speed 3", "--iter 2", "--lr"]
)
def test_flags_that_do_not_parse_are_one_line(capsys, flags):
    with pytest.raises(SystemExit, match="2"):
        train.main(flags.split())
    (line,) = capsys.readouterr().err.splitlines()
    assert flags.split()[0] in line


@pytest.mark.parametrize("flags", ["--hidden 64,64", "--friction 0.5,1", "--hidden 64, 64"])
def test_commas_between_numbers_are_one_line_that_wants_spaces(capsys, flags):
    with pytest.raises(SystemExit, match="2"):
        parse(flags.split())
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        flags.split()[0] in line and "spaces, as in " + flags.split()[1].replace(",", " ") in line
    )


def test_help_names_every_task_and_what_it_is(capsys, monkeypatch):
    """Also a fifth task, whose author has not said what it is."""
    monkeypatch.setitem(tasks.TASKS, "fifth", tasks.Task(rewards.flat, {}, {}))
    with pytest.raises(SystemExit, match="0"):
        parse(["-h"])
    usage, said = capsys.readouterr().out.split("\ntasks:\n")
    lines = [line.split(maxsplit=1) for line in said.split("\n\n")[0].splitlines()]
    assert lines == [
        [name, task.about] if task.about else [name] for name, task in tasks.TASKS.items()
    ]
    assert all(len(task.about) > 10 for name, task in tasks.TASKS.items() if name != "fifth")
    assert "flat|rough|velocity|curriculum" in usage


def test_every_number_of_the_world_has_limits():
    """A number without any would let a world be built that hangs, or fills the memory, or means
    nothing.
    """
    numbers = {field.name for field in fields(tasks.Config) if field.type not in (str, bool)}
    assert len(numbers) > 15
    assert set(flags.LIMITS) == numbers | {"num_envs", "threads", "num_envs * history"}


def test_a_physics_step_may_be_as_long_as_the_motors_stay_stable():
    """Joints of robots that settle move at less than 1 rad/s on average with 20 ms, and at 1000 and
    more with 40 ms.
    """
    speeds = []
    for timestep in (flags.LIMITS["timestep"][1], 0.04):
        env = make(16, physics_steps=1, timestep=0.02, task="rough", tiles=2)
        env.batch.expand("opt.timestep")[:] = timestep
        moving = []
        for _ in range(100):
            still(env)
            moving.append(np.abs(env.qvel[:, 6:]).mean())
        speeds.append(np.mean(moving))
    assert speeds[0] < 1 < 1000 < speeds[1]


@pytest.mark.parametrize(
    "fields",
    [
        dict(stagger=False),
        dict(noise=0.0),
        dict(clock_hz=0.0),
        dict(payload=(0.0, 0.0)),
        dict(roughness=(0.0, 0.0)),
        dict(roughness=(0.05, 0.05), cells_per_m=10),
    ],  # the finest
    ids=str,
)
def test_good_settings_of_the_world(fields):
    """The values that switch something off, or are just allowed, are no mistakes."""
    go1_env.Go1Env(1, tasks.Config(**fields))


def test_settings_of_ppo_are_checked_as_ppo():
    """An odd number of environments, and as few as one sample per minibatch, are enough for one
    policy.
    """
    few = eipo.Config(algo="ppo", num_envs=3, num_steps=1, num_minibatches=3)
    flags.check_learner(eipo.Config())
    flags.check_learner(few)
    with pytest.raises(ValueError, match="num_minibatches"):
        flags.check_learner(replace(few, num_minibatches=4))
