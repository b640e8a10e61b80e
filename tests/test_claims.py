"""results/claims.py: comparisons of runs by the rules of results/audit/rules.md."""

import json
import re

import numpy as np
import pytest
from support import ROOT
from test_results import made

import evaluate
from results import claims, tables, weights
from results.__main__ import main
from results.claims import Comparison, compare, verdict

# ---- numbers and intervals ----


def test_numbers_of_a_run():
    """Commands of 0, 0.1 and 1 m/s: (100 + 300) W / (0.25 + 1.75) m/s = 200 J/m, where the mean of
    the ratios would be about 286. On velocity nothing is asked for, and all count: 1300 / 11.
    """
    e = dict(asked_v_x=[0, 0.1, 1.0], power=[900, 100, 300], v_x=(9, 0.25, 1.75))
    e |= dict(performance=[0, 1, 0.5], fell=[0, 1, 0], peak=[1, 2, 6])
    found = evaluate.numbers({name: np.array(x) for name, x in e.items()})
    assert found == dict(
        performance=0.5, fell=1 / 3, v_x=11 / 3, peak=3, power=1300 / 3, **{"J/m": 200}
    )
    e |= dict(asked_v_x=[0, 0, 0])
    found = evaluate.numbers({name: np.array(x) for name, x in e.items()})
    assert found["J/m"] == pytest.approx(1300 / 11)


