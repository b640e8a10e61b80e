"""`python -m results`: what is kept of a run, who is compared with whom, and what is drawn."""

import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support import ROOT, error_of, make_run, rewrite

import eipo
import evaluate
import go1_env
import tasks
from results import figures, paper, runs, tables
from results.__main__ import main, save_rows
from runtime import checkpoint
from runtime.cli import Refused
from runtime.flags import settle
from runtime.kinds import Group, Kind

RESULTS = ROOT / "results"
LEARNER = paper.ONE_LEARNER[0] + "..."  # a commit of it


def made(name="r", task="flat", commit=LEARNER, **columns):
    """A Run with the usual settings of a task, but for those that are given. Other columns are of
    what pi did, one row for each command, and 0 where nothing is given.
    """
    iterations = columns.get("iterations", tasks.TASKS[task].learner["iterations"])
    settings = runs.usual_settings(task, iterations) | dict(gone=None, void=None)
    for setting in columns.keys() & settings.keys():
        settings[setting] = columns.pop(setting)
    n = max((len(x) for x in columns.values()), default=1)
    names = *runs.ASKED, "episodes", *evaluate.Episodes._fields, "strides"
    did = {x: np.broadcast_to(np.array(columns.get(x, 0.0), float), n) for x in names}
    learned = dict(iteration=np.array([10, 560, 600]), alpha=np.array([9000, 150, 250]))
    return runs.Run(name, settings, [dict(commit=commit)], learned, did, {}, did, {}, {}, {})


def seeds(scores, powers=None, task="flat", first=10, **settings):
    """Runs at 0.5 m/s, one for each score (on velocity: peak) and power, of seeds from 10 on."""
    score = "peak" if task == "velocity" else "score"
    found = []
    for i, (x, power) in enumerate(zip(scores, powers or [100] * len(scores), strict=True)):
        did = {score: [x], "power": [power], "v_x": [0.5], "asked_v_x": [0.5]} | settings
        found.append(made(f"{settings}{i}", task, seed=first + i, **did))
    return found


def ppo(lam, scores, powers=None, **more):
    """The same of PPO(lam)."""
    return seeds(scores, powers, algo="ppo", lam=lam, **more)


# ---- who is of one kind ----

FAST = dict(task="velocity")


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (dict(algo="ppo", lam=0.0005), "PPO(0.0005)"),
        (dict(algo="ppo", lam=0.0), "PPO(0)"),
        (dict(algo="ppo", lam=0.0, reward="shaped"), "PPO(0) shaped"),
        (dict(algo="ppo", lam=0.0, lr_alpha=7), "PPO(0)"),  # which it does not read
        (dict(lam=0.02), "EIPO from 0.02"),
        (dict(lam=0.005, aux="smooth"), "EIPO from 0.005 smooth"),
        (dict(lam=0.005, aux="mine"), "EIPO from 0.005 mine"),
        (dict(num_envs=512, lr_alpha=0.5), "EIPO from 0.005, num_envs 512, lr_alpha 0.5"),
        (dict(power_formula="torque"), "EIPO from 0.005, power_formula torque"),
        (dict(gone=2, void=None), "EIPO from 0.005, gone 2"),  # settings that an older run had
        # alpha's clock (D38): in 600 iterations of 4000 0.444 and 0.933, in 4000 0.01 and 0.99
        (dict(lr_alpha=0.444, momentum_alpha=0.933), "EIPO from 0.005"),
        (dict(iterations=4000, lr_alpha=0.01, momentum_alpha=0.99), "EIPO from 0.005"),
        (dict(iterations=4000, lr_alpha=0.444), "EIPO from 0.005, lr_alpha 0.444"),
        # on velocity 1 and 0.9 in 1000 of 10 000, also of a run that was stopped after 7
        (dict(FAST, iterations=7, lr_alpha=1.0, momentum_alpha=0.9), "EIPO from 0.0002"),
        (dict(FAST, lr_alpha=1.0, momentum_alpha=0.9), "EIPO from 0.0002"),
        (dict(FAST, iterations=10_000, lr_alpha=0.01, momentum_alpha=0.99), "EIPO from 0.0002"),
    ],
)  # fmt: skip
def test_a_kind_is_what_is_not_usual(settings, name):
    assert str(made(**settings).kind) == name


def test_runs_of_a_group_have_one_task_and_one_length():
    """Kinds of EIPO come first, by their starts, and seeds in order."""
    some = [*ppo(0.01, [1, 1]), *seeds([1], lam=0.02), *seeds([1])]
    some += [made("long", iterations=4000), made("fast", "velocity")]
    groups = runs.by_group(some[::-1])
    assert list(map(str, groups)) == [
        "flat, 600 iterations",
        "flat, 4000 iterations",
        "velocity, 1000 iterations",
    ]
    kinds = groups[Group("flat", 600)]
    assert list(map(str, kinds)) == ["EIPO from 0.005", "EIPO from 0.02", "PPO(0.01)"]
    assert [run.settings["seed"] for run in kinds[Kind("ppo", 0.01)]] == [10, 11]
    assert list(runs.by_group(some, "velocity")) == [Group("velocity", 1000)]
    with pytest.raises(Refused, match="of the task rough"):
        runs.by_group(some, "rough")


