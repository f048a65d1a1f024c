"""The words in which a request is answered and logged."""

from __future__ import annotations

from lime_planner.ros.convert import stamp_text
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.requests.worker import Answer, Ticket


def about(plan_id: int, target: Target | None) -> str:
    """Return `[plan_id ..., target ...]`: which request a sentence is about, and which fruit."""
    words = f"plan_id {plan_id}"
    if target is not None:
        x, y, z = (float(v) for v in target.aim.centre)
        header = target.msg.header
        words += f", target {x:.4f} {y:.4f} {z:.4f} in {header.frame_id} stamped {stamp_text(header.stamp)}"
    return f"[{words}]"


def target_values(target: Target | None) -> dict[str, object]:
    """Return what the status says about a request's target; nothing where none is known."""
    if target is None:
        return {}
    header = target.msg.header
    return {
        "target_stamp": stamp_text(header.stamp),
        "target_frame": header.frame_id,
        "target_kind": target.aim.kind,
        "target_position": [round(float(v), 6) for v in target.aim.centre],
    }


def answer_message(ticket: Ticket, answer: Answer) -> str:
    """Return `CODE: sentence [plan_id ..., target ...]`: which request this answers, and which fruit it was about."""
    return f"{answer.message} {about(ticket.plan_id, ticket.context.target)}"


def log_line(ticket: Ticket, answer: Answer) -> str:
    """Return the one line that is logged for a request."""
    return f"{ticket.kind}: {answer_message(ticket, answer)}"
