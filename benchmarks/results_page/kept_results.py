"""Results as the repository keeps them: of each experiment what its tables need, in a compact form, and back.

`keep` takes the contents of a `results.json` and drops what no table reads; `restore` gives back something that every report takes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.errors import SceneError

Results = dict[str, Any]

#: Numbers kept of a trial of the lime experiment, in this order.
LIME_COLUMNS = ("cost", "J", "length", "nodes_inside")
#: And of a method's plan in the damage experiment, after its status.
DAMAGE_COLUMNS = (
    "planning_cpu_s",
    "leaves",
    "area_cm2",
    "duration_s",
    "path_length_rad",
    "leaf_contact_rad",
    "tool_leaf_contact_m",
    "leaves_at_goal",
)
#: Plants with seeds from here on were used to choose nothing.
OTHER_PLANTS = 1000
#: Marks between which improvements of a curve are dropped: times [s] and numbers of checks.
_TIMES = np.geomspace(0.01, 100.0, 41)
_CHECKS = np.geomspace(100.0, 1e8, 49)


def thin_curve(curve: Sequence[Sequence[float]], times: Sequence[float] = (), checks: Sequence[float] = ()) -> list[list[float]]:
    """Keep of a falling curve the points that a reading at some times or numbers of checks finds, and the first and last one.

    Args:
        curve: (time [s], checks, J) of each improvement.
        times, checks: marks that must read the same, besides a logarithmic grid of them.
    """
    kept = {0, len(curve) - 1} if curve else set()
    for column, marks in ((0, (*times, *_TIMES)), (1, (*checks, *_CHECKS))):
        for mark in marks:
            before = [i for i, point in enumerate(curve) if point[column] <= mark]
            if before:
                kept.add(before[-1])
    return [[float(f"{curve[i][0]:.5g}"), int(curve[i][1]), float(f"{curve[i][2]:.7g}")] for i in sorted(kept)]


def _without(results: Mapping[str, Any], *names: str) -> Results:
    return {k: v for k, v in results.items() if k not in names}


def _keep_lime(results: Mapping[str, Any]) -> Results:
    cells: dict[tuple[int, str, str], list[Any]] = {}
    for t in sorted(results["trials"], key=lambda t: t["trial"]):
        row = None if t["cost"] is None else [None if t[c] is None else float(f"{t[c]:.7g}") for c in LIME_COLUMNS]
        cells.setdefault((t["plant"], t["variant"], t["algorithm"]), []).append(row)
    scenes = [{k: s[k] for k in ("seed", "leaves", "goals")} for s in results["scenes"]]
    kept = [{"plant": p, "variant": v, "algorithm": a, "rows": rows} for (p, v, a), rows in cells.items()]
    return _without(results, "trials", "scenes") | {"scenes": scenes, "columns": list(LIME_COLUMNS), "cells": kept}


def _restore_lime(data: Mapping[str, Any]) -> Results:
    trials = []
    for cell in data["cells"]:
        for number, row in enumerate(cell["rows"]):
            values = dict.fromkeys(data["columns"]) if row is None else dict(zip(data["columns"], row, strict=True))
            trials.append({"plant": cell["plant"], "variant": cell["variant"], "algorithm": cell["algorithm"], "trial": number, **values})
    return _without(data, "cells", "columns") | {"trials": trials}


def _keep_damage(results: Mapping[str, Any]) -> Results:
    trials = []
    for t in results["trials"]:
        methods = {}
        for name, m in t["methods"].items():
            values = {**m, "leaves": len(m["leaves"]) if "leaves" in m else None}
            methods[name] = [m["status"], *(values.get(c) for c in DAMAGE_COLUMNS)]
        trials.append({k: t.get(k) for k in ("scene", "density", "number", "target", "leaves_at_best_goal")} | {"methods": methods})
    return _without(results, "trials") | {"columns": list(DAMAGE_COLUMNS), "trials": trials}


def _restore_damage(data: Mapping[str, Any]) -> Results:
    trials = []
    for t in data["trials"]:
        methods = {}
        for name, (status, *values) in t["methods"].items():
            m = {c: v for c, v in zip(data["columns"], values, strict=True) if v is not None}
            if "leaves" in m:
                m["leaves"] = list(range(m["leaves"]))  # which ones they were is not kept
            if status == "SUCCEEDED":
                m |= {c: None for c in data["columns"] if c not in m and c != "leaves"}
            methods[name] = {"status": status, **m}
        trials.append({**t, "methods": methods})
    return _without(data, "trials", "columns") | {"trials": trials}


def _keep_hidden(results: Mapping[str, Any]) -> Results:
    trials = []
    for t in results["trials"]:
        trials.append({**t, "methods": {name: _without(m, "sentence") for name, m in t["methods"].items()}})
    return _without(results, "trials") | {"trials": trials}


def _keep_comparison(results: Mapping[str, Any]) -> Results:
    from benchmarks.planners.report import CHECK_MARKS

    trials = []
    for t in results["trials"]:
        kept = _without(t, "path", "edges", "callbacks", "heuristics", "polls", "iterations")
        trials.append(kept | {"curve": thin_curve(t["curve"], results["options"]["marks_s"], CHECK_MARKS)})
    problems = [p if isinstance(p, str) else _problem_key(p) for p in results["problems"]]
    return _without(results, "trials", "problems") | {"problems": problems, "trials": trials}


def _problem_key(spec: Mapping[str, Any]) -> str:
    from lime_planner.experiments.problems import ProblemSpec

    return ProblemSpec.from_dict(dict(spec)).key


def _keep_scale(results: Mapping[str, Any]) -> Results:
    from benchmarks.scale.report import MARKS_S

    trials = [{**t, "curve": thin_curve(t["curve"], MARKS_S)} if "curve" in t else dict(t) for t in results["trials"]]
    return _without(results, "trials") | {"trials": trials}


def _same(data: Mapping[str, Any]) -> Results:
    return dict(data)


#: By the experiment's name in its file: how it is kept, how it is restored.
FORMS: dict[str, tuple[Callable[[Mapping[str, Any]], Results], Callable[[Mapping[str, Any]], Results]]] = {
    "lime": (_keep_lime, _restore_lime),
    "damage": (_keep_damage, _restore_damage),
    "hidden": (_keep_hidden, _same),
    "bench planners": (_keep_comparison, _same),
    "bench peers": (_keep_comparison, _same),
    "bench scale": (_keep_scale, _same),
}


def keep(results: Mapping[str, Any]) -> Results:
    """What the repository keeps of a `results.json`.

    Raises:
        SceneError: it is of no experiment whose results are kept.
    """
    name = results.get("experiment")
    if name not in FORMS:
        raise SceneError(f"results of {name!r} are not kept; those of {', '.join(FORMS)} are")
    return FORMS[name][0](_without(results, "aside"))  # trials of earlier runs that the last one did not ask for


def restore(data: Mapping[str, Any]) -> Results:
    """What `keep` made, in the form that reports read."""
    return FORMS[data["experiment"]][1](data)


def name_of(results: Mapping[str, Any]) -> str:
    """Name of the file in which results are kept, without its ending."""
    name = str(results["experiment"]).removeprefix("bench ")
    options = results.get("options", {})
    if name == "lime" and options.get("checker") == "fcl":
        return f"{name}-fcl"
    if name == "hidden" and options.get("densities") == ["thicket"]:
        return f"{name}-thicket"
    methods = {method.partition(":")[0] for method in options.get("methods", ())}
    if name == "damage" and methods in ({"free"}, {"binary"}):  # one method at several leaf weights
        return "weights-free" if methods == {"free"} else "weights-fixed"
    if name == "damage" and methods == {"binary", "free", "candidates"}:
        return "freedom"
    return f"{name}-others" if name == "hidden" and options.get("first_plant", 0) >= OTHER_PLANTS else name


def read(path: Path) -> Results:
    """Read a kept file and restore it.

    Raises:
        SceneError: it cannot be read, or holds something else.
    """
    try:
        return restore(json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneError(f"{path} holds no kept results ({error})") from error
