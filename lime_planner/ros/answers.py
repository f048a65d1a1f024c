"""The words in which a request is answered and logged."""

from __future__ import annotations

from lime_planner.ros.convert import stamp_text
from lime_planner.ros.inputs import Target
from lime_planner.ros.worker import Answer, Ticket


def answer_message(ticket: Ticket, answer: Answer) -> str:
    """Return `CODE: sentence [plan_id ..., target ...]`: which request this answers, and which lime it was about."""
    target = ticket.context.get("target")
    about = f"plan_id {ticket.plan_id}"
    if isinstance(target, Target):
        x, y, z = (float(v) for v in target.T_frame_tool[:3, 3])
        header = target.msg.header
        about += f", target {x:.4f} {y:.4f} {z:.4f} in {header.frame_id} stamped {stamp_text(header.stamp)}"
    return f"{answer.message} [{about}]"


def log_line(ticket: Ticket, answer: Answer) -> str:
    """Return the one line that is logged for a request."""
    return f"{ticket.kind}: {answer_message(ticket, answer)}"
