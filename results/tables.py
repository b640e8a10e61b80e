"""What runs did, as tables in Markdown: means over seeds."""

import numpy as np

from results.figures import LABELS, measure_of
from results.paper import compare
from results.runs import by_group, read_all, with_primes
from runtime.cli import Refused
from runtime.kinds import Kind


def short(places):
    """Yields a table for each group of runs, with a line for each kind: what pages show."""
    for group, kinds in by_group(read_all(places)).items():
        rows = {kind: row_of(group, kind, arm) for kind, arm in kinds.items()}
        yield from lines_of(group, rows, num_columns=4)
        yield ""


def table(places):
    """Yields the same with all columns, and with a line for pi' of each kind of EIPO.

    Energy is left out if a run stands. "less best PPO" is the score less that of the weight
    with the best mean, with Welch's interval. It favours PPO, whose best is chosen by these runs.
    """
    for group, kinds in by_group(read_all(places)).items():
        best, rows = best_ppo(group, kinds), {}
        for kind, arm in with_primes(kinds).items():
            rows[kind] = row_of(group, kind, arm) | {"less best PPO [95 %]": ""}
            if best:
                less = compare(scores_of(group, arm), scores_of(group, kinds[best]))
                rows[kind]["less best PPO [95 %]"] = "best" if kind == best else str(less)
        yield from lines_of(group, rows)
        yield ""


def readme(places):
    """Yields the table of README.md: six kinds of runs on flat ground."""
    for group, kinds in by_group(read_all(places), "flat").items():
        best = best_ppo(group, kinds)
        if not best:
            continue
        shown = {
            "PPO(0)": Kind("ppo", 0),
            f"PPO({best.lam:g}), best of {len(plain_ppo(kinds))} weights": best,
            "PPO(0.005), the paper's": Kind("ppo", 0.005),
            "PPO(0.02)": Kind("ppo", 0.02),
        }
        shown |= {str(kind): kind for kind in (Kind("eipo", 0.005), Kind("eipo", 0.02))}
        shown = {name: kind for name, kind in shown.items() if kind in kinds}
        rows = {name: row_of(group, kind, kinds[kind]) for name, kind in shown.items()}
        yield from lines_of("", rows, num_columns=3)
        return
    raise Refused("none of these runs is of PPO on flat ground")


def lines_of(heading, rows, num_columns=None):
    """Yields a table; rows: {what it is of: {column: text}}; num_columns: if not all."""
    columns = list(next(iter(rows.values())))[:num_columns]
    yield f"| {' | '.join((str(heading), *columns))} |"
    yield "|---" * (len(columns) + 1) + "|"
    for name, cells in rows.items():
        yield f"| {' | '.join((str(name), *(cells[x] for x in columns)))} |"


def row_of(group, kind, arm):
    """What the runs of a kind did, as {column: text}."""
    did = [run.numbers for run in arm]
    scores, falls = scores_of(group, arm), [run.nominal["fell"] for run in arm if run.nominal]
    energy = np.mean([x["J/m"] for x in did])
    has_alpha = kind.algo == "eipo" and not kind.prime
    alphas = [run.learned["alpha"][-1] for run in arm] if has_alpha else []
    return {
        LABELS[measure_of(group)]: f"{scores.mean():.2f}",
        "power [W]": f"{np.mean([x['power'] for x in did]):.0f}",
        "runs that walk": f"{sum(run.walks for run in arm)}/{len(arm)}",
        "fell [%]": f"{100 * np.mean([x['fell'] for x in did]):.1f}",
        "from nominal": f"{100 * np.mean(falls):.1f}" if falls else "",
        "energy [J/m]": f"{energy:.0f}" if np.isfinite(energy) else "a run stands",
        "last alpha": ", ".join(f"{x:.0f}" for x in alphas),
        "each seed": ", ".join(f"{x:.3f}" for x in scores),
    }


def scores_of(group, arm):
    """The score of each Run of an arm, (seeds,)."""
    return np.array([run.numbers[measure_of(group)] for run in arm])


def plain_ppo(kinds):
    """The kinds of PPO with the paper's reward and the usual settings."""
    return [kind for kind in kinds if kind.algo == "ppo" and kind.is_plain]


def best_ppo(group, kinds):
    """The kind in `plain_ppo` with the best mean score, or None."""
    means = {kind: scores_of(group, kinds[kind]).mean() for kind in plain_ppo(kinds)}
    return max(means, key=means.get, default=None)
