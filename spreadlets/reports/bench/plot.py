"""Plots of error against run time: a panel for each frame and input, the Pareto front as a line."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from spreadlets.reports.bench.rows import METRICS, Row, front, panels

AXES: dict[str, tuple[str, Callable[[float], float]]] = {
    "ssim": ("1 - SSIM", lambda value: 1.0 - value),
    "flip": ("FLIP", lambda value: value),
    "psnr": ("10^(-PSNR / 20)", lambda value: 10.0 ** (-value / 20.0)),
    "relmse": ("relMSE", lambda value: value),
}
"""For each metric the label of its axis, and what is drawn: less is better everywhere."""
PANEL_INCHES = 4.6, 3.6
DPI = 90
LABEL_POINTS = 7
LABEL_DISTANCE = 0.09
"""Names of points are left out where they would lie on another: distance in sides of the panel."""
OURS = "#c2410c"
COLOURS = {
    **{"dense": "#1d4ed8", "dense-rows": "#60a5fa", "gather": "#a16207", "blender nodes": "#be185d"},
    **{"sheared": "#047857", "axis-aligned": "#65a30d", "mean": "#6b7280", "bm3d": "#7c3aed", "oidn": "#0e7490"},
}
COLOURS |= {"lrdm": "#3730a3", "lrdm-sheared": "#86198f", "lrdm-ewa": "#db2777", "tlfr": "#b45309"}
OTHERS = ("#991b1b", "#854d0e", "#166534", "#155e75")
MARKERS = "s^Dv<>pX"


def save_plots(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write a plot for each task and metric to a folder and return their paths."""
    made = []
    grouped = panels(rows)
    for task in dict.fromkeys(key[1] for key in grouped):
        chosen = {key: group for key, group in grouped.items() if key[1] == task and any(r.measured for r in group)}
        for metric in METRICS if chosen else ():
            made.append(folder / f"{task}_{metric}.png")
            _save_plot(made[-1], chosen, metric)
    return made


def _save_plot(path: Path, groups: dict[tuple[str, str, str], list[Row]], metric: str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    sources = list(dict.fromkeys(key[2] for key in groups))
    frames = list(dict.fromkeys(key[0] for key in groups))
    size = PANEL_INCHES[0] * len(frames), PANEL_INCHES[1] * len(sources)
    figure: Any = Figure(figsize=size, dpi=DPI, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.subplots(len(sources), len(frames), squeeze=False)
    for (frame, _, source), group in groups.items():
        _draw_panel(axes[sources.index(source)][frames.index(frame)], group, metric, f"{frame}, from {source}")
    for each in axes.flat:
        # Not every frame comes from every source.
        each.set_visible(each.has_data())
    canvas.draw()
    image = Image.frombuffer("RGBA", canvas.get_width_height(), bytes(canvas.buffer_rgba()))
    image.convert("RGB").save(path, optimize=True)


def _draw_panel(axes: Any, group: Sequence[Row], metric: str, title: str) -> None:
    """Draw one panel: points with the range of their times, the front, and the names of those on it."""
    label, drawn = AXES[metric]
    measured = [row for row in group if row.measured]
    # Draw each method's points, with the range of their times.
    for number, method in enumerate(dict.fromkeys(row.method for row in measured)):
        mine = [row for row in measured if row.method == method]
        colour = OURS if method == "spreadlets" else COLOURS.get(method, OTHERS[number % len(OTHERS)])
        x, y = [row.seconds for row in mine], [drawn(getattr(row, metric)) for row in mine]
        low, high = zip(*(row.spread for row in mine), strict=True)
        reach = [[a - b for a, b in zip(x, low, strict=True)], [b - a for a, b in zip(x, high, strict=True)]]
        marker = "o" if method == "spreadlets" else MARKERS[number % len(MARKERS)]
        axes.errorbar(x, y, xerr=reach, fmt=marker, color=colour, markersize=5, elinewidth=0.8, label=method)
    # Draw the front.
    on = front(group, metric)
    ours = [row for row in measured if row.method == "spreadlets" and row.knob == "default"]
    axes.step(
        [row.seconds for row in on],
        [drawn(getattr(row, metric)) for row in on],
        where="post",
        color="black",
        linewidth=0.9,
        zorder=0,
    )
    # Scale the axes, and name the points.
    axes.set_xscale("log")
    if all(math.isfinite(drawn(getattr(row, metric))) and drawn(getattr(row, metric)) > 0 for row in measured):
        axes.set_yscale("log")
    _name_points(axes, [*ours, *on], drawn, metric)
    axes.set(title=title, xlabel="seconds", ylabel=label)
    axes.grid(visible=True, which="both", linewidth=0.3)
    axes.legend(fontsize=LABEL_POINTS)


def _name_points(axes: Any, rows: Sequence[Row], drawn: Callable[[float], float], metric: str) -> None:
    """Write the names of points beside them, those that come first where there is no room for all."""
    taken: list[tuple[float, float]] = []
    to_panel = axes.transScale + axes.transLimits
    for row in rows:
        where = row.seconds, drawn(getattr(row, metric))
        x, y = (float(each) for each in to_panel.transform(where))
        if all(math.hypot(x - left, y - low) > LABEL_DISTANCE for left, low in taken):
            taken.append((x, y))
            text = row.knob if row.method == "spreadlets" else row.name
            right = x > 0.8
            axes.annotate(
                text,
                where,
                xytext=(-4 if right else 4, 5),
                textcoords="offset points",
                fontsize=LABEL_POINTS,
                horizontalalignment="right" if right else "left",
            )
