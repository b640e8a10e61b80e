"""evaluate.py: which episodes end in which cell of which CSV, and the commands of a sweep."""

import csv
import functools
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import eipo
import evaluate
import go1_env
import measure
import run_folder
import tasks
import train

ROOT = Path(train.__file__).parent
EQ_10 = [0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2]
TINY = ["--num-envs", "4", "--num-steps", "4", "--hidden", "8", "--hidden-estimator", "8", "--history", "2",
        "--iterations", "2", "--threads", "1"]  # fmt: skip


def make_run(folder, task, algo="eipo", lam=0.005, seed=0):
    """What training leaves for evaluate.py to read, without training."""
    env_cfg = tasks.task_config(task, history=2, tiles=2)
    cfg = eipo.Config(algo=algo, lam=lam, seed=seed, hidden=(8,), hidden_estimator=(8,))
    learner = eipo.init_learner(jax.random.key(seed), ((2 * go1_env.FRAME_WIDTH, 0), (3, 0), (12, 0)), 2, cfg)
    folder.mkdir()
    run_folder.save_config(folder, env_cfg, cfg, [])
    run_folder.save_policy(folder / "policy.npz", learner.params, env_cfg)
    return str(folder)


@pytest.fixture(scope="module", autouse=True)
def short_episodes():
    """An evaluation plays 16 steps, 0.32 s, instead of the paper's 1000."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "EPISODE_STEPS", 16)
        yield


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Run folders by task and name; those of PPO come first, and not in order, so that evaluate.py has to sort."""
    base = tmp_path_factory.mktemp("runs")
    kinds = dict(flat_ppo=("flat", "ppo", 0.005), flat_ppo_0=("flat", "ppo", 0), flat=("flat",),
                 flat_1=("flat", "eipo", 0.005, 1), rough=("rough",), velocity_ppo=("velocity", "ppo", 0.01),
                 velocity=("velocity",), curriculum=("curriculum",))  # fmt: skip
    return {name: make_run(base / name, *settings) for name, settings in kinds.items()}


def table(path):
    """A CSV as a list of dicts of str."""
    with open(path) as file:
        return list(csv.DictReader(file))


def distinct(rows, *columns):
    """The values of these columns, each once, in the order of the rows."""
    return list(dict.fromkeys(tuple(row[c] for c in columns) if columns[1:] else row[columns[0]] for row in rows))


