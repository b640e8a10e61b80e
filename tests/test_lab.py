"""`python -m lab`: which episodes end in which cell of which CSV, the record, and the sweeps."""

import csv
import functools
import gzip
import itertools
import json
import os
import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from support import (
    DAMAGES,
    LAMBDAS,
    ROOT,
    TINY,
    change_npz,
    contents,
    error_of,
    full_disk,
    make_run,
)

import eipo
import evaluate
import go1_env
import rewards
import tasks
import train
from lab import episodes, figures, gap, objective, record, regions
from lab import sweep as sweeps
from lab.__main__ import FIGURES, OTHERS, main
from runtime import flags, metrics, policy_file, run_folder

KINDS = ["EIPO", *(f"PPO({lam:g})" for lam in LAMBDAS)]
ASKED = ["0", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7", "0.8", "0.9", "1"]


@pytest.fixture(autouse=True)
def short_episodes_elsewhere(monkeypatch, tmp_path):
    """An evaluation plays 16 steps, 0.32 s, instead of the paper's 1000, and writes into no folder
    of ours.
    """
    monkeypatch.setattr(evaluate, "EPISODE_STEPS", 16)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def runs(all_runs):
    """The folders of `all_runs`, which nobody has evaluated yet."""
    for folder in all_runs.values():
        (folder / run_folder.EPISODES).unlink(missing_ok=True)
    return all_runs


@pytest.fixture(scope="module")
def all_runs(tmp_path_factory):
    """Run folders by task and name; those of PPO come first, and not in order, so that evaluate.py
    has to sort.
    """
    base, ppo = tmp_path_factory.mktemp("runs"), dict(algo="ppo")
    kinds = dict(
        flat_ppo=("flat", ppo),
        flat_ppo_0=("flat", ppo | dict(lam=0.0)),
        flat=("flat", {}),
        flat_1=("flat", dict(seed=1)),
        rough=("rough", {}),
        velocity_ppo=("velocity", ppo | dict(lam=0.01)),
        velocity=("velocity", {}),
        curriculum=("curriculum", {}),
    )
    return {name: make_run(base / name, task, **learner) for name, (task, learner) in kinds.items()}


NAMES = *FIGURES, *OTHERS


def run(*argv):
    """`python -m lab NAME ...`, or the table of runs where no name is given."""
    argv = [str(x) for x in argv]
    assert main(argv if argv[0] in NAMES else ["table", *argv]) == 0


def table(path):
    """A CSV as a list of dicts of str."""
    with open(path) as file:
        return list(csv.DictReader(file))


def distinct(rows, *columns):
    """The values of these columns, each once, in the order of the rows."""
    return list(dict.fromkeys(tuple(row[c] for c in columns) for row in rows))


# ---- every figure ----


@pytest.mark.parametrize(
    "what, names, key, expected, columns, size",
    [
        (
            "fig2",
            "flat_ppo flat rough",
            "task run seeds episodes yaw_asked v_x_asked",
            [("flat", kind, "1", "2", "0", v) for kind in ("EIPO", "PPO(0.005)") for v in ASKED],
            "performance energy",
            (1500, 540),
        ),
        (
            "fig3",
            "flat_ppo flat rough velocity",
            "task run v_x_asked",
            [("rough", "EIPO", v) for v in ASKED],
            "performance energy",
            (1500, 540),
        ),
        (
            "fig4",
            "rough flat_ppo",
            "task run v_x_asked",
            [(*kind, v) for kind in (("flat", "PPO(0.005)"), ("rough", "EIPO")) for v in ASKED],
            "performance",
            (1500, 540),
        ),
        (
            "fig5",
            "curriculum flat",
            "episodes v_x_asked yaw_asked",
            [("1", f"{-1 + i / 2:g}", f"{j - 5}") for i in range(11) for j in range(11)],
            "performance power",
            None,
        ),
        (
            "fig6",
            "velocity_ppo velocity",
            "run episodes time",
            [("EIPO", "22", "0.16"), ("PPO(0.01)", "22", "0.16")],
            "v_x",
            (750, 540),
        ),
        (
            "table1",
            "velocity_ppo velocity",
            "run paper",
            [("EIPO", "2.86"), ("PPO(0.01)", "1.45")],
            "peak peak_sustained v_x v_x_late power",
            None,
        ),
    ],
    ids=lambda x: x if isinstance(x, str) and x[-1].isdigit() else "",
)
def test_rows_and_size_of_a_figure(runs, what, names, key, expected, columns, size):
    """22 episodes are two of each of eleven commands of 0 to 1 m/s, or at least one of each of 121,
    -1 to 4 m/s in steps of 0.5 times -5 to 5 rad/s. A panel is 5 x 3.6 inches at 150 dpi.

    Fig. 6: 16 steps are one stride, in the middle of which 0.16 s have passed. Table I: what the
        paper prints beside.
    """
    run(what, *(runs[name] for name in names.split()), "--episodes", 22, "--out", "new/folder")
    out = Path("new/folder")
    assert sorted(path.name for path in out.iterdir() if path.is_file()) == [
        f"{what}.csv",
        f"{what}.png",
    ]
    with Image.open(out / f"{what}.png") as image:
        assert len(image.convert("RGB").getcolors(2**24)) > 20, "the figure is blank"
        assert image.size == (size or image.size)
    rows = table(out / f"{what}.csv")
    assert [tuple(row[name] for name in key.split()) for row in rows] == expected
    for row in rows:
        for column in columns.split():
            number, low, high = (float(row[column + part]) for part in ("", "_low", "_high"))
            assert np.isnan(number) or np.isnan(low) or -3 <= low <= number <= high
    if what == "fig2":
        assert {
            name + part for name in columns.split() for part in ("_seeds_low", "_seeds_high")
        } < set(rows[0])
        assert all(
            float(row["performance_low"]) >= 0 and float(row["performance_high"]) < 1.5
            for row in rows
        )
    if what == "table1":
        assert all(float(row["v_x"]) < float(row["peak"]) for row in rows)


def test_table1_of_the_paper_whole():
    """Table I as printed, lambda ascending; each interval holds its number."""
    printed = [2.86, 2.12, 1.55, 1.49, 1.58, 1.64, 1.58, 1.62, 1.45, 1.37]
    assert [value for value, _, _ in figures.TABLE1.values()] == printed
    assert all(low <= value <= high for value, low, high in figures.TABLE1.values())
    assert list(figures.TABLE1) == KINDS


# ---- one cell by hand ----


@pytest.fixture
def scripted(monkeypatch):
    """Instead of episodes: robot k of the command v_x, in the folder of seed s, performs at 1000
    v_x + 8 s + k.

    Eight robots per command, of Figs. 2 to 4 only the commands 0, 0.1 and 0.2 m/s. Returns a list
    of what was loaded: folder, number of episodes, clip, roughness, whether from the nominal pose.
    """
    loaded = []

    def load(folder, *arguments):
        *asked, _ = arguments  # the last one is the world
        loaded.append((folder, *asked))
        return folder, arguments[0]

    def run_episodes(folder, n, commands):
        assert commands.shape == (n, 3)
        seed = run_folder.load_config(folder)[1].seed
        performance = 1000 * commands[:, 0] + 8 * seed + np.arange(n) % 8
        columns = dict.fromkeys(evaluate.Episodes._fields, performance + 0.25)
        columns |= dict(
            performance=performance, peak_sustained=performance + 0.5, fell=np.arange(n) % 8 == 0
        )
        columns |= dict(power=15 * performance)
        return evaluate.Episodes(**columns)

    monkeypatch.setattr(evaluate, "load", load)
    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    monkeypatch.setattr(evaluate, "COMMANDS", evaluate.COMMANDS[:3])
    return loaded


@pytest.fixture
def unsaved(monkeypatch):
    """Instead of files: a list of the rows and figures that would have been saved."""
    made = []
    monkeypatch.setattr(figures, "save", lambda out, what, rows, drawn: made.append((rows, drawn)))
    return made


def test_a_cell_is_of_its_own_command_and_pools_the_seeds(runs, scripted):
    """Two seeds of eight: 100 i + 0 ... 15, mean 7.5; each seed alone 3.5 and 11.5. One robot of
    eight falls.
    """
    run("fig4", runs["flat_1"], runs["flat"], "--episodes", 24)
    rows = table("fig4.csv")
    for column, x in (
        ("performance", 7.5),
        ("performance_seeds_low", 3.5),
        ("performance_seeds_high", 11.5),
    ):
        assert [float(row[column]) for row in rows] == [100 * i + x for i in range(3)]
    assert distinct(rows, "seeds", "episodes", "run", "fell") == [("2", "8", "EIPO", "0.125")]


def test_a_seed_without_partner_has_no_interval_over_seeds(runs, scripted):
    """100 i + 0 ... 7: mean 3.5; one seed says nothing of the next. D27: speeds are 0.25 more, and
    power 15 times as much, so at i = 0 energy per metre is 15 x 3.5 / 3.75 = 14.
    """
    run("fig2", runs["flat"], "--episodes", 24)
    rows = table("fig2.csv")
    assert [float(row["performance"]) for row in rows] == [100 * i + 3.5 for i in range(3)]
    assert float(rows[0]["energy"]) == 14
    assert distinct(rows, "performance_seeds_low", "performance_seeds_high") == [("nan", "nan")]


def test_robots_that_stand_at_every_command_are_drawn(runs, scripted, unsaved, monkeypatch):
    """Their energy per metre is infinite everywhere, so that line has no end to write a name at."""
    play = evaluate.run_episodes
    still = lambda *args: (seen := play(*args))._replace(v_x=0 * seen.v_x)  # noqa: E731
    monkeypatch.setattr(evaluate, "run_episodes", still)
    run("fig2", runs["flat"], "--episodes", 24)
    ((rows, figure),) = unsaved
    assert {row["energy"] for row in rows} == {row["energy_high"] for row in rows} == {np.inf}
    assert [text.get_text() for text in figure.axes[1].texts] == ["EIPO"]


def test_names_stand_beside_the_ends_of_their_lines(runs, scripted, unsaved):
    """Two kinds that end at one number: the second name stands 0.055 of the height above."""
    run("fig2", runs["flat"], runs["flat_ppo"], "--episodes", 24)
    ((_, figure),) = unsaved
    (x, low), (u, high) = sorted(text.xyann for text in figure.axes[0].texts)
    assert x == u > 1 and high - low == pytest.approx(0.055)


def test_table1_by_hand(runs, scripted, unsaved):
    """Eight episodes 0 ... 7, IQM 3.5: peak 0.25 more, its mean over 0.2 s 0.5 more."""
    run("table1", runs["velocity"], "--episodes", 8)
    (((row,), _),) = unsaved
    assert (row["peak"], row["peak_sustained"], row["paper"], row["episodes"]) == (
        3.75,
        4.0,
        2.86,
        8,
    )


def test_table1_is_drawn_from_interquartile_means(runs, scripted, unsaved, monkeypatch):
    """D26. Peaks 0 ... 6 and 1000: the middle half 2, 3, 4, 5 has the mean 3.5. The mean of all is
    (21 + 1000) / 8 = 127.625. The paper's 2.86 is drawn as it is.
    """
    play = evaluate.run_episodes

    def run_episodes(*args):
        episodes = play(*args)
        peak = np.where(episodes.performance == 7, 1000.0, episodes.performance)
        return episodes._replace(peak=peak)

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    run("table1", runs["velocity"], "--episodes", 8)
    (((row,), figure),) = unsaved
    assert row["peak"] == 3.5
    drawn = [bars.lines[0].get_xdata().tolist() for bars in figure.axes[0].containers]
    assert drawn == [[3.5], [2.86]]


def test_one_kind_with_two_numbers_of_robots_is_two_rows(runs, scripted, unsaved, tmp_path):
    """EIPO with 2N robots gives each policy as many as PPO with N has. The paper's number stands
    beside both.
    """
    more = make_run(tmp_path / "more", "velocity", num_envs=512)
    run("table1", more, runs["velocity_ppo"], runs["velocity"], "--episodes", 8)
    ((rows, _),) = unsaved
    assert [(row["run"], row["paper"]) for row in rows] == [
        ("EIPO, 256 robots", 2.86),
        ("EIPO, 512 robots", 2.86),
        ("PPO(0.01)", 1.45),
    ]


def test_eipo_from_another_lambda_0_is_a_kind_of_its_own(runs, scripted, unsaved, tmp_path):
    """The paper has one lambda_0 per task, 0.0002 on `velocity`, so its number stands beside that
    run alone.
    """
    other = make_run(tmp_path / "other", "velocity", lam=0.01)
    run("table1", other, runs["velocity_ppo"], runs["velocity"], "--episodes", 8)
    ((rows, _),) = unsaved
    assert [row["run"] for row in rows] == ["EIPO", "PPO(0.01)", "EIPO from 0.01"]
    assert [row["paper"] for row in rows[:2]] == [2.86, 1.45] and np.isnan(rows[2]["paper"])


def test_fig6_by_hand(runs, monkeypatch):
    """v_x is the step's number, of robot 1 one more until it falls in step 10. 34 steps are two
    strides of 17.

    Steps 1 to 17 have the mean 9, in the middle of 0 to 0.34 s; steps 18 to 34 the mean 26, at 0.51
    s.
    """

    def steps(*_):
        for t in range(1, 35):
            yield (
                np.zeros(2),
                dict(v_x=np.array([t, t + 1.0])),
                np.array([True, t <= 10]),
                np.array([False, t == 10]),
            )

    loaded, env = [], SimpleNamespace(period=0.02, env_cfg=tasks.task_config("velocity"))

    def load(*arguments, world):
        loaded.append(arguments)
        return "policy", env

    monkeypatch.setattr(evaluate, "load", load)
    monkeypatch.setattr(evaluate, "steps", steps)
    run("fig6", runs["velocity"], "--episodes", 2, "--clip", "torque", "--roughness", 0.08)
    assert [(row["time"], row["v_x"]) for row in table("fig6.csv")] == [
        ("0.17", "9"),
        ("0.51", "26"),
    ]
    assert [(str(folder), *rest) for folder, *rest in loaded] == [
        (str(runs["velocity"]), 2, "torque", 0.08)
    ]


def test_fig5_draws_each_number_at_its_command(runs, scripted, unsaved):
    """1000 v_x: in the panel v_x goes up in steps of 0.5 m/s, so its rows are 500 apart, and yaw
    changes nothing.
    """
    run("fig5", runs["curriculum"], "--episodes", 121)
    (mesh,) = unsaved[0][1].axes[0].collections
    value, (x, y) = mesh.get_array(), np.moveaxis(mesh.get_coordinates(), -1, 0)
    assert value.shape == (11, 11) and np.allclose(np.diff(value, axis=0), 500, atol=8)
    assert np.ptp(value, axis=1).max() < 8 and np.isclose(np.diff(y, axis=0), 0.5).all()
    assert np.isclose(np.diff(x, axis=1), 1).all()


def test_fig4_has_a_panel_for_each_task_that_there_are_runs_of(runs, scripted, unsaved):
    """Without runs on flat ground there is one panel, not an empty one."""
    run("fig4", runs["rough"])
    run("fig4", runs["rough"], runs["flat_ppo"])
    rough, both = (drawn.axes for _, drawn in unsaved)
    assert [axes.get_title() for axes in rough] == ["rough ground"]
    assert [axes.get_title() for axes in both] == ["flat ground", "rough ground"]
    assert [[line.get_label() for line in axes.get_lines()] for axes in both] == [
        ["PPO(0.005)"],
        ["EIPO"],
    ]


def test_eipo_comes_first_then_lambda_ascends(runs, scripted, unsaved):
    run("fig4", runs["flat_ppo"], runs["flat_ppo_0"], runs["flat_1"], "--episodes", 11)
    assert distinct(unsaved[0][0], "run") == [("EIPO",), ("PPO(0)",), ("PPO(0.005)",)]


def test_every_kind_of_run_has_a_line_of_its_own():
    """Ten kinds in one figure: no two share colour and marker, EIPO is the thickest."""
    axes = Figure().subplots()
    intervals = dict(y_low=-1, y_high=2, y_seeds_low=-2, y_seeds_high=3)
    figures.draw_lines(
        axes, [dict(run=k, x=x, y=x) | intervals for k in KINDS for x in (0, 1)], "x", "y"
    )
    lines = axes.get_lines()
    assert [line.get_label() for line in lines] == KINDS
    assert len({line.get_marker() for line in lines}) == 10
    assert len({str(line.get_color()) for line in lines}) == 6
    assert lines[0].get_linewidth() > max(line.get_linewidth() for line in lines[1:])
    episodes, seeds = axes.collections[:2]
    assert [band.get_datalim(axes.transData).intervaly.tolist() for band in (episodes, seeds)] == [
        [-1, 2],
        [-2, 3],
    ]
    assert episodes.get_alpha() > seeds.get_alpha()


def test_a_kind_has_its_color_in_every_figure():
    """Whatever else a run's name says, EIPO is blue and a lambda has the shade of its group; of
    a larger one it is darker.
    """
    color = sweeps.color
    assert color("EIPO") == color("EIPO from 0.01, 256 robots") == "#0072B2"
    assert (
        color("PPO(0)")
        == color("PPO(0) shaped")
        == color("PPO(0), 64 robots")
        != color("PPO(0.0001)")
    )
    assert (
        sum(color("PPO(0.3)"))
        < sum(color("PPO(0.005)"))
        < sum(color("PPO(0.0003)"))
        < sum(color("PPO(0)"))
    )


# ---- the world in which it is measured ----


@pytest.mark.parametrize(
    "figure, name, roughness, episodes",
    [
        ("fig2", "flat", None, 24),
        ("fig3", "rough", 0.15, 24),
        ("fig4", "flat", None, 24),
        ("fig4", "rough", 0.15, 24),
        ("fig5", "curriculum", None, 121),
        ("table1", "velocity", None, 26),
    ],
)
def test_figures_are_measured_on_the_ground_that_the_paper_names(
    runs, scripted, unsaved, figure, name, roughness, episodes
):
    """V-B: 15 cm; None is as in training. 26 episodes are 26 // 3 = 8 of each of three commands, so
    24.

    From random starts and from the nominal pose. --roughness and --clip win over training and over
    the figure.
    """
    run(figure, runs[name], "--episodes", 26)
    run(figure, runs[name], "--episodes", 26, "--roughness", 0.08, "--clip", "torque")
    settings = (None, roughness), ("torque", 0.08)
    assert scripted == [
        (runs[name], episodes, *given, nominal) for given in settings for nominal in (False, True)
    ]


def test_clip_and_roughness_reach_the_environment(runs, monkeypatch):
    """A policy of the task rough, trained on 0 to 0.15 m with the power clipped, on 0.03 m with the
    torque clipped.
    """
    seen = []

    def run_episodes(mean, env, command=None):
        seen.append(env)
        return evaluate.Episodes(*np.ones((len(evaluate.Episodes._fields), env.num_envs)))

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    run(runs["rough"], "--clip", "torque", "--roughness", 0.03, "--episodes", 22)
    env, nominal = seen
    assert (env.env_cfg.clip, env.env_cfg.roughness, env.num_envs) == ("torque", (0.03, 0.03), 22)
    assert (env.env_cfg.start_spread, nominal.env_cfg.start_spread) == (0.5, 0.0)
    # the first tile
    assert np.ptp(env.ground[:, : env.ground.shape[1] // 2]) == pytest.approx(0.03)


# ---- episodes are played once ----


@pytest.fixture
def played(monkeypatch):
    """Instead of episodes: every column of the k-th episode ever played is 1000 k + 1 / 3. A list
    of how many each.
    """
    calls = []

    def run_episodes(policy, env, commands):
        first = sum(calls)
        calls.append(env.num_envs)
        return evaluate.Episodes(
            *[1000.0 * (first + np.arange(env.num_envs)) + 1 / 3] * len(evaluate.Episodes._fields)
        )

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    return calls


def usual(clip=None):
    """The flags of a command line that say nothing of the robot."""
    return SimpleNamespace(clip=clip, world=go1_env.Go1Env)


# commands, the first of which is not quite 0.3
TWO = np.array([[0.1 + 0.2, 0.0, 0.0], [1.0, 0.0, 0.5]])


def test_episodes_are_played_once(runs, played):
    """Five digits of 1/3, 1000 1/3, 2000 1/3 and 3000 1/3 are kept, and the file needs no policy
    beside it.

    What was asked in another way (number, commands, clip, roughness, start) is played, and what is
    known stays known.
    """
    folder = runs["flat"]
    expected = [0.33333, 1000.3, 2000.3, 3000.3]
    policy = (folder / "policy.npz").read_bytes()
    for _ in range(2):
        assert list(episodes.of_run(folder, TWO, 2, usual()).v_x) == expected
        (folder / "policy.npz").unlink(missing_ok=True)
    assert played == [4]
    (folder / "policy.npz").write_bytes(policy)
    others = (usual(clip="torque"), None), (usual(), 0.1), (usual(), None, True)
    for k, other in enumerate(others):
        fell = episodes.of_run(folder, TWO, 2, *other).fell
        assert fell[0] == pytest.approx(4000 * (k + 1) + 1 / 3, abs=0.5)
    assert list(episodes.of_run(folder, TWO[:1], 2, usual()).peak) == expected[:2]
    assert list(episodes.of_run(folder, TWO, 2, usual()).peak) == expected and played == [4] * 4
    assert len(episodes.of_run(folder, TWO, 3, usual()).peak) == 6 and played == [4, 4, 4, 4, 6]


def test_fewer_episodes_do_not_replace_more(runs, played):
    """3 of each of two commands are kept. Then 2 of each are played and not kept, and the 3 are
    still there.
    """
    for each in (3, 2, 3):
        assert len(episodes.of_run(runs["flat"], TWO, each, usual()).peak) == 2 * each
    assert played == [6, 4]


def test_kept_episodes_equal_those_that_were_played(runs, monkeypatch):
    """NaN included: a robot that fell has no speed in the second half."""
    play = evaluate.run_episodes
    late = np.where(np.arange(16) < 3, np.nan, 0.5)
    monkeypatch.setattr(evaluate, "run_episodes", lambda *args: play(*args)._replace(v_x_late=late))
    first, again = (episodes.of_run(runs["flat"], TWO, 8, usual()) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert np.isnan(again.v_x_late).sum() == 3 and np.isfinite(again.power).all()


def test_another_policy_voids_the_episodes(runs, played, monkeypatch):
    """Also if it is saved while the episodes of the one before are being played."""
    folder = runs["flat"]
    kept = folder / run_folder.EPISODES
    episodes.of_run(folder, TWO, 1, usual())
    policy_file.save(folder / "policy.npz", *policy_file.load(folder / "policy.npz"))
    assert not kept.exists()
    play = evaluate.run_episodes

    def meanwhile(*arguments):
        policy_file.save(folder / "policy.npz", *policy_file.load(folder / "policy.npz"))
        return play(*arguments)

    monkeypatch.setattr(evaluate, "run_episodes", meanwhile)
    assert len(episodes.of_run(folder, TWO, 1, usual()).v_x) == 2 and not kept.exists()


@pytest.mark.parametrize(
    "data", [b"", b"no gzip", episodes.packed(np.ones((3, 17)))[:-9], gzip.compress(b"a,b\n1,2\n")]
)
def test_damaged_or_older_episodes_are_played_again(runs, played, data):
    (runs["flat"] / run_folder.EPISODES).write_bytes(data)
    assert len(episodes.of_run(runs["flat"], TWO, 1, usual()).v_x) == 2 and played == [2]


def test_a_folder_without_a_policy_says_how_many_episodes_it_has(runs, played, capsys):
    """11 commands. 22 episodes are 2 of each, which are kept, and 33 are 3 of each."""
    folder = Path(shutil.copytree(runs["flat"], "run"))
    run(folder, "--episodes", 22)
    (folder / "policy.npz").unlink()
    run(folder, "--episodes", 22)
    says = error_of(capsys, main, "table", folder, "--episodes", 33)
    assert "has 2 episodes of each" in says and "--episodes 22, not 33" in says
    assert "config.json has the command that trains it again" in error_of(
        capsys, main, "gait", folder
    )


def test_a_folder_that_cannot_be_written_is_evaluated_all_the_same(runs, played, monkeypatch):
    monkeypatch.setattr(
        run_folder, "replace_file", lambda *_: (_ for _ in ()).throw(PermissionError("read-only"))
    )
    assert len(episodes.of_run(runs["flat"], TWO, 1, usual()).v_x) == 2
    assert not (runs["flat"] / run_folder.EPISODES).exists()


# ---- a line for each run ----

OVERVIEW = dict(
    performance=1,
    fell=0.5,
    performance_nominal=1,
    fell_nominal=0.5,
    v_x=2,
    peak=0,
    power=10,
    energy=5,
    pitch=3,
    roll=0,
    v_x_at_0=2,
)


@pytest.fixture
def two_episodes(monkeypatch):
    """Of each of two commands, 0 and 0.1 m/s: performance 0.5 and 1.5, one fall, 1 and 3 m/s,
    10 W.
    """
    pairs = dict(
        performance=(0.5, 1.5),
        fell=(True, False),
        v_x=(1, 3),
        power=(10, 10),
        pitch=(-2, 4),
    )
    columns = {name: np.tile(pairs.get(name, (0, 0)), 2) for name in evaluate.Episodes._fields}
    monkeypatch.setattr(
        evaluate, "run_episodes", lambda mean, env, commands: evaluate.Episodes(**columns)
    )
    monkeypatch.setattr(evaluate, "COMMANDS", evaluate.COMMANDS[:2])


def test_the_line_of_a_run_by_hand(runs, two_episodes, capsys):
    """Means 1, 50 %, 2 m/s, 10 W, so 5 J/m; pitch |-2| and |4|, 3 degrees."""
    run(runs["flat"], "--episodes", 4)
    head, _, row = (
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in capsys.readouterr().out.splitlines()
    )
    printed = dict(zip(head, row, strict=True))
    assert (printed["run"], printed["seed"]) == ("flat", "0")
    assert {"power [W]", "energy [J/m]", "pitch [degrees]", "v_x_at_0 [m/s]", "fell"} <= set(
        printed
    )
    printed = {name.split(" [")[0]: cell for name, cell in printed.items()}
    assert {name: float(printed[name]) for name in OVERVIEW} == OVERVIEW


def test_results_keep_every_tenth_row_and_the_last(runs):
    """Of 35 rows these are the 10th, 20th, 30th and 35th. What is whole stays exact."""
    folder = Path(shutil.copytree(runs["flat"], "run"))
    rows = [f"{i},{100_001 * i},{i / 20},{60 * i},{i + 1 / 3},inf" for i in range(1, 36)]
    columns = "iteration,steps,reward,time_s,v_x,alpha"
    (folder / "metrics.csv").write_text("\n".join([columns, *rows, ""]))
    run("add", folder, "--results", "kept")
    (kept,) = record.take_out("kept/flat/run", "taken")
    assert (kept / "metrics.csv").read_text().splitlines()[::2] == [
        columns,
        "20,2000020,1,1200,20.333,inf",
        "35,3500035,1.75,2100,35.333,inf",
    ]
    assert [row["iteration"] for row in table(kept / "metrics.csv")] == ["10", "20", "30", "35"]


# ---- the record: results/ ----


def test_what_is_put_in_comes_out(runs):
    """Settings, episodes and thinned metrics, whatever other runs stand in the same tables."""
    for name in ("flat", "flat_1", "flat_ppo"):
        (runs[name] / "metrics.csv").write_text(f"iteration,{name}\n10,0.25\n")
        episodes.of_run(runs[name], TWO, 2, usual())
    record.add([runs["flat"], runs["flat_1"]], Path("kept"))
    record.add([runs["flat_ppo"]], Path("kept"))
    for name in ("flat", "flat_1", "flat_ppo"):
        (folder,) = record.take_out(f"kept/flat/{name}", "taken")
        assert run_folder.load_config(folder) == run_folder.load_config(runs[name])
        assert (folder / "metrics.csv").read_text() == f"iteration,{name}\n10,0.25\n"
        kept, before = (episodes.read(x / run_folder.EPISODES) for x in (folder, runs[name]))
        np.testing.assert_array_equal(kept, before)
        (runs[name] / "metrics.csv").unlink()
    assert [path.name for path in record.take_out("kept/flat/flat*", "all")] == [
        "flat",
        "flat_1",
        "flat_ppo",
    ]
    assert [*record.take_out("kept/flat", "none")] == []  # none is called flat-...


def test_runs_csv_says_what_the_episodes_say(runs, monkeypatch):
    """Two commands, two episodes of each, in columns of 1000 k + 1/3: random starts are k = 0 to
    3, mean 1500.3; nominal ones k = 4 to 7, mean 5500.3. Other ground does not count. In runs.csv
    with four digits.
    """
    calls = itertools.count()

    def run_episodes(policy, env, commands):
        column = [1000.0 * next(calls) + 1 / 3 for _ in commands]
        return evaluate.Episodes(*[np.array(column)] * len(evaluate.Episodes._fields))

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    for roughness, nominal in ((None, False), (None, True), (0.1, False)):
        episodes.of_run(runs["flat"], TWO, 2, usual(), roughness, nominal)
    record.add([runs["flat"]], Path("kept"))
    (row,) = table("kept/flat/runs.csv")
    assert (row["episodes"], row["performance"], row["fell_nominal"]) == ("4", "1500", "5500")
    assert (row["learner.lam"], row["env.task"]) == ("0.005", '"flat"')


def test_a_run_of_other_settings_is_not_replaced(runs, capsys):
    """One of the same settings is. Nothing is written where one of several is refused."""
    folder = Path(shutil.copytree(runs["flat"], "flat"))
    (folder / "metrics.csv").write_text("iteration\n10\n")
    run("add", folder, "--results", "kept")
    (folder / "metrics.csv").write_text("iteration\n10\n20\n")
    run("add", folder, "--results", "kept")
    assert [row["iterations"] for row in table("kept/flat/runs.csv")] == ["20"]
    before = contents(Path("kept/flat"))
    env_cfg, cfg = run_folder.load_config(folder)
    run_folder.save_config(folder, replace(env_cfg, noise=0.5), cfg, [])
    says = error_of(capsys, main, "add", runs["flat_1"], folder, "--results", "kept")
    assert "env.noise" in says and contents(Path("kept/flat")) == before


@pytest.mark.parametrize("data", [b"\x1f\x8bx", b"a,b\n1,2\n", b"run,b\nx\n", b"\xff"])
def test_a_damaged_table_is_one_line(runs, capsys, data):
    Path("kept/flat").mkdir(parents=True)
    Path("kept/flat/runs.csv").write_bytes(data)
    assert "damaged" in error_of(capsys, main, "add", runs["flat"], "--results", "kept")
    assert "damaged" in error_of(capsys, main, "fig2", "kept/flat/flat*")
    assert Path("kept/flat/runs.csv").read_bytes() == data


def test_the_record_can_be_read(capsys):
    """Every row of results/ is a run of settings that are valid today, with episodes or metrics of
    its own, and every policy can be loaded. Of one task the table of what is kept can be printed.
    """
    for task in tasks.TASKS:
        place = ROOT / "results" / task
        rows = record.read(place / record.RUNS)
        names = {row["run"] for row in rows}
        assert len(rows) == len(names) > 5
        assert all(record.settings(row)[0].task == task for row in rows)
        for file in (record.METRICS, record.EPISODES):
            assert record.groups(place / file).keys() <= names
    policies = [*ROOT.glob("results/*/policy.npz"), *ROOT.glob("results/*/*/policy.npz")]
    assert len(policies) > 3 and all(policy_file.load(policy) for policy in policies)
    run("table", ROOT / "results" / "flat" / "flat-eipo-lam0.005-seed[01]", "--episodes", 990)
    said = capsys.readouterr().out
    assert "| flat-eipo-lam0.005-seed0 | 0 | 1.466 |" in said and "seed1 | 1 | 1.444 |" in said
    assert "no run" in error_of(capsys, main, "fig2", ROOT / "results" / "flat" / "nobody")


def test_help_names_everything(capsys):
    assert main(["-h"]) == 0 and main([]) == 2
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in NAMES)
    assert "fig2" in error_of(capsys, main, "fig7")


# ---- what goes wrong ----


def test_runs_that_must_not_be_pooled_are_one_line(runs, capsys):
    """The same kind and seed twice would count one policy double; other settings are another
    experiment.
    """
    again = shutil.copytree(runs["flat"], "again")
    says = error_of(capsys, main, "fig2", runs["flat"], again, "--out", "out")
    assert str(runs["flat"]) in says and str(again) in says
    env_cfg, cfg = run_folder.load_config(runs["flat_1"])
    run_folder.save_config(Path(again), replace(env_cfg, history=3), cfg, [])
    assert "history" in error_of(capsys, main, "fig2", runs["flat"], again, "--out", "out")
    assert not list(Path("out").rglob("*"))


@pytest.mark.parametrize(
    "what, name, says",
    [
        ("fig2", "rough", ""),
        ("fig3", "flat", ""),
        ("fig4", "velocity", ""),
        ("fig6", "flat", ""),
        ("table1", "flat", ""),
        ("fig7", "flat", "fig7"),
    ],
)
def test_a_figure_without_runs_of_its_task_is_one_line(runs, capsys, what, name, says):
    """Of other tasks, or none at all; a figure that there is not is taken for a run folder."""
    assert says in error_of(capsys, main, what, *([runs[name]] if name else []), "--out", "out")
    assert not list(Path("out").rglob("*"))


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("file", ["policy.npz", "config.json"])
def test_a_damaged_run_folder_is_one_line_and_nothing_is_written(runs, capsys, file, damage):
    folder = Path(shutil.copytree(runs["flat"], "damaged"))
    DAMAGES[damage](folder / file)
    for argv in ("fig2", folder, "--episodes", 11, "--out", "out"), (folder, "--episodes", 1):
        argv = argv if argv[0] == "fig2" else ("table", *argv)
        assert "damaged" in error_of(capsys, main, *argv)
    assert not list(Path("out").rglob("*"))


@pytest.mark.parametrize(
    "text", ["not JSON", '["env", "learner"]', '{"env": {"moons": 2}, "learner": {}}']
)
def test_a_foreign_config_is_one_line(runs, capsys, text):
    folder = Path(shutil.copytree(runs["flat"], "foreign"))
    (folder / "config.json").write_text(text)
    assert "foreign" in error_of(capsys, main, "fig2", folder, "--out", "out")
    Path("empty").mkdir()
    assert "empty" in error_of(capsys, main, "fig2", "empty", "--out", "out")


TYPES = [
    ("learner", "num_envs", "4"),
    ("env", "history", 2.5),
    ("env", "history", True),
    ("env", "friction", 0.5),
    ("env", "friction", ["a", 1]),
    ("learner", "hidden", [8.5]),
    ("learner", "lam", None),
    ("learner", "lam", [1]),
    ("env", "stagger", 1),
    ("learner", "mirror", "yes"),
    ("env", "task", ["flat"]),
    ("env", "max_power", "9"),
]
RANGES = [
    ("env", "noise", float("nan")),
    ("env", "motor_strength", [-1, -1]),
    ("env", "task", "moon"),
    ("env", "tiles", 10**6),
    ("learner", "lr", -1.0),
    ("learner", "num_envs", 10**12),
]


@pytest.mark.parametrize("part, name, x", TYPES + RANGES)
def test_a_setting_of_another_type_or_beyond_its_range_is_one_line(runs, capsys, part, name, x):
    """In config.json, and for the world also in the policy."""
    folder = Path(shutil.copytree(runs["flat"], "run"))
    record = json.loads((folder / "config.json").read_text())
    record[part][name] = x
    (folder / "config.json").write_text(json.dumps(record))
    says = error_of(capsys, main, "fig2", folder, "--out", "out")
    assert "run/config.json" in says and name in says
    if part == "env":
        (folder / "config.json").write_bytes((runs["flat"] / "config.json").read_bytes())
        change_npz(folder / "policy.npz", config=np.array(json.dumps(record["env"])))
        says = error_of(capsys, main, "fig2", folder, "--out", "out")
        assert "run/policy.npz" in says and name in says


def test_whole_numbers_stand_for_floats_in_a_config(runs):
    """As another program may write them: 0 for 0.0, also for the lambda of PPO."""
    folder = Path(shutil.copytree(runs["flat_ppo_0"], "run"))
    record = json.loads((folder / "config.json").read_text())
    record["learner"]["lam"], record["env"]["roughness"] = 0, [0, 0]
    (folder / "config.json").write_text(json.dumps(record))
    assert run_folder.load_config(folder) == run_folder.load_config(runs["flat_ppo_0"])


@pytest.mark.parametrize(
    "changes",
    [
        dict(actor__0__W=np.ones((3, 3), np.float32)),
        dict(actor__1__b=np.ones(11, np.float32)),
        dict(actor__2__W=np.ones((12, 5), np.float32), actor__2__b=np.ones(5, np.float32)),
        dict(log_std=np.ones(3)),
        dict(estimator__0__W=None),
        dict(actor__0__W=np.full((91, 8), np.nan, np.float32)),
        dict(estimator__0__b=np.full(8, np.inf, np.float32)),
        dict(actor__0__W=np.full((91, 8), "x")),
        dict(actor__0__W=np.full((91, 8), 1e300)),
        dict(actor__0__W=np.ones((91, 8), complex)),
        dict(config=np.array("[1]")),
        dict(config=np.array(7)),
        dict(config=np.array(json.dumps(dict(task="flat", history=3)))),
        dict(config=np.array("[" * 5000)),
    ],
    ids=lambda x: "-".join(x),
)
def test_a_policy_that_fits_nothing_is_one_line(runs, capsys, changes):
    """Widths that do not fit each other, 12 joints or H * 44 entries; NaN, infinities and text; no
    config.
    """
    folder = Path(shutil.copytree(runs["flat"], "run"))
    change_npz(folder / "policy.npz", **changes)
    assert "run/policy.npz" in error_of(capsys, main, "table", folder, "--episodes", 1)


@pytest.mark.parametrize(
    "old, new",
    [
        (b"(100, 60)", b"(100, 50)"),
        (b"(100, 60)", b"(100, 60("),
        (b"'<f4'", b"'<f2'"),
        (b"'descr'", b"'descs'"),
        (b"\x93NUMPY", b"\x93NUMPX"),
        (b"(100", b"(\xff00"),
        (b"\x01\x00v", b"\x01\x00w"),
        (b"{'d", b"[[d"),
    ],
)
def test_a_damaged_header_of_an_array_is_one_line(tmp_path, old, new):
    """Bytes of an npy header within an npz, which NumPy reads as Python. A smaller shape it took
    for granted.

    The array has 24 kB. Smaller ones zipfile reads in one piece, and so finds the wrong checksum
    itself.
    """
    np.savez(tmp_path / "a.npz", a=np.ones((100, 60), np.float32))
    data = (tmp_path / "a.npz").read_bytes()
    assert old in data and len(old) == len(new)
    (tmp_path / "a.npz").write_bytes(data.replace(old, new))
    with pytest.raises(ValueError, match=r"\A.*a\.npz is damaged.*\Z"):
        run_folder.read_npz(tmp_path / "a.npz")


def test_what_is_no_run_folder_is_left_out_and_named(runs, capsys, scripted, unsaved):
    """As `evaluate.py results/flat/*` has it. The rest is evaluated; a path that does not exist is
    a mistake.
    """
    (Path("bare") / "deep").mkdir(parents=True)
    Path("page.md").write_text("# A page")
    unplayed = Path(shutil.copytree(runs["flat_ppo"], "unplayed"))
    (unplayed / "policy.npz").unlink()
    played = Path(shutil.copytree(runs["rough"], "played"))
    (played / "policy.npz").rename(played / run_folder.EPISODES)
    others = ["bare", "page.md", str(unplayed)]
    run("fig4", *others, runs["flat"], played)
    (line,) = capsys.readouterr().err.splitlines()
    assert "left out" in line and line.endswith(", ".join(others))
    assert distinct(unsaved[0][0], "task") == [("flat",), ("rough",)]
    assert all(name in error_of(capsys, main, "fig2", *others) for name in others)
    assert "nowhere" in error_of(capsys, main, "fig2", runs["flat"], "nowhere")


def test_runs_of_several_tasks_have_their_own_columns(runs, scripted, capsys):
    """`velocity` has no commands, and so no speed for each of them: another head is printed."""
    folders = [Path(shutil.copytree(runs[name], name)) for name in ("velocity", "flat", "flat_1")]
    for folder in folders:
        rows = [f"{i},{100 * i},1,{i}" for i in range(1, 30)]
        (folder / "metrics.csv").write_text("\n".join(["iteration,steps,reward,time_s", *rows, ""]))
    run(*folders)
    lines = [line.split("|") for line in capsys.readouterr().out.splitlines()]
    assert [line[1].strip() for line in lines] == [
        "run",
        "---",
        "velocity",
        "run",
        "---",
        "flat",
        "flat_1",
    ]
    assert len(lines[0]) == len(lines[2]) < len(lines[3]) == len(lines[5]) == len(lines[6])


def test_a_fifth_task_needs_no_entry_but_its_own(runs, monkeypatch):
    """README: an entry in tasks.TASKS, and `evaluate.py RUN` knows it. Tables of evaluate.py may
    lack it.
    """
    monkeypatch.setitem(tasks.TASKS, "fifth", tasks.Task(rewards.flat, {}, {}))
    folder = make_run(Path("fifth"), "fifth")
    (folder / "metrics.csv").write_text("iteration,steps,reward,time_s\n1,10,1,1\n")
    run(folder, "--episodes", 11)
    # which know any task, and take their time
    for what in FIGURES.keys() - {"gait", "robust"}:
        assert main([what, "fifth", "--episodes", "11"]) == 2, what


@pytest.mark.parametrize("episodes", [0, -3, 10**6])
def test_too_few_or_too_many_episodes_are_one_line(runs, capsys, episodes):
    assert f"--episodes is {episodes}" in error_of(
        capsys, main, "table", runs["flat"], "--episodes", episodes
    )


# ---- what is written ----


@pytest.mark.parametrize("name", ["fig2.csv", "fig2.png"])
def test_outputs_are_tried_before_anything_is_played(runs, scripted, capsys, name):
    """A file in the way of the folder, a folder in the way of a file, a full disk. What was there
    before stays.
    """
    Path("file").write_text("in the way")
    assert "file" in error_of(capsys, main, "fig2", runs["flat"], "--out", "file")
    Path("full").mkdir()
    (Path("full") / name).write_text("before")
    with full_disk(10_000):
        assert "full/fig2.csv" in error_of(capsys, main, "fig2", runs["flat"], "--out", "full")
    assert contents(Path("full")) == {name: b"before"}
    (Path("out") / name).mkdir(parents=True)
    assert f"out/{name}" in error_of(capsys, main, "fig2", runs["flat"], "--out", "out")
    assert scripted == []


def test_a_disk_that_fills_up_meanwhile_leaves_both_files_as_they_were(
    runs, scripted, capsys, monkeypatch
):
    """The CSV has 1 kB and would still fit, the PNG 30 kB; a CSV beside the figure of other numbers
    would mislead.
    """
    Path("fig2.csv").write_text("before")
    Path("fig2.png").write_bytes(b"before")
    with monkeypatch.context() as patch, full_disk(8_000):
        patch.setattr(run_folder, "check_writable", lambda path: None)
        assert "large" in error_of(capsys, main, "fig2", runs["flat"])
    assert (Path("fig2.csv").read_text(), Path("fig2.png").read_bytes()) == ("before", b"before")
    run("fig2", runs["flat"])
    assert 500 < Path("fig2.csv").stat().st_size < 8000 < Path("fig2.png").stat().st_size


# ---- sweeps ----


@pytest.fixture
def sweep(monkeypatch, capsys, tmp_path):
    """Ask for the commands of a sweep where no run is kept yet; returns the lines."""
    monkeypatch.setattr(record, "RESULTS", tmp_path / "results")
    # reads the source again for each line
    monkeypatch.setattr(flags, "describe", functools.cache(flags.describe))

    def ask(*argv):
        run("missing", *argv)
        return capsys.readouterr().out.split("\n")[:-1]

    return ask


def settled(line):
    """tasks.Config, eipo.Config and run folder of a line, which has to be one that train.py
    accepts.
    """
    python, script, *argv = shlex.split(line)
    assert (python, script) == ("python", "train.py")
    options, *given = flags.parse(argv)
    env_cfg, cfg = flags.settle(*given)
    flags.check_learner(cfg)
    return env_cfg, cfg, train.run_path(flags.Options(**options), env_cfg, cfg)


def kinds(lines):
    """Task, algo, lambda and seed of each line."""
    return [(env_cfg.task, cfg.algo, cfg.lam, cfg.seed) for env_cfg, cfg, _ in map(settled, lines)]


PPO = [("ppo", lam) for lam in LAMBDAS]


def test_table1_takes_thirty_three_runs(sweep, capsys):
    """Three seeds x (EIPO twice and the nine lambdas of Eq. (10)), a folder for each. EIPO's
    lambda_0 is V-D's 0.0002.

    One EIPO has as many robots as PPO, 128, and one as many per policy, 256.
    """
    lines = sweep("table1")
    assert kinds(lines) == [
        ("velocity", *kind, seed) for kind in [("eipo", 0.0002)] * 2 + PPO for seed in range(3)
    ]
    assert [settled(line)[1].num_envs for line in lines] == [128] * 3 + [256] * 3 + [128] * 27
    assert len({settled(line)[2] for line in lines}) == len(lines) == 33
    assert "--num-envs" in error_of(capsys, main, "missing", "table1", "--num-envs", "64")
    assert not any("--resume" in line for line in lines)


@pytest.mark.parametrize(
    "what, expected, seeds",
    [
        ("fig2", [("flat", "eipo", 0.005), ("flat", "ppo", 0.005), ("flat", "ppo", 0)], 3),
        ("fig3", [("rough", "eipo", 0.0002), ("rough", "ppo", 0.005), ("rough", "ppo", 0)], 3),
        ("fig6", [("velocity", "eipo", 0.0002), ("velocity", "ppo", 0.01)], 3),
        (
            "fig4",
            [
                (task, *k)
                for task, lam in (("flat", 0.005), ("rough", 0.0002))
                for k in [("eipo", lam), *PPO]
            ],
            1,
        ),
        (
            "fig5",
            [("curriculum", "eipo", 0.005)] * 2
            + [("curriculum", "ppo", 0.005), ("curriculum", "ppo", 0)],
            1,
        ),
    ],
)
def test_runs_of_the_figures(sweep, what, expected, seeds):
    """V-A, V-B, VI: EIPO against the best and the least lambda, against 0.01 on the robot; Fig. 4
    against all.

    Three seeds, but one of Fig. 4, which has 20 runs, and of Fig. 5, whose runs are long and differ
    in cost and reward.
    """
    lines = sweep(what)
    assert kinds(lines) == [(*kind, seed) for kind in expected for seed in range(seeds)]
    assert len({settled(line)[2] for line in lines}) == len(lines)


def fake_run(line, iterations, checkpoint=True):
    """What the run of a line leaves that has got so far: settings, a row per iteration, a
    checkpoint; its folder.
    """
    env_cfg, cfg, folder = settled(line)
    folder.mkdir(parents=True)
    run_folder.save_config(folder, env_cfg, cfg, [])
    (folder / "metrics.csv").write_text(
        "iteration\n" + "".join(f"{i + 1}\n" for i in range(iterations))
    )
    if checkpoint:
        (folder / "checkpoint.npz").write_bytes(b"")
    return folder


def test_finished_runs_are_left_out_and_interrupted_ones_resumed(sweep):
    """Of four iterations seed 0 has all, seed 1 three, seed 2 none."""
    every = sweep("fig6", "--iterations", 4)
    assert fake_run(every[0], 4) == Path("runs/velocity-eipo-lam0.0002-seed0")
    fake_run(every[1], 3)
    assert sweep("fig6", "--iterations", 4) == [f"{every[1]} --resume", *every[2:]]


@pytest.mark.parametrize("checkpoint", [True, False])
def test_runs_that_are_running_are_left_out(sweep, checkpoint):
    every = sweep("fig6")
    folder = fake_run(every[0], 3, checkpoint)
    with run_folder.lock(folder):
        assert sweep("fig6") == every[1:]
    assert len(sweep("fig6")) == len(every)


def test_a_run_that_results_keep_is_done(sweep, tmp_path):
    """Of four iterations, every second row is kept. Other settings, or fewer iterations, are
    another run.
    """
    every = sweep("fig6", "--iterations", 4)
    folder = fake_run(every[0], 4)
    record.add([folder])
    shutil.rmtree(folder)
    assert sweep("fig6", "--iterations", 4) == every[1:]
    assert len(sweep("fig6", "--iterations", 5)) == 6
    assert len(sweep("fig6", "--iterations", 4, "--noise", 0)) == 6


def test_ppo_of_another_step_of_alpha_is_the_same_run(sweep, tmp_path):
    """PPO's alpha stands still, so its runs with the paper's step are those of ours. EIPO's are
    not.
    """
    every = sweep("fig2", "--iterations", 4)
    for line in every[2:4]:  # EIPO's last seed and the first of PPO(0.005)
        folder = fake_run(f"{line} --lr-alpha 0.01", 4)
        record.add([folder])
        shutil.rmtree(folder)
    assert sweep("fig2", "--iterations", 4) == [*every[:3], *every[4:]]


def test_eipo_of_another_step_of_alpha_has_a_name_of_its_own():
    """Two rules in one figure would otherwise be one line of it. PPO reads no step of alpha."""
    world, printed = tasks.task_config("flat"), eipo.Config(lr_alpha=0.01)
    assert sweeps.kind(world, eipo.Config(lr_alpha=0.5)) == "EIPO"
    assert sweeps.kind(world, printed) == "EIPO at eta_alpha 0.01"
    assert sweeps.kind(world, replace(printed, algo="ppo")) == "PPO(0.005)"
    # the usual step there (D38)
    velocity = eipo.Config(lam=0.0002, lr_alpha=0.01)
    assert sweeps.kind(tasks.task_config("velocity"), velocity) == "EIPO"


def test_a_finished_run_is_resumed_for_more_iterations(sweep):
    """Finished is what has as many iterations as are asked for: by default 600."""
    folder = fake_run(sweep("fig2")[-1], 599)
    assert sweep("fig2")[-1].endswith("--lam 0 --seed 2 --resume")
    (folder / "metrics.csv").write_text("iteration\n1\n600\n")  # rows may be lost
    assert len(sweep("fig2")) == 8
    assert sweep("fig2", "--iterations", 601)[-1].endswith(
        "--lam 0 --seed 2 --iterations 601 --resume"
    )


def test_a_run_of_other_settings_is_one_line(sweep, capsys):
    """What lies in the run folder is not the run that the figure needs."""
    fake_run(sweep("fig2", "--noise", 0)[0], 600)
    assert "--noise" in error_of(capsys, main, "missing", "fig2")


@pytest.mark.parametrize("flag", ["--task", "--algo", "--lam", "--seed", "--out", "--resume"])
def test_flags_that_the_sweep_sets_are_one_line(capsys, flag):
    """Given to every run, they would make several runs the same."""
    assert flag in error_of(capsys, main, "missing", "fig2", flag, "1")


def test_a_run_killed_before_its_first_checkpoint_can_be_started(sweep):
    """It has rows of metrics and nothing to resume; whatever its line is, train.py must
    accept it.
    """
    fake_run(sweep("fig2")[0], 30, checkpoint=False)
    options, *given = flags.parse(shlex.split(sweep("fig2")[0])[2:])
    train.prepare(flags.Options(**options), *given)


def test_flags_pass_through(sweep):
    """With a value, with two, and without; they reach every run and do not change which runs there
    are.
    """
    lines = sweep("fig6", "--threads", 1, "--friction", 0.5, 1, "--no-stagger")
    assert (
        all(line.endswith(" --threads 1 --friction 0.5 1 --no-stagger") for line in lines)
        and len(lines) == 6
    )
    assert kinds(lines) == kinds(sweep("fig6"))


@pytest.mark.parametrize("argv", [["fig7"], []])
def test_commands_of_what_is_no_sweep_are_one_line(capsys, argv):
    assert "table1" in error_of(capsys, main, "missing", *argv)
    assert capsys.readouterr().out == ""


def test_flags_that_train_does_not_know_are_one_line(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["missing", "fig2", "--speed", "3"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "--speed" in line


@pytest.mark.skipif(not shutil.which("xargs"), reason="needs xargs")
def test_a_sweep_trains_as_the_page_says(sweep, capsys):
    """EIPO and PPO(0.005) of Fig. 2: xargs, as on the page, starts what the lines say. A python of
    our own writes it down. Once the two are trained, seven of nine commands are left.
    """
    flags = [*TINY, "--iterations", 2, "--threads", 1]
    lines = sweep("fig2", *flags)
    Path("bin").mkdir()
    Path("bin/python").write_text('#!/bin/sh\necho python "$@" >> said\n')
    Path("bin/python").chmod(0o755)
    path = os.pathsep.join([str(Path("bin").absolute()), os.environ["PATH"]])
    pipes = dict(input=f"{lines[0]}\n{lines[3]}\n", text=True, capture_output=True)
    options = dict(shell=True, env=os.environ | dict(PATH=path)) | pipes
    done = subprocess.run("xargs -P 2 -I CMD sh -c CMD", **options)
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(Path("said").read_text().splitlines()) == sorted([lines[0], lines[3]])
    for line in (lines[0], lines[3]):
        assert train.main(shlex.split(line)[2:]) == 0
    names = ["flat-eipo-lam0.005-4envs-seed0", "flat-ppo-lam0.005-4envs-seed0"]
    assert sorted(folder.name for folder in Path("runs").iterdir()) == names
    assert all((Path("runs") / name / "policy.npz").exists() for name in names)
    capsys.readouterr()
    assert sweep("fig2", *flags) == [lines[1], lines[2], *lines[4:]]


# ---- lab/objective.py ----


def test_the_policy_that_eq2_prefers():
    """At 0.01 the slow one is worth 0.5 - 0.01 x 50 = 0 and the fast one 2 - 1.5 = 0.5; at 0.02 it
    is -0.5 and -1.
    """
    policies = {"velocity-ppo-lam0.01-seed0": (0.5, 50.0, 0.4), "fast": (2.0, 150.0, 2.25)}
    *_, at_001, at_002 = objective.rows(policies)
    assert (at_001, at_002) == (
        "0.01,0.000,nan,nan,fast,0.500,2.25,150",
        "0.02,nan,nan,nan,velocity-ppo-lam0.01-seed0,-0.500,0.40,50",
    )


def test_objective_csv_is_that_of_the_kept_episodes(capsys):
    run("objective", ROOT / "results" / "velocity" / "*")
    kept = (ROOT / "results" / "velocity" / "objective.csv").read_text()
    assert capsys.readouterr().out == kept


# ---- lab/regions.py ----


def test_regions_of_figure_5():
    """Straight ahead A has (1 + 0.5) / 2 = 0.75, (100 + 300) / 2 = 200 W, a half ends; it is ahead
    at 0 m/s alone.
    """
    names = "run", "v_x_asked", "yaw_asked", "performance", "power", "fell"
    rows = [
        ("A", 0, 0, 1, 100, 0),
        ("A", 1.5, 0, 0.5, 300, 1),
        ("A", 1, -2, 0.25, 500, 0.25),
        ("A", -1, 0, 0, 1, 1),
        ("A", 4, 0, 0, 2, 1),
        ("A", 0, 5, 0, 3, 1),
    ]
    rows += [("B", *row[1:3], 0.75, 200, 0) for row in rows]
    _, _, ahead, *_, better, less = regions.table(
        [dict(zip(names, row, strict=True)) for row in rows], rival="B"
    )
    assert ahead == "| straight ahead, 0 to 1.5 m/s | 2 | 0.75, 200 W, 50 % | 0.75, 200 W, 0 % |"
    assert (better, less) == (
        "| performs better than B | | 1 | 0 |",
        "| draws less than B | | 4 | 0 |",
    )
    page = (ROOT / "results" / "curriculum" / "README.md").read_text()
    assert all(
        line in page for line in regions.table(table(ROOT / "results" / "curriculum" / "fig5.csv"))
    )


# ---- pi beside pi' ----


def test_gap_is_measured_with_noise_and_without(tmp_path, capsys, monkeypatch):
    """A checkpoint says the same twice. Noise changes what it says. Rewards are at most 1.5."""
    monkeypatch.setattr(gap, "STEPS", 5)
    monkeypatch.setattr(gap, "WARM_UP", 2)
    out = tmp_path / "run"
    assert train.main([*TINY, "--iterations", "1", "--out", str(out)]) == 0
    rows = [gap.row(out) for _ in range(2)]
    assert rows[0] == rows[1]
    (row, _) = rows
    assert all(
        0 < row[f"{noise}_{side}"] <= 1.5
        for noise in ("noisy", "quiet")
        for side in ("pi", "prime")
    )
    assert row["noisy_gap"] != row["quiet_gap"]
    trained = metrics.read(out)["gap"][0]
    assert row["training_gap"] == trained
    assert row["same_sign"] == (np.sign(row["quiet_gap"]) == np.sign(row["noisy_gap"]))


def test_mean_reward_leaves_out_the_first_second(monkeypatch):
    """Rewards 0, 1, ..., 549 times (1, 3): the last 500 have the mean (50 + 549) / 2 x 2 = 599."""

    class Counting:
        t = -1

        def step(self, action):
            self.t += 1
            return self.t, self.t * np.array([1.0, 3.0]), None, None, None

    monkeypatch.setattr(evaluate, "mean_action", lambda params, obs: obs)
    assert gap.mean_reward(Counting(), None, (0, None), noisy=False) == 599


def test_gap_of_ppo_is_one_line(runs, capsys):
    assert "has no pi'" in error_of(capsys, main, "gap", runs["flat_ppo"])
