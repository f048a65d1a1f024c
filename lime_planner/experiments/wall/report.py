"""`table.md` and `statistics.md` of a wall experiment, beside the paper's numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.experiments.analysis.statistics import Comparison, Effect, mean_interval, mixed_anova, post_hoc, welch
from lime_planner.experiments.analysis.tables import markdown_table, p_text, values
from lime_planner.experiments.wall.reference import MARKS, PAPER, ROWS, YARDSTICK, YARDSTICK_PROPAGATED, YARDSTICK_TRIALS

_LABELS = {row.key: row.label for row in ROWS}


def yardstick(results: dict[str, Any]) -> dict[str, tuple[tuple[float, float], ...]] | None:
    """Return mean and standard deviation to expect on geometry G at the paper's marks, or None where none are known.

    Where the yardstick gives no standard deviation, the one of these trials is taken.
    """
    options = results["options"]
    changed = set()
    for row in ROWS:
        if row.key in options["planners"]:
            from lime_planner.planning.rrt_star.planner import PaperOptions

            default = PaperOptions.wall(row.algorithm, beta=row.beta)
            changed |= {k for k, v in options["planners"][row.key].items() if v != getattr(default, k)}
    if options["world"]["name"] != "G" or tuple(options["marks"]) != MARKS or changed - {"propagate"}:
        return None
    if not changed:
        return {key: expected for key, expected in YARDSTICK.items() if key in options["planners"]}
    deviations = {key: np.nanstd(costs, axis=0, ddof=1) for key, costs in values(results).items() if len(costs) > 1}
    return {key: tuple(zip(YARDSTICK_PROPAGATED[key], map(float, sd), strict=True)) for key, sd in deviations.items()}


def tolerance(sd: float, trials: int) -> float:
    """Return 4 standard errors of the difference between a mean of `trials` and the yardstick's."""
    return 4.0 * math.sqrt(sd**2 / trials + sd**2 / YARDSTICK_TRIALS)


def _head(results: dict[str, Any], title: str) -> list[str]:
    options = results["options"]
    counts = {key: len(rows) for key, rows in values(results).items()}
    lines = [f"# {title}", ""]
    lines.append(f"Wall {options['world']['name']}, seed {options['seed']}, lime_planner {results['version']}. Trials for each row: ")
    lines[-1] += ", ".join(f"{_LABELS[key]} {n}" for key, n in counts.items()) + "."
    if not results["complete"]:
        lines += ["", f"**Incomplete**: the run was stopped before its {results['trials_wanted']} trials for each row were done."]
    first = next(iter(options["planners"].values()))
    lines += ["", f"C_perm {first['c_perm']:g}, δ {first['delta']:g}, costs propagated to descendants: "]
    lines[-1] += ("yes" if first["propagate"] else "no") + f", cost of edges: {first['cost']}, neighbour radius: {first['radius']}."
    return [*lines, ""]


def table_text(results: dict[str, Any]) -> str:
    """Return the contents of `table.md`."""
    options = results["options"]
    marks, costs = options["marks"], values(results)
    expected = yardstick(results)
    lines = _head(results, "Costs of the paths found")
    lines += ["Mean of length + C_perm × nodes inside leaves (standard error). Failed trials are counted and left out of the mean.", ""]
    head = ["algorithm", *(f"{m} iterations" for m in marks), "failures"]
    rows = []
    for key, table in costs.items():
        intervals = [mean_interval(table[:, i]) for i in range(len(marks))]
        failures = " / ".join(str(int(np.isnan(table[:, i]).sum())) for i in range(len(marks)))
        rows.append([_LABELS[key], *(f"{mean:.1f} ({error:.1f})" for mean, error, _ in intervals), failures])
        if tuple(marks) == MARKS and options["world"]["name"] == "G":
            rows.append(["  paper, 100 trials", *(f"{mean:.1f} ({error:.1f})" for mean, error in PAPER[key]), "not given"])
        if expected and key in expected:
            rows.append(["  yardstick, 1000 trials", *(f"{mean:.0f} (SD {sd:.0f})" for mean, sd in expected[key]), ""])
            gaps = [(intervals[i][0] - mean, tolerance(sd, len(table))) for i, (mean, sd) in enumerate(expected[key])]
            rows.append(["  difference (allowed)", *(f"{gap:+.1f} (±{limit:.1f})" for gap, limit in gaps), ""])
    lines += [markdown_table(head, rows), ""]
    lines += ["## What else was measured", "", "Means at each mark; J = length + (C_perm / δ) × length inside leaves.", ""]
    measured = {name: values(results, name) for name in ("J", "length", "nodes_inside", "stored_cost", "time_s")}
    formats = {"J": "{:.1f}", "length": "{:.1f}", "nodes_inside": "{:.2f}", "stored_cost": "{:.1f}", "time_s": "{:.4f}"}
    rows = []
    for key in costs:
        cells = [" / ".join(formats[name].format(v) for v in _means(table[key])) for name, table in measured.items()]
        rows.append([_LABELS[key], *cells])
    lines += [markdown_table(["algorithm", "J", "length", "nodes inside", "stored cost", "time [s]"], rows), ""]
    return "\n".join(lines)


