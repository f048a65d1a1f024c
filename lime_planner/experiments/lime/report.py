"""`table.md` of the lime experiment: costs beside the paper's, tests, ratios, further plants, sensitivity to the open choices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.experiments.analysis.bootstrap import Estimate, by_cluster, independent
from lime_planner.experiments.analysis.statistics import MeanTest, against_zero, mean_interval, welch
from lime_planner.experiments.analysis.tables import markdown_table, p_text
from lime_planner.experiments.lime.trials import ALGORITHMS, FIXED, LABELS, PAPER, VARIANTS

Cells = dict[tuple[int, str, str], list[dict[str, Any]]]

PAIRS = (("rrt_star", "apf_rrt_star"), ("p_rrt_star", "apf_rrt_star"), ("rrt_star", "p_rrt_star"))
#: With the sign of the row, as its own t: positive where APF-RRT* is the cheaper one.
PAPER_TESTS = {("rrt_star", "apf_rrt_star"): "t(182.25) = 6.39", ("p_rrt_star", "apf_rrt_star"): "t(186.07) = 7.63"}
_PAPER_SIGN = "The paper prints t(182.25) = -6.39 for a decrease with APF-RRT\\*; here it has the sign of its row, like the other one."
FEWEST = 5  #: successes of every planner, for a ratio to be worth naming


def cells_of(results: dict[str, Any]) -> Cells:
    """Sort the trials by plant, variant and planner."""
    cells: Cells = {}
    for trial in results["trials"]:
        cells.setdefault((trial["plant"], trial["variant"], trial["algorithm"]), []).append(trial)
    return cells


def quantity(trials: list[dict[str, Any]], name: str = "cost") -> Array:
    """One quantity of every trial that found a path; J is left out where an edge goes through a stem."""
    found = [trial[name] for trial in trials if trial["cost"] is not None]
    return np.array([v for v in found if v is not None], dtype=np.float64)


def failures(trials: list[dict[str, Any]]) -> int:
    """How many trials found no path."""
    return sum(trial["cost"] is None for trial in trials)


def blocked(trials: list[dict[str, Any]]) -> int:
    """How many paths have an edge through a stem."""
    return sum(trial["cost"] is not None and trial["J"] is None for trial in trials)


def _median_with_failures(trials: list[dict[str, Any]]) -> float:
    return float(np.sort([math.inf if t["cost"] is None else t["cost"] for t in trials])[(len(trials) - 1) // 2])


def ratio(cells: Cells, plant: int, variant: str, below: str, name: str = "cost") -> Estimate | None:
    """Mean of APF-RRT* over the mean of another planner on one plant; None with too few paths."""
    samples = [quantity(cells.get((plant, variant, key), []), name) for key in ("apf_rrt_star", below)]
    if min(len(s) for s in samples) < FEWEST:
        return None
    return independent(samples, lambda a, b: a.mean(axis=-1) / b.mean(axis=-1))


def overall(ratios: list[Estimate | None]) -> Estimate:
    """Geometric mean of the plants' ratios, with an interval over plants."""
    logs = [np.log([r.value]) for r in ratios if r is not None]
    estimate = by_cluster(logs, lambda rows: float(rows.mean()))
    return Estimate(*(float(np.exp(v)) for v in (estimate.value, estimate.low, estimate.high)))


def ratio_test(ratios: list[Estimate | None]) -> MeanTest | None:
    """Test over plants whether the logarithms of their ratios are 0 on average."""
    return against_zero(np.log([r.value for r in ratios if r is not None]))


def ratio_p(cells: Cells, plant: int, variant: str, below: str, name: str = "cost") -> float:
    """P of Welch's test of APF-RRT* against another planner on one plant; NaN where there is no ratio."""
    first, second = (quantity(cells.get((plant, variant, key), []), name) for key in ("apf_rrt_star", below))
    return welch("apf_rrt_star", below, first, second).p if min(len(first), len(second)) >= FEWEST else math.nan


