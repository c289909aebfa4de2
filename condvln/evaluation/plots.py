"""Plot SR, BSA and CSR over all episodes against depth and chain length, with intervals and numbers of episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from condvln.evaluation.aggregate import by_axis
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.metrics import metrics_of
from condvln.formats.streams import write_figure
from schemas.errors import UsageError

__all__ = ["SHOWN", "axis_figure", "save_figures"]

SHOWN: Final = tuple((metric.key, metric.heading) for metric in metrics_of("plots"))
"""Measures over every episode; by the paper's rule CSR could exceed SR."""
_AXES: Final = ("depth", "chain")
_SHIFT: Final = 0.06
"""Horizontal offset between agents as a share of an axis unit, so that their intervals do not overlap."""
_MARGIN: Final = 4.0
"""Margin in percent drawn below 0 and above 100, so that markers at the ends are not cut."""
_MARKERS: Final = "os^Dv<>pX*P"
"""One more than the number of colours, so that agents stay distinct when colours repeat, and in black and white."""


def axis_figure(evaluations: Sequence[Evaluation], axis: str) -> Figure:
    """Return a figure with one panel per measure and one line per agent, in percent with 95 % intervals."""
    figure = Figure(figsize=(3.4 * len(SHOWN) + 1.6, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(SHOWN), sharey=True, squeeze=False)[0]
    keys = tuple(key for key, _ in SHOWN)
    for number, evaluation in enumerate(evaluations):
        rows = [row for row in by_axis(evaluation, axis, measures=keys) if row.group[axis] is not None]
        places = np.array([float(row.group[axis]) for row in rows]) + (number - (len(evaluations) - 1) / 2) * _SHIFT
        # File names may contain a dollar sign, which would begin a formula.
        label = evaluation.agent.replace("$", r"\$")
        for panel, (key, _) in zip(panels, SHOWN, strict=True):
            means, low, high = (
                100 * np.array([getattr(row.estimates[key], name) for row in rows]) for name in ("mean", "low", "high")
            )
            bars = np.nan_to_num(np.vstack([means - low, high - means])).clip(min=0)
            marker = _MARKERS[number % len(_MARKERS)]
            panel.errorbar(places, means, yerr=bars, marker=marker, markersize=5, capsize=3, label=label)
    for panel, (_, heading) in zip(panels, SHOWN, strict=True):
        _dress(panel, axis, heading, evaluations)
    handles, labels = panels[0].get_legend_handles_labels()
    # The legend is beside the panels, since inside one it would hide data.
    figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize="small")
    return figure


def _dress(panel: Any, axis: str, heading: str, evaluations: Sequence[Evaluation]) -> None:
    panel.set_title(heading)
    panel.set_xlabel(axis)
    panel.set_ylim(-_MARGIN, 100 + _MARGIN)
    values = {value for evaluation in evaluations for value in evaluation.axes[axis] if value is not None}
    counts = [sum(value == own for value in evaluations[0].axes[axis]) for own in sorted(values)] if evaluations else []
    panel.set_xticks(sorted(values), [f"{value}\nn = {n:,}" for value, n in zip(sorted(values), counts, strict=True)])
    panel.grid(axis="y", alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
    if heading == SHOWN[0][1]:
        panel.set_ylabel("%")


def save_figures(evaluations: Sequence[Evaluation], folder: Path) -> list[Path]:
    """Write ``depth.png``, ``depth.pdf``, ``chain.png`` and ``chain.pdf`` to `folder` and return their paths; equal
    scores give equal bytes.

    Raises
    ------
    UsageError : depth and chain length are unknown, as for an R2R file that is not ours
    StoreError : a file can't be written
    """
    if not any(value is not None for evaluation in evaluations for value in evaluation.axes["depth"]):
        raise UsageError(
            "the depth of these episodes is unknown",
            remedy="Evaluate on an export: its manifest holds the depths that plots need.",
        )
    written = []
    for axis in _AXES:
        figure = axis_figure(evaluations, axis)
        for suffix, metadata in (("png", {"Software": None}), ("pdf", {"CreationDate": None, "Producer": None})):
            path = folder / f"{axis}.{suffix}"
            write_figure(figure, path, dpi=150, metadata=metadata)
            written.append(path)
    return written
