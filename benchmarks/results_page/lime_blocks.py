"""The blocks of the results page about the lime experiment."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.experiments.analysis.statistics import against_zero, welch
from lime_planner.experiments.analysis.tables import markdown_table, p_text
from lime_planner.experiments.lime import report as lime
from lime_planner.experiments.lime.trials import ALGORITHMS, FIXED, LABELS, PAPER

Results = dict[str, Any]
Costs = dict[tuple[int, str, int], float | None]


def escaped(text: str) -> str:
    """A text with its stars as Markdown wants them."""
    return text.replace("*", "\\*")


def plants_of(data: Results) -> list[int]:
    """Seeds of a run's plants, the default one first."""
    return [int(scene["seed"]) for scene in data["scenes"]]


def main(data: Results) -> str:
    """Table II on the default plant."""
    return lime.main_table(lime.cells_of(data), plants_of(data)[0])


def tests(data: Results) -> str:
    """Welch's tests on the default plant."""
    return lime.tests_table(lime.cells_of(data), plants_of(data)[0])


def ratios(data: Results) -> str:
    """Ratios of means on the default plant and over the others, beside the paper's."""
    cells, plants, rows = lime.cells_of(data), plants_of(data), []
    for below in ("rrt_star", "p_rrt_star"):
        for name, words in (("cost", "node cost"), ("J", "J")):
            first = lime.ratio(cells, plants[0], FIXED, below, name)
            others = [lime.ratio(cells, plant, FIXED, below, name) for plant in plants[1:]]
            mean = lime.overall(others)
            paper = f"{PAPER['apf_rrt_star'][0] / PAPER[below][0]:.2f}" if name == "cost" else "–"
            known = f"{sum(r is not None for r in others)} of {len(others)}"
            test = lime.ratio_test(others)
            p = "–" if test is None else f"{p_text(test.p)} (t({test.dof}) = {test.t:.2f})"
            rows.append(
                [f"APF-RRT\\* / {escaped(LABELS[below])}, {words}", lime.estimate_text(first), lime.estimate_text(mean), p, known, paper]
            )
    head = ["ratio of means (95 %)", f"plant {plants[0]}", "geometric mean of the others", "p over plants", "plants with a ratio", "paper"]
    return markdown_table(head, rows)


def success(data: Results) -> str:
    """How many trials found a path, over all plants, with the choices as fixed."""
    cells, plants = lime.cells_of(data), plants_of(data)
    rows = []
    for key in ALGORITHMS:
        trials = [t for plant in plants for t in cells.get((plant, FIXED, key), [])]
        if not trials:
            continue
        found = [t for t in trials if t["cost"] is not None]
        empty = sum(all(t["cost"] is None for t in cells.get((plant, FIXED, key), [])) for plant in plants)
        share = f"{len(found)} of {len(trials)} ({100 * len(found) / len(trials):.0f} %)"
        rows.append([escaped(LABELS[key]), share, f"{empty} of {len(plants)}", str(lime.blocked(trials))])
    return markdown_table(["planner", "trials with a path", "plants without any", "paths with an edge through a stem"], rows)


def plants(data: Results) -> str:
    """The further plants."""
    return lime.plants_table(lime.cells_of(data), plants_of(data)[1:])


def sensitivity(data: Results) -> str:
    """Changed choices."""
    return lime.sensitivity_table(lime.cells_of(data), plants_of(data)[1:])


def floor(data: Results) -> str:
    """How low the node cost gets at all: the cheapest path of a plant without an edge in a stem, whatever planner and choice it had."""
    cells, rows, shares = lime.cells_of(data), [], []
    for plant in plants_of(data):
        everything = [t["cost"] for (p, _, _), trials in cells.items() if p == plant for t in trials if t["J"] is not None]
        means = [lime.quantity(cells.get((plant, FIXED, key), [])) for key in ("rrt_star", "apf_rrt_star")]
        if not everything or min(map(len, means)) == 0:
            continue
        least, texts = min(everything), [f"{m.mean():.0f}" for m in means]
        shares.append(least / means[0].mean())
        rows.append([str(plant), *texts, f"{least:.0f}", f"{shares[-1]:.2f}"])
    rows.append(["geometric mean", "", "", "", f"{float(np.exp(np.mean(np.log(shares)))):.2f}"])
    return markdown_table(["plant", "RRT\\*, mean", "APF-RRT\\*, mean", "cheapest path clear of stems", "over RRT\\*'s mean"], rows)