def test_a_run_does_not_count_twice():
    with pytest.raises(Refused, match="r and again differ in nothing"):
        runs.by_group([made("r"), made("again")])
    path = RESULTS / "flat/flat-ppo-lam0-seed10.json"
    found = [run.name for run in runs.read_all([path, RESULTS / "flat"])]
    assert len(found) == len({*found}) > 20


@pytest.mark.parametrize(("alpha", "lam"), [([150, 250], 1 / 200), ([-1, 0], np.inf)])
def test_the_last_lambda_is_of_the_last_hundred_iterations(alpha, lam):
    """(150 + 250) / 2 = 200; where alpha ends below 0 no lambda is large enough."""
    run = made()
    run.learned["alpha"][1:] = alpha
    assert run.lam_end == lam and ppo(0.02, [1])[0].lam_end == 0.02


def test_a_command_is_inside_a_cell_or_on_its_edge():
    """Cell (2, 20) of the grid is 0 to 0.5 m/s and 0 to 0.5 rad/s. Of the commands of Figure 5 the
    grid starts with those of at most 1 m/s and 1 rad/s, 5 times 3.
    """
    grid = np.zeros((22, 40))
    grid[2, 20] = 0.4
    cells = runs.cells_of(grid)
    assert {name: x.tolist() for name, x in cells.items()} == dict(v_x=[0.25], yaw=[0.25])
    commands = {(0, 0): 1, (0.5, 0.5): 1, (0.2, 0.3): 1, (0.51, 0): 0, (0, -0.01): 0, (-0.5, 0): 0}
    v_x, yaw = np.array(list(commands)).T
    assert runs.inside(v_x, yaw, cells).tolist() == [bool(x) for x in commands.values()]
    v_x, _, yaw = runs.GRID.T
    assert runs.inside(v_x, yaw, runs.cells_of(tasks.Grid().weights)).sum() == 15


# ---- the statistic ----


def test_the_interval_is_welchs():
    """0, 1, 2 and 4, 5, 6: both variances are 1, so the degrees of freedom are 4 and t is 2.7764;
    the error is sqrt(1/3 + 1/3) = 0.81650, and half of the interval 2.2669.

    With 0, 1, 2 and 3, 5, 7: errors^2 1/3 and 4/3, so (5/3)^2 / (1/18 + 16/18) = 50/17 = 2.9412
    degrees of freedom, for which t is 3.2188 (between 4.3027 of 2 and 3.1824 of 3, by 1 / df);
    the error is sqrt(5/3) = 1.29099, and half 4.155.
    """
    found = paper.compare([0, 1, 2], [4, 5, 6])
    assert found[:3] == (1, 5, -4) and found[3:5] == pytest.approx((-6.2669, -1.7331), abs=1e-4)
    assert str(found) == "-4.000 [-6.267, -1.733]"
    found = paper.compare([0, 1, 2], [3, 5, 7])
    assert found[3:5] == pytest.approx((-4 - 4.155, -4 + 4.155), abs=0.01)


def test_a_ratio_is_of_geometric_means():
    """1, 2, 4 and 16, 32, 64 have the geometric means 2 and 32: 1/16, less and more by e to the
    2.2669 log 2, which is a factor of 4.813.
    """
    found = paper.compare([1, 2, 4], [16, 32, 64], is_ratio=True)
    assert (found.left, found.right) == pytest.approx((2, 32))
    assert np.exp(found[2:5]) == pytest.approx((1 / 16, 1 / 16 / 4.813, 4.813 / 16), rel=1e-3)
    assert str(found) == "x 0.06 [0.01, 0.30]"


@pytest.mark.parametrize("x", [[1, 2], [1, 2, np.inf], [1, 2, np.nan]])
def test_two_runs_or_a_number_that_is_not_finite_decide_nothing(x):
    found = paper.compare(x, [5, 6, 7])
    assert np.isnan(found[3:5]).all() and paper.verdict(*found[3:5], "<", 1) == "open"
    assert "[" not in str(found)


@pytest.mark.parametrize(
    ("low", "high", "claimed", "word"),
    [
        (0.1, 0.2, ">", "agrees"), (-0.2, -0.1, ">", "disagrees"), (-0.1, 0.2, ">", "open"),
        (-0.2, -0.1, "<", "agrees"), (0.1, 0.2, "<", "disagrees"),
        (-0.2, 0.2, "similar", "agrees"), (-0.4, 0.2, "similar", "open"),
        (0.4, 0.5, "similar", "disagrees"), (-0.5, -0.4, "similar", "disagrees"),
        (-0.2, 0.9, "no worse", "agrees"), (-0.9, -0.4, "no worse", "disagrees"),
        (-0.4, 0.2, "no worse", "open"), (-0.9, 0.2, "no more", "agrees"),
        (0.4, 0.9, "no more", "disagrees"), (np.nan, np.nan, "no more", "open"),
    ],
)  # fmt: skip
def test_a_verdict_is_where_the_interval_lies(low, high, claimed, word):
    """The margin is 0.3."""
    assert paper.verdict(low, high, claimed, 0.3) == word


# ---- the sentences of the paper ----


@pytest.fixture
def of(monkeypatch):
    """A function that lets `paper` and `table` be of these runs."""

    def let(some):
        for module in (paper, tables):
            monkeypatch.setattr(module, "read_all", lambda places: some)
        return some

    return let


