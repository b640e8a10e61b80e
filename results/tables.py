"""What runs did, as tables in Markdown: means over seeds."""

import numpy as np

from results.figures import WALKS, score_of
from results.paper import compare
from results.runs import by_group, read_all, with_primes
from runtime.cli import Refused
from runtime.kinds import Kind

HEADINGS = "score", "power", "walk", "fell", "from nominal", "energy", "less best PPO [95 %]"
HEADINGS += "last alpha", "each seed"


def short(places):
    """Yields a line for each kind of run, in a table for each group of runs: what pages show."""
    for group, kinds in by_group(read_all(places)).items():
        heading = "peak [m/s]" if score_of(group) == "peak" else "score"
        yield f"| {group} | {heading} | power | fell | runs that walk |"
        yield "|---" * 5 + "|"
        for kind, arm in kinds.items():
            score, power, walk = brief(group, arm)
            yield f"| {kind} | {score} | {power} | {more(arm)[0]} | {walk} |"
        yield ""


def table(places):
    """Yields a line for each kind of run, and for pi' of EIPO, in a table for each group of runs.

    Energy is that of runs that all move ahead. "less best PPO" is the score less that of the weight
    with the best mean, with Welch's interval.
    """
    for group, kinds in by_group(read_all(places)).items():
        yield f"| {' | '.join((str(group), *HEADINGS))} |"
        yield "|---" * (len(HEADINGS) + 1) + "|"
        best, shown = best_ppo(group, kinds), set()
        for kind, arm in with_primes(kinds).items():
            scores = scores_of(group, arm)
            if (
                kind.prime and tuple(scores) in shown
            ):  # it knows no energy, so lambda changes nothing
                continue
            shown.add(tuple(scores))
            less = compare(scores, scores_of(group, kinds[best])) if best else ""
            cells = [*brief(group, arm), *more(arm), str(less if kind != best else "best")]
            alphas = [
                run.learned["alpha"][-1]
                for run in arm
                if (kind.algo, kind.prime) == ("eipo", False)
            ]
            cells += [", ".join(f"{x:.0f}" for x in alphas)]
            yield f"| {kind} | {' | '.join(cells)} | {', '.join(f'{x:.3f}' for x in scores)} |"
        yield ""


def scores_of(group, arm):
    """The score of each Run of an arm, (seeds,)."""
    return np.array([run.numbers[score_of(group)] for run in arm])


def best_ppo(group, kinds):
    """The kind of PPO whose mean score is the best, or None; of the paper's reward and settings."""
    plain = [kind for kind in kinds if kind == Kind("ppo", kind.lam)]
    return max(plain, key=lambda kind: scores_of(group, kinds[kind]).mean(), default=None)


def brief(group, arm):
    """Score, power, and how many runs walk, as text."""
    mine = [run.numbers for run in arm]
    walk = sum(x["v_x"] > WALKS for x in mine)
    power = np.mean([x["power"] for x in mine])
    return [f"{scores_of(group, arm).mean():.2f}", f"{power:.0f} W", f"{walk} of {len(arm)}"]


def more(arm):
    """Falls from both kinds of start, and energy per metre, as text."""
    fell = [100 * np.mean([run.numbers["fell"] for run in arm])]
    starts = [run.nominal["fell"] for run in arm if run.nominal]
    fell += [100 * np.mean(starts)] if starts else []
    energy = np.mean([run.numbers["J/m"] for run in arm])
    shown = f"{energy:.0f} J/m" if np.isfinite(energy) else "a run stands"
    return [*(f"{x:.1f} %" for x in fell), *[""] * (2 - len(fell)), shown]


def readme(places):
    """Yields the table of README.md: six kinds of runs on flat ground."""
    for group, kinds in by_group(read_all(places), "flat").items():
        best = best_ppo(group, kinds)
        if not best:
            continue
        yield "| | score | power | runs that walk |"
        yield "|---|---|---|---|"
        shown = {
            "PPO(0)": Kind("ppo", 0),
            f"PPO({best.lam:g}), best of nine weights": best,
            "PPO(0.005), the paper's": Kind("ppo", 0.005),
            "PPO(0.02)": Kind("ppo", 0.02),
        }
        for lam in (0.005, 0.02):  # with the default settings, or else those that were run
            some = [kind for kind in kinds if (kind.algo, kind.lam) == ("eipo", lam)]
            shown |= {str(kind): kind for kind in sorted(some, key=lambda x: len(x.other))[:1]}
        for name, kind in shown.items():
            if kind in kinds:
                yield f"| {name} | {' | '.join(brief(group, kinds[kind]))} |"
        return
    raise Refused("these runs have none of PPO on flat ground")
