"""`table.md` of the hidden-stems experiment: real stems touched, limes reached, leaves cut, looks and time, by what was known."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.experiments.analysis.bootstrap import Estimate, by_cluster, by_plant
from lime_planner.experiments.analysis.tables import markdown_table
from lime_planner.experiments.hidden.trials import LABELS

Results = dict[str, Any]
Trials = list[dict[str, Any]]

ALL = "all plants"
UNSEEN_STEPS_RAD = (0.02, 0.1, 0.3)  #: between groups of motions, by how much of their path is unseen
APPROACHES = {"fixed": "one drawn grasp pose", "free": "the fruit, approach free"}


def label(method: str) -> str:
    """What is known by a method, with its changed parameters."""
    name, _, changes = method.partition(":")
    return LABELS[name.partition("-")[0]] + (f", {changes}" if changes else "")


def trials_of(results: Results, density: str = ALL) -> Trials:
    """The trials of a density, or of all plants, whose lime can be grasped without touching a stem."""
    return [t for t in results["trials"] if t["target"] is not None and density in (ALL, t["density"])]


def succeeded(trial: dict[str, Any], method: str) -> bool:
    """Whether a method's motion was sent."""
    return bool(trial["methods"][method]["status"] == "SUCCEEDED")


def _share(rows: list[Array]) -> Estimate:
    """Share of ones: the interval draws whole plants; where all agree, drawing tells nothing, and the exact binomial interval serves."""
    estimate = by_cluster(rows, lambda x: float(x.mean()))
    if rows and estimate.value in (0.0, 1.0):
        from scipy.stats import binomtest

        count = sum(len(row) for row in rows)
        interval = binomtest(round(estimate.value * count), count).proportion_ci(0.95, "exact")
        return Estimate(estimate.value, float(interval.low), float(interval.high))
    return estimate


def touching(trials: Trials, method: str) -> Estimate:
    """Share of the motions sent, looks with them, that touch a real stem; whole plants are drawn for the interval."""
    rows = by_plant(trials, lambda t: float(t["methods"][method]["stems"] > 0) if succeeded(t, method) else None)
    return _share(rows)


def reached(trials: Trials, method: str, full: str) -> Estimate:
    """Share of the limes that full knowledge reaches which a method reaches too."""
    return _share(by_plant(trials, lambda t: float(succeeded(t, method)) if succeeded(t, full) else None))