def rows_of(says):
    """The cells of the lines of `paper` that say this, after the group of each."""
    _, _, *lines = (line.strip("| ").split(" | ") for line in paper.paper(()))
    found, group = [], ""
    for cells in lines:
        group = cells[0].strip("* ") if len(cells) == 1 else group
        found += [[group, *cells[2:]]] if says in cells else []
    return found


def test_a_row_for_each_sentence_and_length(of):
    """EIPO scores 1.3, 1.4, 1.5 and PPO(0.005) 0.9, 1.0, 1.1: 0.4 -+ 0.22669, as above. At 4000
    iterations there are two runs of it, and of other weights none.
    """
    some = [*seeds([1.3, 1.4, 1.5]), *ppo(0.005, [0.9, 1.0, 1.1])]
    length = dict(iterations=4000, lr_alpha=0.01, momentum_alpha=0.99)
    of([*some, *seeds([1.4, 1.4], **length), *ppo(0.005, [1.4, 1.4], **length)])
    assert rows_of("EIPO outperforms tuned PPO") == [
        ["flat, 4000 iterations", "score 1.4 and 1.4", "open"],
        ["flat, 600 iterations", "score +0.400 [+0.173, +0.627]", "agrees"],
    ]
    assert rows_of("EIPO outperforms PPO(0)") == []


def test_a_sentence_about_every_weight_counts(of):
    """Peaks of EIPO are 3, 4, 5; those of PPO(0) 0, 1, 2, which is 3 [0.73, 5.27] less; of
    PPO(0.0001) 3, 4, 5; of PPO(0.0002) 7, 8, 9. The paper prints +0.74, +1.31 and +1.37: the
    second lies within [-2.27, 2.27], and the third is far from [-6.27, -1.73]. Of one weight there
    is only the row that is about it.
    """
    task, every = dict(task="velocity"), "EIPO is faster than PPO at every lambda"
    some = of(seeds([3, 4, 5], **task) + ppo(0, [0, 1, 2], **task))
    cells = ["velocity, 1000 iterations", "peak +3.000 [+0.733, +5.267]; printed +0.74", "agrees"]
    assert rows_of("EIPO is faster than PPO(0)") == [cells] and rows_of(every) == []
    of(some + ppo(0.0001, [3, 4, 5], **task) + ppo(0.0002, [7, 8, 9], **task))
    counts = "agrees at 1 of 3, disagrees at 1; 1 of 3 printed differences excluded"
    ((group, *cells),) = rows_of(every)
    assert group == "velocity, 1000 iterations" and " ".join(cells).strip(" |") == f"peak {counts}"


def test_table_1_as_printed():
    """2.86 less 2.12 and 1.37 m/s; 1.55 less 2.12."""
    assert (paper.FASTER[0], paper.FASTER[-1], paper.SLOWER[0]) == pytest.approx(
        (0.74, 1.49, -0.57)
    )


@pytest.mark.parametrize(
    ("commands", "mine"),
    [
        (paper.ALL, [0, 1, 2, 3, 4]), (paper.BOX, [0, 1]), (paper.SPEED, [3]),
        (paper.TURNING, [2]), ((0, 0.3), [0]), ((0.6, 1), [1]),
    ],
)  # fmt: skip
def test_the_commands_that_a_sentence_is_about(commands, mine):
    did = dict(asked_v_x=np.array([0.3, 1, 2, 3, 4]), asked_yaw=np.array([0, -1, -3, 1, 3]))
    assert np.flatnonzero(paper.asked(did, commands)).tolist() == mine


def test_the_promise_is_of_pi_and_its_own_pi_prime(of):
    """pi draws 100 W and its pi' 200 W, with every seed."""
    some = of(seeds([1.4, 1.4, 1.4], [100, 101, 102]))
    some[:] = [run._replace(prime=run.did | dict(power=2 * run.did["power"])) for run in some]
    assert rows_of("pi draws less power than pi'")[0][1].startswith("power x 0.50 [")


@pytest.mark.parametrize(
    ("commits", "refused"),
    [(paper.ONE_LEARNER[1:3], False), (["unknown"] * 2, True), (["3eb3a5e+", "3eb3a5e"], True),
     (["0123456", "3eb3a5e"], True)],
)  # fmt: skip
def test_a_comparison_is_of_one_learner(of, commits, refused):
    of([made(str(i), seed=10 + i, commit=commit) for i, commit in enumerate(commits)])
    if not refused:
        list(paper.paper(()))
        return
    with pytest.raises(Refused, match="of one learner"):
        list(paper.paper(()))


def test_runs_of_other_seeds_do_not_count(of):
    of(seeds([1, 1, 1], first=0))
    with pytest.raises(Refused, match="a seed from 10 to 17"):
        list(paper.paper(()))


# ---- tables ----


