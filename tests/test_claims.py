"""lab/claims.py and lab/statistics.py: comparisons of runs by the rules of results/rules.md."""

import json
import re

import numpy as np
import pytest
from scipy import stats
from support import ROOT
from test_lab import made

from lab import claims, promise, record
from lab.__main__ import main
from lab.statistics import NUMBERS, Comparison, compare, shift, verdict

# ---- numbers and intervals ----


def test_energy_is_the_ratio_of_means():
    """Commands of 0, 0.1 and 1 m/s: (100 + 300) W / (0.25 + 1.75) m/s = 200 J/m, where the mean of
    the ratios would be about 286. On velocity nothing is asked for, and all count.
    """
    e = dict(asked_v_x=[0, 0.1, 1.0], power=[900, 100, 300], v_x=(9, 0.25, 1.75))
    assert NUMBERS["J/m"]({name: np.array(x) for name, x in e.items()}) == 200
    e = dict(asked_v_x=[0, 0], power=[100, 300], v_x=(1, 3))
    assert NUMBERS["J/m"]({name: np.array(x) for name, x in e.items()}) == 100


def test_peak_is_an_interquartile_mean():
    """Of 0, 1, 2, 99 the middle half is 1 and 2."""
    assert NUMBERS["peak"](dict(peak=np.array([0, 1, 2, 99.0]))) == 1.5


def test_intervals_are_paired_by_seed():
    """Seeds differ by 1, 0 and 2: mean 1, deviation 1, error 1 / sqrt 3. On 2 degrees of
    freedom t is 4.302653 at 95 % and 2.919986 at 90 %. Welch: variances 7/3 and 4/3, so the error
    is sqrt(7/9 + 4/9) = sqrt(11) / 3, on (11/9)^2 / ((7/9)^2 / 2 + (4/9)^2 / 2) = 242 / 65 degrees.
    """
    compared = compare(np.array([1, 2, 4]), np.array([0, 2, 2]))
    assert (compared.seeds, compared.difference) == (3, 1)
    assert compared.means == pytest.approx((7 / 3, 4 / 3))
    assert compared.wide == pytest.approx((1 - 2.484138, 1 + 2.484138))
    assert compared.narrow == pytest.approx((1 - 1.685855, 1 + 1.685855))
    half = stats.t.ppf(0.975, 242 / 65) * 11**0.5 / 3
    assert compared.welch == pytest.approx((1 - half, 1 + half))
    assert compared.visible == pytest.approx(shift(3) / 3**0.5)


def test_ratios_are_compared_by_logarithms():
    """2/1, 4/1 and 8/2: the logs have the mean 5/3 log 2. Geometric means are 4 and 2^(1/3)."""
    compared = compare(np.array([2, 4, 8]), np.array([1, 1, 2]), ratio=True)
    assert compared.difference == pytest.approx(5 / 3 * np.log(2))
    assert compared.means == pytest.approx((4, 2 ** (1 / 3)))


def test_runs_are_paired_by_seed():
    """Whatever their order. Two common seeds are not enough, and one that stands has no J/m."""
    left = [made(f"l{seed}", seed=seed, performance=[seed]) for seed in (12, 10, 11)]
    right = [made(f"r{seed}", seed=seed, performance=[0]) for seed in (11, 13, 12)]
    sides = claims.paired(dict(a=left, b=right), "a", "b")
    assert [[run.name for run in runs] for runs in sides] == [["l11", "l12"], ["r11", "r12"]]
    assert claims.numbers(sides[0], "performance").tolist() == [11, 12]
    assert claims.decide(*sides, "performance") == (None, "not tested")
    assert claims.decide(left, left, "J/m") == (None, "no verdict, a run stands")
    assert claims.paired({}, "a", "b") == ([], [])