def figure(out, *argv):
    """Make a figure with two episodes of each of eleven commands; returns the CSV and the size of the PNG."""
    assert evaluate.main([*argv, "--episodes", "22", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir() if path.is_file()) == [f"{argv[0]}.csv", f"{argv[0]}.png"]
    with Image.open(out / f"{argv[0]}.png") as image:
        assert len(image.convert("RGB").getcolors(2**24)) > 20, "the figure is blank"
        return table(out / f"{argv[0]}.csv"), image.size


def error_of(capsys, *argv):
    """The one line that a failing command prints."""
    assert evaluate.main([str(x) for x in argv]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("evaluate.py: ")
    return line


def files(folder):
    """What a failing command has left behind in --out, which it may have made."""
    return list(folder.rglob("*"))


# ---- every figure ----


def test_fig2_has_eleven_commands_for_each_kind_of_run(runs, tmp_path):
    """Two kinds x 11 commands of 0 to 1 m/s, 22 / 11 = 2 episodes of each; two panels of 5 x 3.6 inches at 150 dpi."""
    rows, size = figure(tmp_path / "new" / "folder", "fig2", runs["flat_ppo"], runs["flat"], runs["rough"])
    asked = ["0", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7", "0.8", "0.9", "1"]
    assert [(row["run"], row["v_x_asked"]) for row in rows] == [(k, v) for k in ("EIPO", "PPO(0.005)") for v in asked]
    assert distinct(rows, "task", "seeds", "episodes", "yaw_asked") == [("flat", "1", "2", "0")] and size == (1500, 540)
    parts = ("", "_low", "_high", "_seeds_low", "_seeds_high")
    assert {name + part for name in ("performance", "energy") for part in parts} < set(rows[0])
    assert all(0 <= float(row["performance_low"]) <= float(row["performance_high"]) < 1.5 for row in rows)


def test_fig3_is_of_the_runs_on_rough_ground(runs, tmp_path):
    """One kind x 11 commands; performance and energy side by side."""
    rows, size = figure(tmp_path, "fig3", *runs.values())
    assert distinct(rows, "task", "run") == [("rough", "EIPO")] and len(rows) == 11 and size == (1500, 540)
    assert {"performance", "energy"} < set(rows[0])


def test_fig4_has_both_tasks(runs, tmp_path):
    """One kind of run on each ground, 11 commands each; two panels."""
    rows, size = figure(tmp_path, "fig4", runs["rough"], runs["flat_ppo"])
    assert [(row["task"], row["run"]) for row in rows] == [("flat", "PPO(0.005)")] * 11 + [("rough", "EIPO")] * 11
    assert size == (1500, 540) and {"performance", "performance_high"} < set(rows[0])


def test_fig5_has_121_commands(runs, tmp_path):
    """11 v_x from -1 to 4 m/s, step 0.5, times 11 yaw rates from -5 to 5 rad/s; at least one episode of each."""
    rows, _ = figure(tmp_path, "fig5", runs["curriculum"], runs["flat"])
    grid = [(f"{-1 + i / 2:g}", f"{j - 5}") for i in range(11) for j in range(11)]
    assert [(row["v_x_asked"], row["yaw_asked"]) for row in rows] == grid
    assert distinct(rows, "episodes") == ["1"] and {"performance", "power"} < set(rows[0])


def test_fig6_has_a_row_for_each_stride(runs, tmp_path):
    """16 steps are one stride, in the middle of which 0.16 s have passed; who fell in it does not count."""
    rows, size = figure(tmp_path, "fig6", runs["velocity_ppo"], runs["velocity"])
    assert [(row["run"], row["time"]) for row in rows] == [("EIPO", "0.16"), ("PPO(0.01)", "0.16")]
    assert distinct(rows, "episodes") == ["22"] and size == (750, 540)
    assert all(-3 < float(row["v_x_low"]) <= float(row["v_x"]) <= float(row["v_x_high"]) < 3 for row in rows)


def test_table1_has_what_the_paper_prints(runs, tmp_path):
    """Table I: 2.86 m/s of EIPO and 1.45 m/s of lambda = 0.01, beside ours, a row for each."""
    rows, _ = figure(tmp_path, "table1", runs["velocity_ppo"], runs["velocity"])
    assert [(row["run"], row["paper"]) for row in rows] == [("EIPO", "2.86"), ("PPO(0.01)", "1.45")]
    assert {"peak", "peak_low", "peak_sustained", "v_x", "v_x_late", "power"} < set(rows[0])
    assert all(float(row["v_x"]) < float(row["peak"]) for row in rows)


def test_table1_of_the_paper_whole():
    """Table I as printed, lambda ascending; each interval holds its number."""
    printed = [2.86, 2.12, 1.55, 1.49, 1.58, 1.64, 1.58, 1.62, 1.45, 1.37]
    assert [value for value, _, _ in evaluate.TABLE1.values()] == printed
    assert all(low <= value <= high for value, low, high in evaluate.TABLE1.values())
    assert list(evaluate.TABLE1) == ["EIPO", *(f"PPO({lam:g})" for lam in EQ_10)]


# ---- one cell by hand ----


@pytest.fixture
def scripted(monkeypatch):
    """Instead of episodes: robot k of the command v_x, in the folder of seed s, performs at 1000 v_x + 8 s + k.

    Eight robots per command, of Figs. 2 to 4 only the commands 0, 0.1 and 0.2 m/s. Returns a list of what was loaded:
    folder, number of episodes, clip, roughness, whether from the nominal pose.
    """
    loaded = []

    def load(folder, *arguments):
        loaded.append((str(folder), *arguments))
        return folder, arguments[0]

    def run_episodes(folder, n, commands):
        assert commands.shape == (n, 3)
        seed = run_folder.load_config(Path(folder))[1].seed
        performance = 1000 * commands[:, 0] + 8 * seed + np.arange(n) % 8
        columns = dict.fromkeys(measure.Episodes._fields, performance + 0.25)
        columns |= dict(performance=performance, peak_sustained=performance + 0.5, fell=np.arange(n) % 8 == 0)
        return measure.Episodes(**columns)

    monkeypatch.setattr(measure, "load", load)
    monkeypatch.setattr(measure, "run_episodes", run_episodes)
    monkeypatch.setattr(evaluate, "FORWARD", evaluate.FORWARD[:3])
    return loaded


@pytest.fixture
def unsaved(monkeypatch):
    """Instead of files: a list of the figures that would have been saved."""
    figures = []
    monkeypatch.setattr(evaluate, "keep_policies", lambda out, folders: None)
    monkeypatch.setattr(evaluate, "save", lambda out, what, rows, drawn: figures.append(drawn))
    return figures


def test_a_cell_is_of_its_own_command_and_pools_the_seeds(runs, scripted, tmp_path):
    """Two seeds of eight: 100 i + 0 ... 15, mean 7.5; each seed alone 3.5 and 11.5.

    One robot of eight falls.
    """
    assert evaluate.main(["fig4", runs["flat_1"], runs["flat"], "--episodes", "24", "--out", str(tmp_path)]) == 0
    rows = table(tmp_path / "fig4.csv")
    assert [float(row["performance"]) for row in rows] == [100 * i + 7.5 for i in range(3)]
    assert [float(row["performance_seeds_low"]) for row in rows] == [100 * i + 3.5 for i in range(3)]
    assert [float(row["performance_seeds_high"]) for row in rows] == [100 * i + 11.5 for i in range(3)]
    assert distinct(rows, "seeds", "episodes", "run", "fell") == [("2", "8", "EIPO", "0.125")]


def test_a_seed_without_partner_has_no_interval_over_seeds(runs, scripted, tmp_path):
    """100 i + 0 ... 7: mean 3.5, energy 0.25 more; one seed says nothing of the next."""
    assert evaluate.main(["fig2", runs["flat"], "--episodes", "24", "--out", str(tmp_path)]) == 0
    rows = table(tmp_path / "fig2.csv")
    assert [float(row["performance"]) for row in rows] == [100 * i + 3.5 for i in range(3)]
    assert [float(row["energy"]) for row in rows[:2]] == [3.75, 103.75]
    assert distinct(rows, "performance_seeds_low", "performance_seeds_high") == [("nan", "nan")]


def test_table1_by_hand(runs, scripted, unsaved, monkeypatch):
    """Eight episodes 0 ... 7, IQM 3.5: peak 0.25 more, its mean over 0.2 s 0.5 more."""
    monkeypatch.setattr(evaluate, "save", lambda out, what, rows, drawn: unsaved.extend(rows))
    assert evaluate.main(["table1", runs["velocity"], "--episodes", "8"]) == 0
    (row,) = unsaved
    assert (row["peak"], row["peak_sustained"], row["paper"], row["episodes"]) == (3.75, 4.0, 2.86, 8)


def test_fig6_by_hand(runs, monkeypatch, tmp_path):
    """v_x is the step's number, of robot 1 one more until it falls in step 10. 34 steps are two strides of 17.

    Steps 1 to 17 have the mean 9, in the middle of 0 to 0.34 s; steps 18 to 34 the mean 26, at 0.51 s.
    """

    def steps(*_):
        for t in range(1, 35):
            yield np.zeros(2), dict(v_x=np.array([t, t + 1.0])), np.array([True, t <= 10]), np.array([False, t == 10])

    loaded, env = [], SimpleNamespace(period=0.02, env_cfg=tasks.task_config("velocity"))
    monkeypatch.setattr(
        measure, "load", lambda *arguments: loaded.append((str(arguments[0]), *arguments[1:])) or ("policy", env)
    )
    monkeypatch.setattr(measure, "steps", steps)
    argv = ["fig6", runs["velocity"], "--episodes", "2", "--clip", "torque", "--roughness", "0.08"]
    assert evaluate.main([*argv, "--out", str(tmp_path)]) == 0
    assert [(row["time"], row["v_x"]) for row in table(tmp_path / "fig6.csv")] == [("0.17", "9"), ("0.51", "26")]
    assert loaded == [(runs["velocity"], 2, "torque", 0.08)]


def test_fig5_draws_each_number_at_its_command(runs, scripted, unsaved):
    """1000 v_x: in the panel v_x goes up in steps of 0.5 m/s, so its rows are 500 apart, and yaw changes nothing."""
    assert evaluate.main(["fig5", runs["curriculum"], "--episodes", "121"]) == 0
    (mesh,) = unsaved[0].axes[0].collections
    value, (x, y) = mesh.get_array(), np.moveaxis(mesh.get_coordinates(), -1, 0)
    assert value.shape == (11, 11) and np.allclose(np.diff(value, axis=0), 500, atol=8)
    assert np.ptp(value, axis=1).max() < 8 and np.isclose(np.diff(y, axis=0), 0.5).all()
    assert np.isclose(np.diff(x, axis=1), 1).all()


def test_fig4_has_a_panel_for_each_task_that_there_are_runs_of(runs, scripted, unsaved):
    """Without runs on flat ground there is one panel, not an empty one."""
    assert evaluate.main(["fig4", runs["rough"]]) == 0
    assert [axes.get_title() for axes in unsaved[0].axes] == ["rough ground"]
    assert evaluate.main(["fig4", runs["rough"], runs["flat_ppo"]]) == 0
    assert [axes.get_title() for axes in unsaved[1].axes] == ["flat ground", "rough ground"]
    assert [[line.get_label() for line in axes.get_lines()] for axes in unsaved[1].axes] == [["PPO(0.005)"], ["EIPO"]]


def test_eipo_comes_first_then_lambda_ascends(runs, scripted, tmp_path):
    paths = [runs["flat_ppo"], runs["flat_ppo_0"], runs["flat_1"]]
    assert evaluate.main(["fig4", *paths, "--episodes", "11", "--out", str(tmp_path)]) == 0
    assert distinct(table(tmp_path / "fig4.csv"), "run") == ["EIPO", "PPO(0)", "PPO(0.005)"]


def test_every_kind_of_run_has_a_line_of_its_own():
    """Ten kinds in one figure: no two share colour or marker, EIPO is the thickest."""
    kinds = ["EIPO", *(f"PPO({lam:g})" for lam in EQ_10)]
    axes = Figure().subplots()
    evaluate.draw_lines(axes, [dict(run=k, x=x, y=x, y_low=x, y_high=x) for k in kinds for x in (0, 1)], "x", "y")
    lines = axes.get_lines()
    assert [line.get_label() for line in lines] == kinds
    assert len({str(line.get_color()) for line in lines}) == len({line.get_marker() for line in lines}) == 10
    assert lines[0].get_linewidth() > max(line.get_linewidth() for line in lines[1:])


# ---- the world in which it is measured ----


@pytest.mark.parametrize(
    "figure, name, roughness",
    [
        ("fig2", "flat", None),
        ("fig3", "rough", 0.15),
        ("fig4", "flat", None),
        ("fig4", "rough", 0.15),
        ("fig5", "curriculum", None),
        ("table1", "velocity", None),
    ],
)
def test_figures_are_measured_on_the_ground_that_the_paper_names(runs, scripted, unsaved, figure, name, roughness):
    """V-B: 15 cm; None is as in training. 26 episodes are 26 // 3 = 8 of each of three commands, so 24."""
    assert evaluate.main([figure, runs[name], "--episodes", "26"]) == 0
    n = dict(fig5=121, table1=26).get(figure, 24)
    assert scripted == [(runs[name], n, None, roughness, nominal) for nominal in (False, True)]


def test_clip_reaches_the_figures(runs, scripted, unsaved):
    """--clip torque: Eq. (9) as printed, for whatever was trained with the other."""
    assert evaluate.main(["fig3", runs["rough"], "--clip", "torque", "--episodes", "24"]) == 0
    assert scripted == [(runs["rough"], 24, "torque", 0.15, nominal) for nominal in (False, True)]


@pytest.mark.parametrize("figure, name", [("fig2", "flat"), ("fig3", "rough"), ("fig4", "rough"),
                                          ("fig5", "curriculum"), ("table1", "velocity")])  # fmt: skip
def test_roughness_reaches_the_figures(runs, scripted, unsaved, figure, name):
    """0.08 m, for whatever the run was trained on and whatever the figure's default is. (fig6 is above.)"""
    assert evaluate.main([figure, runs[name], "--roughness", "0.08", "--episodes", "11"]) == 0
    assert scripted[0][3] == 0.08


def test_clip_and_roughness_reach_the_environment(runs, monkeypatch, capsys):
    """A policy of the task rough, trained on 0 to 0.15 m with the power clipped, on 0.03 m with the torque clipped."""
    seen = []

    def run_episodes(mean, env, command=None):
        seen.append(env)
        return measure.Episodes(*np.ones((len(measure.Episodes._fields), env.num_envs)))

    monkeypatch.setattr(measure, "run_episodes", run_episodes)
    assert evaluate.main([runs["rough"], "--clip", "torque", "--roughness", "0.03", "--episodes", "22"]) == 0
    env, nominal = seen
    assert (env.env_cfg.clip, env.env_cfg.roughness, env.num_envs) == ("torque", (0.03, 0.03), 22)
    assert (env.env_cfg.start_spread, nominal.env_cfg.start_spread) == (0.5, 0.0)
    assert np.ptp(env.ground[:, : env.ground.shape[1] // 2]) == pytest.approx(0.03)  # the first tile


@pytest.fixture
def two_episodes(monkeypatch):
    """Of each of two commands, 0 and 0.1 m/s: performance 0.5 and 1.5, one fall, 1 and 3 m/s, 10 W, one J/m unknown."""
    pairs = dict(
        performance=(0.5, 1.5), fell=(True, False), v_x=(1, 3), power=(10, 10), energy=(7, np.nan), pitch=(-2, 4)
    )
    columns = {name: np.tile(pairs.get(name, (0, 0)), 2) for name in measure.Episodes._fields}
    monkeypatch.setattr(measure, "run_episodes", lambda mean, env, commands: measure.Episodes(**columns))
    monkeypatch.setattr(evaluate, "FORWARD", evaluate.FORWARD[:2])


OVERVIEW = dict(performance=1, fell=0.5, performance_nominal=1, fell_nominal=0.5, v_x=2, peak=0, power=10, energy=7,
                pitch=3, roll=0, v_x_at_0=2)  # fmt: skip


def test_the_line_of_a_run_by_hand(runs, two_episodes, capsys):
    """Means 1, 50 %, 2 m/s, 10 W; 7 J/m of the robot that moves; pitch |-2| and |4|, 3 degrees."""
    assert evaluate.main([runs["flat"], "--episodes", "4"]) == 0
    head, _, row = ([cell.strip() for cell in line.split("|")[1:-1]] for line in capsys.readouterr().out.splitlines())
    printed = dict(zip(head, row, strict=True))
    assert (printed["run"], printed["seed"]) == (Path(runs["flat"]).name, "0")
    assert {name: float(printed[name]) for name in OVERVIEW} == OVERVIEW


def test_seeds_says_when_a_reward_was_reached(runs, two_episodes, tmp_path):
    """The reward of iteration i is i / 20, the mean of 20 is (i - 9.5) / 20: at 1.2 in the 34th, at 1.35 in the 37th.

    34 times a hundred steps are 0.0034 million; 60 s an iteration, resumed after 10, are 34 minutes.
    """
    folder = shutil.copytree(runs["flat"], tmp_path / "run")
    rows = [f"{i},{100 * i},{i / 20},{60 * (i if i <= 10 else i - 10)}" for i in range(1, 36)]
    (folder / "metrics.csv").write_text("\n".join(["iteration,steps,reward,time_s", *rows, ""]))
    assert evaluate.main(["seeds", str(folder), "--episodes", "4", "--out", str(tmp_path / "out")]) == 0
    (row,) = table(tmp_path / "out" / "seeds.csv")
    assert [row[c] for c in ("msteps_1.2", "minutes_1.2", "msteps_1.35", "minutes_1.35")] == [
        "0.0034",
        "34",
        "nan",
        "nan",
    ]
    assert {name: float(row[name]) for name in OVERVIEW} == OVERVIEW


def test_policies_of_a_figure_are_kept_beside_it(runs, two_episodes, tmp_path):
    """So that play.py can show the gait behind a number: the same bytes. In its own folder nothing is copied."""
    (Path(runs["flat"]) / "metrics.csv").write_text("steps,reward,time_s\n" + "1,1,1\n" * 20)
    assert evaluate.main(["seeds", runs["flat"], "--episodes", "4", "--out", str(tmp_path)]) == 0
    kept = tmp_path / Path(runs["flat"]).name / "policy.npz"
    assert kept.read_bytes() == (Path(runs["flat"]) / "policy.npz").read_bytes()
    evaluate.keep_policies(tmp_path, [kept.parent])
    (Path(runs["flat"]) / "metrics.csv").unlink()


# ---- what goes wrong ----


def test_the_same_kind_and_seed_twice_is_one_line(runs, tmp_path, capsys):
    """Pooled, they would count one policy double."""
    again = shutil.copytree(runs["flat"], tmp_path / "again")
    line = error_of(capsys, "fig2", runs["flat"], again, "--out", tmp_path / "out")
    assert runs["flat"] in line and str(again) in line and not files(tmp_path / "out")


def test_runs_that_differ_in_more_than_the_seed_are_one_line(runs, tmp_path, capsys):
    """Other settings are another experiment, which must not be pooled."""
    env_cfg, cfg = run_folder.load_config(Path(runs["flat_1"]))
    run_folder.save_config(tmp_path, replace(env_cfg, history=3), cfg, [])
    assert "history" in error_of(capsys, "fig2", runs["flat"], tmp_path)


@pytest.mark.parametrize("figure, name", [("fig2", "rough"), ("fig3", "flat"), ("fig4", "velocity"), ("fig6", "flat"),
                                          ("table1", "flat")])  # fmt: skip
def test_runs_of_another_task_only_are_one_line(runs, tmp_path, capsys, figure, name):
    error_of(capsys, figure, runs[name], "--out", tmp_path / "out")
    assert not files(tmp_path / "out")


def test_a_figure_without_runs_is_one_line(capsys):
    assert "fig2" in error_of(capsys, "fig2")


def test_an_unknown_figure_is_taken_for_a_run_folder(runs, capsys):
    assert "fig7" in error_of(capsys, "fig7", runs["flat"])


def damage(kind, folder):
    policy, config = folder / "policy.npz", folder / "config.json"
    if kind == "policy truncated":
        policy.write_bytes(policy.read_bytes()[:-500])
    elif kind == "policy empty":
        policy.write_bytes(b"")
    elif kind == "policy missing":
        policy.unlink()
    elif kind == "policy of another program":
        np.savez(policy, weights=np.ones(3))
    elif kind == "config garbage":
        config.write_text("not JSON")
    elif kind == "config binary":
        config.write_bytes(b"\xff\x00")
    elif kind == "config of another program":
        config.write_text('["env", "learner"]')
    elif kind == "config of another version":
        config.write_text('{"env": {"moons": 2}, "learner": {}}')
    elif kind == "empty folder":
        policy.unlink()
        config.unlink()


KINDS = ["policy truncated", "policy empty", "policy missing", "policy of another program", "config garbage",
         "config of another program", "config of another version", "empty folder"]  # fmt: skip


@pytest.mark.parametrize("kind", [*KINDS, "config binary"])
def test_a_damaged_run_folder_is_one_line_and_nothing_is_written(runs, tmp_path, capsys, kind):
    folder = shutil.copytree(runs["flat"], tmp_path / "run")
    damage(kind, folder)
    assert str(folder) in error_of(capsys, "fig2", folder, "--episodes", "11", "--out", tmp_path / "out")
    assert not files(tmp_path / "out")
    if "config" not in kind:  # a line per run folder needs no config.json
        assert str(folder) in error_of(capsys, folder, "--episodes", "1")


def test_an_unwritable_folder_is_one_line(runs, scripted, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert "file" in error_of(capsys, "fig2", runs["flat"], "--episodes", "11", "--out", tmp_path / "file")


# ---- sweeps ----


@pytest.fixture
def sweep(monkeypatch, tmp_path, capsys):
    """Ask for the commands of a sweep, in an empty folder; returns the lines."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "describe", functools.cache(train.describe))  # reads the source again for each line

    def ask(*argv):
        assert evaluate.main(["--commands", *argv]) == 0
        return capsys.readouterr().out.split("\n")[:-1]

    return ask


def settled(line):
    """Task, algo, lambda, seed and run folder of a line, which has to be one that train.py accepts."""
    python, script, *argv = shlex.split(line)
    assert (python, script) == ("python", "train.py")
    options, *given = train.parse(argv)
    env_cfg, cfg = train.settle(*given)
    eipo.check(cfg)
    folder = str(train.run_path(train.Options(**options), env_cfg, cfg))
    return env_cfg.task, cfg.algo, cfg.lam, cfg.seed, folder


def test_table1_takes_thirty_runs(sweep):
    """Three seeds x (EIPO and the nine lambdas of Eq. (10)), a folder for each; EIPO begins at V-D's lambda 0.0002."""
    lines = sweep("table1")
    asked = [settled(line) for line in lines]
    kinds = [("eipo", 0.0002), *(("ppo", lam) for lam in EQ_10)]
    assert [run[:4] for run in asked] == [("velocity", *kind, seed) for kind in kinds for seed in range(3)]
    assert len({run[4] for run in asked}) == len(lines) == 30
    assert not any("--resume" in line for line in lines)


@pytest.mark.parametrize(
    "what, kinds",
    [
        ("fig2", [("flat", "eipo", 0.005), ("flat", "ppo", 0.005), ("flat", "ppo", 0)]),
        ("fig3", [("rough", "eipo", 0.0002), ("rough", "ppo", 0.005), ("rough", "ppo", 0)]),
        ("fig6", [("velocity", "eipo", 0.0002), ("velocity", "ppo", 0.01)]),
        (
            "fig4",
            [(task, *kind) for task, lam in (("flat", 0.005), ("rough", 0.0002))
             for kind in (("eipo", lam), *(("ppo", lam) for lam in EQ_10))],
        ),
    ],
)  # fmt: skip
def test_runs_of_the_figures(sweep, what, kinds):
    """V-A, V-B, VI: EIPO against the best and the least lambda, against 0.01 on the robot; Fig. 4 against all."""
    asked = [settled(line)[:4] for line in sweep(what)]
    assert asked == [(*kind, seed) for kind in kinds for seed in range(3)]
    assert len(asked) == dict(fig2=9, fig3=9, fig4=60, fig6=6)[what]


def fake_run(line, iterations, checkpoint=True):
    """What the run of a line leaves that has got so far: settings, a row per iteration, a checkpoint; its folder."""
    options, *given = train.parse(shlex.split(line)[2:])
    settings = train.settle(*given)
    folder = train.run_path(train.Options(**options), *settings)
    folder.mkdir(parents=True)
    run_folder.save_config(folder, *settings, [])
    (folder / "metrics.csv").write_text("iteration\n" + "".join(f"{i + 1}\n" for i in range(iterations)))
    if checkpoint:
        (folder / "checkpoint.npz").write_bytes(b"")
    return folder


def test_finished_runs_are_left_out_and_interrupted_ones_resumed(sweep):
    """Of four iterations seed 0 has all, seed 1 three, seed 2 none."""
    every = sweep("fig6", "--iterations", "4")
    assert fake_run(every[0], 4) == Path("runs/velocity-eipo-lam0.0002-seed0")
    fake_run(every[1], 3)
    assert sweep("fig6", "--iterations", "4") == [f"{every[1]} --resume", *every[2:]]


def test_a_finished_run_is_resumed_for_more_iterations(sweep):
    """Finished is what has as many iterations as are asked for: by default 4000 of V-A."""
    folder = fake_run(sweep("fig2")[-1], 3999)
    assert sweep("fig2")[-1].endswith("--lam 0 --seed 2 --resume")
    (folder / "metrics.csv").write_text("iteration\n" + "0\n" * 4000)
    assert len(sweep("fig2")) == 8
    assert sweep("fig2", "--iterations", "4001")[-1].endswith("--lam 0 --seed 2 --iterations 4001 --resume")


def test_a_run_of_other_settings_is_one_line(sweep, capsys):
    """What lies in the run folder is not the run that the figure needs."""
    fake_run(sweep("fig2", "--noise", "0")[0], 4000)
    assert "--noise" in error_of(capsys, "--commands", "fig2")


@pytest.mark.parametrize("flag", ["--task", "--algo", "--lam", "--seed", "--out", "--resume"])
def test_flags_that_the_sweep_sets_are_one_line(capsys, flag):
    """Given to every run, they would make several runs the same."""
    assert flag in error_of(capsys, "--commands", "fig2", flag, "1")


def test_a_run_killed_before_its_first_checkpoint_can_be_started(sweep):
    """It has rows of metrics and nothing to resume; whatever its line is, train.py must accept it."""
    fake_run(sweep("fig2")[0], 30, checkpoint=False)
    argv = shlex.split(sweep("fig2")[0])[2:]
    options, *given = train.parse(argv)
    train.prepare(train.Options(**options), *given)


def test_flags_pass_through(sweep):
    """With a value, with two, and without; they reach every run and do not change which runs there are."""
    lines = sweep("fig6", "--threads", "1", "--friction", "0.5", "1", "--no-stagger")
    assert all(line.endswith(" --threads 1 --friction 0.5 1 --no-stagger") for line in lines) and len(lines) == 6
    assert [settled(line) for line in lines] == [settled(line) for line in sweep("fig6")]


@pytest.mark.parametrize("argv", [["fig7"], []])
def test_commands_of_what_is_no_sweep_are_one_line(capsys, argv):
    assert "table1" in error_of(capsys, "--commands", *argv)
    assert capsys.readouterr().out == ""


def test_flags_that_train_does_not_know_are_one_line(capsys):
    with pytest.raises(SystemExit, match="2"):
        evaluate.main(["--commands", "fig2", "--speed", "3"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "--speed" in line


@pytest.mark.skipif(not shutil.which("xargs"), reason="needs xargs")
def test_a_sweep_trains_as_the_readme_says(sweep, tmp_path):
    """EIPO and PPO(0.005) of Fig. 2, two at a time as in README; then seven of nine commands are left."""
    lines = sweep("fig2", *TINY)
    (tmp_path / "train.py").symlink_to(ROOT / "train.py")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    jobs = f"{lines[0]}\n{lines[3]}\n"
    done = subprocess.run("xargs -P 2 -I CMD sh -c CMD", shell=True, cwd=tmp_path, input=jobs, text=True,
                          env=os.environ | dict(PATH=path), capture_output=True)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    names = ["flat-eipo-lam0.005-seed0", "flat-ppo-lam0.005-seed0"]
    assert sorted(folder.name for folder in (tmp_path / "runs").iterdir()) == names
    assert all((tmp_path / "runs" / name / "policy.npz").exists() for name in names)
    assert sweep("fig2", *TINY) == [lines[1], lines[2], *lines[4:]]


def test_ctrl_c_is_no_traceback(runs, monkeypatch):
    """Evaluating takes minutes: who loses patience gets the shell's exit status, 128 + SIGINT's 2."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "run_episodes", interrupted)
    assert evaluate.main([runs["flat"]]) == 130