def test_a_line_for_each_kind(of):
    """PPO(0.001) has the best mean, 1.5, and EIPO 1.4, on (80 + 100 + 120) / 3 W. One run of
    PPO(0.02) stands.
    """
    some = seeds([1.3, 1.4, 1.5], [80, 100, 120]) + ppo(0.001, [1.4, 1.5, 1.6])
    some += ppo(0.02, [0.9]) + ppo(0, [0.8], reward="shaped")
    some[-2].did["v_x"] = np.array([0.04])
    of(some)
    head, _, *lines, _ = [line.strip("| ").split(" | ") for line in tables.table(())]
    rows = {line[0]: dict(zip(head, line, strict=True)) for line in lines}
    prime = "pi' of EIPO from 0.005"
    assert list(rows) == ["EIPO from 0.005", prime, "PPO(0) shaped", "PPO(0.001)", "PPO(0.02)"]
    line = rows["EIPO from 0.005"]
    assert (line["score"], line["power [W]"], line["runs that walk"]) == ("1.40", "100", "3/3")
    assert line["energy [J/m]"] == "200" and line["each seed"] == "1.300, 1.400, 1.500"
    assert line["last alpha"] == "250, 250, 250"
    assert line["less best PPO [95 %]"] == "-0.100 [-0.327, +0.127]"
    assert rows["PPO(0.001)"]["less best PPO [95 %]"] == "best"
    assert (
        rows["PPO(0.02)"]["runs that walk"] == "0/1"
        and "stands" in rows["PPO(0.02)"]["energy [J/m]"]
    )


def test_a_run_walks_if_it_goes_the_way_it_was_asked():
    """(1 + 0.5) / 2 = 0.75 m/s, of which half is backwards; where it was asked ahead instead, the
    mean is (-1 + 0.5) / 2, and it does not walk.
    """
    back, ahead = (made("a", asked_v_x=[x, 0.5], v_x=[-1, 0.5]) for x in (-1, 1))
    assert (back.walks, ahead.walks) == (True, False)


def test_the_table_of_the_readme(of):
    of(ppo(0, [1.25], [400]) + ppo(0.002, [1.5]) + seeds([1.25], lam=0.02))
    assert [line.split(" | ")[0].strip("| ") for line in tables.readme(())][2:] == [
        "PPO(0)",
        "PPO(0.002), best of 2 weights",
        "EIPO from 0.02",
    ]
    assert "| PPO(0) | 1.25 | 400 | 1/1 |" in tables.readme(())


# ---- figures ----


def test_fig2_has_every_seed_and_their_mean():
    """D27. Power 150 and 450 W at speeds of 0.5 m/s are 300 and 900 J/m; their mean is drawn. A
    robot that stands, at 0.04 m/s, has no J/m, and its score is seen.
    """
    x = dict(asked_v_x=[0, 0.5], score=[1.25, 1.0])
    some = [made("a", seed=1, power=[75, 150], v_x=[0.04, 0.5], **x)]
    some += [made("b", seed=2, power=[75, 450], v_x=[0.5, 0.5], **x)]
    rows, figure = figures.fig2(some)
    assert [row["energy"] for row in rows] == [np.inf, 300, 150, 900]
    score, energy = figure.axes
    *_, mean = (line.get_ydata() for line in energy.lines)
    assert mean[1] == 600 and np.isnan(mean[0])
    assert len(score.lines) == 3


def test_fig4_has_a_panel_for_each_group():
    rows, figure = figures.fig4([made("a"), made("b", "rough"), made("c", iterations=7)])
    assert len(figure.axes) == 3 and len(rows) == 3


def test_fig5_draws_each_number_at_its_command():
    """Performance 1000 v_x + yaw: rows of the panel are 0.5 m/s apart, so 500, and columns 1. They
    go from -1 m/s and -5 rad/s to 4 m/s and 5 rad/s.
    """
    v_x, _, yaw = runs.GRID.T
    columns = dict(asked_v_x=v_x, asked_yaw=yaw, score=1000 * v_x + yaw, power=100 + v_x)
    _, figure = figures.fig5([made(task="curriculum", **columns)])
    mesh, power = (axes.collections[0] for axes in figure.axes[:2])
    value, (x, y) = mesh.get_array(), np.moveaxis(mesh.get_coordinates(), -1, 0)
    assert value.shape == (11, 11) and (value[0, 0], value[-1, -1]) == (-1005, 4005)
    for axis, (step, width, at) in enumerate(((500, 0.5, y), (1, 1, x))):
        assert np.allclose(np.diff(value, axis=axis), step)
        assert np.allclose(np.diff(at, axis=axis), width)
    assert (power.get_array()[0, 0], power.get_array()[-1, -1]) == (99, 104)


def test_fig5_outlines_what_the_grid_had_reached():
    """At the start that is -1 to 1 m/s and -1 to 1 rad/s. Squares have 0.5 m/s by 1 rad/s, so the
    line goes from -1.25 to 1.25 and from -1.5 to 1.5. One more cell, of 1 to 1.5 m/s and 0 to 0.5
    rad/s, adds the square at (1.5, 0) alone, whose line goes up to 1.75 and from -0.5 to 0.5.
    """
    v_x, _, yaw = runs.GRID.T
    columns = dict(asked_v_x=v_x, asked_yaw=yaw, score=v_x, task="curriculum")
    grid = tasks.Grid()
    first = made("a", **columns)._replace(reached=runs.cells_of(grid.weights))
    grid.weights[4, 20] = 0.2
    more = made("b", lam=0.01, **columns)._replace(reached=runs.cells_of(grid.weights))
    _, figure = figures.fig5([first, more, made("c", lam=0.02, **columns)])
    panels = [axes for axes in figure.axes if axes.get_title()]
    for axes, top in zip(panels, (1.25, 1.75, None), strict=True):
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


