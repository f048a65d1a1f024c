"""`table.md` of the damage experiment: success, leaves touched, swept area and time by method and density, and paired comparisons."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.experiments.analysis.bootstrap import Estimate, by_cluster, by_plant, median
from lime_planner.experiments.analysis.tables import markdown_table
from lime_planner.experiments.damage.trials import LABELS

Trials = list[dict[str, Any]]

ALL = "all plants"


def label(method: str) -> str:
    """A method's name in tables, with its changed parameters."""
    name, _, changes = method.partition(":")
    return LABELS[name] + (f", {changes}" if changes else "")


def graspable(results: dict[str, Any], density: str = ALL) -> Trials:
    """The trials of a density (or of all plants; `scan` for the scans) whose lime can be grasped without touching a stem."""
    wanted = [t for t in results["trials"] if (t["density"] != "scan" if density == ALL else t["density"] == density)]
    return [t for t in wanted if t["target"] is not None]


def succeeded(trial: dict[str, Any], method: str) -> bool:
    """Whether a method carried a trial out."""
    return bool(trial["methods"][method]["status"] == "SUCCEEDED")


def figure(trial: dict[str, Any], method: str, name: str) -> float:
    """A figure of one plan; `leaves` is their number."""
    value = trial["methods"][method][name]
    return float(len(value)) if name == "leaves" else float("nan") if value is None else float(value)


def success_difference(trials: Trials, method: str, other: str) -> Estimate:
    """Share of successes of a method less that of another, on the same grasps."""
    return by_cluster(by_plant(trials, lambda t: float(succeeded(t, method)) - float(succeeded(t, other))), lambda x: float(x.mean()))


def median_ratio(trials: Trials, method: str, other: str, name: str) -> Estimate:
    """Median over grasps that both carried out of one's figure over the other's; 0 over 0 is 1, anything else over 0 is infinite."""

    def row(trial: dict[str, Any]) -> float | None:
        if not (succeeded(trial, method) and succeeded(trial, other)):
            return None
        a, b = figure(trial, method, name), figure(trial, other, name)
        return a / b if b > 0.0 else 1.0 if a == 0.0 else math.inf

    return by_cluster(by_plant(trials, row), median)


def _values(trials: Trials, method: str, name: str) -> Array:
    return np.array([figure(t, method, name) for t in trials if succeeded(t, method)])


def _cell(values: Array, digits: int, statistic: Callable[[Array], Any] = np.mean) -> str:
    return f"{float(statistic(values)):.{digits}f}" if len(values) else "–"


def plants_table(results: dict[str, Any], density: str) -> str:
    """One row for each method."""
    trials = graspable(results, density)
    head = ["method", "success", "leaves touched", "above the least", "swept area [cm²]", "planning [s]", "motion [s]", "joint path [rad]"]
    rows = []
    for method in results["options"]["methods"]:
        solved = [t for t in trials if succeeded(t, method)]
        excess = np.array([figure(t, method, "leaves") - t["leaves_at_best_goal"] for t in solved])
        leaves = _values(trials, method, "leaves")
        rows.append(
            [
                label(method),
                f"{len(solved)} of {len(trials)}" + (f" ({100 * len(solved) / len(trials):.0f} %)" if trials else ""),
                f"{_cell(leaves, 2)} (median {_cell(leaves, 0, np.median)})",
                _cell(excess, 2),
                _cell(_values(trials, method, "area_cm2"), 1),
                _cell(np.array([t["methods"][method]["planning_cpu_s"] for t in trials]), 2, np.median),
                _cell(_values(trials, method, "duration_s"), 1, np.median),
                _cell(_values(trials, method, "path_length_rad"), 1, np.median),
            ]
        )
    return markdown_table(head, rows)


def scans_table(results: dict[str, Any]) -> str:
    """One row for each method: on scans leaves have no numbers, so that contact length and patches of leaf are reported."""
    trials = graspable(results, "scan")
    head = ["method", "success", "leaf contact, tool [m]", "leaf contact, joints [rad]", "swept area [cm²]", "planning [s]", "motion [s]"]
    rows = []
    for method in results["options"]["methods"]:
        rows.append(
            [
                label(method),
                f"{sum(succeeded(t, method) for t in trials)} of {len(trials)}",
                *(_cell(_values(trials, method, name), 3) for name in ("tool_leaf_contact_m", "leaf_contact_rad")),
                _cell(_values(trials, method, "area_cm2"), 1),
                _cell(np.array([t["methods"][method]["planning_cpu_s"] for t in trials]), 2, np.median),
                _cell(_values(trials, method, "duration_s"), 1, np.median),
            ]
        )
    return markdown_table(head, rows)


