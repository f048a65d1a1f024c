"""Every row of the table in docs/reliability.md: the node's answer to an odd input, and that it goes on serving."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from domains import DOMAIN
from reliability_rig import Rig, line, masked, rig, written
from reliability_rows import GOOD, ROWS, Row, fields, some
from ros_fakes import cloud

from lime_planner.core.status import Status
from lime_planner.ros.requests.worker import Answer

pytestmark = pytest.mark.timed


@pytest.fixture(scope="module")
def node() -> Iterator[Rig]:
    with rig(DOMAIN) as made:
        yield made


@pytest.mark.parametrize(("number", "row"), enumerate(ROWS, 1), ids=[f"{row.group}: {row.what}" for row in ROWS])
def test_the_answer_is_the_pages_and_the_next_good_request_succeeds(node: Rig, number: int, row: Row) -> None:
    answer = node.answer(row)
    assert answer.startswith(f"{row.code}: "), answer
    assert row.words in answer
    assert masked(line(number, row, answer)) in [masked(each) for each in written()]


def test_the_page_has_these_rows_and_no_others() -> None:
    assert len(ROWS) >= 60
    assert len(written()) == len(ROWS)


def test_a_failed_preview_leaves_nothing_to_execute(node: Rig) -> None:
    node.good()
    assert node.bench.call("preview").success
    assert not node.bench.call("preview_to", node.goal([math.nan, *GOOD[1:]], "base")).plan.poses
    assert node.bench.call("execute").message.startswith("NOTHING_TO_EXECUTE: ")


def test_a_preview_that_was_answered_otherwise_is_not_carried_out(node: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stop, a newer request or the deadline, in the moment between the plan and its answer."""
    node.good()
    markers, worker = node.node.markers, node.node.worker
    show = markers.show

    def stopped_then(planned: Any) -> None:
        show(planned)
        assert worker.current.take_away(Answer(Status.CANCELLED, "in between"))

    monkeypatch.setattr(markers, "show", stopped_then)
    assert node.bench.call("preview").message.startswith("CANCELLED: in between")
    monkeypatch.undo()
    assert node.bench.call("execute").message.startswith("NOTHING_TO_EXECUTE: ")
    assert node.bench.call("preview").success


def test_the_counts_add_up(node: Rig) -> None:
    node.good()
    assert node.bench.call("preview").success
    for _ in range(3):
        node.deliver("stem_cloud", cloud(5))
    node.deliver("stem_cloud", some(fields("x")))
    for name in ("leaf_cloud", "stem_cloud", "grasp_target"):
        slot = node.node.inputs.slots[name]
        assert slot.received == slot.used + slot.superseded + slot.refused, name
        assert slot.used > 0
    node.bench.health.clear()
    node.wait_until(lambda: "stem_cloud.refusal" in node.bench.health, "diagnostics")
    assert "no field 'y'" in node.bench.health["stem_cloud.refusal"]
    assert node.bench.health["stem_cloud.lost"] == "0"