def mean_text(values: Array, digits: int = 1) -> str:
    """Mean, and its standard error in brackets."""
    mean, error, _ = mean_interval(values)
    if not len(values):
        return "–"
    return f"{mean:.{digits}f}" if math.isnan(error) else f"{mean:.{digits}f} ({error:.{digits}f})"


def estimate_text(estimate: Estimate | None) -> str:
    """An estimate with its interval, or a dash."""
    return "–" if estimate is None or math.isnan(estimate.value) else estimate.text()


def main_table(cells: Cells, plant: int) -> str:
    """The paper's table II with what was measured here."""
    head = ["planner", "node cost", "paper", "median, failures last", "J", "nodes in leaves", "length [rad]", "no path", "edge in stem"]
    rows = []
    for key in ALGORITHMS:
        trials = cells.get((plant, FIXED, key), [])
        median = _median_with_failures(trials) if trials else math.nan
        rows.append(
            [
                LABELS[key],
                mean_text(quantity(trials)),
                "{:.2f} ({:.2f})".format(*PAPER[key]),
                f"{median:.1f}" if math.isfinite(median) else "none",
                mean_text(quantity(trials, "J")),
                mean_text(quantity(trials, "nodes_inside"), 2),
                mean_text(quantity(trials, "length"), 2),
                f"{failures(trials)} of {len(trials)}",
                str(blocked(trials)),
            ]
        )
    return markdown_table(head, rows)


def tests_table(cells: Cells, plant: int) -> str:
    """Welch's t-tests on one plant."""
    rows = []
    for a, b in PAIRS:
        for name, words in (("cost", "node cost"), ("J", "J")):
            first, second = (quantity(cells.get((plant, FIXED, key), []), name) for key in (a, b))
            if min(len(first), len(second)) < 3:
                continue
            c = welch(a, b, first, second)
            paper = PAPER_TESTS.get((a, b), "–") if name == "cost" else "–"
            row = [f"{LABELS[a]} − {LABELS[b]}, {words}", f"{c.difference:.1f}", f"{c.low:.1f} to {c.high:.1f}", f"{c.t:.2f}"]
            rows.append([*row, f"{c.dof:.1f}", p_text(c.p), f"{c.hedges_g:.2f}", paper])
    table = markdown_table(["comparison", "difference", "95 % CI", "t", "df", "p", "Hedges g", "paper"], rows)
    return f"{table}\n\n{_PAPER_SIGN}"


def ratio_rows(cells: Cells, plants: list[int], variant: str) -> tuple[list[list[str]], dict[str, list[Estimate | None]]]:
    """One row for each plant, and the ratios."""
    rows: list[list[str]] = []
    ratios: dict[str, list[Estimate | None]] = {"rrt_star": [], "p_rrt_star": [], "J/rrt_star": [], "J/p_rrt_star": []}
    for plant in plants:
        means = [quantity(cells.get((plant, variant, key), [])) for key in ALGORITHMS]
        counts = [failures(cells.get((plant, variant, key), [])) for key in ALGORITHMS]
        for below in ("rrt_star", "p_rrt_star"):
            ratios[below].append(ratio(cells, plant, variant, below))
            ratios["J/" + below].append(ratio(cells, plant, variant, below, "J"))
        texts = [estimate_text(ratios[name][-1]) for name in ratios]
        rows.append([str(plant), *(mean_text(m, 0) for m in means), " / ".join(map(str, counts)), *texts])
    return rows, ratios


def plants_table(cells: Cells, plants: list[int]) -> str:
    """The further plants with the choices as fixed: costs, ratios, and p of the node cost's ratios."""
    head = ["plant", *(LABELS[key] for key in ALGORITHMS), "no path", "APF / RRT*", "APF / P-RRT*", "J: APF / RRT*", "J: APF / P-RRT*"]
    rows, ratios = ratio_rows(cells, plants, FIXED)
    rows.append(["geometric mean", "", "", "", "", *(estimate_text(overall(values)) for values in ratios.values())])
    for below in ("rrt_star", "p_rrt_star"):
        head.append(f"p, APF / {LABELS[below]}")
        test = ratio_test(ratios[below])
        for row, plant in zip(rows, plants, strict=False):
            row.append(p_text(ratio_p(cells, plant, FIXED, below)))
        rows[-1].append(p_text(test.p if test else math.nan))
    words = "p of the node cost: Welch's test on each plant, not corrected for their number; in the last line a t-test of the logarithms."
    return f"{markdown_table(head, rows)}\n\n{words}"