def test_intervals_are_paired_by_seed():
    """Seeds differ by 1, 0 and 2: mean 1, deviation 1, error 1 / sqrt 3. On 2 degrees of
    freedom t is 4.302653 at 95 % and 2.919986 at 90 %.
    """
    compared = compare(np.array([1, 2, 4]), np.array([0, 2, 2]))
    assert compared.difference == 1
    assert compared.means == pytest.approx((7 / 3, 4 / 3))
    assert compared.wide == pytest.approx((1 - 2.484138, 1 + 2.484138))
    assert compared.narrow == pytest.approx((1 - 1.685855, 1 + 1.685855))


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
    assert claims.decide(sides, "performance", ">") == (None, "not tested")
    assert claims.decide((left, left), "J/m", ">") == (None, "no verdict, a run stands")
    assert claims.paired({}, "a", "b") == ([], [])


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
        ("no more", (-9, 0.9), (-8, 0.8), "holds"),
        ("no more", (-9, 1.1), (-8, 0.8), "undecided"),
        ("no more", (1.1, 9), (1.2, 8), "reversed"),
        ("", (0.1, 9), (0.2, 8), ""),
    ],
)
def test_a_verdict_by_the_rules(claimed, wide, narrow, word):
    """The margin is 1."""
    assert verdict(Comparison((0, 0), 0, wide, narrow), claimed, 1) == word


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
    PPO(0.005), which stands. Of rough ground there is nothing, so no row.
    """
    arms = dict(flat={"EIPO": arm(shift=0.1, power=50), "PPO(0)": arm()})
    arms["flat"]["PPO(0.005)"] = arm(shift=0.08, v_x=0.01)
    lines = list(claims.claim_lines(arms))
    assert row(lines, 2)[3:] == [
        "3",
        "0.1110 and 0.0110",
        "+0.1000 [+0.1000, +0.1000]",
        "holds",
    ]
    assert row(lines, 1)[-1] == "holds, within the margin"
    assert row(lines, 3, "PPO(0) ")[3:] == ["3", "", "", "holds (of 11 commands: 11 holds)"]
    assert row(lines, 4)[5] == "x 0.50 [0.50, 0.50]" and row(lines, 4)[-1] == "holds"
    assert row(lines, 6)[-1] == "no verdict, a run stands"
    assert row(lines, 9)[-1] == "reversed"
    assert not any(line.startswith("| 10 |") for line in lines)


def test_a_line_for_each_kind_of_run():
    """Performances 0.01, 0.011 and 0.012 at a power of 100, 101 and 102.01 W; at 0.1 m/s and above
    all move at 1 m/s. `made` ends with an alpha of 400. pi' draws 5 times as much.
    """
    runs = [x._replace(prime=y.episodes) for x, y in zip(arm(), arm(power=500.0), strict=True)]
    head, _, pi, prime, _ = claims.table(runs)
    assert head.startswith(
        "| flat, 600 iterations | score | power | fell | from nominal | energy |"
    )
    each = "0.010, 0.011, 0.012"
    assert pi == f"| EIPO | 0.011 | 101 W | 0.0 % | 0.0 % | 101 J/m | 400, 400, 400 | {each} |"
    assert prime == f"| pi' of EIPO | 0.011 | 505 W | 0.0 % | 0.0 % | 505 J/m |  | {each} |"
    head, _, *lines = filter(None, claims.summary(runs + arm("velocity", power=7.0)))
    assert head == "| flat, 600 iterations | score | power | energy | fell | seeds |"
    assert lines[0] == "| EIPO | 0.01 | 101 W | 101 J/m | 0.0 % | 3 |"
    assert lines[1] == "| velocity, 1000 iterations | peak [m/s] | power | energy | fell | seeds |"
    assert lines[3] == "| EIPO | 3.10 | 7 W | 7 J/m | 0.0 % | 3 |"


def test_a_claim_about_every_command():
    """Left is 0.1 above right, but for one command with every seed at which it is 0.1 below."""
    left, right = arm(shift=0.1), arm()
    assert (
        claims.at_every_command((left, right), "performance", ">")
        == "holds (of 11 commands: 11 holds)"
    )
    for run in left:
        run.episodes["performance"][run.episodes["asked_v_x"] == 0.7] -= 0.2
    said = claims.at_every_command((left, right), "performance", ">")
    assert said == "reversed (of 11 commands: 10 holds; 1 reversed)"


def test_commands_that_count():
    """Performance is the command itself: 0.1 to 0.5 has the mean 0.3."""
    columns = dict(asked_v_x=V_X, performance=V_X)
    left, right = ([made(seed=i, **columns) for i in range(3)] for _ in range(2))
    compared, _ = claims.decide((left, right), "performance", ">", (0.1, 0.5))
    assert compared.means == pytest.approx((0.3, 0.3))


def test_rows_of_the_curriculum():
    """Four commands (v_x, yaw rate): (1, -1) on the edge of the start box, (2.5, 0) just fast,
    (0, -2.5) just turning, and (3, 4), which is neither of the last two alone.

    EIPO scores 0.9, 0.6, 0.2 and 0, a mean of 0.425, and the shaped reward 0.9, 0.3, 0.4 and 0,
    a mean of 0.4. Power is 100 W, 125 W and, smooth, 110 W: ratios of 0.8, 0.88 and 1.1.
    """

    def three(scores, power, **settings):
        e = dict(
            asked_v_x=[1, 2.5, 0, 3],
            asked_yaw=[-1, 0, -2.5, 4],
            performance=scores,
            power=4 * [power],
        )
        return [made(f"s{seed}", "curriculum", seed=seed, **e, **settings) for seed in SEEDS]

    eipo, shaped = (0.9, 0.6, 0.2, 0), (0.9, 0.3, 0.4, 0)
    runs = three(eipo, 100.0), three(eipo, 110.0, aux="smooth")
    runs += (three(shaped, 125.0, algo="ppo", lam=0, reward="shaped"),)
    runs += (three((0.1, 0.1, 0.1, 0.1), 90.0, algo="ppo", lam=0.005),)
    kinds = tables.by_kind([run for arm in runs for run in arm])
    lines = list(claims.claim_lines({"curriculum, 2000 iterations": kinds}))
    found = [row(lines, 26, "start box", what) for what in ("- EIPO", "- PPO(0) shaped")]
    assert [cells[4:] for cells in found] == [
        ["0.1000 and 0.9000", "-0.8000 [-0.8000, -0.8000]", "holds"]
    ] * 2
    assert row(lines, 27, "performance: EIPO")[4:] == [
        "0.4250 and 0.4000",
        "+0.0250 [+0.0250, +0.0250]",
        "holds",
    ]
    assert row(lines, 27, "power: EIPO")[5:] == ["x 0.80 [0.80, 0.80]", "holds"]
    assert row(lines, 28, "high yaw rate")[4:6] == [
        "0.2000 and 0.4000",
        "-0.2000 [-0.2000, -0.2000]",
    ]
    assert row(lines, 28, "high v_x")[4:6] == ["0.6000 and 0.3000", "+0.3000 [+0.3000, +0.3000]"]
    assert row(lines, 29, "power: ")[5:] == ["x 0.88 [0.88, 0.88]", "holds, within the margin"]
    assert row(lines, 30, "power: ")[5:] == ["x 1.10 [1.10, 1.10]", "holds, within the margin"]


def test_runs_with_more_episodes_count_as_much():
    """A seed is one number, whatever it is the mean of: older runs have 30 episodes of a command,
    and newer ones 90. Left scores 1, 2, 3 with each command twice, right 0, 2, 1 with each once.
    """
    left, right = (
        [
            made(f"r{seed}", seed=seed, asked_v_x=np.tile(V_X, n), performance=np.full(11 * n, x))
            for seed, x in enumerate(scores)
        ]
        for n, scores in ((2, [1.0, 2.0, 3.0]), (1, [0.0, 2.0, 1.0]))
    )
    compared, _ = claims.decide((left, right), "performance", ">")
    assert compared.means == (2, 1) and compared.difference == 1
    # differences of 1, 0 and 2 have an error of 1 / sqrt 3, and t is 4.302653
    assert compared.wide == pytest.approx((1 - 2.484138, 1 + 2.484138))


def test_the_papers_own_difference():
    """EIPO peaks 0.9 m/s above PPO(0) with every seed: the paper's 0.74 lies outside, and 0.9 of
    PPO(0.0001) below PPO(0) is not the paper's 1.55 - 2.12 = -0.57.
    """
    arms = dict(velocity={"EIPO": arm("velocity", peak=3.9)})
    arms["velocity"] |= {"PPO(0)": arm("velocity"), "PPO(0.0001)": arm("velocity", peak=2.1)}
    lines = list(claims.claim_lines(arms))
    assert row(lines, 23, "EIPO - PPO(0) ")[-1] == "holds; the paper's +0.74 is outside"
    assert row(lines, 24, "PPO(0.0001)")[-1] == "holds; the paper's -0.57 is outside"
    arms["velocity"]["EIPO"][1].episodes["peak"][:] += 1.5
    said = row(list(claims.claim_lines(arms)), 23, "EIPO - PPO(0) ")[-1]
    assert said == "undecided; the paper's +0.74 is inside"


def write(place, *runs):
    """Tables with runs (name, seed, commit), each with an episode. One called long has 4000
    iterations.
    """
    place.mkdir(parents=True)
    rows = []
    for name, seed, commit, *resumed in runs:
        long = dict(iterations=4000, lr_alpha=0.01) if name == "long" else {}
        settings = made(seed=seed, **long).settings
        row = dict(run=name, commit=commit, resumed=json.dumps([dict(commit=x) for x in resumed]))
        rows.append(row | {f"env.{x}": json.dumps(y) for x, y in settings.items()})
    tables.write(place / tables.RUNS, rows)
    episodes = [dict(run=name, policy="pi", fell=0.0) for name, *_ in runs]
    tables.write(place / tables.EPISODES, episodes)


def test_runs_that_count(tmp_path, capsys):
    """Seeds from 10 to 17, in a group of one learner, of which all their starts must be; several
    commits may have one. The longest group of a task comes first.
    """
    others = ("a", 9, "old"), ("d", 18, "old"), ("new-b", 10, "other"), ("long", 10, "newest")
    write(tmp_path / "flat", ("b", 10, "new"), ("c", 17, "new"), *others)
    groups = claims.counted(tmp_path)
    names = {group: [run.name for run in kinds["EIPO"]] for group, kinds in groups.items()}
    assert list(names.items()) == [
        ("flat, 4000 iterations", ["long"]),
        ("flat, 600 iterations", ["b", "c"]),
    ]
    write(tmp_path / "same" / "flat", ("a", 10, "3eb3a5e0"), ("b", 11, "e7fdb0b1", "52831f82"))
    assert [len(kinds["EIPO"]) for kinds in claims.counted(tmp_path / "same").values()] == [2]
    write(tmp_path / "mixed" / "flat", ("a", 10, "3eb3a5e0"), ("b", 11, "c2fb9810"))
    assert main(["claims", "--results", str(tmp_path / "mixed")]) == 2
    write(tmp_path / "more" / "flat", ("a", 10, "0ld"), ("b", 11, "new"))
    assert main(["claims", "--results", str(tmp_path / "more")]) == 2
    assert "0ld, new" in capsys.readouterr().err
    write(tmp_path / "resumed" / "flat", ("a", 10, "new", "0ld"), ("b", 11, "new"))
    assert main(["claims", "--results", str(tmp_path / "resumed")]) == 2
    assert "0ld, new" in capsys.readouterr().err
    write(tmp_path / "unknown" / "flat", ("a", 10, "unknown"), ("b", 11, "unknown"))
    assert main(["claims", "--results", str(tmp_path / "unknown")]) == 2
    assert "commits: unknown" in capsys.readouterr().err
    write(tmp_path / "changed" / "flat", ("a", 10, "abc+"), ("b", 11, "abc+"))
    assert main(["claims", "--results", str(tmp_path / "changed")]) == 2
    assert "commits: abc+" in capsys.readouterr().err
    assert main(["claims", "--results", str(tmp_path / "nothing")]) == 2
    assert "has no run" in capsys.readouterr().err


FLAT = "flat/flat4000-*", "flat/flat-*"
INTERVAL = re.compile(r"([\d.]+\.(\d+)) \[[-+]?([\d.]+), [-+]?([\d.]+)\]")
IN_MIND = *FLAT, "rough/new-*", "velocity", "curriculum"


def test_the_pages_have_what_the_commands_print():
    pages = "".join(page.read_text() for page in (ROOT / "results").rglob("*.md"))
    lines = list(claims.claim_lines(claims.counted()))
    for shown in (claims.TASKS, ("flat/flat4000-*",), ("curriculum",), ("rough/new-*",)):
        lines += claims.table(tables.runs([ROOT / "results" / runs for runs in shown]))
    in_mind = list(claims.summary(tables.runs([ROOT / "results" / runs for runs in IN_MIND])))
    for line in lines + in_mind:
        assert line in pages, line
    # README has the table of its first command: EIPO with 256 robots and 512, nine weights of PPO
    # and EIPO from three other lambda_0, after two lines
    (first,) = (i for i, line in enumerate(in_mind) if line.startswith("| flat, 600 iterations"))
    readme = (ROOT / "README.md").read_text()
    assert all(line in readme for line in in_mind[first : first + 16])


def ends(text):
    """The numbers of "0.12 [0.03, 0.21]" wherever it stands in a text, without their signs, in the
    order in which they stand there and for the opposite difference; and how far rounding may go.
    """
    for x, digits, low, high in INTERVAL.findall(text):
        yield np.array([[x, low, high], [x, high, low]], float), 0.501 * 10 ** -len(digits)


def test_the_intervals_of_the_pages_are_those_that_the_commands_print():
    """A page may turn a difference around, and round it."""
    runs = "flat/flat-*", "rough/new-*"  # as results/README.md has them
    lines = list(weights.answers(tables.runs([ROOT / "results" / x for x in runs])))
    lines += claims.claim_lines(claims.counted())
    printed = np.array([x[0] for x, _ in ends("\n".join(lines))])
    pages = [ROOT / "README.md", *(ROOT / "results").glob("**/README.md")]
    found = [(page, *x) for page in pages for x in ends(" ".join(page.read_text().split()))]
    assert len(found) > 40
    for page, both, rounding in found:
        near = (np.abs(printed[:, None] - both) <= rounding).all(-1)
        assert near.any(), (page, both[0])


def test_the_promise_is_of_pi_and_its_own_pi_prime():
    """pi is 0.01 below its pi' on 100 / 500 of the power. The rival itself is compared with PPO(0),
    and the power of EIPO with that of each PPO of which no claim speaks, without a verdict.
    """
    flat = {"EIPO": arm(shift=-0.01), "pi' of EIPO": arm(power=500), "PPO(0)": arm(power=400)}
    flat["PPO(0.005)"] = arm(power=80)
    lines = list(claims.claim_lines(dict(flat=flat)))
    own = row(lines, "(3)", "flat, performance: EIPO - pi'")
    assert own[3:] == ["3", "0.0010 and 0.0110", "-0.0100 [-0.0100, -0.0100]", "holds"]
    own = row(lines, "(3)", "flat, power: EIPO / pi'")
    assert own[3:] == ["3", "101 and 505", "x 0.20 [0.20, 0.20]", "holds"]
    assert row(lines, "-", "power: pi' of EIPO / PPO(0)")[-2:] == ["x 1.25 [1.25, 1.25]", ""]
    assert row(lines, "-", "power: EIPO / PPO(0)")[-2:] == ["x 0.25 [0.25, 0.25]", ""]
    assert row(lines, "-", "power: PPO(0.005) / PPO(0)")[-2:] == ["x 0.20 [0.20, 0.20]", ""]
    assert not [line for line in lines if line.startswith("| - |") and "EIPO / PPO(0.005)" in line]