@pytest.mark.parametrize("n", [3, 6])
def test_the_visible_difference_is_seen_in_four_of_five_samples(n):
    """Drawn: n differences with the deviation 1 around shift(n) / sqrt n."""
    drawn = np.random.default_rng(0).normal(shift(n) / n**0.5, 1, (40_000, n))
    seen = stats.ttest_1samp(drawn, 0, axis=1).pvalue < 0.05
    assert seen.mean() == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(
    ("claimed", "wide", "narrow", "word"),
    [
        (">", (0.1, 9), (0.2, 8), "holds"),
        (">", (0.1, 0.9), (0.2, 0.8), "holds, within the margin"),
        ("<", (0.1, 9), (0.2, 8), "reversed"),
        ("<", (-9, -0.1), (-8, -0.2), "holds"),
        (">", (-0.9, -0.1), (-0.8, -0.2), "reversed, within the margin"),
        (">", (-2, 2), (-0.9, 0.9), "level"),
        (">", (-2, 2), (-1.1, 0.9), "undecided"),
        ("similar", (-2, 2), (-0.9, 0.9), "holds"),
        ("similar", (0.9, 3), (1.1, 2.8), "undecided"),
        ("similar", (1.1, 3), (1.2, 2.8), "reversed"),
        ("no worse", (-0.9, 9), (-0.8, 8), "holds"),
        ("no worse", (-1.1, 9), (-0.8, 8), "undecided"),
        ("no worse", (-9, -1.1), (-8, -1.2), "reversed"),
    ],
)
def test_a_verdict_by_the_rules(claimed, wide, narrow, word):
    """The margin is 1."""
    assert verdict(Comparison(3, (0, 0), 0, wide, narrow, (0, 0), 0), claimed, 1) == word


# ---- the rows ----

SEEDS = 10, 11, 12
V_X = np.arange(11) / 10


def arm(task="flat", shift=0.0, power=100.0, v_x=1.0, peak=3.0, **settings):
    """Runs of three seeds. Seed s performs at s / 1000 + shift at every command, from both starts,
    and each draws 1 % more than the one before.
    """
    runs = []
    for i, seed in enumerate(SEEDS):
        columns = dict(asked_v_x=np.tile(V_X, 2) * (task != "velocity"))
        columns |= dict(start_spread=np.repeat([0.5, 0.0], 11))
        columns |= dict(performance=22 * [seed / 1000 + shift], power=22 * [power * 1.01**i])
        columns |= dict(v_x=22 * [v_x], peak=22 * [peak + 0.1 * i])
        runs.append(made(f"{task}-seed{seed}", task, seed=seed, **columns, **settings))
    return runs


def row(lines, number, *words):
    """The cells of the row of that number which has some words."""
    found = [line for line in lines if line.startswith(f"| {number} |")]
    (line,) = [line for line in found if all(word in line for word in words)]
    return [cell.strip() for cell in line.split("|")[1:-1]]


def test_rows_of_the_claims():
    """EIPO performs 0.1 above PPO(0) with every seed, on half of the power, and 0.02 above
    PPO(0.005), which stands.
    """
    arms = dict(flat={"EIPO": arm(shift=0.1, power=50), "PPO(0)": arm()}, rough={}, velocity={})
    arms["flat"]["PPO(0.005)"] = arm(shift=0.08, v_x=0.01)
    lines = list(claims.claim_lines(arms))
    assert row(lines, 2)[3:] == [
        "3",
        "0.1110 and 0.0110",
        "+0.1000 [+0.1000, +0.1000]",
        "[+0.0977, +0.1023]",
        "holds",
    ]
    assert row(lines, 1)[-1] == "holds, within the margin"
    assert row(lines, 3, "PPO(0) ")[3:] == 4 * [""] + ["holds (of 11 commands: 11 holds)"]
    assert row(lines, 4)[5] == "x 0.50 [0.50, 0.50]" and row(lines, 4)[-1] == "holds"
    assert row(lines, 6)[-1] == "no verdict, a run stands"
    assert row(lines, 9)[-1] == "reversed"
    assert ": 10, 11, " in lines[-1] and ", 18, 19, " in lines[-1]


def test_a_line_for_each_kind_of_run():
    """Performances 0.01, 0.011 and 0.012 at a power of 100, 101 and 102.01 W; at 0.1 m/s and above
    all move at 1 m/s. `made` ends with an alpha of 400.
    """
    head, _, line = claims.table(arm())
    assert head.startswith("| flat | seeds | performance: mean; each seed | fell |")
    each = "0.011; 0.010, 0.011, 0.012"
    assert line == f"| EIPO | 3 | {each} | 0.0 % | 0.0 % | 101 W | 101 J/m | 400, 400, 400 |"