def sensitivity_table(cells: Cells, plants: list[int]) -> str:
    """One row for each variant: success and ratios over the further plants."""
    head = ["choice", *(f"{LABELS[key]} finds" for key in ALGORITHMS), "APF / RRT*", "APF / P-RRT*", "plants with a ratio"]
    rows = []
    for variant in VARIANTS:
        trials = {key: [t for plant in plants for t in cells.get((plant, variant, key), [])] for key in ALGORITHMS}
        if not any(trials.values()):
            continue
        _, ratios = ratio_rows(cells, plants, variant)
        shares = [f"{100.0 * (1.0 - failures(t) / len(t)):.0f} %" if t else "–" for t in trials.values()]
        known = sum(r is not None for r in ratios["rrt_star"]), sum(r is not None for r in ratios["p_rrt_star"])
        texts = [estimate_text(overall(ratios[below])) for below in ("rrt_star", "p_rrt_star")]
        rows.append([variant, *shares, *texts, f"{known[0]}, {known[1]}"])
    return markdown_table(head, rows)


def ranking(cells: Cells, plants: list[int]) -> list[str]:
    """Planners by mean node cost over plants, cheapest first; plants on which one has no path do not count, and without any it is empty."""
    usable = [p for p in plants if all(len(quantity(cells.get((p, FIXED, key), []))) for key in ALGORITHMS)]
    if not usable:
        return []
    means = {key: np.mean([quantity(cells[(p, FIXED, key)]).mean() for p in usable]) for key in ALGORITHMS}
    return sorted(ALGORITHMS, key=lambda key: means[key])


def table_text(results: dict[str, Any]) -> str:
    """Return the contents of `table.md`."""
    options, cells = results["options"], cells_of(results)
    plants = [scene["seed"] for scene in results["scenes"]]
    lines = ["# The lime experiment", ""]
    lines.append(
        f"{options['robot']}, {options['iterations']} iterations, seed {options['seed']}, collisions by "
        f"{'FCL with undecimated meshes' if options['checker'] == 'fcl' else 'the fast model'}, lime_planner {results['version']}."
    )
    if not results["complete"]:
        lines.append("**Incomplete**: the run was stopped.")
    lines += ["Choices: docs/paper-lime-choices.md. Mean (standard error); trials without a path are counted and left out of means.", ""]
    first = results["scenes"][0]
    lines += [f"## Default scene: dense plant {plants[0]}, {min(first['leaves'])} leaves in the hand at the goal", ""]
    lines += [main_table(cells, plants[0]), "", tests_table(cells, plants[0]), ""]
    for below in ("rrt_star", "p_rrt_star"):
        lines.append(f"- Ratio of means, APF-RRT\\* to {LABELS[below].replace('*', chr(92) + '*')}: ")
        paper = PAPER["apf_rrt_star"][0] / PAPER[below][0]
        ratios = {name: estimate_text(ratio(cells, plants[0], FIXED, below, name)) for name in ("cost", "J")}
        lines[-1] += f"{ratios['cost']}; for J {ratios['J']}; the paper's {paper:.2f}."
    lines.append("")
    if len(plants) > 1:
        lines += ["## Further plants, choices as fixed", "", "Ratios of means with 95 % bootstrap intervals.", ""]
        lines += [plants_table(cells, plants[1:]), "", "## Sensitivity to the choices, over the further plants", ""]
        lines += [sensitivity_table(cells, plants[1:]), ""]
    order = " < ".join(LABELS[key].replace("*", "\\*") for key in ranking(cells, plants))
    words = f"Ranking by mean node cost over all plants: {order}."
    lines += [words if order else "No ranking: there is no plant on which all three planners found a path.", ""]
    return "\n".join(lines)