def _means(table: Array) -> list[float]:
    return [float(np.mean(c[np.isfinite(c)])) if np.isfinite(c).any() else math.nan for c in table.T]


def _anova_text(effects: list[Effect]) -> str:
    names = {"algorithm": "algorithm", "iterations": "iterations", "Interaction": "algorithm × iterations"}
    rows = []
    for e in effects:
        epsilon = "–" if math.isnan(e.epsilon) else f"{e.epsilon:.3f}"
        rows.append([names[e.source], f"{e.df1}, {e.df2}", f"{e.F:.2f}", p_text(e.p), f"{e.eta_squared:.3f}", epsilon])
    return markdown_table(["effect", "df", "F", "p", "partial η²", "ε (GG)"], rows)


def _corrected(record: dict[str, Any]) -> float:
    # A family of one comparison needs no correction and has none.
    corrected = float(record["p_corr"])
    return float(record["p_unc"]) if math.isnan(corrected) else corrected


def _post_hoc_text(records: list[dict[str, Any]]) -> str:
    rows = []
    for r in records:
        at = "" if r["iterations"] == "-" else f" at {float(r['iterations']):.0f}"
        a, b = (_LABELS.get(str(r[k]), f"{r[k]} iterations") for k in ("A", "B"))
        rows.append([f"{a} − {b}{at}", f"{r['T']:.2f}", f"{r['dof']:.1f}", p_text(_corrected(r)), f"{r['hedges']:.2f}"])
    return markdown_table(["comparison", "t", "df", "p (Holm)", "Hedges g"], rows)


def _comparison_text(comparisons: list[tuple[int, Comparison]]) -> str:
    rows = [
        [
            f"{_LABELS[c.a]} − {_LABELS[c.b]} at {mark}",
            f"{c.difference:.1f}",
            f"{c.low:.1f} to {c.high:.1f}",
            f"{c.t:.2f}",
            f"{c.dof:.1f}",
            p_text(c.p),
            f"{c.hedges_g:.2f}",
        ]
        for mark, c in comparisons
    ]
    return markdown_table(["comparison", "difference", "95 % CI", "t", "df", "p", "Hedges g"], rows)


