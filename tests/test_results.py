"""`python -m results`: which episodes end in which cell of which CSV, and the tables."""

import gzip
import json
import os
import shutil
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from support import ROOT, error_of, make_run

import eipo
import evaluate
import go1_env
import policy
import tasks
from networks import MLP
from results import claims, figures, tables, weights
from results.__main__ import main
from results.tables import by_group
from runtime import checkpoint, run_folder
from runtime.cli import Refused
from runtime.flags import settle

RESULTS = ROOT / "results"


def made(run="r", task="flat", speed=None, **columns):
    """A Run with the usual settings of a task, but for those that are given. Other columns are of
    its episodes, which are of random starts and 0 where nothing is given.
    """
    settings = asdict(tasks.task_config(task)) | asdict(eipo.Config(**tasks.TASKS[task].learner))
    for name in columns.keys() & settings.keys() - {"start_spread"}:
        settings[name] = columns.pop(name)
    n = max((len(x) for x in columns.values()), default=0)
    world = dict(start_spread=0.5) | dict.fromkeys((*tables.ASKED, *evaluate.Episodes._fields), 0)
    e = {x: np.broadcast_to(columns.get(x, y), n).copy() for x, y in world.items()} if n else {}
    return tables.Run(run, settings, {}, dict(alpha=[200, 400]), e, {}, speed or {}, {})


def cells(rows, *columns):
    """Some columns of rows, each combination once."""
    return list(dict.fromkeys(tuple(row[x] for x in columns) for row in rows))


# ---- a cell by hand ----


def eight(seed, n=8, **settings):
    """n episodes of each of the commands 0, 0.1, ... 1: at command i they perform at 100 i + 8 seed
    + 0, 1, ..., and 15 times that is their power; they are 0.25 faster; the first one falls.
    """
    i, k = np.repeat(np.arange(11), n), np.tile(np.arange(n), 11)
    performance = 100 * i + 8 * seed + k
    columns = dict(asked_v_x=i / 10, performance=performance, power=15.0 * performance)
    columns |= dict(v_x=performance + 0.25, fell=k == 0)
    return made(f"r{seed}", seed=seed, **columns, **settings)


def fig2(runs):
    """The rows of Figure 2."""
    return figures.fig2(runs)[0]


def test_a_cell_is_of_its_own_command_and_pools_the_seeds():
    """Two seeds of eight: 100 i + 0 ... 15, mean 7.5; each seed alone 3.5 and 11.5. One robot of
    eight falls.
    """
    rows = fig2([eight(1), eight(0)])
    for column, x in (("", 7.5), ("_seeds_low", 3.5), ("_seeds_high", 11.5)):
        assert [row[f"performance{column}"] for row in rows] == [100 * i + x for i in range(11)]
    assert cells(rows, "run", "seeds", "episodes", "fell") == [("EIPO", 2, 8, 0.125)]


def test_every_seed_counts_with_as_many_episodes():
    """Of eight and four episodes the first four: 0 ... 3 and 8 ... 11 have the mean 5.5. One of the
    first seed's four falls.
    """
    other = eight(1, n=4)
    other.episodes["fell"][:] = False
    rows = fig2([eight(0), other])
    assert rows[0]["performance"] == 5.5 and cells(rows, "episodes", "fell") == [(4, 1 / 8)]


def test_energy_is_power_over_speed_and_one_seed_says_nothing_of_the_next():
    """D27. At i = 0 power is 15 x 3.5 in the mean and speed 3.75, so 14 J/m."""
    rows = fig2([eight(0)])
    assert rows[0]["energy"] == 14
    assert np.isnan([rows[0][f"performance_seeds_{end}"] for end in ("low", "high")]).all()


def test_the_lighter_band_is_over_seeds():
    """At the command 0 the seeds of `eight` are at 3.5 and 11.5."""
    rows, figure = figures.fig2([eight(1), eight(0)])
    bands = figure.axes[0].collections
    edges = [band.get_paths()[0].vertices for band in bands]
    found = [set(x[x[:, 0] == 0, 1]) for x in edges]
    over_episodes = {rows[0][f"performance_{end}"] for end in ("low", "high")}
    assert found == [over_episodes, {3.5, 11.5}] and over_episodes != {3.5, 11.5}
    assert [band.get_alpha() for band in bands] == [0.2, 0.1]


def test_fig4_has_a_panel_for_flat_and_for_rough_ground():
    """On flat ground the score's axis begins at 1.2, on rough ground at 0.8."""
    rows, figure = figures.fig4([eight(0), eight(0, task="rough")])
    assert cells(rows, "group", "run") == [
        (f"{task}, 600 iterations", "EIPO") for task in ("flat", "rough")
    ]
    drawn = [axes.lines[0].get_ydata().tolist() for axes in figure.axes]
    assert drawn == 2 * [[100 * i + 3.5 for i in range(11)]]
    assert [axes.get_ylim()[0] for axes in figure.axes] == [1.2, 0.8]


def test_table1_has_interquartile_means_beside_the_papers():
    """D26. Peaks 0 ... 6 and 1000: the middle half 2, 3, 4, 5 has the mean 3.5. The paper has 2.86
    for EIPO, and nothing for another lambda_0. Starts from the nominal pose do not count.
    """
    fast = [made("a", "velocity", peak=[0, 1, 2, 3, 4, 5, 6, 1000])]
    fast += [made("b", "velocity", peak=[1.0, 1, 9, 9], start_spread=[0.5, 0.5, 0, 0], lam=0.01)]
    rows, figure = figures.table1(fast)
    assert cells(rows, "run", "peak", "paper")[0] == ("EIPO", 3.5, 2.86)
    (bars,) = (x for x in figure.axes[0].containers if hasattr(x, "has_xerr"))
    drawn = bars[2][0].get_segments()[0]
    assert drawn == pytest.approx(np.array([[rows[0][f"peak_{x}"], 1] for x in ("low", "high")]))
    assert cells(rows, "run", "peak")[1] == ("EIPO from 0.01", 1) and np.isnan(rows[1]["paper"])
    printed = {"EIPO": 2.86, "PPO(0)": 2.12, "PPO(0.0001)": 1.55, "PPO(0.0002)": 1.49}
    printed |= {"PPO(0.0005)": 1.58, "PPO(0.001)": 1.64, "PPO(0.002)": 1.58, "PPO(0.005)": 1.62}
    assert printed | {"PPO(0.01)": 1.45, "PPO(0.02)": 1.37} == figures.TABLE1


def test_fig5_draws_each_number_at_its_command():
    """Performance 1000 v_x + yaw: rows of the panel are 0.5 m/s apart, so 500, and columns 1. They
    go from -1 m/s and -5 rad/s to 4 m/s and 5 rad/s.
    """
    v_x, _, yaw = tables.GRID.T
    columns = dict(asked_v_x=v_x, asked_yaw=yaw, performance=1000 * v_x + yaw)
    _, figure = figures.fig5([made(task="curriculum", **columns)])
    mesh = figure.axes[0].collections[0]
    value, (x, y) = mesh.get_array(), np.moveaxis(mesh.get_coordinates(), -1, 0)
    assert value.shape == (11, 11) and (value[0, 0], value[-1, -1]) == (-1005, 4005)
    for axis, (step, width, at) in enumerate(((500, 0.5, y), (1, 1, x))):
        assert np.allclose(np.diff(value, axis=axis), step)
        assert np.allclose(np.diff(at, axis=axis), width)


