"""The table of parameters: what counts as a number, in Python, on the command line and in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.cli.parameter_file import read_parameter_file
from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, NodeSettings, Settings, parse_assignment, settings_from, validate


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("c_perm=1e3", 1000.0),
        ("stem_margin_m=5e-3", 0.005),
        ("stem_margin_m=5.E-3", 0.005),
        ("leaf_weight=-1e0", -1.0),
        ("iterations=1e3", 1000),
        ("stem_labels=[7, 8e0]", [7, 8]),
        ("keep_out_boxes=[-1e-1, 0, 0, 1e-1, .2, 3.e-1]", [-0.1, 0.0, 0.0, 0.1, 0.2, 0.3]),
        ("robot=1e3", "1e3"),
    ],
)
def test_powers_of_ten_are_numbers_in_text(text: str, value: Any) -> None:
    name, read = parse_assignment(text)
    assert read == value and type(read) is type(value), name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("c_perm=nan", "c_perm must be a number, got 'nan'"),
        ("c_perm=.nan", "c_perm must be finite, got nan"),
        ("c_perm=1e400", "c_perm must be finite, got inf"),
        ("c_perm=1" + 400 * "0", "c_perm must be finite"),
        ("iterations=15e-1", "iterations must be a whole number, got 1.5"),
        ("c_perm=1e", "c_perm must be a number, got '1e'"),
        ("c_perm='1e3'", "c_perm must be a number, got '1e3'"),
        ("stem_margin_m=1e3", "stem_margin_m is 1000.0; allowed: 0 to 0.2 m"),
        ("motion_enabled=1e0", "motion_enabled must be true or false, got 1.0"),
    ],
)
def test_what_is_no_number_stays_refused(text: str, words: str) -> None:
    with pytest.raises(ParameterError) as refused:
        parse_assignment(text)
    assert words in str(refused.value)


def test_numpy_numbers_are_numbers() -> None:
    settings = settings_from(
        {
            "seed": np.int64(1),
            "iterations": np.uint8(200),
            "time_budget_s": np.float32(0.05),
            "keep_out_boxes": np.arange(6, dtype=np.float32),
        }
    )
    assert (settings.seed, settings.iterations) == (1, 200) and settings.time_budget_s == pytest.approx(0.05)
    assert [type(v) for v in (settings.seed, settings.time_budget_s, *settings.keep_out_boxes)] == [int, *7 * [float]]
    for name, value in (
        ("seed", True),
        ("seed", np.True_),
        ("c_perm", np.float32("nan")),
        ("c_perm", "1e3"),
        ("keep_out_boxes", np.array(1.0)),
    ):
        with pytest.raises(ParameterError, match=name):
            validate(name, value)


def test_the_fields_are_the_table() -> None:
    assert settings_from() == Settings()
    for settings, table in ((Settings(), PARAMETERS), (NodeSettings(), NODE_PARAMETERS)):
        for name, parameter in table.items():
            value = getattr(settings, name)
            assert validate(name, parameter.default) == parameter.default == (list(value) if isinstance(value, tuple) else value), name
            assert parameter.description.endswith(".") and parameter.name == name
    assert not PARAMETERS.keys() & NODE_PARAMETERS.keys()
    assert [NODE_PARAMETERS[name].element for name in ("leaf_labels", "static_transforms")] == [int, str]


def test_files_read_numbers_as_the_node_does(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("lime_planner:\n  ros__parameters:\n    c_perm: 1e3\n    leaf_labels: [1e0]\n    stem_labels: [7]\n")
    assert read_parameter_file(tmp_path / "a.yaml").values == {"c_perm": 1000.0, "leaf_labels": [1], "stem_labels": [7]}