def paired_table(results: dict[str, Any], density: str, other: str) -> str:
    """Every method against another one on the same grasps: medians of ratios, differences of success."""
    trials = graspable(results, density)
    measured = [("area_cm2", "swept area"), ("duration_s", "motion")]
    if density != "scan":
        measured.insert(0, ("leaves", "leaves touched"))
    else:
        measured.insert(0, ("tool_leaf_contact_m", "leaf contact, tool"))
    head = ["method", "grasps of both", *(f"{words}, ratio" for _, words in measured), "success, points"]
    rows = []
    for method in results["options"]["methods"]:
        if method == other:
            continue
        both = sum(succeeded(t, method) and succeeded(t, other) for t in trials)
        ratios = [median_ratio(trials, method, other, name).text() if both else "–" for name, _ in measured]
        rows.append([label(method), str(both), *ratios, success_difference(trials, method, other).text(0, 100.0)])
    return markdown_table(head, rows)


def failures(results: dict[str, Any], methods: Sequence[str]) -> list[str]:
    """One line for each grasp on which one of the methods failed: which, and how."""
    lines = []
    for density in (ALL, "scan"):
        for trial in graspable(results, density):
            failed = {m: trial["methods"][m]["status"] for m in methods if not succeeded(trial, m)}
            if failed:
                lines.append(f"{trial['scene']}/{trial['number']}: " + ", ".join(f"{label(m)} {status}" for m, status in failed.items()))
    return lines


def status_table(results: dict[str, Any]) -> str:
    """How the methods fail, over plants and scans."""
    trials = graspable(results) + graspable(results, "scan")
    counts = {m: Counter(t["methods"][m]["status"] for t in trials) for m in results["options"]["methods"]}
    kinds = sorted({kind for c in counts.values() for kind in c}, key=lambda kind: (kind != "SUCCEEDED", kind))
    return markdown_table(["method", *kinds], [[label(m), *(str(c[kind]) for kind in kinds)] for m, c in counts.items()])


def table_text(results: dict[str, Any]) -> str:
    """Return the contents of `table.md`."""
    options = results["options"]
    budget = f"{options['iterations']} iterations" if options["iterations"] else f"{options['time_s']:g} s of search"
    if options["repeatable"]:
        budget = "iterations: " + ", ".join(f"{label(m)} {options['repeatable'][m.partition(':')[0]]}" for m in options["methods"])
    trials = [t for t in results["trials"] if t["density"] != "scan"]
    without = sum(t["target"] is None for t in trials)
    lines = ["# Leaves really touched", ""]
    lines.append(f"{options['robot']}, {budget}, seed {options['seed']}, lime_planner {results['version']}.")
    if not results["complete"]:
        lines.append("**Incomplete**: the run was stopped.")
    plants = len({t["scene"] for t in trials})
    lines.append(f"{plants} generated plants, {len(trials) - without} limes that can be grasped without touching a stem")
    lines[-1] += f" ({without} of {len(trials)} cannot and are left out)."
    lines.append(
        "Leaves: whose triangles the arm's meshes cut along the executed trajectory. Least: at the goal configuration that cuts fewest."
    )
    lines.append("Planning: CPU seconds of the whole plan, median, failures included.")
    lines += ["Ratios: medians over the grasps that both methods carried out, 95 % bootstrap interval over plants.", ""]
    for density in [d for d in (ALL, *options["densities"]) if graspable(results, d)]:
        lines += [f"## {density.capitalize()}", "", plants_table(results, density), ""]
        for other, words in (("ignored", "Against leaves ignored"), ("solid", "Against leaves solid")):
            if other in options["methods"]:
                lines += [f"{words}:", "", paired_table(results, density, other), ""]
    if graspable(results, "scan"):
        lines += ["## Scans", "", scans_table(results), ""]
        if "ignored" in options["methods"]:
            lines += ["Against leaves ignored:", "", paired_table(results, "scan", "ignored"), ""]
    lines += ["## How plans ended", "", status_table(results), ""]
    watched = [m for m in options["methods"] if m.partition(":")[0] in ("ignored", "binary", "graded")]
    failed = failures(results, watched) or ["none"]
    lines += [f"Failures of {', '.join(label(m) for m in watched)}:", "", *(f"- {line}" for line in failed), ""]
    return "\n".join(lines)