def test_fig5_outlines_what_the_grid_had_reached():
    """At the start that is -1 to 1 m/s and -1 to 1 rad/s. Squares have 0.5 m/s by 1 rad/s, so the
    line goes from -1.25 to 1.25 and from -1.5 to 1.5. One more cell, of 1 to 1.5 m/s and 0 to 0.5
    rad/s, adds the square at (1.5, 0) alone, whose line goes up to 1.75 and from -0.5 to 0.5.
    """
    v_x, _, yaw = tables.GRID.T
    columns = dict(asked_v_x=v_x, asked_yaw=yaw, performance=v_x, task="curriculum")
    grid = tasks.Grid()
    first = made("a", **columns)._replace(reached=tables.cells_of(grid.weights))
    grid.weights[4, 20] = 0.2
    more = made("b", lam=0.01, **columns)._replace(reached=tables.cells_of(grid.weights))
    _, figure = figures.fig5([first, more, made("c", lam=0.02, **columns)])
    for axes, top in zip(figure.axes[:6], 2 * (1.25, 1.75, None), strict=True):
        _, *lines = axes.collections
        segments = [line for lines in lines for line in lines.get_segments()]
        if top is None:
            assert segments == []
            continue
        points = np.concatenate(segments)  # (yaw, v_x)
        assert points.min(0).tolist() == [-1.5, -1.25] and points.max(0).tolist() == [1.5, top]
        assert {x for x, y in points if y == top} <= {-1.5, -0.5, 0.5, 1.5}
        # around 5 by 3 squares, and twice the height of the one on top
        length = sum(np.abs(np.diff(line, axis=0)).sum() for line in segments)
        assert length == 2 * 2.5 + 2 * 3 + 2 * (top - 1.25)


def test_alpha_over_iterations_beside_one_over_lambda():
    """PPO(0.005), which scores 1.25 on 100 W, has the objective of an alpha of 200."""
    played = dict(asked_v_x=[0.5, 0.5], start_spread=[0.5, 0], performance=[1.25, 0])
    played |= dict(power=[100, 0], algo="ppo")
    ppo = [made("p", lam=0.005, **played), made("q", lam=0.0, **played)]
    history = dict(iteration=[10, 20], alpha=[200, 400])
    rows, figure = figures.alpha([made("r")._replace(metrics=history), *ppo])
    assert [(row["run"], row["iteration"], row["alpha"]) for row in rows] == [
        ("r", 10, 200),
        ("r", 20, 400),
    ]
    dotted = [line for line in figure.axes[0].lines if line.get_linestyle() == ":"]
    assert [line.get_ydata()[0] for line in dotted] == [200]
    assert [text.get_text() for text in figure.axes[0].texts] == [" PPO(0.005):\n 1.25 on 100 W"]
    assert not figure.axes[0].get_legend()


def test_alpha_of_two_kinds_of_eipo_has_two_kinds_of_lines():
    """Two runs with the usual step of alpha, and one with another step."""
    history = dict(iteration=[10, 20], alpha=[200, 400])
    runs = [made("r", seed=0), made("s", seed=1), made("t", lr_alpha=0.444)]
    _, figure = figures.alpha([run._replace(metrics=history) for run in runs])
    (axes,) = figure.axes
    assert [line.get_linestyle() for line in axes.lines] == ["-", "-", "--"]
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert words == ["EIPO", "EIPO, lr_alpha 0.444"]


def seeds(kind, scores, powers, **settings):
    """Runs at 0.5 m/s, one for each score and power, with alpha 150 and then 250 at the end."""
    history = dict(iteration=np.array([10, 560, 600]), alpha=np.array([9000, 150, 250]))
    world = dict(asked_v_x=[0.5, 0.5], start_spread=[0.5, 0], v_x=[0.5, 0.5])
    found = []
    for seed, (score, power) in enumerate(zip(scores, powers, strict=True)):
        played = dict(performance=[score, score], power=[power, power], seed=seed)
        run = made(f"{kind}{seed}", **world, **played, **settings)
        found.append(run._replace(metrics=history, row=dict(commit="c", resumed="")))
    return found


def test_weights_by_hand():
    """PPO(0) scores 1.4 and 1.5 on 400 W, PPO(0.005) 1.43 and 1.43 on 100 W, EIPO 1.44 on 200 W.

    Squares within arms are 2 x 0.05^2 = 0.005, over 1 + 1 + 0 degrees of freedom, so s = 0.05, and
    t of 95 % and 2 is 4.3027. PPO(0.005) less PPO(0) is 1.43 - 1.45 = -0.02, +- 4.3027 x 0.05 x
    sqrt(1/2 + 1/2) = 0.215: good, not surely. So the least power is 100 W, and EIPO draws twice as
    much. Its difference is -0.01, +- 4.3027 x 0.05 x sqrt(1 + 1/2) = 0.263. Powers do not spread.
    Its last lambda is 1 / 200 = 0.005, a good one.

    PPO(0.005) with other settings, which scores 1.3 and 1.5, is compared, too, but no weight, and
    its spread does not count: 1.4 - 1.45 = -0.05, and 1.4 - 1.43 = -0.03, +- 0.215. Nor does that
    of EIPO with other settings, which scores 1.3 and 1.6: 1.45 - 1.45 = 0, and 1.45 - 1.43 = 0.02.
    Both are compared with the same without these settings: 1.45 - 1.44 = 0.01, +- 0.263, and -0.03.
    """
    runs = seeds("a", [1.4, 1.5], [400, 400], algo="ppo", lam=0.0)
    runs += seeds("b", [1.43, 1.43], [100, 100], algo="ppo", lam=0.005)
    runs += seeds("c", [1.44], [200])
    runs += seeds("d", [1.3, 1.5], [100, 100], algo="ppo", lam=0.005, num_envs=128)
    runs += seeds("e", [1.3, 1.6], [200, 200], num_envs=512)
    lines = [line.strip("| ").replace(" | ", "; ") for line in weights.answers(runs)]
    assert lines[2:7] == [
        "EIPO; 1.440; -0.010 [-0.273, +0.253]; open; 200 W; 2.00 [2.00, 2.00]; 1 of 1; "
        "+0.010 [-0.253, +0.273]; 1",
        "EIPO, num_envs 512; 1.450; +0.000 [-0.215, +0.215]; open; 200 W; 2.00 [2.00, 2.00]; "
        "2 of 2; +0.020 [-0.195, +0.235]; 2",
        "PPO(0); 1.450; ; best; 400 W; ; ; ; 2",
        "PPO(0.005); 1.430; -0.020 [-0.235, +0.195]; good; 100 W; ; ; ; 2",
        "PPO(0.005), num_envs 128; 1.400; -0.050 [-0.265, +0.165]; not good; 100 W; ; ; "
        "-0.030 [-0.245, +0.185]; 2",
    ]
    beside = [line for line in lines if " beside " in line]
    assert beside[:2] == [
        "EIPO, num_envs 512, scores +0.010 [-0.253, +0.273] beside EIPO, "
        "on 1.00 [1.00, 1.00] times the power.",
        "PPO(0.005), num_envs 128, scores -0.030 [-0.245, +0.185] beside PPO(0.005), "
        "on 1.00 [1.00, 1.00] times the power.",
    ]
    assert len(beside) == 4  # and once more from nominal starts


def test_weights_gives_a_start_and_a_setting_one_colour_each():
    """On both tasks: 512 robots have their own, whatever lambda_0 they have."""
    plain = [dict(lam=0.005), dict(lam=0.02), dict(lam=0.02, num_envs=512)]
    runs = [run for i in plain for run in seeds(str(i), [1.4], [100], **i)]
    runs += [run for i in plain for run in seeds(f"r{i}", [1.1], [100], task="rough", **i)]
    _, figure = weights.weights(runs)
    found = [
        {x.get_label(): x.get_color() for x in axes.lines if x.get_label().startswith("EIPO")}
        for axes in (figure.axes[0], figure.axes[2])
    ]
    assert found[0] == found[1]
    assert list(found[0]) == ["EIPO from 0.005", "EIPO from 0.02", "EIPO from 0.02, num_envs 512"]
    assert len({*found[0].values()}) == 3 and found[0]["EIPO from 0.005"] == weights.COLOURS[0]
    assert found[0]["EIPO from 0.02, num_envs 512"] == weights.OTHERS[0]


