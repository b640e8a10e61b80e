"""lab/claims.py: verdicts by rule."""

import numpy as np
import pytest
from support import ROOT

from lab import claims
from lab.__main__ import main
from lab.statistics import NUMBERS


@pytest.mark.parametrize(
    "rivals, sign, word",
    [((4, 6), 1, "undecided"), ((40, 42), 1, "no"), ((40, 42), -1, "yes")],
)
def test_a_verdict_by_hand(rivals, sign, word):
    """Ours are 0 and 2, mean 1, variance 2, and rivals as far apart. The standard error is
    sqrt(2/2 + 2/2) = sqrt 2, on 2 degrees of freedom t = 4.302653, so +- 6.084870.
    """
    difference, (low, high), said = claims.verdict((0, 2), rivals, sign)
    assert (difference, said) == (1 - np.mean(rivals), word)
    assert (low, high) == pytest.approx((difference - 6.084870, difference + 6.084870))


def test_a_single_seed_decides_nothing():
    difference, interval, said = claims.verdict((0, 2), (100,), 1)
    assert (difference, said) == (-99, "undecided") and np.isnan(interval).all()


def test_energy_is_the_ratio_of_means():
    """Commands of 0, 0.1 and 1 m/s: (100 + 300) W / (0.5 + 1.5) m/s = 200 J/m, where the mean of
    the ratios would be (400 + 150) / 2. On velocity nothing is asked for, and all count.
    """
    e = dict(asked_v_x=[0, 0.1, 1.0], power=[900, 100, 300], v_x=(9, 0.25, 1.75))
    assert NUMBERS["J/m"]({name: np.array(x) for name, x in e.items()}) == 200
    e = dict(asked_v_x=[0, 0], power=[100, 300], v_x=(1, 3))
    assert NUMBERS["J/m"]({name: np.array(x) for name, x in e.items()}) == 100


def test_peak_is_an_interquartile_mean():
    """Of 0, 1, 2, 99 the middle half is 1 and 2."""
    assert NUMBERS["peak"](dict(peak=np.array([0, 1, 2, 99.0]))) == 1.5


@pytest.mark.parametrize(
    "argv, page", [([], "README.md"), (["table1"], "velocity/README.md")], ids=["claims", "table1"]
)
def test_the_page_has_what_the_command_prints(capsys, argv, page):
    assert main(["claims", *argv]) == 0
    text = (ROOT / "results" / page).read_text()
    for line in capsys.readouterr().out.splitlines():
        assert line in text, line