def test_a_claim_about_every_command():
    """Left is 0.1 above right, but for one command with every seed at which it is 0.1 below."""
    left, right = arm(shift=0.1), arm()
    assert (
        claims.at_every_command(left, right, "performance", ">")
        == "holds (of 11 commands: 11 holds)"
    )
    for run in left:
        run.episodes["performance"][run.episodes["asked_v_x"] == 0.7] -= 0.2
    said = claims.at_every_command(left, right, "performance", ">")
    assert said == "reversed (of 11 commands: 10 holds, 1 reversed)"


def test_commands_that_count():
    """Performance is the command itself: 0.1 to 0.5 has the mean 0.3."""
    columns = dict(asked_v_x=V_X, performance=V_X)
    assert claims.numbers([made(**columns)], "performance", (0.1, 0.5)) == pytest.approx([0.3])


def test_the_papers_own_difference():
    """EIPO peaks 0.9 m/s above PPO(0) with every seed: the paper's 0.74 lies outside, and 0.9 of
    PPO(0.0001) below PPO(0) is not the paper's 1.55 - 2.12 = -0.57.
    """
    arms = dict(flat={}, rough={}, velocity={"EIPO": arm("velocity", peak=3.9)})
    arms["velocity"] |= {"PPO(0)": arm("velocity"), "PPO(0.0001)": arm("velocity", peak=2.1)}
    lines = list(claims.claim_lines(arms))
    assert row(lines, 23, "EIPO - PPO(0) ")[-1] == "holds; the paper's +0.74 is outside"
    assert row(lines, 24, "PPO(0.0001)")[-1] == "holds; the paper's -0.57 is outside"
    arms["velocity"]["EIPO"][1].episodes["peak"][:] += 1.5
    said = row(list(claims.claim_lines(arms)), 23, "EIPO - PPO(0) ")[-1]
    assert re.fullmatch(r"undecided, would see \d\.\d; the paper's \+0\.74 is inside", said)


def test_every_row_of_the_rules_is_there():
    """results/rules.md counts to 31, of which 26 to 31 are not tested; those about every lambda
    have nine, eight where PPO(0) is the rival, or seven where rows 1 to 3 have the other two.
    """
    numbers = [number for number, *_ in claims.CLAIMS]
    page = (ROOT / "results" / "rules.md").read_text()
    listed = {int(n) for n in re.findall(r"^\| (\d+) \| ", page, re.M)}
    assert {*numbers, *range(26, 32)} == listed
    assert [numbers.count(n) for n in (19, 20, 21, 22, 23, 24)] == [7, 7, 9, 9, 9, 8]


def write(place, *runs):
    """Tables with runs (name, seed, commit), each with an episode."""
    place.mkdir(parents=True)
    settings = made().settings
    rows = [
        dict(run=name, commit=commit, resumed=json.dumps([dict(commit=x) for x in resumed]))
        | {f"env.{x}": json.dumps(seed if x == "seed" else y) for x, y in settings.items()}
        for name, seed, commit, *resumed in runs
    ]
    record.write(place / record.RUNS, rows)
    record.write(place / record.EPISODES, [dict(run=name, fell=0.0) for name, *_ in runs])


def test_runs_that_count(tmp_path, capsys):
    """Seeds from 10 to 17, of one commit, of which all their starts must be."""
    write(tmp_path / "flat", ("a", 9, "old"), ("b", 10, "new"), ("c", 11, "new"), ("d", 23, "old"))
    assert [run.name for run in claims.counted(tmp_path)["flat"]["EIPO"]] == ["b", "c"]
    write(tmp_path / "more" / "flat", ("a", 10, "0ld"), ("b", 11, "new"))
    assert main(["claims", "--results", str(tmp_path / "more")]) == 2
    assert "0ld, new" in capsys.readouterr().err
    write(tmp_path / "resumed" / "flat", ("a", 10, "new", "0ld"), ("b", 11, "new"))
    assert main(["claims", "--results", str(tmp_path / "resumed")]) == 2
    assert "0ld, new" in capsys.readouterr().err
    assert main(["claims", "--results", str(tmp_path / "nothing")]) == 2
    assert "has no run" in capsys.readouterr().err


