"""What a command shows: figures as text or JSON, and a bar of progress with an estimate."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from typing import Any

import click

BAR_WIDTH = 40
"""Characters of the whole time in the chart of steps."""


@contextmanager
def progress_bar(title: str, *, quiet: bool) -> Iterator[Callable[..., None]]:
    """Show a bar with an estimate on standard error, from the first report of progress on.

    What is yielded takes the numbers of what is done and of all, and the seconds left, if the caller knows better than
    by counting.
    """
    # The bar stays hidden until something is reported.
    shown: Any = click.progressbar(
        length=1,
        label=title,
        file=sys.stderr,
        show_eta=False,
        show_pos=True,
        item_show_func=_time_left,
        hidden=quiet,
    )
    with ExitStack() as stack:

        def report(done: int, total: int, *left_s: float | None) -> None:
            if not shown.entered:
                stack.enter_context(shown)
            shown.length = total
            left = next(iter(left_s), None)
            shown.update(done - shown.pos, shown.eta if left is None else left)

        yield report


def _time_left(seconds: float | None) -> str:
    return f"left {timedelta(seconds=round(seconds))}" if seconds else ""


def print_figures(figures: dict[str, Any], as_json: bool) -> None:
    """Print figures as one JSON object, or as lines for people."""
    if as_json:
        click.echo(json.dumps(_finite(figures)))
    else:
        for line in _lines(figures, ""):
            click.echo(line)


def _finite(value: Any) -> Any:
    """Replace what JSON cannot say (infinite PSNR of equal images) by null."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _lines(figures: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for name, value in figures.items():
        if name == "time_s":
            lines += [f"{indent}{name}", *_time_chart(value, indent + "  ")]
        elif isinstance(value, dict):
            lines += [f"{indent}{name}", *_lines(value, indent + "  ")]
        elif isinstance(value, float):
            lines.append(f"{indent}{name:<18} {value:.5g}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for index, item in enumerate(value):
                lines += [f"{indent}{name} {index}", *_lines(item, indent + "  ")]
        else:
            text = ", ".join(map(str, value)) if isinstance(value, list) else value
            lines.append(f"{indent}{name:<18} {text}")
    return lines


def _time_chart(time_s: dict[str, float], indent: str) -> list[str]:
    """Draw the share of each step in the total as a bar."""
    total = max(time_s["total"], 1e-9)
    bars = {name: "#" * round(BAR_WIDTH * seconds / total) for name, seconds in time_s.items() if name != "total"}
    return [f"{indent}{name:<16} {seconds:8.3f} {bars.get(name, '')}".rstrip() for name, seconds in time_s.items()]