def test_fig5_is_of_one_length():
    with pytest.raises(Refused, match="several lengths"):
        figures.fig5([made("a", "curriculum"), made("b", "curriculum", iterations=7)])


def test_fig6_has_a_line_for_each_seed_and_their_mean():
    """Speeds 1, 2 and 3, 4 at 0.17 and 0.51 s: the mean is 2, 3."""
    time = np.array([0.17, 0.51])
    speeds = [dict(time=time, v_x=np.array(x)) for x in ((1.0, 2.0), (3.0, 4.0))]
    fast = [made(f"s{i}", "velocity", seed=i)._replace(speed=x) for i, x in enumerate(speeds)]
    rows, figure = figures.fig6(fast)
    assert [(row["run"], row["v_x"]) for row in rows if row["time"] == 0.51] == [
        ("s0", 2),
        ("s1", 4),
    ]
    (thick,) = [line for line in figure.axes[0].lines if line.get_linewidth() == 2]
    assert thick.get_xydata().tolist() == [[0.17, 2], [0.51, 3]]
    said = {text.get_text(): text.get_position()[1] for text in figure.axes[0].texts}
    assert said == {"EIPO, the paper's robot": 2.5, "PPO(0.01), the paper's robot": 1.5}


def test_table1_has_interquartile_means_beside_the_papers():
    """D26. Peaks of two seeds, 0 to 3 and 4, 5, 6, 1000: the middle half 2, 3, 4, 5 has the mean
    3.5. The paper has 2.86 for EIPO from 0.0002, 2.12 for PPO(0), and nothing for other kinds.
    """
    peaks = [0, 1, 2, 3], [4, 5, 6, 1000]
    fast = [made(f"s{i}", "velocity", seed=i) for i in (0, 1)]
    fast += [made("p", "velocity", algo="ppo", lam=0.0), made("e", "velocity", lam=0.02)]
    fast = [
        run._replace(episodes=dict(peak=np.array(x)))
        for run, x in zip(fast, (*peaks, *peaks), strict=True)
    ]
    rows, figure = figures.table1(fast)
    found = {str(row["kind"]): (row["peak"], row["paper"]) for row in rows}
    assert found["EIPO from 0.0002"] == (3.5, 2.86) and found["PPO(0)"] == (1.5, 2.12)
    assert np.isnan(found["EIPO from 0.02"][1])
    assert rows[0]["low"] < 2 and rows[0]["high"] > 4
    (axes,) = figure.axes
    assert axes.lines[0].get_xdata().tolist() == [1.5, 5.5]


def test_table1_of_one_episode_is_one_line():
    run = made("s", "velocity")._replace(episodes=dict(peak=np.array([1.0])))
    with pytest.raises(Refused, match="has one episode"):
        figures.table1([run])


def test_peaks_over_strides():
    """Of pi and, open, of pi' of each run; in `made` both do the same."""
    some = [made("e", "velocity", strides=[6.0], peak=[4.0])]
    some += [made("p", "velocity", algo="ppo", lam=0.0, strides=[3.0], peak=[2.5])]
    rows, figure = figures.strides(some)
    found = [(str(row["kind"]), row["run"], row["strides"], row["peak"]) for row in rows]
    pi = "EIPO from 0.0002", "e", 6, 4
    assert found == [pi, ("pi' of EIPO from 0.0002", "e", 6, 4), ("PPO(0)", "p", 3, 2.5)]
    dots = figure.axes[0].lines
    assert [line.get_xydata().tolist() for line in dots] == [[[6, 4]], [[6, 4]], [[3, 2.5]]]
    assert [line.get_markerfacecolor() == "none" for line in dots] == [False, True, False]


