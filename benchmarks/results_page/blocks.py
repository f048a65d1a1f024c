"""The texts of the results page: tables and sentences with numbers, each made from kept results and from nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.planners import report as compare
from benchmarks.results_page import lime_blocks as lime
from benchmarks.results_page.lime_blocks import escaped
from benchmarks.scale import report as scale
from lime_planner.core.parameters import parse_assignment, settings_from
from lime_planner.experiments.analysis.bootstrap import by_cluster, by_plant, median
from lime_planner.experiments.analysis.tables import markdown_table
from lime_planner.experiments.damage import report as damage
from lime_planner.experiments.hidden import report as hidden
from lime_planner.experiments.runs.results_file import machine_text

Results = dict[str, Any]

_CLOCKS = {"wall": "wall time", "cpu": "processor time of the planner's thread"}
DENSE_POINTS, LEAF_RATIO = 25.0, 0.5  # what was asked of the default planner
MEDIAN_RATIO, TAIL_RATIO = 1.10, 1.25
PEER_SHARE = 90.0
OURS_S, FIRST_MARK_S = 0.5, 0.5
_TOUCHING = ("ignored", "binary", "graded", "free", "candidates")  # methods that may touch leaves


# Leaves really touched.


def _plural(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")


def damage_heading(data: Results) -> str:
    """What was run."""
    options = data["options"]
    plants = [t for t in data["trials"] if t["density"] != "scan"]
    usable, scans = [t for t in plants if t["target"] is not None], damage.graspable(data, "scan")
    budget = f"{options['iterations']} iterations" if options["iterations"] else f"{options['time_s']:g} s of search"
    if options["repeatable"]:
        budget = ", ".join(f"{damage.label(m)} {options['repeatable'][m.partition(':')[0]]:,}" for m in options["methods"])
        budget = f"iterations of each method: {escaped(budget)}"
    return (
        f"{len({t['scene'] for t in plants})} plants, {len(usable)} limes that can be grasped without touching a stem "
        f"({len(plants) - len(usable)} of {len(plants)} cannot), {len(scans)} places in {len({t['scene'] for t in scans})} scans; {budget}."
    )


def damage_verdict(data: Results) -> str:
    """What was asked, and what came out, for both leaf costs."""
    rows = []
    for method in ("binary", "graded"):
        if method not in data["options"]["methods"]:
            continue
        solid = damage.success_difference(damage.graspable(data, "dense"), method, "solid")
        trials = damage.graspable(data)
        ratio = damage.median_ratio(trials, method, "ignored", "leaves")
        success = damage.success_difference(trials, method, "ignored")
        rows.append([damage.label(method), solid.text(0, 100.0), ratio.text(), success.text(1, 100.0)])
    head = [
        "method",
        f"dense plants: success over leaves solid, points (asked: {DENSE_POINTS:.0f})",
        f"all plants: leaves touched / leaves ignored, median (asked: {LEAF_RATIO:g})",
        "all plants: success over leaves ignored, points (asked: 0)",
    ]
    return markdown_table(head, rows)


def damage_excess(data: Results) -> str:
    """Ratios of what planners can influence: leaves beyond those that every grasp of the lime must cut."""
    trials = [t for t in damage.graspable(data) if damage.succeeded(t, "ignored")]
    rows = []
    for method in data["options"]["methods"]:
        both = [t for t in trials if damage.succeeded(t, method)]
        if not both:
            continue
        totals = [sum(damage.figure(t, m, "leaves") for t in both) for m in (method, "ignored")]
        beyond = [sum(damage.figure(t, m, "leaves") - t["leaves_at_best_goal"] for t in both) for m in (method, "ignored")]
        area = [sum(damage.figure(t, m, "area_cm2") for t in both) for m in (method, "ignored")]
        fewer = sum(damage.figure(t, method, "leaves") < damage.figure(t, "ignored", "leaves") for t in both)
        more = sum(damage.figure(t, method, "leaves") > damage.figure(t, "ignored", "leaves") for t in both)
        cells = [f"{a / b:.2f}" if b else "–" for a, b in (totals, beyond, area)]
        rows.append([damage.label(method), str(len(both)), *cells, f"{fewer} / {len(both) - fewer - more} / {more}"])
    head = ["over leaves ignored", "grasps of both", "all leaves", "leaves above the least", "swept area", "fewer / equal / more leaves"]
    return markdown_table(head, rows)


def damage_failures(data: Results) -> str:
    """Every grasp on which a method failed that touches leaves at a cost, or for nothing, whatever it was asked for."""
    methods = [m for m in data["options"]["methods"] if m.partition(":")[0] in _TOUCHING]
    return "\n".join(f"- {line}" for line in damage.failures(data, methods)) or "None."


def iterations_heading(data: Results) -> str:
    """What was run, with how many iterations for every method."""
    trials = data["trials"]
    return (
        f"{len({t['scene'] for t in trials})} plants, {len(damage.graspable(data))} limes; "
        f"{data['options']['iterations']:,} iterations each."
    )


def weights_table(data: Results) -> str:
    """What each leaf weight gives on the limes that all of them reach: lengths are medians, leaves and contact means."""
    methods = sorted(data["options"]["methods"], key=_weight)
    trials = damage.graspable(data)
    both = [t for t in trials if all(damage.succeeded(t, method) for method in methods)]
    usual = next(method for method in methods if ":" not in method)
    rows = []
    for method in methods:
        leaves = by_cluster(by_plant(both, partial(damage.figure, method=method, name="leaves")), np.mean)
        contact = np.mean([damage.figure(t, method, "leaf_contact_rad") for t in both])
        lengths = [damage.median_ratio(both, method, usual, name).text() for name in ("path_length_rad", "duration_s")]
        reached = f"{sum(damage.succeeded(t, method) for t in trials)} of {len(trials)}"
        rows.append([f"{_weight(method):g}", reached, leaves.text(), f"{contact:.3f}", *lengths])
    head = [
        "leaf weight [1/rad]",
        "reached",
        "leaves cut",
        "leaf contact [rad]",
        "joint path, over the default's",
        "motion, over the default's",
    ]
    return markdown_table(head, rows)


def _weight(method: str) -> float:
    changes = dict(parse_assignment(text) for text in method.partition(":")[2].split(",") if text)
    return settings_from(changes).weight


# Comparisons of planners.


def comparison_heading(data: Results) -> str:
    """What was compared, on what."""
    budget = compare.budget_of(data)
    seeds = {t["seed"] for t in data["trials"] if t["seconds"] == budget}
    longer = sorted({t["seconds"] for t in data["trials"] if t["seconds"] != budget})
    text = f"{_plural(len(data['problems']), 'problem')}, {_plural(len(seeds), 'seed')}, {_CLOCKS[data['options']['clock']]} on one core"
    text += f" of: {machine_text(data)}."
    if longer:
        runs = {m: sum(t["seconds"] in longer for t in data["trials"] if t["method"] == m) for m in {t["method"] for t in data["trials"]}}
        words = ", ".join(f"{n} of {compare.LABELS.get(m, m)}" for m, n in sorted(runs.items()) if n)
        text += f" Best known J: of all these runs and of runs of {longer[-1]:g} s ({escaped(words)})."
    return text


def planners_verdict(data: Results) -> str:
    """The default planner beside what was asked of it."""
    marks = data["options"]["marks_s"]
    rows = []
    for mark in marks:
        ours = median(np.array(list(compare.costs_at(data, compare.DEFAULT, mark).values())))
        theirs = median(np.array(list(compare.costs_at(data, "apf_rrt_star_paper", mark).values())))
        ratios = np.sort(list(compare.ratios_at(data, compare.DEFAULT, mark).values()))
        cells = [f"{float(np.quantile(ratios, share, method='nearest')):.3f}" for share in (0.5, 0.9)]
        asked = f"{MEDIAN_RATIO:.2f} / {TAIL_RATIO:.2f}" if mark == FIRST_MARK_S else "–"
        lower = "yes" if ours < theirs else "no"
        rows.append([f"{mark:g}", _number(ours), _number(theirs), lower, *cells, asked])
    head = ["budget [s]", "median J, default", "median J, APF-RRT\\* (paper)", "lower", "J / best known, median", "90 %", "asked"]
    return markdown_table(head, rows)


def planners_tail(data: Results) -> str:
    """The problems on which the default planner's median is above the asked 90th percentile at the asked budget."""
    best, rows = compare.best_known(data), []
    later = data["options"]["marks_s"][-1]
    ours, end = (compare.problem_medians(data, compare.DEFAULT, mark) for mark in (FIRST_MARK_S, later))
    for problem, cost in sorted(ours.items(), key=lambda item: -item[1] / best[item[0]]):
        if cost / best[problem] > TAIL_RATIO:
            rows.append([problem, _number(cost), f"{cost / best[problem]:.2f}", _number(end[problem]), _number(best[problem])])
    if not rows:
        return f"No problem's median is above {TAIL_RATIO:g} times the best known J at {FIRST_MARK_S:g} s."
    return markdown_table(["problem", f"median J at {FIRST_MARK_S:g} s", "over best known", f"median J at {later:g} s", "best known"], rows)


