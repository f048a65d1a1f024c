"""Plot of the hidden-stems experiment: motions that touch a real stem, and limes reached, by what was known. Colour-blind safe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.experiments.hidden.report import APPROACHES, reached, touching, trials_of
from lime_planner.experiments.hidden.trials import KNOWLEDGE, LABELS

_COLOURS = {"fixed": ("#56B4E9", "\\\\"), "free": ("#0072B2", "")}


def draw(results: dict[str, Any], folder: Path) -> Path:
    """Draw both shares with their intervals over plants; methods with changed parameters are left out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    trials, methods = trials_of(results), results["options"]["methods"]
    known = [k for k in KNOWLEDGE if any(f"{k}-{approach}" in methods for approach in APPROACHES)]
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)  # no window system, no global state
    axes = figure.subplots(1, 2)
    for j, (approach, words) in enumerate(APPROACHES.items()):
        colour, hatch = _COLOURS[approach]
        for axis, share in zip(axes, ("touching", "reached"), strict=True):
            places, heights, low, high = [], [], [], []
            for i, knowledge in enumerate(known):
                method = f"{knowledge}-{approach}"
                if method not in methods or (share == "reached" and f"full-{approach}" not in methods):
                    continue
                found = touching(trials, method) if share == "touching" else reached(trials, method, f"full-{approach}")
                if np.isfinite(found.value):
                    places.append(i + 0.4 * (j - 0.5))
                    heights.append(100.0 * found.value)
                    low.append(100.0 * max(found.value - found.low, 0.0))
                    high.append(100.0 * max(found.high - found.value, 0.0))
            axis.bar(places, heights, 0.38, color=colour, hatch=hatch, edgecolor="white", linewidth=0.5, label=words)
            if places:
                axis.errorbar(places, heights, yerr=[low, high], fmt="none", ecolor="#333333", elinewidth=1.0, capsize=2.0)
    for axis, title in zip(axes, ("motions that touch a real stem [%]", "reached, of what full knowledge reaches [%]"), strict=True):
        axis.set_xticks(np.arange(len(known)), [LABELS[k].replace(", ", ",\n").replace(" and ", "\nand ") for k in known], fontsize=8)
        axis.set_title(title, fontsize=11)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(True, axis="y", color="#E8E8E8", linewidth=0.6)
        axis.set_axisbelow(True)
    axes[0].legend(frameon=False, fontsize=9)
    path = folder / "hidden.png"
    figure.savefig(path, dpi=110)
    return path