def leaves_ratio(trials: Trials, method: str, full: str) -> Estimate:
    """Leaves that a method's motions cut, over those that full knowledge's cut on the same limes."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for t in trials:
        if succeeded(t, method) and succeeded(t, full):
            groups.setdefault(t["scene"], []).append((t["methods"][method]["leaves"], t["methods"][full]["leaves"]))
    return by_cluster([np.array(g) for g in groups.values()], lambda x: float(x[:, 0].sum() / max(x[:, 1].sum(), 1.0)))


def _mean(values: list[float], digits: int) -> str:
    return f"{float(np.mean(values)):.{digits}f}" if values else "–"


def _median(values: list[float], digits: int) -> str:
    return f"{float(np.median(values)):.{digits}f}" if values else "–"


def table(results: Results, approach: str, density: str = ALL) -> str:
    """One row for each state of knowledge, for one kind of target."""
    trials = trials_of(results, density)
    methods = [m for m in results["options"]["methods"] if m.partition(":")[0].endswith(f"-{approach}")]
    full = f"full-{approach}"
    head = ["known", "stems known", "reached", "touch a real stem", "[%]", "stem points", "leaves cut", "unseen [rad]", "looks"]
    head += ["planning [s]", "a look [s]", "motion [s]"]
    rows = []
    for method in methods:
        every = [t["methods"][method] for t in trials]
        sent = [m for m in every if m["status"] == "SUCCEEDED"]
        hit = [m for m in sent if m["stems"] > 0]
        share = f"{100.0 * reached(trials, method, full).value:.0f} %" if full in results["options"]["methods"] else ""
        rows.append(
            [
                label(method),
                f"{100.0 * float(np.mean([m['stems_known'] for m in every])):.0f} %" if every else "–",
                f"{len(sent)} of {len(every)}" + (f" ({share})" if share else ""),
                f"{len(hit)} of {len(sent)}",
                touching(trials, method).text(0, 100.0) if sent else "–",
                _median([float(m["stems"]) for m in hit], 0),
                _mean([float(m["leaves"]) for m in sent], 2),
                _mean([float(m["unseen_contact_rad"]) for m in sent], 2),
                _mean([float(m["looks"]) for m in every], 1),
                _median([m["planning_cpu_s"] for m in every], 1),
                _median([s for m in every for s in m["look_cpu_s"]], 2),
                _median([m["duration_s"] for m in sent], 1),
            ]
        )
    return markdown_table(head, rows)


def by_unseen(results: Results) -> str:
    """How many motions touch a real stem, by how much of their path lies in unseen space; all methods but full knowledge."""
    sent = [
        (m["unseen_contact_rad"], m["stems"] > 0)
        for t in trials_of(results)
        for method, m in t["methods"].items()
        if m["status"] == "SUCCEEDED" and not method.startswith("full-")
    ]
    rows, low = [], -1.0
    for high in (*UNSEEN_STEPS_RAD, float("inf")):
        own = [hit for unseen, hit in sent if low < unseen <= high]
        words = f"up to {high:g} rad" if low < 0.0 else f"{low:g} to {high:g} rad" if high < float("inf") else f"more than {low:g} rad"
        rows.append([words, str(len(own)), str(sum(own)), f"{100.0 * float(np.mean(own)):.0f} %" if own else "–"])
        low = high
    return markdown_table(["of the path in unseen space", "motions", "touch a real stem", ""], rows)


def verdict(results: Results) -> str:
    """What planned looks, with the approach free, come to."""
    full, method, trials = "full-free", "looks-free", trials_of(results)
    if not {full, method} <= set(results["options"]["methods"]):
        return "Planned looks with a free approach were not run."
    rows = [["touch a real stem", f"{touching(trials, method).text(0, 100.0)} %"]]
    rows.append(["reached, of what full knowledge reaches", f"{reached(trials, method, full).text(0, 100.0)} %"])
    rows.append(["leaves cut, over those with full knowledge", leaves_ratio(trials, method, full).text()])
    return markdown_table(["one view and planned looks, approach free", "95 % interval over plants"], rows)


def heading(results: Results) -> str:
    """What was run."""
    options, trials = results["options"], trials_of(results)
    plants = len({t["scene"] for t in results["trials"]})
    budget = f"{options['iterations']} iterations" if options.get("iterations") else f"{options['time_s']:g} s"
    return (
        f"{plants} generated plants ({', '.join(options['densities'])}; seeds from {options['first_plant']}), {len(trials)} limes "
        f"that can be grasped without touching a stem ({len(results['trials']) - len(trials)} of {len(results['trials'])} cannot); "
        f"{budget} of search for each plan, {options['max_looks']} looks at most."
    )


def failures(results: Results) -> str:
    """How often each method ended how, where it did not reach the lime."""
    lines = []
    for method in results["options"]["methods"]:
        ended = Counter(t["methods"][method]["status"] for t in trials_of(results))
        others = ", ".join(f"{count} {status}" for status, count in ended.most_common() if status != "SUCCEEDED")
        if others:
            lines.append(f"- {label(method)}, {APPROACHES[method.partition(':')[0].partition('-')[2]]}: {others}")
    return "\n".join(lines) or "None."


def table_text(results: Results) -> str:
    """The whole of `table.md`."""
    parts = [heading(results)]
    for approach, words in APPROACHES.items():
        if any(m.partition(":")[0].endswith(f"-{approach}") for m in results["options"]["methods"]):
            parts += [f"## {words[0].upper()}{words[1:]}", table(results, approach)]
            parts += [f"### {density}\n\n{table(results, approach, density)}" for density in results["options"]["densities"]]
    return "\n\n".join([*parts, by_unseen(results), verdict(results), "## Not reached", failures(results)]) + "\n"