def claims(results: dict[str, Any]) -> list[tuple[str, bool, str]]:
    """Check the paper's claims that the data can decide: what is claimed, whether it holds here, and the numbers."""
    costs, marks = values(results), results["options"]["marks"]
    found: list[tuple[str, bool, str]] = []
    effects = {e.source: e for e in mixed_anova({k: costs[k] for k in ("rrt_star", "apf_rrt_star_1")}, marks)}
    told = {"iterations": "costs differ between iterations", "algorithm": "costs differ between RRT* and APF-RRT* (β = 1)"}
    for source, words in told.items():
        e = effects[source]
        found.append((f"{words}, p < .001", e.p < 0.001, f"F({e.df1}, {e.df2}) = {e.F:.1f}, p {p_text(e.p)}"))
    e = effects["Interaction"]
    found.append(("no interaction of iterations and bias", e.p >= 0.05, f"F({e.df1}, {e.df2}) = {e.F:.1f}, p {p_text(e.p)}"))
    tests = [welch("apf_rrt_star_1", "rrt_star", costs["apf_rrt_star_1"][:, i], costs["rrt_star"][:, i]) for i in range(len(marks))]
    below = all(t.difference < 0.0 and t.p < 0.001 for t in tests)
    found.append(("APF-RRT* (β = 1) below RRT* at every mark, p < .001", below, ", ".join(f"{t.difference:.0f}" for t in tests)))
    t = welch("apf_rrt_star_1", "p_rrt_star", costs["apf_rrt_star_1"][:, -1], costs["p_rrt_star"][:, -1])
    words = f"APF-RRT* (β = 1) below P-RRT* at {marks[-1]}, p < .001"
    found.append((words, t.difference < 0.0 and t.p < 0.001, f"{t.difference:.0f}, t({t.dof:.0f}) = {t.t:.2f}, p {p_text(t.p)}"))
    means = {key: float(np.nanmean(costs[key][:, -1])) for key in costs if key.startswith("apf")}
    best = min(means, key=lambda key: means[key])
    text = ", ".join(f"{_LABELS[key]} {mean:.0f}" for key, mean in means.items())
    found.append((f"β = 1 is the best of the three at {marks[-1]}", best == "apf_rrt_star_1", text))
    return found


def statistics_text(results: dict[str, Any]) -> str:
    """Return the contents of `statistics.md`; needs two trials or more of every row."""
    costs, marks = values(results), results["options"]["marks"]
    lines = _head(results, "Tests")
    complete = {key: int(np.isfinite(table).all(axis=1).sum()) for key, table in costs.items()}
    if len(costs) < 2 or min(complete.values(), default=0) < 3 or len(marks) < 2:
        lines += ["Too few trials: the tests need two rows, two marks and three trials without a failure in every row.", ""]
        return "\n".join(lines)
    lines += ["Computed by pingouin. Trials with a failure at any mark are left out of the analyses of variance: "]
    lines[-1] += ", ".join(f"{_LABELS[key]} {len(costs[key]) - n}" for key, n in complete.items()) + "."
    lines += ["", "## Two-way mixed analysis of variance, all rows", ""]
    lines += ["Iterations within trials, algorithm between them; p of the within effects with the Greenhouse-Geisser correction.", ""]
    lines += [_anova_text(mixed_anova(costs, marks)), ""]
    if {"rrt_star", "apf_rrt_star_1"} <= set(costs):
        pair = {k: costs[k] for k in ("rrt_star", "apf_rrt_star_1")}
        lines += ["## The paper's analysis: RRT* and APF-RRT* (β = 1)", ""]
        lines += ["The paper: iterations F(2, 396) = 166.985, p < .001; algorithm F(1, 198) = 88.103, p < .001; no interaction.", ""]
        lines += [_anova_text(mixed_anova(pair, marks)), "", _post_hoc_text(post_hoc(pair, marks)), ""]
    lines += ["## Post-hoc comparisons, all rows", "", _post_hoc_text(post_hoc(costs, marks)), ""]
    lines += ["## Unpaired two-tailed t-tests (Welch)", ""]
    lines += ["The paper: P-RRT* against APF-RRT* (β = 1) at 5000 iterations, t(198) = 4.12, p < .001.", ""]
    pairs = [("rrt_star", "apf_rrt_star_1"), ("p_rrt_star", "apf_rrt_star_1"), ("rrt_star", "p_rrt_star")]
    comparisons = [(m, welch(a, b, costs[a][:, i], costs[b][:, i])) for a, b in pairs if {a, b} <= set(costs) for i, m in enumerate(marks)]
    lines += [_comparison_text(comparisons), ""]
    if set(costs) >= {row.key for row in ROWS}:
        lines += ["## The paper's claims", ""]
        judged = [[claim, "holds" if ok else "does not hold", numbers] for claim, ok, numbers in claims(results)]
        lines += [markdown_table(["claim", "here", "numbers"], judged), ""]
    return "\n".join(lines)
