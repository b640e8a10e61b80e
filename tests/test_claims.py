"""lab/claims.py and lab/overview.py: verdicts by rule, and the pictures of all runs."""

import gzip

import numpy as np
import pytest
from matplotlib.figure import Figure
from support import ROOT, error_of, make_run

from lab import claims, episodes, overview, record
from lab.__main__ import main


@pytest.mark.parametrize(
    "rivals, less, word",
    [((4, 6), False, "undecided"), ((40, 42), False, "no"), ((40, 42), True, "yes")],
)
def test_a_verdict_by_hand(rivals, less, word):
    """Ours are 0 and 2, mean 1, variance 2, and rivals as far apart. The standard error is
    sqrt(2/2 + 2/2) = sqrt 2, on 2 degrees of freedom t = 4.302653, so +- 6.084870.
    """
    difference, (low, high), said = claims.verdict((0, 2), rivals, less)
    assert (difference, said) == (1 - np.mean(rivals), word)
    assert (low, high) == pytest.approx((difference - 6.084870, difference + 6.084870))


def test_a_single_seed_decides_nothing():
    difference, interval, said = claims.verdict((0, 2), (100,))
    assert (difference, said) == (-99, "undecided") and np.isnan(interval).all()


def rows(task, **columns):
    """Episodes as results/ keeps them: dicts of text."""
    n = max(map(len, columns.values()))
    usual = dict.fromkeys(episodes.COLUMNS, [0.0] * n) | columns
    usual = {name: [*x] * (n // len(x)) for name, x in usual.items()}
    return [dict(run="r") | {k: f"{x[i]:g}" for k, x in usual.items()} for i in range(n)]


def test_only_the_evaluation_of_the_paper_counts():
    """Rough ground: 15 cm and random starts. What starts in the nominal pose, or on 10 cm, is out:
    of 1, 2, 4, 8 the first two are left, mean 1.5.
    """
    played = rows(
        "rough",
        start_spread=[0.5, 0.5, 0, 0.5],
        roughness=[0.15, 0.15, 0.15, 0.1],
        performance=[1, 2, 4, 8],
    )
    assert claims.performance(claims.random_starts(played, "rough")) == 1.5


def test_energy_is_the_ratio_of_means():
    """Commands of 0, 0.1 and 1 m/s: (100 + 300) W / (0.5 + 1.5) m/s = 200 J/m, where the mean of
    the ratios is (200 + 200) / 2 only by chance: 100 / 0.25 and 300 / 1.75 do the same here.
    """
    for speeds in ((9, 0.5, 1.5), (9, 0.25, 1.75)):
        e = dict(asked_v_x=[0, 0.1, 1.0], power=[900, 100, 300], v_x=speeds)
        assert claims.energy({name: np.array(x) for name, x in e.items()}) == 200


def test_peak_is_an_interquartile_mean():
    """Of 0, 1, 2, 99 the middle half is 1 and 2."""
    assert claims.peak(dict(peak=np.array([0, 1, 2, 99.0]))) == 1.5


def test_the_claims_name_kinds_of_runs():
    """At most 14, of numbers that there are, of kinds with at least one seed."""
    every = list(claims.claims())
    assert 0 < len(every) <= 14
    for claim in every:
        assert claim.number in claims.NUMBERS and claim.sign in "<>"
        for kind in (claim.ours, claim.rivals):
            task, name = kind.split("/")
            runs = [row["run"] for row in record.read(record.RESULTS / task / record.RUNS)]
            assert any(run.removeprefix(f"{name}-seed").isdecimal() for run in runs), kind


@pytest.mark.parametrize(
    "argv, page", [([], "README.md"), (["table1"], "velocity/README.md")], ids=["claims", "table1"]
)
def test_the_page_has_what_the_command_prints(capsys, argv, page):
    assert main(["claims", *argv]) == 0
    text = (ROOT / "results" / page).read_text()
    for line in capsys.readouterr().out.splitlines():
        assert line in text, line


def test_results_without_a_kind_are_one_line(tmp_path, capsys):
    with pytest.raises(ValueError, match=r"flat-eipo-lam0\.005"):
        claims.table(path=tmp_path)
    assert "table1" in error_of(capsys, main, "claims", "table2")


def test_dots_of_runs(tmp_path):
    """Of a run its score, power, lambda and last alpha; without kept episodes it is left out."""
    folders = [make_run(tmp_path / name, "flat", seed=i) for i, name in enumerate("ab")]
    played = rows("flat", start_spread=[0.5, 0.5], performance=[1, 2], power=[100, 300])
    record.write(folders[0] / "episodes.csv.gz", [record.without_run(row) for row in played])
    data = gzip.decompress((folders[0] / "episodes.csv.gz").read_bytes()).decode()
    assert data.startswith(",".join(episodes.COLUMNS))
    (folders[0] / "metrics.csv").write_text("iteration,alpha\n10,200\n20,400\n")
    (row,) = overview.dots(folders)
    expected = dict(run="a", score=1.5, power=200, lam=0.005, alpha=400, kind="EIPO")
    assert {name: row[name] for name in expected} == expected
    for draw in (overview.tradeoff, overview.lambdas):
        _, figure = draw(folders, None)
        collections = [c.get_offsets() for c in figure.axes[0].collections]
        points = [c[0].tolist() for c in collections if len(c)]  # but for those of the legend
        assert points[0][1] == 1.5 and points[0][0] in (200, 0.005)
    with pytest.raises(ValueError, match="kept episodes"):
        overview.dots(folders[1:])


def test_lambda_0_stands_beside_a_dot_where_nothing_else_is():
    """The usual lambda_0 has no name. Of two dots side by side the left one's name is on its left,
    because the other dot is on its right, and PPO has none.
    """
    axes = Figure().subplots()
    axes.set(xlim=(0, 10), ylim=(0, 10))
    rows = [
        dict(algo="eipo", lam=0.01, power=4, score=5),
        dict(algo="eipo", lam=0.005, power=5, score=5),
        dict(algo="ppo", lam=0.02, power=2, score=2),
    ]
    rows += [dict(algo="ppo", lam=0, power=4, score=y) for y in (4, 6)]
    overview.name_dots(axes, rows, 0.005)
    (text,) = axes.texts
    assert text.get_text() == "0.01" and text.get_position()[0] < 4
    assert text.get_position()[1] == pytest.approx(5)