def test_weights_once_more_without_runs_that_stand():
    """PPO(0.005) scores 1.4 twice, and 0.8 with a seed that stands: (1.4 + 1.4 + 0.8) / 3 = 1.2.
    PPO(0.02) stands with its only seed, and stays. A summary counts who stands.
    """
    runs = seeds("a", [1.5], [400], algo="ppo", lam=0.0)
    runs += seeds("b", [1.4, 1.4, 0.8], [100] * 3, algo="ppo", lam=0.005)
    runs += seeds("c", [0.9], [70], algo="ppo", lam=0.02)
    for i in (3, 4):
        runs[i] = runs[i]._replace(episodes=runs[i].episodes | dict(v_x=np.zeros(2)))
    lines = [line.strip("| ").split(" | ") for line in weights.answers(runs)]
    found = [(x[0], x[1], x[-1]) for x in lines if x[0] in ("PPO(0.005)", "PPO(0.02)")]
    assert found == 2 * [("PPO(0.005)", "1.200", "3"), ("PPO(0.02)", "0.900", "1")] + 2 * [
        ("PPO(0.005)", "1.400", "2"),
        ("PPO(0.02)", "0.900", "1"),
    ]
    assert sum("runs that walk" in x[0] for x in lines) == 2
    rows = [line.strip("| ").split(" | ") for line in claims.summary(runs)]
    assert {x[0]: x[3] for x in rows if x[0] in ("PPO(0.005)", "PPO(0.02)")} == {
        "PPO(0.005)": "1 of 3 stands",
        "PPO(0.02)": "stands",
    }


def test_weights_of_nominal_starts_have_their_own_score_and_power():
    run = made(
        "a", algo="ppo", lam=0.0, performance=[1.4, 1.0], power=[400, 300], start_spread=[0.5, 0]
    )
    runs = [run._replace(row=dict(commit="c", resumed=""))]
    lines = [line for line in weights.answers(runs) if line.startswith("| PPO(0) |")]
    assert [line.split("|")[2:6:3] for line in lines] == [
        [" 1.400 ", " 400 W "],
        [" 1.000 ", " 300 W "],
    ]


def test_weights_has_ppo_at_any_lambda():
    """0.003 is none of Eq. (10)'s."""
    runs = seeds("a", [1.4], [400], algo="ppo", lam=0.0)
    runs += seeds("b", [1.3], [100], algo="ppo", lam=0.003)
    assert sum("| PPO(0.003) | 1.300 |" in line for line in weights.answers(runs)) == 2
    _, figure = weights.weights(runs)
    assert 0.003 in figure.axes[0].lines[1].get_xdata()


def test_eipo_is_no_worse_or_worse():
    """Seeds that do not spread have no interval: 1.44 is within 0.03 of 1.45, and 1.3 is not."""
    runs = seeds("a", [1.45, 1.45], [400, 400], algo="ppo", lam=0.0)
    runs += seeds("b", [1.44, 1.44], [200, 200]) + seeds("c", [1.3, 1.3], [200, 200], lam=0.02)
    lines = [line.split("|") for line in weights.answers(runs)]
    found = {line[1].strip(): line[4].strip() for line in lines if len(line) > 4}
    assert (found["EIPO"], found["EIPO from 0.02"]) == ("no worse", "worse")


def test_the_spread_is_of_arms_that_walk():
    """Squares of 1.4 and 1.5 are 2 x 0.05^2 = 0.005, over 1. Runs at 0.2 m/s do not count."""
    walk = seeds("a", [1.4, 1.5], [400, 400], algo="ppo", lam=0.0)
    stand = seeds("b", [0.5, 0.9], [100, 100], algo="ppo", lam=0.01)
    for run in stand:
        run.episodes["v_x"][:] = 0.2
    (kinds,) = by_group(walk + stand).values()
    found = weights.pooled(kinds, "performance", nominal=False).of_score
    assert (found.s, found.df) == (pytest.approx(0.005**0.5), 1)


def test_the_last_lambda_where_alpha_ends_at_0():
    history = dict(iteration=np.array([510, 600]), alpha=np.zeros(2))
    assert weights.last_lam(made()._replace(metrics=history)) == np.inf


def test_margins_are_those_of_the_rules():
    """Section 2 of rules.md. log 1.25 = 0.2231436."""
    margins = {"performance": 0.03, "peak": 0.37, "power": 0.2231436, "J/m": 0.2231436}
    assert pytest.approx(margins) == tables.MARGINS


@pytest.mark.parametrize(
    "scores, word",
    [([1.44, 1.44], "surely good"), ([1.41, 1.41], "surely not"), ([0.9, 0.9], "surely not")],
)
def test_a_weight_is_surely_good_or_surely_not(scores, word):
    """Seeds that do not spread have no interval: of 1.45 the good ones are above 1.42."""
    runs = seeds("a", [1.45, 1.45], [400, 400], algo="ppo", lam=0.0)
    runs += seeds("b", scores, [100, 100], algo="ppo", lam=0.005)
    lines = [line for line in weights.answers(runs) if line.startswith("| PPO(0.005) |")]
    assert [line.split("|")[4].strip() for line in lines] == [word, word]  # of both starts


@pytest.mark.parametrize("lam, good, arrived", [
    (0.00026, [0, 5e-4, 2e-3], True),
    (0.00024, [0, 5e-4, 2e-3], False),
    (0.0039, [5e-4, 2e-3], True),
    (0.0041, [5e-4, 2e-3], False),
    (0.0001, [0], False),
])  # fmt: skip
def test_alpha_arrives_at_a_good_weight_or_within_a_factor_of_two(lam, good, arrived):
    assert weights.arrives(lam, good) == arrived


def test_the_figure_of_weights_has_a_dot_for_ppo_and_an_arrow_for_eipo():
    """lambda 0 stands left of 0.0001, and the line ends where no weight was run. A robot that
    does not walk, at 0.25 m/s and less, has an open dot. EIPO's arrow goes from 0.02 to 1 / 200,
    leftwards, with a stroke where it starts. The lowest score of those that walk is 1.3, so the
    axis begins at 1.3 - 3 * 0.03 = 1.21.
    """
    runs = seeds("a", [1.4, 1.5], [400, 400], algo="ppo", lam=0.0)
    runs += seeds("b", [1.3], [100], algo="ppo", lam=0.0001)
    runs[0].episodes["v_x"][:] = 0.25
    runs[1].episodes["v_x"][:] = 0.26
    runs += seeds("c", [1.44], [200], lam=0.02)
    rows, figure = weights.weights(runs)
    assert [(row["lam"], row["lam_end"]) for row in rows if row["run"] == "c0"] == [(0.02, 0.005)]
    figure.draw_without_rendering()
    line, dots, stands, arrow, head = figure.axes[0].lines
    assert np.allclose(line.get_xydata()[:2], [[0.0001 / 3, 1.45], [0.0001, 1.3]])
    assert np.isnan(line.get_ydata()[2:]).all()
    assert np.allclose(dots.get_xydata(), [[0.0001 / 3, 1.5], [0.0001, 1.3]])
    assert np.allclose(stands.get_xydata(), [[0.0001 / 3, 1.4]])
    assert stands.get_markerfacecolor() == "white" != dots.get_markerfacecolor()
    assert np.allclose(arrow.get_xydata(), [[0.02, 1.44], [0.005, 1.44]])
    assert arrow.get_marker() == "|" and arrow.get_markevery() == [0]
    assert head.get_marker() == "<" and np.allclose(head.get_xydata(), [[0.005, 1.44]])
    assert np.isclose(figure.axes[0].get_ylim()[0], 1.21)
    (band,) = figure.axes[0].patches
    assert np.allclose(band.get_xy()[1] + np.array([0, band.get_height()]), [1.42, 1.45])


def test_a_start_of_eipo_has_one_colour_and_power_one_axis_on_all_tasks():
    """On flat ground there are two starts, and the second one is the first of rough ground."""
    runs = seeds("a", [1.4], [200], lam=0.005) + seeds("b", [1.3], [100], lam=0.02)
    runs += seeds("c", [1.0], [90], task="rough", lam=0.02)
    _, figure = weights.weights(runs)
    flat, strict = figure.axes[0].lines[3::2]
    (rough,) = figure.axes[1].lines[3::2]
    assert flat.get_color() != strict.get_color() == rough.get_color()
    assert figure.axes[2].get_ylim() == figure.axes[3].get_ylim()