def _number(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:.1f}"


def comparison_costs(data: Results) -> str:
    """Median J at the marks."""
    return escaped(compare.cost_table(data, data["options"]["marks_s"], compare.TIME, "s"))


def comparison_ratios(data: Results) -> str:
    """Ratios to the best known J."""
    return escaped(compare.ratio_table(data, data["options"]["marks_s"]))


def comparison_pairs(data: Results) -> str:
    """Pairs against the default planner."""
    return escaped(compare.paired_table(data, data["options"]["marks_s"]))


def comparison_effort(data: Results) -> str:
    """Checks and callbacks."""
    return escaped(compare.effort_table(data))


def peers_checks(data: Results) -> str:
    """Median J at equal numbers of checks, of the runs that got so far."""
    return escaped(compare.cost_table(data, compare.CHECK_MARKS, compare.CHECKS, "checks"))


def peers_lead(data: Results) -> str:
    """Where the default planner is ahead, and where not."""
    return escaped(compare.lead_text(data, OURS_S)) + f"\n\nAsked: {PEER_SHARE:.0f} % of the problems."


def peers_settings(data: Results) -> str:
    """The peers' settings."""
    rows = []
    for method in compare.methods_of(data):
        if settings := data["options"]["settings"].get(method):
            rows.append([escaped(compare.LABELS.get(method, method)), ", ".join(f"{k} {v}" for k, v in sorted(settings.items()))])
    return markdown_table(["peer", "settings"], rows)


