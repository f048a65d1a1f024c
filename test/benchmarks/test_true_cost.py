"""Searches minimise what they say: J of polished paths is that of an integral which shares no code with theirs."""

from __future__ import annotations

from conftest import shared_data

from benchmarks.planners.true_cost import compare, is_true, sampled_cost
from benchmarks.problem_sets import choose_problems, plant_specs, scan_specs
from lime_planner.experiments.problems import build_problem
from lime_planner.pipeline.leaf_spans import leaf_spans


def test_cost_of_polished_paths_is_true() -> None:
    problems, _ = choose_problems([*scan_specs(shared_data()), *plant_specs(["medium:1", "dense:2"])], 6)
    found = [compare(build_problem(spec), 1, 1200) for spec in problems]
    assert sum(row["cost"] is not None for row in found) >= 4
    assert not [row for row in found if not is_true(row)]


def test_figures_of_a_path_are_its_cost() -> None:
    problem = build_problem(choose_problems(plant_specs(["dense:2"]), 1)[0][0])
    path = problem.start + 0.2 * (problem.goals.configurations[:1] - problem.start) * [[0.0], [2.0], [5.0]]
    contact = leaf_spans(problem.obstacles, path)
    sampled, contacts = sampled_cost(problem.obstacles, path, 1.0)
    length = sampled_cost(problem.obstacles, path, 0.0)[0]
    assert contacts > 0
    assert abs(contact.charged_rad - (sampled - length)) < 0.0005 * (contacts + 1)
    assert contact.contact_rad == contact.charged_rad  # leaves cost 1
    assert (contact.spans[1:, 0] >= contact.spans[:-1, 1]).all() and contact.spans[-1, 1] <= length + 1e-9
    assert contact.charged_until(length) == contact.charged_until([length])[0] == contact.charged_rad