def test_fig6_has_a_line_for_each_seed_and_their_mean():
    """Speeds 1, 2 and 3, 4 at 0.17 and 0.51 s: the mean is 2, 3."""
    time = np.array([0.17, 0.51])
    speeds = [dict(time=time, v_x=np.array(x)) for x in ((1.0, 2.0), (3.0, 4.0))]
    fast = [made(f"s{i}", "velocity", speed, seed=i) for i, speed in enumerate(speeds)]
    rows, figure = figures.fig6(fast)
    found = [(row["run"], row["v_x"]) for row in rows if row["time"] == 0.51]
    assert found == [("s0", 2), ("s1", 4), ("mean", 3)]
    assert figure.legends[0].get_texts()[0].get_text() == "EIPO, n = 2"
    paper = {text.get_text(): text.get_position()[1] for text in figure.axes[0].texts}
    assert paper == {"EIPO, the paper's robot": 2.5, "PPO(0.01), the paper's robot": 1.5}


def test_each_lambda_has_its_marker_and_its_shade():
    """Eq. (10)'s nine, from 0 to 0.02. Shades are of 0, to 0.0005, to 0.002, 0.005, and above."""
    looks = [figures.style(f"PPO({lam:g})") for lam in tables.LAMBDAS]
    assert "".join(look["marker"] for look in looks) == "os^v<>pPX"
    shades = [look["color"] for look in looks]
    first = [shades.index(x) for x in shades]  # where a shade comes first
    assert first == [0, 1, 1, 1, 4, 4, 6, 7, 7]
    plain = dict(color="#0072B2", linestyle="-")
    assert figures.style("EIPO") == plain | dict(marker="D")
    assert figures.style("EIPO from 0.02") == plain | dict(marker="X")
    others = (
        "EIPO from 0.02, num_envs 512",
        "PPO(0.005), num_envs 128",
        "EIPO smooth",
        "PPO(0) shaped",
    )
    assert {figures.style(name)["linestyle"] for name in others} == {"--"}


def test_fig5_has_power_below_the_score():
    """100 v_x + 10 yaw + 1000: 850 at -1 m/s and -5 rad/s, and 1450 at 4 m/s and 5 rad/s."""
    v_x, _, yaw = tables.GRID.T
    columns = dict(asked_v_x=v_x, asked_yaw=yaw, performance=v_x, power=100 * v_x + 10 * yaw + 1000)
    _, figure = figures.fig5([made(task="curriculum", **columns)])
    score, power = (axes.collections[0].get_array() for axes in figure.axes[:2])
    assert (score[0, 0], score[-1, -1]) == (-1, 4)
    assert (power[0, 0], power[-1, -1]) == pytest.approx((850, 1450))


def test_the_thick_line_of_fig6_is_the_mean():
    time = np.array([0.17, 0.51])
    speeds = [dict(time=time, v_x=np.array(x)) for x in ((1.0, 2.0), (2.0, 3.0), (6.0, 10.0))]
    _, figure = figures.fig6([made(f"s{i}", "velocity", x, seed=i) for i, x in enumerate(speeds)])
    (thick,) = [line for line in figure.axes[0].lines if line.get_linewidth() == 2]
    assert thick.get_xydata().tolist() == [[0.17, 3], [0.51, 5]]


def test_table1_draws_each_kind_in_its_own_line():
    """Seeds of EIPO are at 1 and at 3. The paper has 2.86 and 2.12."""
    many = np.ones(200)
    runs = [made("a", "velocity", peak=many, seed=0), made("b", "velocity", peak=3 * many, seed=1)]
    runs += [made("c", "velocity", peak=5 * many, algo="ppo", lam=0.0)]
    _, figure = figures.table1(runs)
    (axes,) = figure.axes
    words = [x.get_text() for x in axes.get_yticklabels()]
    row = dict(zip(words, axes.get_yticks(), strict=True))
    assert list(row) == ["EIPO, n = 2", "PPO(0), n = 1"]
    eipo, ppo = row.values()
    assert axes.collections[0].get_segments()[0].tolist() == [[1, eipo], [3, eipo]]
    drawn = {x.get_label(): x.get_xydata().tolist() for x in axes.lines}
    assert drawn["the paper's"] == [[2.86, eipo], [2.12, ppo]]
    (bars,) = (x for x in axes.containers if hasattr(x, "has_xerr"))
    assert bars[0].get_xydata().tolist() == [[2, eipo], [5, ppo]]


def test_tradeoff_has_a_small_dot_for_each_run_and_a_large_one_for_their_mean():
    """pi' is hollow. Scores of velocity are peaks, on an axis of their own."""
    runs = seeds("a", [1.0, 2.0, 6.0], [100, 200, 600])
    runs = [run._replace(prime=run.episodes) for run in runs]
    _, figure = figures.tradeoff([*runs, *seeds("v", [1.0], [50], task="velocity")])
    small, large, hollow, _ = figure.axes[0].collections
    assert small.get_offsets().tolist() == [[1, 100], [2, 200], [6, 600]]
    assert large.get_offsets().tolist() == [[3, 300]]
    assert large.get_sizes()[0] > small.get_sizes()[0]
    assert len(small.get_facecolors()) == 1 and len(hollow.get_facecolors()) == 0
    score, peak = figure.axes
    assert not score.get_shared_x_axes().joined(score, peak)


def test_alpha_is_drawn_over_iterations():
    history = dict(iteration=[10, 20], alpha=[200, 400])
    _, figure = figures.alpha([made("r")._replace(metrics=history)])
    (line,) = figure.axes[0].lines
    assert line.get_xydata().tolist() == [[10, 200], [20, 400]]


def test_a_run_that_stands_is_left_of_the_tradeoff():
    """On flat ground the axis begins at 1.2 if a run scores less, but not if all do."""
    runs = seeds("a", [1.4, 0.9], [100, 100], algo="ppo", lam=0.005)
    _, figure = figures.tradeoff(runs)
    assert figure.axes[0].get_xlim()[0] == 1.2
    _, figure = figures.tradeoff(runs[1:])
    assert figure.axes[0].get_xlim()[0] < 0.9