def test_alpha_over_iterations_beside_one_over_lambda():
    """PPO(0.005), which scores 1.25 on 100 W, has the objective of an alpha of 200."""
    some = seeds([1.4]) + ppo(0.005, [1.25]) + ppo(0, [1.5])
    some += ppo(0.01, [1.2], num_envs=512) + ppo(0.01, [1.2], aux="smooth")  # these have no line
    rows, figure = figures.alpha(some)
    assert [(row["iteration"], row["alpha"]) for row in rows] == [
        (10, 9000),
        (560, 150),
        (600, 250),
    ]
    dotted = [line for line in figure.axes[0].lines if line.get_linestyle() == ":"]
    assert [line.get_ydata()[0] for line in dotted] == [200]
    assert [text.get_text() for text in figure.axes[0].texts] == [" PPO(0.005):\n 1.25 on 100 W"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["EIPO from 0.005"]


def test_weights_have_a_dot_for_ppo_and_an_arrow_for_eipo():
    """lambda 0 stands left of 0.0001. A robot that does not walk, at 0.25 m/s and less, has an open
    dot. EIPO's arrow goes from 0.02 to 1 / 200. The grey band reaches 0.03 down from the best mean.
    """
    some = ppo(0, [1.4, 1.5], [400, 400]) + ppo(0.0001, [1.3])
    for run, v_x in zip(some, (0.25, 0.26), strict=False):
        run.did["v_x"] = np.array([v_x])
    other = ppo(0.005, [1.5], num_envs=128) + ppo(0.01, [1.6], reward="shaped")  # are left out,
    other += ppo(0.01, [1.6], aux="smooth") + seeds([1.6], aux="smooth")  # and these
    rows, figure = figures.weights([*some, *other, *seeds([1.44], [200], lam=0.02)])
    assert (rows[0]["lam"], rows[0]["lam_end"]) == (0.02, 0.005)
    axes = figure.axes[0]
    line, dots, stands, start, end = axes.lines
    assert np.allclose(line.get_xydata(), [[0.0001 / 3, 1.45], [0.0001, 1.3]])
    assert np.allclose(dots.get_xydata(), [[0.0001 / 3, 1.5], [0.0001, 1.3]])
    assert np.allclose(stands.get_xydata(), [[0.0001 / 3, 1.4]])
    assert stands.get_markerfacecolor() == "white" != dots.get_markerfacecolor()
    assert np.allclose([*start.get_xydata(), *end.get_xydata()], [[0.02, 1.44], [0.005, 1.44]])
    (band,) = axes.patches
    assert np.allclose([band.get_y(), band.get_y() + band.get_height()], [1.42, 1.45])


def test_weights_stand_where_they_are_and_0_and_infinity_beside_them():
    """0 at a third of 0.00001. 1 / ((1 + 3) / 2) = 0.5, and where alpha ends at 0, it is 0.2."""
    some = ppo(0, [1.4]) + ppo(1e-5, [1.4]) + seeds([1.4], lam=0.02) + seeds([1.4], lam=0.04)
    for run, alpha in zip(some[2:], ([1, 3], [0, 0]), strict=True):
        run.learned["alpha"][1:] = alpha
    _, figure = figures.weights(some)
    line, _, *ends = figure.axes[0].lines
    assert np.allclose(line.get_xdata(), [1e-5 / 3, 1e-5])
    assert np.allclose([x.get_xdata()[0] for x in ends], [0.02, 0.5, 0.04, 0.2])


def test_weights_on_velocity_are_of_peaks():
    """In a band of 0.37 m/s."""
    fast = ppo(0, [3.0], task="velocity")
    rows, figure = figures.weights([*ppo(0, [1.5]), *fast])
    assert [row["measure"] for row in rows] == [1.5, 3.0]
    (band,) = figure.axes[1].patches
    assert np.allclose([band.get_y(), band.get_y() + band.get_height()], [2.63, 3.0])


# ---- what is kept of a run ----


@pytest.fixture
def short(monkeypatch, tmp_path):
    """An evaluation plays 16 steps, 0.32 s, instead of the paper's 1000, in an empty folder."""
    monkeypatch.setattr(evaluate, "EPISODE_STEPS", 16)
    monkeypatch.chdir(tmp_path)


TO = ["--results", "kept", "--episodes", "11"]


def run_of(name, task="flat", **learner):
    """A run folder with 35 iterations in its metrics."""
    folder = make_run(Path(name), task, **learner)
    rows = [f"{i},{100_001 * i},{i / 20},{i + 1 / 3},inf" for i in range(1, 36)]
    (folder / "metrics.csv").write_text("\n".join(["iteration,steps,reward,v_x,alpha", *rows, ""]))
    return folder


def test_a_run_that_is_kept_comes_out(short):
    """Of pi from both starts and of pi' from random ones; every tenth row of the metrics and the
    last one. It was stopped after 35 of 600 iterations, so it is one of 35. The second time it
    replaces the first.
    """
    folder = run_of("flat-seed3", seed=3)
    shutil.copy(folder / "policy.npz", folder / "policy_prime.npz")
    for _ in range(2):
        assert main(["add", str(folder), *TO]) == 0
    (run,) = runs.read_all(["kept/flat"])
    assert (run.name, str(run.group)) == ("flat-seed3", "flat, 35 iterations")
    assert run.settings["hidden"] == [8] and run.settings["power_formula"] == "power"
    assert run.learned["iteration"].tolist() == [10, 20, 30, 35]
    assert run.learned["v_x"].tolist() == [10.333, 20.333, 30.333, 35.333]
    assert run.learned["alpha"].tolist() == [np.inf] * 4
    for did in (run.did, run.nominal, run.prime):
        assert did["asked_v_x"].tolist() == [x / 10 for x in range(11)]
        assert did["episodes"].tolist() == [1] * 11
    # the same policy from the same starts, of which random ones are not nominal
    assert run.did["v_x"].tolist() == run.prime["v_x"].tolist() != run.nominal["v_x"].tolist()
    # what evaluate.py says of it
    pi, env_cfg = evaluate.load(folder)
    assert run.numbers["score"] == pytest.approx(
        evaluate.evaluate(pi, env_cfg, 11)["score"], rel=1e-4
    )


def test_what_is_kept_of_velocity(short):
    """The peak of each episode, the speed over time, and strides; the peak of the run is the
    interquartile mean over its episodes.
    """
    assert main(["add", str(run_of("r", "velocity")), *TO]) == 0
    (run,) = runs.read_all(["kept/velocity"])
    assert {name: len(x) for name, x in run.episodes.items()} == dict(peak=11)
    assert run.numbers["peak"] == pytest.approx(evaluate.iqm(run.episodes["peak"]), abs=1e-4)
    assert run.speed["time"].tolist() == [0.16]
    assert "strides" in run.did


def test_strides_are_the_strongest_frequency():
    """2 s of 50 rows. Robot 0 swings 3 times a second, and half as far 6 times; robot 1 falls after
    one second, in which it swung 5 times.
    """
    turns = 2 * np.pi * np.arange(100)[:, None] / 50
    angle = 0.8 + np.sin(turns * [3, 5]) + [0.5, 0] * np.sin(turns * 6)
    angle[50:, 1] = np.nan
    assert runs.strides_of(angle, 0.02).tolist() == pytest.approx([3, 5])


def test_speeds_in_thirds_of_a_second():
    """A row each 20 ms: 40 make 0.8 s, so two parts of 20. Robot 1 falls after 30. Means are of
    0 ... 19, and of 20 ... 39 with 20 ... 29: (590 + 245) / 30.
    """
    v_x = np.repeat(np.arange(40.0)[:, None], 2, axis=1)
    v_x[30:, 1] = np.nan
    found = runs.speed_of(v_x, 0.02)
    assert found["time"] == pytest.approx([0.2, 0.6])
    assert found["v_x"] == pytest.approx([9.5, 835 / 30])


@pytest.mark.parametrize(
    ("iterations", "kept"), [(35, [10, 20, 30, 35]), (4001, [*range(30, 4001, 30), 4001])]
)
def test_at_most_two_hundred_rows_are_kept(iterations, kept):
    log = dict(iteration=np.arange(1, iterations + 1), J=np.arange(iterations), kl=None)
    found = runs.thinned(log)
    assert found["iteration"].tolist() == kept and list(found) == ["iteration", "J"]


def test_the_commands_of_figure_5_and_what_the_grid_had_reached(short):
    """11 x 11 commands. The cells come from the checkpoint, as train.py writes it, and are not
    known if it is of another iteration than the policy, or gone.
    """
    folder = run_of("r", "curriculum")
    env_cfg, cfg = settle(
        dict(task="curriculum", history=2), dict(hidden=(8,), hidden_estimator=(8,))
    )
    envs = [go1_env.Go1Env(1, env_cfg, 1) for _ in range(2)]
    state = eipo.init_state(envs, cfg)
    envs[0].commands.weights[4, 20] = 0.4
    path = folder / "checkpoint.npz"
    checkpoint.save(path, state._replace(iteration=35), envs, cfg)
    assert main(["add", str(folder), *TO]) == 0
    (run,) = runs.read_all(["kept/curriculum"])
    assert len(run.did["fell"]) == 121
    assert (run.did["asked_v_x"].max(), run.did["asked_yaw"].min()) == (4, -5)
    assert len(run.reached["v_x"]) == 17  # 4 x 4 cells of 0.5 m/s and 0.5 rad/s, and one more
    assert (run.reached["v_x"][-1], run.reached["yaw"][-1]) == (1.25, 0.25)
    assert len(runs.reached_by(folder, 36)["v_x"]) == 0
    path.unlink()
    assert len(runs.reached_by(folder, 35)["v_x"]) == 0


def test_what_does_not_belong_together_is_refused(short, capsys):
    folder = run_of("r")
    file, prime = folder / "policy.npz", folder / "policy_prime.npz"
    shutil.copy(file, prime)
    rewrite(prime, dict(iteration=30))
    assert "pi and pi' have another iteration" in error_of(capsys, main, "add", folder, *TO)
    prime.unlink()
    rewrite(file, dict(iteration=36))
    assert "no row of iteration 36" in error_of(capsys, main, "add", folder, *TO)
    rewrite(file, dict(iteration=30), noise=0.5)
    assert "policy.npz and config.json have another noise" in error_of(
        capsys, main, "add", folder, *TO
    )
    shutil.rmtree(folder)
    run_of("r")
    (folder / "metrics.csv").unlink()
    assert "metrics.csv: No such file or directory" in error_of(capsys, main, "add", folder, *TO)
    assert not Path("kept").exists()


def test_two_runs_of_one_name_are_refused(short, capsys):
    """Also one after the other, if their settings differ. A run that goes on is the same one."""
    for place in ("a", "b"):
        Path(place).mkdir()
    a, b = run_of("a/run"), run_of("b/run", lam=0.01)
    assert "have one name" in error_of(capsys, main, "add", a, b, *TO)
    assert not Path("kept").exists()
    assert main(["add", str(a), str(a), *TO]) == 0
    before = Path("kept/flat/run.json").read_bytes()
    assert "has another lam" in error_of(capsys, main, "add", b, *TO)
    assert Path("kept/flat/run.json").read_bytes() == before
    with (a / "metrics.csv").open("a") as file:
        file.write("36,3600036,1.8,36.3,inf\n")
    rewrite(a / "policy.npz", dict(iteration=36))
    assert main(["add", str(a), *TO]) == 0, "a run that goes on is the same one"
    (run,) = runs.read_all(["kept/flat"])
    assert run.settings["iterations"] == run.learned["iteration"][-1] == 36
    rewrite(a / "policy.npz", dict(iteration=35))
    assert "has another iterations" in error_of(capsys, main, "add", a, *TO), "it was longer"


def test_a_place_that_cannot_be_written_is_refused_before_it_plays(short, capsys, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # the tests may run as root
    monkeypatch.setattr(evaluate, "run_episodes", None)
    assert "cannot be written" in error_of(capsys, main, "add", run_of("r"), *TO)


@pytest.mark.parametrize(
    "out", ["--out a/b", "--out=a", "'--out=my runs/a'", "--out 'my runs/a'", "--out 'it'\"'\"'s'"]
)
def test_a_file_does_not_say_where_its_run_was(out):
    typed = f"python train.py {out} --task flat"
    assert runs.without_out(typed) == "python train.py --task flat"


def test_the_record_can_be_read():
    """Every run of results/ is of its folder's task and of a learner that is known."""
    found = {task: runs.read_all([RESULTS / task]) for task in paper.PAPER}
    assert sum(map(len, found.values())) > 100
    for task, mine in found.items():
        assert {group.task for group in runs.by_group(mine)} == {task}
        starts = [start for run in mine for start in run.starts]
        assert all(start["command"] and start["commit"] != "unknown" for start in starts)


def test_the_rows_beside_a_picture_are_of_the_runs_that_are_kept():
    """By the commands on our pages, and on velocity by those in place of `table1`."""
    pages = (ROOT / "README.md").read_text() + (RESULTS / "README.md").read_text()
    lines = set(re.findall(r"python -m results (\w+) (.*) --out (\S+)", pages))
    lines |= {(name, *["results/velocity"] * 2) for name in ("fig6", "alpha", "strides")}
    drawn = {(out, f"{name}.csv") for name, _, out in lines}
    assert drawn == {(str(x.parent.relative_to(ROOT)), x.name) for x in RESULTS.rglob("*.csv")}
    for name, places, out in lines:
        files = [path for place in places.split() for path in sorted(ROOT.glob(place))]
        rows, _ = getattr(figures, name)(runs.read_all(files))
        save_rows(rows, made := io.BytesIO())
        assert made.getvalue() == (ROOT / out / f"{name}.csv").read_bytes(), name


def test_pictures_do_not_depend_on_the_users_own_style(tmp_path):
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    (tmp_path / "metrics.csv").write_text("iteration,steps,reward\n1,2,3\n")
    draw = "import pathlib; from runtime.metrics import draw_curves"
    draw += f"; draw_curves(pathlib.Path({str(tmp_path)!r}))"
    alpha = "-m", "results", "alpha", "results/flat", "--out", str(tmp_path)
    page = "from tutorial.figures import *; draw('a', curves(('x', 'y', [1], {'z': [2]})))"
    env = os.environ | dict(MATPLOTLIBRC=str(tmp_path))
    subprocess.run([sys.executable, "-c", page], cwd=ROOT, env=env, check=True)
    for words in (("-c", draw), alpha):  # also in a notebook's `!`, with the notebook's backend
        elsewhere = env | dict(MPLBACKEND="nobody_has_this")
        subprocess.run([sys.executable, *words], cwd=ROOT, env=elsewhere, check=True)
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    with Image.open(tmp_path / "alpha.png") as image:
        assert len(image.convert("RGB").getcolors(2**24)) > 20, "the figure is blank"


# ---- what goes wrong ----


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["fig2", "nobody.json"], "nobody.json: No such file or directory"),
        (["alpha", str(RESULTS / "flat/flat-ppo-lam0-seed10.json"), "--out", "new"], "which alone"),
        (["add", "nowhere"], "nowhere/policy.npz: No such file or directory"),
        (["table", "empty"], "empty holds no run"),
        (["table", "half.json"], "half.json is damaged"),
        (["table", "run"], "run is a run folder: add it"),
    ],
)
def test_what_there_is_not_is_one_line(argv, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    Path("run").mkdir()
    Path("run/config.json").touch()
    whole = (RESULTS / "flat/flat-ppo-lam0-seed10.json").read_text()
    Path("half.json").write_text(whole[: len(whole) // 2])
    assert says in error_of(capsys, main, *argv)
    assert {path.name for path in tmp_path.iterdir()} == {"empty", "half.json", "run"}


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("table RUN --out d", "table takes no --out"), ("fig2 RUN --results d", "no --results"),
        ("table RUN --episodes 1", "takes no --episodes"), ("fig2 RUN --out ''", "it is empty"),
        ("fig7 RUN", "invalid choice"), ("fig2", "RUN"), ("fig2 a --moon", "--moon"),
        ("add RUN --episodes 0", "--episodes is 0"),
    ],
)  # fmt: skip
def test_a_wrong_command_line_is_one_line(line, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert says in error_of(capsys, main, *shlex.split(line)) and not [*tmp_path.iterdir()]


def test_a_pipe_that_is_closed_early_is_no_error():
    """`python -m results table ... | head -1` reads a line and closes the pipe."""
    command = [sys.executable, "-m", "results", "table", "results/rough"]
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    with subprocess.Popen(command, cwd=ROOT, **pipes) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


def test_a_file_is_text_with_a_row_a_line():
    text = runs.text_of(dict(asked=dict(env=dict(a=[1, 2])), did=[["x", "y"], [1, np.inf]]))
    assert text == (
        '{\n "asked": {\n  "env": {\n   "a": [1, 2]\n  }\n },\n'
        ' "did": [\n  ["x", "y"],\n  [1, Infinity]\n ]\n}'
    )
    assert json.loads(text)["did"][1] == [1, np.inf]
    table = runs.table_of(dict(a=["pi"], b=[3686400.0], c=[1 / 3], d=[np.inf]))
    assert table == [["a", "b", "c", "d"], ["pi", 3686400, 0.33333, np.inf]]
