"""The results page: every figure in it follows from the kept files, and those that matter are derived here a second time, by hand."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from scipy import stats

from benchmarks.planner_runs import cost_at
from benchmarks.results_page.kept_results import FORMS, keep, name_of, read, restore, thin_curve
from benchmarks.results_page.page import blocks_in, filled, missing, numbers_outside
from lime_planner.cli.main import main
from lime_planner.core.errors import SceneError

DOCS = ROOT / "docs"
PAGE = (DOCS / "results.md").read_text()
FILES = sorted((DOCS / "results").glob("*.json"))


def kept(name: str) -> dict[str, Any]:
    return read(DOCS / "results" / f"{name}.json")


def rows_of(block: str) -> list[list[str]]:
    """The cells of a block's table, without its two head lines."""
    lines = [line for line in blocks_in(PAGE)[block].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def test_every_block_is_what_the_kept_results_give() -> None:
    assert len(blocks_in(PAGE)) >= 8
    assert PAGE.count("<!-- end -->") == len(blocks_in(PAGE))
    assert missing(PAGE, DOCS / "results") == {}


def test_numbers_in_the_prose_are_settings_not_findings() -> None:
    assert sorted(set(numbers_outside(PAGE)) - SETTINGS) == []


#: Numbers of the paper, of the commands and of what was asked.
SETTINGS = {"0.1", "1", "2", "90", "95", "100", "1,500", "1000"}


def test_files_are_small_and_used() -> None:
    assert sum(path.stat().st_size for path in FILES) < 2_000_000
    assert {path.stem.split("-")[0] for path in FILES} == {name.split(".")[0] for name in blocks_in(PAGE)}
    for path in FILES:
        assert json.loads(path.read_text())["complete"] is True, path
    named = set(re.findall(r"figures/(results-[a-z-]+\.(?:png|svg))", PAGE))
    assert named == {path.name for path in (DOCS / "figures").glob("results-*")}
    for name in named:
        assert 5_000 < (DOCS / "figures" / name).stat().st_size < 300_000, name


def test_lime_ratios_by_hand() -> None:
    trials = kept("lime")["trials"]
    first = min(t["plant"] for t in trials)
    means: dict[tuple[int, str], float] = {}
    counts: dict[str, int] = {}
    for plant in sorted({t["plant"] for t in trials}):
        for algorithm in ("rrt_star", "apf_rrt_star", "p_rrt_star"):
            mine = [t for t in trials if (t["plant"], t["variant"], t["algorithm"]) == (plant, "as fixed", algorithm)]
            assert len(mine) == 100
            costs = [t["cost"] for t in mine if t["cost"] is not None]
            counts[algorithm] = counts.get(algorithm, 0) + len(costs)
            if len(costs) >= 5:
                means[plant, algorithm] = float(np.mean(costs))
    for below, row in zip(("rrt_star", "p_rrt_star"), rows_of("lime.ratios")[::2], strict=True):
        assert row[1].split()[0] == f"{means[first, 'apf_rrt_star'] / means[first, below]:.2f}"
        others = [p for p in {p for p, _ in means} - {first} if {(p, "apf_rrt_star"), (p, below)} <= means.keys()]
        logs = [math.log(means[p, "apf_rrt_star"] / means[p, below]) for p in others]
        assert row[2].split()[0] == f"{math.exp(np.mean(logs)):.2f}"
        assert row[4] == f"{len(others)} of 10"
    assert [row[1].split()[0] for row in rows_of("lime.success")] == [str(n) for n in counts.values()]


def test_lime_tests_by_hand() -> None:
    found: dict[tuple[int, str], list[float]] = {}
    for t in kept("lime")["trials"]:
        if t["variant"] == "as fixed" and t["cost"] is not None:
            found.setdefault((t["plant"], t["algorithm"]), []).append(t["cost"])
    table = {row[0]: row for row in rows_of("lime.plants")}
    for column, below in ((-2, "rrt_star"), (-1, "p_rrt_star")):
        logs = []
        for plant, row in table.items():
            mine, other = (found.get((int(plant), key), []) if plant.isdigit() else [] for key in ("apf_rrt_star", below))
            if min(len(mine), len(other)) < 5:
                continue
            p = float(stats.ttest_ind(mine, other, equal_var=False).pvalue)
            assert row[column] == "< .001" if p < 0.001 else float(row[column]) == pytest.approx(p, abs=6e-4), plant
            logs.append(math.log(np.mean(mine) / np.mean(other)))
        p = float(stats.ttest_1samp(logs, 0.0).pvalue)
        assert p < 0.001 and table["geometric mean"][column] == "< .001"
        over_plants = rows_of("lime.ratios")[0 if below == "rrt_star" else 2][3]
        assert over_plants == f"< .001 (t({len(logs) - 1}) = {stats.ttest_1samp(logs, 0.0).statistic:.2f})"
    by_j = [row[3].split()[0] for row in rows_of("lime.ratios")[1::2]]
    assert all(float(p) < 0.05 for p in by_j)


def test_the_cheapest_paths_are_clear_of_stems() -> None:
    trials = kept("lime")["trials"]
    for plant, *_, least, _ in rows_of("lime.floor")[:-1]:
        mine = [t for t in trials if t["plant"] == int(plant) and t["cost"] is not None]
        assert least == f"{min(t['cost'] for t in mine if t['J'] is not None):.0f}"
    shares = [float(row[-1]) for row in rows_of("lime.floor")[:-1]]
    assert shares[0] > 0.5 and max(shares[1:]) < 0.5  # far cheaper ones exist, but on the default plant
    assert rows_of("lime.floor")[0][3] != f"{min(t['cost'] for t in trials if t['plant'] == 0 and t['cost'] is not None):.0f}"


def test_the_papers_t_has_the_sign_of_its_row() -> None:
    for row in rows_of("lime.tests")[:2]:  # others minus APF-RRT*, which is the cheaper one in the paper too
        assert "−" in row[0] and row[0].split(" − ")[1].startswith("APF-RRT*")
        assert float(row[-1].split(" = ")[1]) > 0.0
    assert "prints t(182.25) = -6.39" in blocks_in(PAGE)["lime.tests"]


def test_checkers_in_pairs_by_hand() -> None:
    exact = kept("lime-fcl")["trials"]
    fast = {(t["plant"], t["algorithm"], t["trial"]): t["cost"] for t in kept("lime")["trials"] if t["variant"] == "as fixed"}
    pairs = [(t["algorithm"], t["cost"], fast[t["plant"], t["algorithm"], t["trial"]]) for t in exact]
    table = [row for row in rows_of("lime.checkers") if len(row) == 8 and " of " in row[1]]
    for name, row in zip(("rrt_star", "apf_rrt_star", "p_rrt_star", ""), table, strict=True):
        mine = [(a, b) for key, a, b in pairs if name in ("", key)]
        assert row[1] == f"{sum((a is None) == (b is None) for a, b in mine)} of {len(mine)}"
        both = np.array([(a, b) for a, b in mine if a is not None and b is not None])
        assert row[4] == str(len(both))
        tested = stats.ttest_rel(both[:, 0], both[:, 1])
        low, high = tested.confidence_interval(0.95)
        assert row[6] == f"{np.mean(both[:, 0] - both[:, 1]):.0f} ({low:.0f} to {high:.0f})"
        assert low < 0.0 < high  # no planner's costs differ between the checkers
    bold = {
        (row[0], row[1]): [cell.startswith("**") for cell in row[5:]]
        for row in rows_of("lime.checkers")
        if len(row) == 8 and row[0].isdigit()
    }
    fast_model = "fast model, same seeds"
    assert [key for key, cells in bold.items() if cells[0] and cells[1]] == [
        ("1", "FCL"),
        ("1", fast_model),
        ("3", fast_model),
        ("5", "FCL"),
    ]
    told_from_p = {"FCL": ["1", "4", "5"], fast_model: ["0", "1", "3", "4", "5"]}
    for checker, plants in told_from_p.items():
        assert [plant for (plant, by), cells in bold.items() if by == checker and cells[1]] == plants
    for row in rows_of("lime.checkers"):
        if row[0].isdigit():  # APF-RRT* has the lowest mean of the three
            means = [float(cell.split()[0].rstrip(",")) for cell in row[2:5]]
            assert means[1] == min(means)
    assert not any(cells[2] for cells in bold.values())  # RRT* and P-RRT* cannot be told apart


def test_leaves_touched_by_hand() -> None:
    trials = [t for t in kept("damage")["trials"] if t["density"] != "scan" and t["target"] is not None]
    table = {row[0]: row for row in rows_of("damage.verdict")}
    for method in ("binary", "graded"):
        row = table[f"default, {method} cost"]
        ratios, shares = [], {"dense": [], "all": []}
        for t in trials:
            mine, ignored, solid = (t["methods"][m] for m in (method, "ignored", "solid"))
            ok = [float(m["status"] == "SUCCEEDED") for m in (mine, ignored, solid)]
            shares["all"].append(ok[0] - ok[1])
            if t["density"] == "dense":
                shares["dense"].append(ok[0] - ok[2])
            if ok[0] and ok[1]:
                a, b = len(mine["leaves"]), len(ignored["leaves"])
                ratios.append(a / b if b else 1.0 if a == 0 else math.inf)
        assert row[1].split()[0] == f"{100 * np.mean(shares['dense']):.0f}"
        assert row[2].split()[0] == f"{np.median(ratios):.2f}"
        assert row[3].split()[0] == f"{100 * np.mean(shares['all']):.1f}"


def test_hidden_stems_by_hand() -> None:
    trials = [t for t in kept("hidden")["trials"] if t["target"] is not None]
    rows = {row[0]: row for row in rows_of("hidden.free")}
    for method, words in (("one", "one view, as seen"), ("looks", "one view and planned looks")):
        sent = [m for t in trials if (m := t["methods"][f"{method}-free"])["status"] == "SUCCEEDED"]
        assert rows[words][3] == f"{sum(m['stems'] > 0 for m in sent)} of {len(sent)}"
        assert float(rows[words][6]) == pytest.approx(np.mean([m["leaves"] for m in sent]), abs=0.006)
    sent = [m for t in trials for name, m in t["methods"].items() if "full" not in name and m["status"] == "SUCCEEDED"]
    # What the prose says: motions that are seen but for a tenth of a radian hardly ever touch, those with more of it the likelier.
    shares = [
        np.mean([m["stems"] > 0 for m in sent if low < m["unseen_contact_rad"] <= high]) for low, high in ((-1, 0.1), (0.1, 0.3), (0.3, 99))
    ]
    assert shares[0] < 0.01 < shares[1] < shares[2]
    little = [m["stems"] > 0 for m in sent if m["unseen_contact_rad"] <= 0.1]
    assert sum(little) == 1 and f"one of {len(little)} touched" in (DOCS / "safety.md").read_text()
    assert [row[3] for row in rows_of("hidden.unseen")][2:] == [f"{100 * share:.0f} %" for share in shares[1:]]
    price, looks = (next(float(r[7]) for w, r in rows.items() if w.startswith(name)) for name in ("one view, unseen", "one view and"))
    assert price < 0.25 * float(rows["one view, as seen"][7]) and looks < 0.02
    reached = [float(rows[w][2].partition("(")[2].split()[0]) for w in rows]
    assert min(reached) >= 90.0, "looks cost no limes"


def test_lead_over_peers_by_hand() -> None:
    data = kept("peers")
    ahead = 0
    for problem in data["problems"]:

        def cost(method: str, seconds: float, problem: str = problem) -> float:
            runs = [t for t in data["trials"] if (t["problem"], t["method"]) == (problem, method)]
            return float(np.median([min([p[2] for p in t["curve"] if p[0] <= seconds], default=math.inf) for t in runs]))

        peers = [m for m in data["methods"] if m != "lime_star"]
        assert len(peers) == 5
        ahead += cost("lime_star", 0.5) < min(cost(m, 5.0) for m in peers)
    assert f"on {ahead} of {len(data['problems'])} problems" in blocks_in(PAGE)["peers.lead"]


def test_default_planner_beside_the_papers_by_hand() -> None:
    data = kept("planners")
    best = {p: min(c[2] for t in data["trials"] if t["problem"] == p for c in t["curve"]) for p in data["problems"]}
    for row in rows_of("planners.verdict"):
        ratios, costs = [], {"lime_star": [], "apf_rrt_star_paper": []}
        for t in data["trials"]:
            if t["seconds"] == 5.0:
                cost = min([c[2] for c in t["curve"] if c[0] <= float(row[0])], default=math.inf)
                costs[t["method"]].append(cost)
                if t["method"] == "lime_star":
                    ratios.append(cost / best[t["problem"]])
        assert len(ratios) == 5 * len(data["problems"]) == 100
        ours, theirs = (np.median(costs[m]) for m in ("lime_star", "apf_rrt_star_paper"))
        assert row[1] == f"{ours:.1f}" and row[2] == ("∞" if math.isinf(theirs) else f"{theirs:.1f}")
        assert (row[3] == "yes") == bool(ours < theirs)
        assert float(row[4]) == pytest.approx(np.median(ratios), abs=0.01)
        assert float(row[5]) == pytest.approx(np.quantile(ratios, 0.9), rel=0.05)


def curve() -> list[list[float]]:
    rng = np.random.default_rng(0)
    times, costs = np.sort(rng.uniform(0.001, 5.0, 300)), np.sort(rng.uniform(1.0, 50.0, 300))[::-1]
    return [[float(t), int(1e5 * t), float(c)] for t, c in zip(times, costs, strict=True)]


def test_a_thinned_curve_reads_the_same_at_its_marks() -> None:
    full = curve()
    thin = thin_curve(full, times=(0.3, 0.5), checks=(777, 12_345))
    assert len(thin) < 120 and thin == thin_curve(thin, (0.3, 0.5), (777, 12_345))
    for column, marks in ((0, (0.3, 0.5, 1.0, 9.0)), (1, (777, 12_345, 1e6))):
        for mark in marks:
            assert cost_at(thin, mark, column) == pytest.approx(cost_at(full, mark, column), rel=1e-6)
    assert thin_curve([]) == []


def small_lime() -> dict[str, Any]:
    trial = {"plant": 0, "variant": "as fixed", "algorithm": "rrt_star", "seed": 3, "time_s": 0.1}
    found = {"cost": 312.5, "J": None, "length": 12.5, "nodes_inside": 3, "stored_cost": 1.0, "nodes": 9}
    options = {"checker": "fast", "iterations": 10, "seed": 0, "robot": "any"}
    scenes = [{"seed": 0, "pose": [0.0] * 7, "leaves": [2], "goals": 1}]
    trials = [{**trial, "trial": 0, **found}, {**trial, "trial": 1, "cost": None}]
    return {"experiment": "lime", "version": "1", "options": options, "scenes": scenes, "complete": True, "trials": trials}


def test_what_is_kept_comes_back() -> None:
    back = restore(json.loads(json.dumps(keep(small_lime()))))
    assert [t["cost"] for t in back["trials"]] == [312.5, None]
    assert back["trials"][0]["nodes_inside"] == 3 and back["trials"][0]["J"] is None
    method = {"status": "SUCCEEDED", "planning_cpu_s": 0.9, "leaves": [4, 7], "area_cm2": 3.5, "duration_s": 8.0, "leaves_at_goal": 1}
    method |= {"path_length_rad": 3.0, "leaf_contact_rad": 0.2, "tool_leaf_contact_m": None, "iterations": 5}
    trial = {"scene": "dense-0", "density": "dense", "number": 0, "target": 2, "leaves_at_best_goal": 1, "pose": [], "goals": 3}
    failed = {"status": "NO_PATH", "planning_cpu_s": 0.5, "sentence": "none"}
    both = {"experiment": "damage", "options": {}, "trials": [trial | {"methods": {"binary": method, "solid": failed}}], "complete": True}
    back = restore(json.loads(json.dumps(keep(both))))
    assert len(back["trials"][0]["methods"]["binary"]["leaves"]) == 2
    assert back["trials"][0]["methods"]["binary"]["tool_leaf_contact_m"] is None
    assert back["trials"][0]["methods"]["solid"] == {"status": "NO_PATH", "planning_cpu_s": 0.5}
    with pytest.raises(SceneError, match="'wall' are not kept"):
        keep({"experiment": "wall"})
    assert {name_of({"experiment": name, "options": {"checker": "fast"}}) for name in FORMS} >= {"lime", "damage", "peers"}


def test_the_command_keeps_runs_and_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, docs = tmp_path / "run", tmp_path / "docs"
    run.mkdir()
    docs.mkdir()
    (run / "results.json").write_text(json.dumps(small_lime()))
    (run / "simulation.png").write_bytes(b"picture")
    page = docs / "results.md"
    page.write_text("# Page\n\n<!-- lime.success -->\nold\n<!-- end -->\n\nEnd.\n")
    assert main(["experiment", "report", str(run), "--docs", str(docs)]) == 0
    assert (docs / "figures" / "results-lime.png").read_bytes() == b"picture"
    assert "| RRT\\* | 1 of 2 (50 %) |" in page.read_text() and page.read_text().endswith("\n\nEnd.\n")
    assert main(["experiment", "report", "--docs", str(docs), "--check"]) == 0
    page.write_text(page.read_text().replace("1 of 2", "2 of 2"))
    capsys.readouterr()
    assert main(["experiment", "report", "--docs", str(docs), "--check"]) == 1
    assert "block lime.success differs" in capsys.readouterr().out
    (run / "results.json").write_text(json.dumps(small_lime() | {"complete": False}))
    assert main(["experiment", "report", str(run), "--docs", str(docs)]) == 1
    assert "--resume" in capsys.readouterr().err
    with pytest.raises(SceneError, match="none of"):
        filled("<!-- nonsense -->\n<!-- end -->\n", docs)
