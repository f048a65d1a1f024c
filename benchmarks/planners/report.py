"""What a comparison's results say: tables in Markdown, all derived from the results file alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.planner_runs import cost_at
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.experiments.analysis.bootstrap import by_cluster, median

Key = tuple[str, int]

DEFAULT = DEFAULT_PLANNER
TIME, CHECKS = 0, 1  # columns of a curve
CHECK_MARKS = (3_000, 10_000, 30_000, 100_000, 300_000)
LABELS = {
    "lime_star": "lime_star (default)",
    "apf_rrt_star": "APF-RRT*",
    "rrt_star": "RRT*",
    "p_rrt_star": "P-RRT*",
    "apf_rrt_star_paper": "APF-RRT* (paper)",
    "rrt_star_paper": "RRT* (paper)",
    "p_rrt_star_paper": "P-RRT* (paper)",
    "ompl_rrt_star": "OMPL RRT*",
    "ompl_informed_rrt_star": "OMPL Informed RRT*",
    "ompl_bit_star": "OMPL BIT*",
    "ompl_rrt_connect": "OMPL RRT-Connect + shortcutting",
    "pyroboplan": "pyroboplan RRT-Connect + shortcutting",
}


def methods_of(results: Mapping[str, Any]) -> list[str]:
    """The compared methods that have trials, in the order of the tables."""
    seen = {t["method"] for t in results["trials"]}
    return [m for m in results["methods"] if m in seen]


def budget_of(results: Mapping[str, Any]) -> float:
    """Budget of the compared runs [s]; longer ones looked for the best known cost."""
    return float(results["options"]["marks_s"][-1])


def compared(results: Mapping[str, Any], method: str) -> list[dict[str, Any]]:
    """The trials of a method that are compared, without the reference runs."""
    return [t for t in results["trials"] if t["method"] == method and t["seconds"] == budget_of(results)]


def best_known(results: Mapping[str, Any]) -> dict[str, float]:
    """The lowest cost of any trial of each problem, reference runs and times after the budget included; inf where all failed."""
    best: dict[str, float] = {}
    for t in results["trials"]:
        cost = math.inf if t["cost"] is None else float(t["cost"])
        best[t["problem"]] = min(best.get(t["problem"], math.inf), cost, *(p[2] for p in t["curve"]))
    return best


def reached(trial: Mapping[str, Any], mark: float, column: int) -> bool:
    """Whether a run got as far as a mark: all runs have the same time, but not the same number of checks."""
    return column == TIME or trial["checks"] >= mark


def costs_at(results: Mapping[str, Any], method: str, mark: float, column: int = TIME) -> dict[Key, float]:
    """J of every (problem, seed) at a time [s] or a number of checks that its run reached; inf where there was no path yet."""
    trials = [t for t in compared(results, method) if reached(t, mark, column)]
    return {(t["problem"], t["seed"]): cost_at(t["curve"], mark, column) for t in trials}


def ratios_at(results: Mapping[str, Any], method: str, mark: float, column: int = TIME) -> dict[Key, float]:
    """The same divided by the best known cost of the problem; problems that nothing solved are left out."""
    best = best_known(results)
    return {key: cost / best[key[0]] for key, cost in costs_at(results, method, mark, column).items() if math.isfinite(best[key[0]])}


def _quantile(values: Sequence[float], share: float) -> float:
    return float(np.quantile(np.sort(np.array(values)), share, method="nearest")) if len(values) else float("nan")


def _number(value: float, digits: int = 2) -> str:
    if math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:.{digits}f}"


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(heading) + " |", "|---|" + "---:|" * (len(heading) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def cost_table(results: Mapping[str, Any], marks: Sequence[float], column: int, unit: str) -> str:
    """Median J and share of solved runs of each method at each mark, of the runs that got so far; no cell of fewer than half of them."""
    rows = []
    for method in methods_of(results):
        cells, runs = [], len(compared(results, method))
        for mark in marks:
            costs = list(costs_at(results, method, mark, column).values())
            if 2 * len(costs) < runs:
                cells.append("–")
                continue
            solved = sum(math.isfinite(c) for c in costs)
            some = "" if len(costs) == runs else f" ({len(costs)} of {runs} runs)"
            cells.append(f"{_number(median(np.array(costs)), 1)} ({100 * solved / len(costs):.0f} %){some}")
        rows.append([LABELS.get(method, method), *cells])
    return _table(["median J (solved)", *(f"{m:,g} {unit}" for m in marks)], rows)


def ratio_table(results: Mapping[str, Any], marks: Sequence[float]) -> str:
    """Median and 90th percentile of the ratio to the best known cost."""
    rows = []
    for method in methods_of(results):
        cells = []
        for mark in marks:
            ratios = list(ratios_at(results, method, mark).values())
            cells.append(f"{_number(_quantile(ratios, 0.5))} / {_number(_quantile(ratios, 0.9))}")
        rows.append([LABELS.get(method, method), *cells])
    return _table(["J / best known: median / 90 %", *(f"{m:g} s" for m in marks)], rows)


def _pair_ratio(theirs: float, ours: float) -> float:
    if math.isinf(theirs) and math.isinf(ours):
        return 1.0
    return theirs / ours if math.isfinite(ours) else 0.0


def paired_table(results: Mapping[str, Any], marks: Sequence[float]) -> str:
    """Every other method against the default planner at equal time, pair by pair: how many times its J, and how often it is higher."""
    rows = []
    for method in methods_of(results):
        if method == DEFAULT:
            continue
        cells = []
        for mark in marks:
            ours, theirs = costs_at(results, DEFAULT, mark), costs_at(results, method, mark)
            pairs = sorted(ours.keys() & theirs.keys())
            groups: dict[str, list[float]] = {}
            for key in pairs:
                groups.setdefault(key[0], []).append(_pair_ratio(theirs[key], ours[key]))
            if not pairs:
                cells.append("–")
                continue
            won = sum(r > 1.0 for g in groups.values() for r in g) / len(pairs)
            spread = by_cluster([np.array(g) for g in groups.values()], median)
            cells.append(f"{_number(spread.value)} ({_number(spread.low)} to {_number(spread.high)}), {100 * won:.0f} %")
        rows.append([LABELS.get(method, method), *cells])
    return _table(["J / default planner's J (95 %), higher in", *(f"{m:g} s" for m in marks)], rows)


def problem_medians(results: Mapping[str, Any], method: str, mark: float) -> dict[str, float]:
    """Median J over the seeds of each problem."""
    groups: dict[str, list[float]] = {}
    for (problem, _), cost in costs_at(results, method, mark).items():
        groups.setdefault(problem, []).append(cost)
    return {problem: median(np.array(costs)) for problem, costs in groups.items()}


def lead_over_peers(results: Mapping[str, Any], ours_s: float, theirs_s: float) -> tuple[list[str], list[tuple[str, str, float, float]]]:
    """Compare the default planner after `ours_s` with every peer after `theirs_s`, by the medians of each problem.

    Returns:
        The problems where it is below every peer, and for each other problem: its name, the best peer, that one's J and ours.
    """
    ours = problem_medians(results, DEFAULT, ours_s)
    peers = {m: problem_medians(results, m, theirs_s) for m in methods_of(results) if m != DEFAULT}
    ahead, behind = [], []
    for problem, cost in sorted(ours.items()):
        rivals = {m: costs[problem] for m, costs in peers.items() if problem in costs}
        if not rivals:
            continue
        best = min(rivals, key=rivals.__getitem__)
        if cost < rivals[best]:
            ahead.append(problem)
        else:
            behind.append((problem, best, rivals[best], cost))
    return ahead, behind


def lead_text(results: Mapping[str, Any], ours_s: float = 0.5) -> str:
    """The same in words and a table."""
    budget = budget_of(results)
    ahead, behind = lead_over_peers(results, ours_s, budget)
    total = len(ahead) + len(behind)
    if not total:
        return "No problem has runs of the default planner and of a peer."
    text = (
        f"The default planner's median J after {ours_s:g} s is below every peer's after {budget:g} s on {len(ahead)} of {total} problems."
    )
    if behind:
        rows = [[p, LABELS.get(m, m), _number(theirs), _number(cost), _number(cost / theirs, 3)] for p, m, theirs, cost in behind]
        text += "\n\n" + _table(["not on", "best peer", f"its J at {budget:g} s", f"ours at {ours_s:g} s", "ratio"], rows)
    return text


def _percent(shares: Sequence[float]) -> str:
    return f"{100 * float(np.median(shares)):.0f} %" if shares else "–"


def effort_table(results: Mapping[str, Any]) -> str:
    """What the runs did: configurations checked a second, and how a peer's time divides into checks, callbacks and its own work."""
    rows = []
    for method in methods_of(results):
        trials = compared(results, method)
        rate = float(np.median([t["checks"] / t.get("spent_s", t["seconds"]) for t in trials]))
        compiled = [t["compiled_share"] for t in trials if "compiled_share" in t]
        called = [t["callback_share"] for t in trials if "callback_share" in t]
        failures = sum("failure" in t for t in trials)
        heuristic = [t["heuristic_share"] for t in trials if t.get("heuristic_share")]
        in_heuristic = f" (heuristic {_percent(heuristic)})" if heuristic else ""
        rows.append(
            [
                LABELS.get(method, method),
                f"{rate:,.0f}",
                _percent(compiled),
                _percent(called) + in_heuristic,
                str(failures),
                str(sum(t.get("paths_through_stem", 0) for t in trials)),
            ]
        )
    return _table(["", "checks a second", "in checks", "in callbacks", "crashes", "paths through a stem"], rows)


def heading(results: Mapping[str, Any]) -> str:
    """What was compared, on what."""
    m, seeds = results["machine"], {t["seed"] for t in results["trials"] if t["seconds"] == budget_of(results)}
    clock = {"wall": "wall time", "cpu": "processor time of the planner's thread"}[results["options"]["clock"]]
    done = "" if results["complete"] else " **Not complete.**"
    place = f"{m['processor']}, {m['cores']} cores, load {m['load'][0]} at the start"
    return (
        f"{len(results['problems'])} problems, {len(seeds)} seeds, {clock}; {place}. "
        f"J = path length + leaf weight × length inside leaves; a failure counts as infinite.{done}"
    )