def test_weights_prints_its_tables(tmp_path, capsys):
    runs = str(ROOT / "results/flat/flat-*")
    assert main(["weights", runs, "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == list(weights.answers(tables.runs([runs])))


def test_weights_says_what_it_cannot_compare():
    (line, _) = weights.answers(seeds("a", [1.4], [100], lam=0.02))
    assert line == "flat, 600 iterations: without runs of PPO there is nothing to compare with."


# ---- regions of commands ----


def test_a_command_is_inside_a_cell_or_on_its_edge():
    """Cell (2, 20) of the grid is 0 to 0.5 m/s and 0 to 0.5 rad/s. Of the commands of Figure 5 the
    grid starts with those of at most 1 m/s and 1 rad/s, 5 times 3.
    """
    grid = np.zeros((22, 40))
    grid[2, 20] = 0.4
    cells = tables.cells_of(grid)
    assert {name: x.tolist() for name, x in cells.items()} == dict(
        v_x=[0.25], yaw=[0.25], weight=[0.4]
    )
    commands = {(0, 0): 1, (0.5, 0.5): 1, (0.2, 0.3): 1, (0.51, 0): 0, (0, -0.01): 0, (-0.5, 0): 0}
    v_x, yaw = np.array(list(commands)).T
    assert tables.inside(v_x, yaw, cells).tolist() == [bool(x) for x in commands.values()]
    v_x, _, yaw = tables.GRID.T
    found = tables.inside(v_x, yaw, tables.cells_of(tasks.Grid().weights))
    assert (
        found.tolist() == ((np.abs(v_x) <= 1) & (np.abs(yaw) <= 1)).tolist() and found.sum() == 15
    )


def test_the_table_of_the_curriculum_by_region():
    """Commands of 0, 1.5 and 4 m/s score 1, 0.5 and 0: 0.5 in the mean, 1 in the start box, and
    0.75 where the cell of 1 to 1.5 m/s is reached, too. Powers are 100, 200 and 600 W, and the last
    two episodes end early. pi' scores half as much. Of PPO it is not known what it had reached.
    """
    e = dict(asked_v_x=[0, 1.5, 4], performance=[1, 0.5, 0], power=[100, 200, 600], fell=[0, 1, 1])
    e = {name: 2 * x for name, x in e.items()} | dict(start_spread=[0.5] * 3 + [0] * 3)
    e |= dict(task="curriculum", v_x=[1.0] * 6)
    grid = tasks.Grid()
    grid.weights[4, 20] = 0.2
    run = made("a", **e)._replace(reached=tables.cells_of(grid.weights))
    prime = run.episodes | dict(performance=run.episodes["performance"] / 2)
    runs = [run._replace(prime=prime), made("b", lam=0.0, algo="ppo", **e)]
    lines = [line.strip("|").split(" | ")[:4] for line in claims.table(runs) if "| " in line]
    head = ["score", "power", "fell"]
    every, box, reached = (
        ["0.500", "300 W", "66.7 %"],
        ["1.000", "100 W", "0.0 %"],
        ["0.750", "150 W", "50.0 %"],
    )
    group = " curriculum, 2000 iterations"
    assert lines == [
        [group, *head],
        [" EIPO", *every],
        [" pi' of EIPO", "0.250", *every[1:]],
        [" PPO(0)", *every],
        [f"{group}, start box", *head],
        [" EIPO", *box],
        [" pi' of EIPO", "0.500", *box[1:]],
        [" PPO(0)", *box],
        [f"{group}, reached", *head],
        [" EIPO", *reached],
        [" pi' of EIPO", "0.375", *reached[1:]],
    ]


def test_a_kind_is_of_what_was_reached_if_all_its_runs_say_so():
    e = dict(task="curriculum", asked_v_x=[0.0], performance=[1.0])
    knows = made("a", seed=0, **e)._replace(reached=tables.start_box())
    found = tables.by_region(by_group([knows, made("b", seed=1, **e)]))
    assert list(found) == ["curriculum, 2000 iterations", "curriculum, 2000 iterations, start box"]


# ---- kinds of runs ----


def test_kinds_of_runs():
    """EIPO first, then lambda ascends. In what a run is unlike most others is part of its name. PPO
    reads no learning rate of alpha.
    """
    ppo = dict(algo="ppo", lr_alpha=7.0)
    settings = dict(
        a=dict(lam=0.002),
        b=dict(lr_alpha=0.01, momentum_alpha=0.5),
        c=dict(num_envs=64),
        d=dict(lam=0.005, **ppo),
        e=dict(lam=0.0, **ppo),
        f={},
        g=dict(task="rough"),
        h=dict(lam=0.0, algo="ppo", seed=1),
    )
    several = [made(name, **given) for name, given in settings.items()]
    (flat,) = by_group(several, "flat").values()
    assert {name: [run.name for run in runs] for name, runs in flat.items()} == {
        "EIPO": ["f"],
        "EIPO, lr_alpha 0.01, momentum_alpha 0.5": ["b"],
        "EIPO, num_envs 64": ["c"],
        "PPO(0)": ["e", "h"],
        "PPO(0.005)": ["d"],
        "EIPO from 0.002": ["a"],
    }


def test_a_longer_run_is_of_another_group():
    """In which another learning rate of alpha is usual."""
    long = dict(iterations=4000)
    runs = [made("a"), made("b", lr_alpha=0.01, **long), made("c", lr_alpha=0.5, **long)]
    groups = by_group([*runs, made("d", "rough")])
    assert {group: list(kinds) for group, kinds in groups.items()} == {
        "flat, 600 iterations": ["EIPO"],
        "flat, 4000 iterations": ["EIPO", "EIPO, lr_alpha 0.5"],
        "rough, 600 iterations": ["EIPO"],
    }
    assert list(by_group([*runs, made("d", "rough")], "rough")) == ["rough, 600 iterations"]


def test_runs_that_are_unlike_have_names_of_their_own():
    """Of whatever kind they are: EIPO with noise beside PPO without, which comes first. What a run
    does not say is unknown, and what most have is not worth a word, whatever today's default is.
    """
    eipo_run, other = made("a", history=3), made("b", history=3, seed=1)
    del other.settings["history"]
    ppo = dict(algo="ppo", lam=0.0, history=3)
    several = [made("c", noise=0.0, mirror=False, **ppo), eipo_run, other, made("d", **ppo)]
    (kinds,) = by_group(several).values()
    assert {name: [run.name for run in runs] for name, runs in kinds.items()} == {
        "EIPO": ["a", "b"],
        "PPO(0)": ["d"],
        "PPO(0), noise 0.0, mirror False": ["c"],
    }


def test_runs_of_the_shaped_reward_do_not_decide_what_is_usual():
    other = dict(reward="shaped", algo="ppo", lam=0.0, noise=0.0)
    shaped = [made(f"s{seed}", "curriculum", seed=seed, **other) for seed in (0, 1)]
    (kinds,) = by_group([*shaped, made("e", "curriculum")]).values()
    assert list(kinds) == ["EIPO", "PPO(0) shaped, noise 0.0"]


def test_no_kept_run_is_renamed_when_a_default_changes(monkeypatch):
    """EIPO from the paper's lambda_0 is EIPO, and in a task of one's own it is the first one."""
    kept, others = [made("a"), made("b", lam=0.02)], [made("c"), made("d", lam=0.02)]
    for run in others:
        run.settings["task"] = "hop"
    other = tasks.TASKS["flat"]._replace(learner=dict(lam=0.02, iterations=7, lr_alpha=3.0))
    monkeypatch.setitem(tasks.TASKS, "flat", other)
    names = [list(kinds) for kinds in by_group(kept + others).values()]
    assert names == [["EIPO", "EIPO from 0.02"]] * 2
    kept.reverse()
    others.reverse()
    names = [list(kinds) for kinds in by_group(kept + others).values()]
    assert names == [["EIPO", "EIPO from 0.02"], ["EIPO", "EIPO from 0.005"]]


def test_two_formulas_of_power_have_two_names():
    """Older tables do not say how power was measured: as it was in training."""
    torque, power = ({"env.clip": json.dumps(x)} for x in ("torque", "power"))
    new = {"evaluation.power_formula": '"power"'}
    rows = power, torque | new, torque, power | new
    found = [tables.settings_of(row)["power_formula"] for row in rows]
    assert found == ["power", "power", "torque", "power"]
    several = [made(clip=x, seed=i) for i, x in enumerate(("power", "torque", "torque", "power"))]
    for run, formula in zip(several, found, strict=True):
        run.settings["power_formula"] = formula
    (kinds,) = by_group(several).values()
    assert list(kinds) == [
        "EIPO",
        *(f"EIPO, clip torque{x}" for x in ("", ", power_formula torque")),
    ]


def test_a_run_does_not_count_twice():
    with pytest.raises(Refused, match=r"r and again .* nothing"):
        by_group([made("r"), made("again")])


# ---- the tables ----


@pytest.fixture
def short(monkeypatch, tmp_path):
    """An evaluation plays 16 steps, 0.32 s, instead of the paper's 1000, in an empty folder."""
    monkeypatch.setattr(evaluate, "EPISODE_STEPS", 16)
    monkeypatch.chdir(tmp_path)


def run_of(name, task="flat", **learner):
    """A run folder with 35 iterations in its metrics; what is whole there stays exact."""
    folder = make_run(Path(name), task, **learner)
    rows = [f"{i},{100_001 * i},{i / 20},{i + 1 / 3},inf" for i in range(1, 36)]
    (folder / "metrics.csv").write_text("\n".join(["iteration,steps,reward,v_x,alpha", *rows, ""]))
    return folder


def test_a_run_that_is_put_in_comes_out(short, monkeypatch):
    """Both policies from both starts, two of each of 11 commands; every tenth row of the metrics
    and the last one; where it ran. It was stopped after 35 of 600 iterations, so it is one of 35.
    """
    folder = run_of("flat-eipo-seed3", seed=3)
    shutil.copy(folder / "policy.npz", folder / "policy_prime.npz")
    config = json.loads((folder / "config.json").read_text())
    (start,) = config["starts"]
    config["starts"] = [
        start | dict(cpu="a CPU", cores=2),
        start | dict(command="again --out /a/b --seed 3"),
    ]
    (folder / "config.json").write_text(json.dumps(config))
    for _ in range(2):  # the second time replaces the first
        assert main(["add", str(folder), "--results", "kept", "--episodes", "22"]) == 0
    other = run_of("flat-ppo-seed3", seed=3, algo="ppo")
    assert main(["add", str(other), "--results", "kept", "--episodes", "11"]) == 0
    assert [run.name for run in tables.runs(["kept/flat"])] == ["flat-eipo-seed3", "flat-ppo-seed3"]
    monkeypatch.chdir("kept/flat")
    eipo_run, ppo_run = tables.runs(["."])
    both = {**config["env"], **config["learner"], "iterations": 35, "power_formula": "power"}
    assert eipo_run.settings == both and ppo_run.settings["algo"] == "ppo"
    assert eipo_run.metrics["iteration"].tolist() == [10, 20, 30, 35]
    assert eipo_run.metrics["v_x"].tolist() == [10.333, 20.333, 30.333, 35.333]
    row = eipo_run.row
    assert (row["iterations"], row["cpu"]) == ("35", "a CPU")
    assert row["cores"] == "2" and json.loads(row["resumed"])[0]["command"] == "again --seed 3"
    pi, prime = (eipo_run._replace(episodes=e) for e in (eipo_run.episodes, eipo_run.prime))
    for run, each in ((pi, 22), (prime, 22), (ppo_run, 11)):
        assert len(run.episodes["fell"]) == 2 * each
        for nominal in (False, True):
            e = tables.evaluation(run.episodes, nominal)
            assert e["asked_v_x"].tolist() == np.repeat(np.arange(11) / 10, each // 11).tolist()
            assert 0 < e["performance"].mean() < 1.5
    # the same policy from the same starts, of which random ones are not nominal
    assert pi.episodes["v_x"].tolist() == prime.episodes["v_x"].tolist()
    assert len(np.unique(pi.episodes["v_x"])) > 22
    mean = tables.evaluation(pi.episodes)["performance"].mean()
    assert float(row["performance"]) == pytest.approx(mean, rel=1e-3) and not ppo_run.prime


def rewrite(file, about=(), **world):
    """Let a policy file of a run folder say what it is of, in a world with other settings."""
    pi, env_cfg = run_folder.load_policy(file)
    params = dict(actor=MLP(pi.actor), estimator=MLP(pi.estimator))
    run_folder.save_policy(file, params, replace(env_cfg, **world), about)


def change_config(folder, part, **settings):
    """Other settings in a part of config.json."""
    config = json.loads((folder / "config.json").read_text())
    config[part] |= settings
    (folder / "config.json").write_text(json.dumps(config))


def test_a_row_is_of_its_policy(short):
    """A run of 35 iterations was killed before their policy was saved: what there is is that of 20.
    Its own iterations * 24 * 256 steps count, and its alpha.
    """
    folder = run_of("r", seed=3)
    rewrite(folder / "policy.npz", dict(iteration=20, algo="eipo", lam=0.005, seed=3))
    text = (
        (folder / "metrics.csv")
        .read_text()
        .replace("20,2000020,1.0,20.333333333333332,inf", "20,1,1,1,7")
    )
    (folder / "metrics.csv").write_text(text)
    assert main(["add", str(folder), "--results", "kept", "--episodes", "11"]) == 0
    (run,) = tables.runs(["kept/flat/r"])
    assert run.settings["iterations"] == 20 and list(by_group([run])) == ["flat, 20 iterations"]
    assert (run.row["iterations"], run.row["steps"]) == ("20", str(20 * 24 * 256))
    assert run.metrics["iteration"].tolist() == [10, 20] and run.metrics["alpha"][-1] == 7


def two_ages(folder):
    rewrite(folder / "policy.npz", dict(iteration=20))
    shutil.copy(folder / "policy.npz", folder / "policy_prime.npz")
    rewrite(folder / "policy_prime.npz", dict(iteration=10))


def two_worlds(folder):
    shutil.copy(folder / "policy.npz", folder / "policy_prime.npz")
    rewrite(folder / "policy_prime.npz", noise=0.5)


def half_a_row(folder):
    """As a copy of a folder may have it in which something trains."""
    text = (folder / "metrics.csv").read_text()
    (folder / "metrics.csv").write_text(text[:-8])


TOLD_APART = {
    "pi and pi' have another iteration": two_ages,
    "pi and pi' have another noise": two_worlds,
    "metrics.csv has no row of iteration 36": lambda x: rewrite(
        x / "policy.npz", dict(iteration=36)
    ),
    "policy.npz and config.json have another seed": lambda x: rewrite(
        x / "policy.npz", dict(seed=4)
    ),
    "policy.npz and config.json have another roughness, task": lambda x: rewrite(
        x / "policy.npz", task="rough", roughness=(0.0, 0.15)
    ),
    "metrics.csv does not exist": lambda x: (x / "metrics.csv").unlink(),
    "metrics.csv is damaged": lambda x: (x / "metrics.csv").write_text("iteration,steps\n"),
    "metrics.csv is damaged, or of another program: TypeError": half_a_row,
    "config.json is damaged": lambda x: change_config(x, "env", clock_hz=None, other=1),
}


@pytest.mark.parametrize("says", TOLD_APART)
def test_what_does_not_belong_together_is_one_line(short, capsys, says):
    """And it is found before the first run is played."""
    first, other = run_of("first"), run_of("other", seed=3)
    TOLD_APART[says](other)
    assert says in error_of(capsys, main, "add", first, other, "--results", "kept")
    assert not Path("kept").exists()


def test_a_run_that_trains_while_it_is_played_is_one_line(short, capsys, monkeypatch):
    """It saved its next policy meanwhile: episodes and metrics would be of two."""
    folder, real = run_of("r"), tables.play

    def play(*args):
        played = real(*args)
        rewrite(folder / "policy.npz", dict(iteration=30))
        return played

    rewrite(folder / "policy.npz", dict(iteration=20))
    monkeypatch.setattr(tables, "play", play)
    to = "--results", "kept", "--episodes", "11"
    assert "was trained on meanwhile" in error_of(capsys, main, "add", folder, *to)
    assert not Path("kept/flat/runs.csv").exists()


def test_add_waits_for_another_add(short, monkeypatch):
    waits, real = [], run_folder.lock

    def lock(folder, wait=False):
        waits.append((folder.name, wait))
        return real(folder, wait)

    monkeypatch.setattr(run_folder, "lock", lock)
    assert main(["add", str(run_of("r")), "--results", "kept", "--episodes", "11"]) == 0
    assert waits == [("flat", True)]


def test_two_runs_of_one_name_are_one_line(short, capsys):
    """In one command, and in two as soon as they differ. A run that goes on is the same one."""
    for place in ("a", "b"):
        Path(place).mkdir()
    a, b = run_of("a/run"), run_of("b/run", lam=0.01)
    to = ["--results", "kept", "--episodes", "11"]
    assert "have one name" in error_of(capsys, main, "add", a, b, *to)
    assert not Path("kept").exists()
    assert main(["add", str(a), str(a), *to]) == 0
    assert capsys.readouterr().out == "run: 22 episodes, now in kept/flat\n"
    before = Path("kept/flat/runs.csv").read_bytes()
    assert "has a run with another lam" in error_of(capsys, main, "add", b, *to)
    assert Path("kept/flat/runs.csv").read_bytes() == before
    rewrite(a / "policy.npz", dict(iteration=30))
    assert main(["add", str(a), *to]) == 0
    (run,) = tables.runs(["kept/flat/run"])
    assert run.settings["iterations"] == 30


def test_a_run_that_was_trained_from_the_nominal_pose_can_be_put_in(short):
    """Its random starts are nominal ones, too, and both are there."""
    folder = run_of("r")
    rewrite(folder / "policy.npz", start_spread=0.0)
    change_config(folder, "env", start_spread=0.0)
    assert main(["add", str(folder), "--results", "kept", "--episodes", "11"]) == 0
    (run,) = tables.runs(["kept/flat/r"])
    for nominal in (False, True):
        assert len(tables.evaluation(run.episodes, nominal)["fell"]) == 11
    assert main(["table", "kept/flat/r"]) == 0


def test_the_printed_clip_is_measured_as_all_are(short):
    """It decides what a policy learns, and not how its power is measured."""
    power, torque = run_of("power"), run_of("torque")
    rewrite(torque / "policy.npz", clip="torque")
    change_config(torque, "env", clip="torque")
    assert main(["add", str(power), str(torque), "--results", "kept", "--episodes", "11"]) == 0
    a, b = tables.runs(["kept/flat/*"])
    assert a.episodes["power"].tolist() == b.episodes["power"].tolist()
    assert list(*by_group([a, b]).values()) == ["EIPO", "EIPO, clip torque"]


@pytest.mark.parametrize(
    "out", ["--out a/b", "--out=a", "'--out=my runs/a'", "--out 'my runs/a'", "--out 'it'\"'\"'s'"]
)
def test_a_row_does_not_say_where_its_run_was(out):
    typed = f"python train.py {out} --task flat"
    assert tables.without_out(typed) == "python train.py --task flat"


@pytest.mark.parametrize(
    ("task", "main_one", "others"),
    [("flat", 990, 330), ("rough", 990, 330), ("velocity", 1000, 1000), ("curriculum", 968, 968)],
)
def test_as_many_episodes_as_the_rules_say(short, monkeypatch, task, main_one, others):
    """Of pi from random starts, and of the others: pi from the nominal pose, and pi' from both.
    Sections 8 and 10 of rules.md, and eight of each of the 11 x 11 commands of Figure 5.
    """

    def run_episodes(policy, env):  # nothing is simulated
        n = env.num_envs
        return evaluate.Episodes(*np.zeros((5, n))), np.zeros((16, n))

    def make_env(env_cfg, asked):
        return SimpleNamespace(num_envs=len(asked), env_cfg=env_cfg, period=0.02)

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    monkeypatch.setattr(evaluate, "make_env", make_env)
    folder = run_of("r", task)
    shutil.copy(folder / "policy.npz", folder / "policy_prime.npz")
    assert main(["add", str(folder), "--results", "kept"]) == 0
    (run,) = tables.runs([f"kept/{task}/r"])
    starts = [e["nominal"] for e in (run.episodes, run.prime)]
    assert [[(x == nominal).sum() for nominal in (0, 1)] for x in starts] == [
        [main_one, others],
        [others, others],
    ]


def test_what_the_grid_had_reached_is_kept(short):
    """From the checkpoint, as train.py writes it. It is not known if the checkpoint is of another
    iteration than the policy, of an older version, or gone.
    """
    folder = run_of("r", "curriculum")
    env_cfg, cfg = settle(
        dict(task="curriculum", history=2), dict(hidden=(8,), hidden_estimator=(8,))
    )
    envs = [go1_env.Go1Env(1, env_cfg, 1) for _ in range(2)]
    state = eipo.init_state(envs, cfg)
    envs[0].commands.weights[4, 20] = 0.4
    path = folder / "checkpoint.npz"
    to = ["--results", "kept", "--episodes", "1"]

    def reached(iteration, envs=envs):
        checkpoint.save(path, state._replace(iteration=iteration), envs, cfg)
        assert main(["add", str(folder), *to]) == 0
        return tables.runs(["kept/curriculum/r"])[0].reached

    cells = reached(35)
    assert len(cells["v_x"]) == 17  # 4 x 4 cells of 0.5 m/s and 0.5 rad/s, and one more
    assert [x[-1] for x in (cells["v_x"], cells["yaw"], cells["weight"])] == [1.25, 0.25, 0.4]
    assert reached(36) == {}
    path.unlink()
    assert main(["add", str(folder), *to]) == 0
    assert tables.runs(["kept/curriculum/r"])[0].reached == {}


def test_curriculum_is_asked_for_every_command_of_figure_5(tmp_path, monkeypatch):
    """11 x 11 of them, from -1 to 4 m/s and from -5 to 5 rad/s, from both starts."""
    asked = []

    def run_episodes(policy, env):  # nothing is simulated
        return evaluate.Episodes(*np.zeros((5, env.num_envs))), np.zeros((16, env.num_envs))

    def make_env(env_cfg, commands):
        asked.append(commands)
        return SimpleNamespace(num_envs=len(commands), env_cfg=env_cfg, period=0.02)

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    monkeypatch.setattr(evaluate, "make_env", make_env)
    tables.play(make_run(tmp_path / "r", "curriculum"), "curriculum", 121)
    assert [len(np.unique(commands, axis=0)) for commands in asked] == [121, 121]
    assert asked[0].min(0).tolist() == [-1, 0, -5] and asked[0].max(0).tolist() == [4, 0, 5]


def test_speeds_by_period_of_the_clock():
    """5 Hz and 20 ms: ten steps a period. Robot 1 falls after 15. Means are of 0, 1, ..., 9, and
    of 10, ..., 19 with 10, ..., 14: (145 + 60) / 15.
    """
    env = SimpleNamespace(period=0.02, env_cfg=SimpleNamespace(clock_hz=5.0))
    v_x = np.repeat(np.arange(20.0)[:, None], 2, axis=1)
    v_x[15:, 1] = np.nan
    rows = list(tables.speed_rows(v_x, env))
    assert [row["time"] for row in rows] == pytest.approx([0.1, 0.3])
    assert [row["v_x"] for row in rows] == pytest.approx([4.5, 205 / 15])


def test_velocity_keeps_speeds_over_time(short):
    """16 steps of 0.02 s are one period of the clock, in the middle of which 0.16 s have passed.
    They are those of pi, beside which there is a pi' that does something else.
    """
    folder = run_of("velocity-eipo-seed0", "velocity")
    pi, env_cfg = run_folder.load_policy(folder / "policy.npz")
    actor = MLP([(0 * w, b + 1) for w, b in pi.actor])
    params = dict(actor=actor, estimator=MLP(pi.estimator))
    run_folder.save_policy(folder / "policy_prime.npz", params, env_cfg)
    assert main(["add", str(folder), "--results", "kept", "--episodes", "3"]) == 0
    (run,) = tables.runs(["kept/velocity"])
    assert run.speed["time"].tolist() == [0.16] and len(run.speed["v_x"]) == 1
    assert (run.prime["v_x"] != run.episodes["v_x"]).all()
    assert run.speed["v_x"][0] == pytest.approx(
        tables.evaluation(run.episodes)["v_x"].mean(), abs=1e-3
    )


def test_tables_come_out_as_they_went_in(tmp_path):
    """Five digits, and all of a whole number."""
    rows = [dict(run="a", steps=3686400.0, x=1 / 3, y=np.inf), dict(run="b", policy="prime", z=2)]
    tables.write(tmp_path / "t.csv.gz", rows)
    first, second = tables.read(tmp_path / "t.csv.gz")
    assert first == dict(run="a", steps="3686400", x="0.33333", y="inf", policy="", z="")
    assert tables.grouped([first, second], "run") == dict(a=[first], b=[second])
    assert tables.columns([first]) == dict(steps=3686400, x=0.33333, y=np.inf)


def test_the_record_can_be_read():
    """Every run of results/ has settings, and every table is of such runs alone. Every policy can
    be loaded. results/ stays small. A task of one's own needs no runs there.
    """
    places = [path.parent for path in RESULTS.glob(f"*/{tables.RUNS}")]
    assert {place.name for place in places} >= {"flat", "rough", "velocity", "curriculum"}
    found = 0
    for place in places:
        runs = tables.runs([place / "*"])
        found += len(runs)
        assert len(runs) > 1 and all(run.settings["task"] == place.name for run in runs)
        # those of a newer learner may be of a kind and a seed that is there
        new = [run for run in runs if run.name.startswith("new-")]
        kept = [run for run in runs if not run.name.startswith("new-")]
        assert by_group(kept) and len(by_group(new)) <= 1
        names = {run.name for run in runs}
        for file in (tables.METRICS, tables.EPISODES, tables.SPEED):
            assert {row["run"] for row in tables.read(place / file)} <= names
    assert found > 90
    policies = [*RESULTS.rglob("policy*.npz")]
    assert len(policies) > 3 and all(policy.load(path) for path in policies)
    files = [path for path in RESULTS.rglob("*") if path.is_file()]
    assert len(files) <= 110 and sum(path.stat().st_size for path in files) < 15e6


TRADEOFF = (
    "flat4000-*",
    *(f"flat-{x}-*" for x in ("eipo-lam0.005", "ppo-lam0", "ppo-lam0.00[125]")),
)
WEIGHTS = "flat/flat-*", "rough/new-*"


@pytest.mark.parametrize("picture, runs", [
    ("flat/tradeoff", [f"flat/{x}" for x in TRADEOFF]),
    ("weights", WEIGHTS),
    ("curriculum/fig5", ["curriculum"]),
])  # fmt: skip
def test_a_committed_picture_comes_from_the_committed_tables(tmp_path, picture, runs):
    name = Path(picture).name
    assert main([name, *(str(RESULTS / run) for run in runs), "--out", str(tmp_path / "new")]) == 0
    committed = (RESULTS / f"{picture}.csv").read_text()
    assert (tmp_path / f"new/{name}.csv").read_text() == committed
    with Image.open(tmp_path / f"new/{name}.png") as image:
        assert len(image.convert("RGB").getcolors(2**24)) > 20, "the figure is blank"


@pytest.mark.parametrize("figure", ["fig5", "fig6", "table1"])
def test_one_panel_takes_runs_of_one_length(figure):
    task = "curriculum" if figure == "fig5" else "velocity"
    speed = dict(time=np.array([0.5]), v_x=np.array([1.0]))
    several = [made("a", task, speed), made("b", task, speed, iterations=7)]
    with pytest.raises(Refused, match=f"several lengths.*{task}, 7 iterations"):
        getattr(figures, figure)(several)


def test_a_figure_of_robots_that_stand():
    """They have no finite J/m, so that axis is empty. The axis of their score is theirs."""
    v_x = np.arange(11) / 10
    stand = made(asked_v_x=v_x, performance=np.full(11, 0.9), power=np.full(11, 100.0))
    rows, figure = figures.fig2([stand])
    assert np.isinf([row["energy"] for row in rows]).all()
    figure.draw_without_rendering()
    score, energy = figure.axes
    assert score.get_ylim()[0] < 0.9 < score.get_ylim()[1]
    assert np.isnan(energy.lines[0].get_ydata()).all()


def test_a_notebooks_backend_is_no_obstacle(tmp_path):
    """Notebooks set one for every process that they start, and it is valid in theirs alone."""
    (tmp_path / "metrics.csv").write_text("iteration,steps,reward\n1,2,3\n")
    draw = "import pathlib, sys; from runtime.metrics import draw_curves"
    draw += "; draw_curves(pathlib.Path(sys.argv[1]))"
    alpha = "-m", "results", "alpha", "results/rough/rough-eipo-*", "--out", tmp_path
    options = dict(cwd=ROOT, env=os.environ | dict(MPLBACKEND="module://nobody_has.this"))
    for arguments in (("-c", draw, tmp_path), alpha):
        subprocess.run([sys.executable, *arguments], check=True, **options)
    assert {"curves.png", "alpha.png", "alpha.csv"} <= {path.name for path in tmp_path.iterdir()}


# ---- what goes wrong ----


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["fig2", str(RESULTS / "flat" / "nobody")], "no run nobody"),
        (["fig3", str(RESULTS / "flat" / "flat-ppo-lam0-seed10")], "task rough"),
        (["alpha", str(RESULTS / "flat" / "flat-ppo-lam0-seed10")], "EIPO, which alone"),
        (["add", "nowhere"], "nowhere/policy.npz does not exist"),
        (["summary", "nowhere"], "nowhere has no runs: there is no runs.csv"),
    ],
)
def test_what_there_is_not_is_one_line(argv, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert says in error_of(capsys, main, *argv)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("line", [
    "summary RUN --out d", "add RUN --out d", "fig2 RUN --results d", "table RUN --episodes 1",
    "claims --episodes 1", "claims --out d",
])  # fmt: skip
def test_a_flag_that_would_be_ignored_is_refused(line, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(line.split())
    name, *_, flag, _ = line.split()
    assert f"{name} takes no {flag}" in capsys.readouterr().err and not [*tmp_path.iterdir()]


@pytest.mark.parametrize("argv", [["weights", "RUN", "--out", ""], ["claims", "--results", ""]])
def test_an_empty_path_is_not_where_one_is(argv, capsys, tmp_path, monkeypatch):
    """A script's variable that is not set would write into the folder where one is."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(argv)
    assert "it is empty" in capsys.readouterr().err and not [*tmp_path.iterdir()]


def test_a_run_that_two_patterns_find_counts_once():
    patterns = [RESULTS / "flat" / name for name in ("flat-ppo-lam0-*", "flat-ppo-lam0-seed1?")]
    names = [run.name for run in tables.runs(patterns)]
    assert len(names) == len({*names}) == 6


def test_a_damaged_table_is_one_line(tmp_path, capsys):
    shutil.copy(RESULTS / "flat" / "runs.csv", tmp_path)
    (tmp_path / "episodes.csv.gz").write_bytes(gzip.compress(b"run,fell\na,1\n")[:-9])
    assert "episodes.csv.gz is damaged" in error_of(capsys, main, "table", tmp_path / "flat-*")
    (tmp_path / "episodes.csv.gz").unlink()
    said = error_of(capsys, main, "table", tmp_path / "flat-*")
    assert "runs.csv has no run flat-* with episodes" in said


def test_a_table_that_somebody_edited(tmp_path, capsys):
    """A spreadsheet may put a mark before the first letter. Rows that are there twice, or without a
    column that it takes, are one line.
    """
    place = RESULTS / "flat"
    for name in ("runs.csv", "episodes.csv.gz", "metrics.csv.gz"):
        shutil.copy(place / name, tmp_path)
    head, *rows = (place / "runs.csv").read_text().splitlines()
    row = next(row for row in rows if row.startswith("flat-ppo-lam0-seed10,"))
    (tmp_path / "runs.csv").write_text("\ufeff" + f"{head}\n{row}\n", encoding="utf-8")
    assert main(["summary", str(tmp_path / "flat-ppo-lam0-*")]) == 0
    capsys.readouterr()
    for text in (f"{head}\n{row}\n{row}\n", f"{head}\n{row}\n".replace(",", ";")):
        (tmp_path / "runs.csv").write_text(text)
        said = error_of(capsys, main, "summary", tmp_path / "flat-ppo-lam0-*")
        assert "runs.csv is damaged" in said


@pytest.mark.parametrize("argv", [["fig7"], ["fig2"], ["claims", "a"], ["fig2", "a", "--moon"]])
def test_a_wrong_command_line_is_one_line(argv, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(argv)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("python -m results: ")


def test_weights_of_ppo_without_energy_alone():
    """There is no lambda above 0 to place 0 by."""
    rows, figure = weights.weights(seeds("a", [1.4], [400], algo="ppo", lam=0.0))
    figure.draw_without_rendering()
    assert figure.axes[0].lines[1].get_xdata() == [0.0001 / 3] and len(rows) == 1


def test_a_pipe_that_is_closed_early_is_no_error():
    """`python -m results summary ... | head -1` reads a line and closes the pipe."""
    command = [sys.executable, "-m", "results", "summary", "results/rough"]
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    with subprocess.Popen(command, cwd=ROOT, **pipes) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1