def test_the_pages_have_what_the_commands_print():
    arms = claims.counted()
    if not any(arms.values()):
        pytest.skip("results/ has no run that counts")
    pages = "".join(page.read_text() for page in (ROOT / "results").rglob("*.md"))
    lines = [*claims.claim_lines(arms), *promise.promise_lines(arms)]
    older = "velocity/older-*", "velocity/binding1000-*"
    for shown in (claims.TASKS, older, ("curriculum", "curriculum/printed-*")):
        lines += claims.table(record.runs([ROOT / "results" / runs for runs in shown]))
    for line in lines:
        assert line in pages, line


# ---- the promise ----


def promised():
    """Arms of flat ground in which the sentence is carried."""
    flat = {"PPO(0)": arm(power=400)}
    for kind in promise.LAMBDA_0:
        flat |= {kind: arm(power=100, shift=-0.01), f"pi' of {kind}": arm(power=500)}
    for kind, less in zip(promise.SEARCHED, (0, -0.02, -0.5), strict=True):
        flat[kind] = arm(power=80, shift=less)
    return dict(flat=flat, rough={}, velocity={})


def test_the_promise_by_hand():
    """pi is 0.01 below its pi' on 100 / 500 of the power. The sentence is carried."""
    lines = list(promise.promise_lines(promised()))
    (own,) = [line for line in lines if "| pi of EIPO against its pi' |" in line]
    cells = [cell.strip() for cell in own.split("|")[1:-1]]
    power = "x 0.20 [0.20, 0.20], 101 and 505 W"
    assert cells[1:4] == ["3", "-0.0100 [-0.0100, -0.0100]", power]
    assert cells[-3:] == ["0.0 and 0.0", "0.0 and 0.0", "holds"]
    assert 'for": carried.\n' in lines
    assert any(line.startswith("| PPO(0.01) against PPO(0) | 3 | -0.5") for line in lines)
    assert "| EIPO from 0.01 / PPO(0.002) | x 1.25 [1.25, 1.25] |" in lines
    rows, figure = promise.promise(promised())
    dot = next(row for row in rows if row["kind"] == "EIPO")
    assert (dot["task"], dot["rival"]) == ("flat", "pi' of EIPO")
    assert dot["performance_difference"] == pytest.approx(-0.01)
    assert dot["power_ratio"] == pytest.approx(0.2)
    assert len(rows) == 3 * (4 + 7)  # four kinds of EIPO, on the right with three of PPO
    drawn = [[len(dots.get_offsets()) for dots in axes.collections] for axes in figure.axes]
    assert drawn == [4 * [3, 1], 7 * [3, 1]]


@pytest.mark.parametrize(
    ("landed", "no_worse", "says"),
    [
        ({}, {}, "carried"),
        ({"EIPO": "fails"}, {}, "refuted"),
        ({"PPO(0.01)": "holds"}, {}, "refuted"),
        ({}, {"EIPO from 0.02": "reversed"}, "refuted"),
        ({"EIPO from 0.01": "undecided"}, {}, "that EIPO from 0.01 lands"),
        ({}, {"EIPO": "undecided"}, "that EIPO is no worse than PPO(0)"),
        ({"PPO(0.01)": "undecided"}, {}, "that one PPO fails"),
    ],
)
def test_the_sentence(landed, no_worse, says):
    """EIPO lands from four lambda_0 and is no worse than PPO(0); PPO lands with two of three
    lambdas, and fails with 0.01. Then one thing is changed.
    """
    words = dict.fromkeys([*promise.LAMBDA_0, *promise.SEARCHED], "holds") | {"PPO(0.01)": "fails"}
    level = dict.fromkeys(promise.LAMBDA_0, "holds")
    assert promise.sentence(words | landed, level | no_worse).endswith(says)


def test_what_lands():
    """It lands if it is no worse and draws less, and fails if one of the two is reversed."""
    assert promise.lands("holds", "holds, within the margin") == "holds"
    assert promise.lands("undecided", "holds") == promise.lands("holds", "level") == "undecided"
    assert promise.lands("reversed", "holds") == "fails"
    assert promise.lands("holds", "reversed, within the margin") == "fails"
    assert promise.lands("not tested", "not tested") == "not tested"