def _costs(trials: list[dict[str, Any]]) -> Costs:
    return {(t["plant"], t["algorithm"], t["trial"]): t["cost"] for t in trials}


def _difference(first: Array, second: Array) -> str:
    """Difference of means with Welch's 95 % interval, marked where it leaves out 0."""
    if min(len(first), len(second)) < lime.FEWEST:
        return "–"
    c = welch("", "", first, second)
    text = f"{c.difference:.0f} ({c.low:.0f} to {c.high:.0f})"
    return f"**{text}**" if c.low > 0.0 or c.high < 0.0 else text


def _rankings(kinds: dict[str, list[dict[str, Any]]], plants: list[int]) -> str:
    """Every plant's means and differences by each checker."""
    rows = []
    for plant in plants:
        for words, trials in kinds.items():
            found = {key: lime.quantity([t for t in trials if (t["plant"], t["algorithm"]) == (plant, key)]) for key in ALGORITHMS}
            means = [f"{lime.mean_text(found[key], 0)}, {len(found[key])}" if len(found[key]) else "none" for key in ALGORITHMS]
            rows.append([str(plant), words, *means, *(_difference(found[a], found[b]) for a, b in lime.PAIRS)])
    differences = [f"{escaped(LABELS[a])} − {escaped(LABELS[b])}" for a, b in lime.PAIRS]
    return markdown_table(["plant", "collisions by", *(f"{escaped(LABELS[key])}, paths" for key in ALGORITHMS), *differences], rows)


def _pairs(fast: Costs, exact: Costs) -> str:
    """Both checkers' answers to the same seed."""
    rows, total = [], []
    for name in (*ALGORITHMS, "all"):
        keys = [key for key in exact if name in (key[1], "all")]
        both = [(e, f) for e, f in ((exact[key], fast[key]) for key in keys) if e is not None and f is not None]
        alone = [sum(a[key] is not None and b[key] is None for key in keys) for a, b in ((exact, fast), (fast, exact))]
        differences = np.array([e - f for e, f in both])
        total.append(len(keys) - sum(alone))
        test = against_zero(differences)
        texts = ["–", "–"] if test is None else [f"{test.mean:.0f} ({test.low:.0f} to {test.high:.0f})", p_text(test.p)]
        equal = str(int((np.abs(differences) < 0.01).sum()))  # radians: the costs are kept with seven digits
        label = escaped(LABELS.get(name, "all three"))
        rows.append([label, f"{total[-1]} of {len(keys)}", *map(str, alone), str(len(both)), equal, *texts])
    head = ["same seed", "end alike", "path by FCL alone", "by the fast model alone", "by both", "of equal cost"]
    return markdown_table([*head, "FCL − fast model, pairs of both", "p"], rows)


def checkers(data: Results, exact: Results) -> str:
    """Both checkers on the plants that both have: rankings of each plant, and the trials of the same seed in pairs."""
    plants = [plant for plant in plants_of(exact) if plant in plants_of(data)]
    by_fcl, shared = [t for t in exact["trials"] if t["plant"] in plants], set(_costs(exact["trials"]))
    fast = [t for t in data["trials"] if t["variant"] == FIXED and t["plant"] in plants]
    same = [t for t in fast if (t["plant"], t["algorithm"], t["trial"]) in shared]
    checked = {"FCL": by_fcl, "fast model, same seeds": same}
    if len(same) < len(fast):
        checked["fast model, all trials"] = fast
    rankings = _rankings(checked, plants)
    words = (
        "Mean node cost (standard error) and the number of paths that it is of; differences of means with Welch's 95 % interval where both "
        f"planners have {lime.FEWEST} paths or more, bold where it leaves out 0. Planners have seeds of their own, so these are not pairs."
    )
    words_of_pairs = "The same planner with the same seed by both checkers (difference of node costs with a paired t-test's 95 % interval):"
    return f"{rankings}\n\n{words}\n\n{words_of_pairs}\n\n{_pairs(_costs(same), _costs(by_fcl))}"