# How cost grows.


def scale_heading(data: Results) -> str:
    """On what, and which targets are missed."""
    missed = scale.targets_missed(data)
    text = f"Processor time of one core of: {machine_text(data)}."
    return text + (" Missed: " + "; ".join(missed) + "." if missed else " Every limit is kept.")


Block = tuple[tuple[str, ...], Callable[..., str]]

#: Name of a block: the kept results that it is made from, and the function that makes it.
BLOCKS: dict[str, Block] = {
    "lime.main": (("lime",), lime.main),
    "lime.tests": (("lime",), lime.tests),
    "lime.ratios": (("lime",), lime.ratios),
    "lime.success": (("lime",), lime.success),
    "lime.plants": (("lime",), lime.plants),
    "lime.sensitivity": (("lime",), lime.sensitivity),
    "lime.floor": (("lime",), lime.floor),
    "lime.checkers": (("lime", "lime-fcl"), lime.checkers),
    "damage.heading": (("damage",), damage_heading),
    "damage.verdict": (("damage",), damage_verdict),
    "damage.excess": (("damage",), damage_excess),
    "damage.scans": (("damage",), damage.scans_table),
    "damage.scans-paired": (("damage",), partial(damage.paired_table, density="scan", other="ignored")),
    "damage.status": (("damage",), damage.status_table),
    "damage.failures": (("damage",), damage_failures),
    "freedom.heading": (("freedom",), iterations_heading),
    "freedom.failures": (("freedom",), damage_failures),
    "weights.heading": (("weights-fixed",), iterations_heading),
    "weights.fixed": (("weights-fixed",), weights_table),
    "weights.free": (("weights-free",), weights_table),
    "hidden.heading": (("hidden",), hidden.heading),
    "hidden.verdict": (("hidden",), hidden.verdict),
    "hidden.fixed": (("hidden",), partial(hidden.table, approach="fixed")),
    "hidden.free": (("hidden",), partial(hidden.table, approach="free")),
    "hidden.dense": (("hidden",), partial(hidden.table, approach="free", density="dense")),
    "hidden.unseen": (("hidden",), hidden.by_unseen),
    "hidden.failures": (("hidden",), hidden.failures),
    "hidden.thicket-heading": (("hidden-thicket",), hidden.heading),
    "hidden.thicket": (("hidden-thicket",), partial(hidden.table, approach="free")),
    "hidden.others-heading": (("hidden-others",), hidden.heading),
    "hidden.others": (("hidden-others",), partial(hidden.table, approach="free")),
    "planners.heading": (("planners",), comparison_heading),
    "planners.verdict": (("planners",), planners_verdict),
    "planners.tail": (("planners",), planners_tail),
    "planners.costs": (("planners",), comparison_costs),
    "planners.ratios": (("planners",), comparison_ratios),
    "planners.pairs": (("planners",), comparison_pairs),
    "planners.effort": (("planners",), comparison_effort),
    "peers.heading": (("peers",), comparison_heading),
    "peers.lead": (("peers",), peers_lead),
    "peers.costs": (("peers",), comparison_costs),
    "peers.ratios": (("peers",), comparison_ratios),
    "peers.pairs": (("peers",), comparison_pairs),
    "peers.checks": (("peers",), peers_checks),
    "peers.effort": (("peers",), comparison_effort),
    "peers.settings": (("peers",), peers_settings),
    "scale.heading": (("scale",), scale_heading),
    "scale.points": (("scale",), scale.points_table),
    "scale.leaves": (("scale",), partial(scale.search_table, axis="leaves", heading="leaves")),
    "scale.joints": (("scale",), partial(scale.search_table, axis="joints", heading="joints")),
    "scale.budget": (("scale",), scale.budget_table),
}
for _density, _name in ((damage.ALL, "all"), ("sparse", "sparse"), ("medium", "medium"), ("dense", "dense")):
    BLOCKS[f"freedom.{_name}"] = (("freedom",), partial(damage.plants_table, density=_density))
    BLOCKS[f"freedom.{_name}-paired"] = (("freedom",), partial(damage.paired_table, density=_density, other="binary"))
    BLOCKS[f"damage.{_name}"] = (("damage",), partial(damage.plants_table, density=_density))
    for _other in ("ignored", "solid"):
        BLOCKS[f"damage.{_name}-{_other}"] = (("damage",), partial(damage.paired_table, density=_density, other=_other))
