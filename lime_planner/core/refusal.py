"""The exception that carries a status code from where an input is judged to where the request is answered."""

from __future__ import annotations

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.status import Status


class Refusal(LimePlannerError):
    """A request or an input cannot be served; `status` is the code of the answer and the text its sentence."""

    def __init__(self, status: Status, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status
