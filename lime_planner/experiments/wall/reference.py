"""The rows of the paper's table I and the numbers to compare a wall experiment with."""

from __future__ import annotations

from dataclasses import dataclass

#: Iterations at which the paper reports costs.
MARKS = (1000, 2500, 5000)


@dataclass(frozen=True)
class Row:
    """One row of table I.

    Attributes:
        key: its name in files.
        label: its name in tables and figures.
        algorithm: planner.
        beta: β of APF-RRT*, 1 for the others (which do not use it).
    """

    key: str
    label: str
    algorithm: str
    beta: float = 1.0


ROWS = (
    Row("rrt_star", "RRT*", "rrt_star"),
    Row("apf_rrt_star_1", "APF-RRT* (β = 1)", "apf_rrt_star", 1.0),
    Row("apf_rrt_star_1.5", "APF-RRT* (β = 1.5)", "apf_rrt_star", 1.5),
    Row("apf_rrt_star_2", "APF-RRT* (β = 2)", "apf_rrt_star", 2.0),
    Row("p_rrt_star", "P-RRT*", "p_rrt_star"),
)

#: Table I: mean and standard error at each mark, 100 trials.
PAPER = {
    "rrt_star": ((971.19, 8.53), (921.31, 9.88), (846.09, 10.99)),
    "apf_rrt_star_1": ((880.43, 9.55), (810.41, 10.54), (726.93, 11.10)),
    "apf_rrt_star_1.5": ((892.42, 8.47), (835.43, 10.21), (775.16, 11.53)),
    "apf_rrt_star_2": ((900.51, 8.07), (846.32, 8.89), (768.36, 11.64)),
    "p_rrt_star": ((950.26, 8.74), (874.25, 12.20), (799.83, 13.64)),
}

#: Yardstick on geometry G, 1000 trials of an independent implementation with costs not propagated: mean and standard deviation.
YARDSTICK = {
    "rrt_star": ((982.0, 121.0), (925.0, 84.0), (850.0, 86.0)),
    "apf_rrt_star_1": ((904.0, 85.0), (848.0, 69.0), (696.0, 88.0)),
    "apf_rrt_star_1.5": ((884.0, 67.0), (840.0, 65.0), (656.0, 61.0)),
    "apf_rrt_star_2": ((858.0, 59.0), (827.0, 48.0), (790.0, 36.0)),
    "p_rrt_star": ((940.0, 96.0), (896.0, 71.0), (827.0, 87.0)),
}

#: The same with costs propagated to descendants: means.
YARDSTICK_PROPAGATED = {
    "rrt_star": (981.0, 905.0, 734.0),
    "apf_rrt_star_1": (900.0, 797.0, 623.0),
    "apf_rrt_star_1.5": (882.0, 759.0, 615.0),
    "apf_rrt_star_2": (855.0, 805.0, 778.0),
    "p_rrt_star": (939.0, 882.0, 752.0),
}

YARDSTICK_TRIALS = 1000
