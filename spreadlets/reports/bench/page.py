"""The benchmark's page: one HTML file with tables, plots, and pictures compared side by side under one zoom."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.reports.bench.rows import METRICS, Row, front, panels
from spreadlets.scene.display import display_encode

DIFFERENCE_GAIN = 4.0
"""Differences of displayed values are shown times this, around grey."""
JPEG_QUALITY = 88
TEMPLATE = Path(__file__).with_name("page.html")
MOST_PICTURES = 14
"""Pictures for each frame, task and input: of the front, then of every method's first setting."""
REFERENCE = "reference"


def picture_path(folder: Path, key: str, kind: str) -> Path:
    """Return where the picture of a row lies: ``image`` or ``difference``."""
    return folder / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}_{kind}.jpg"


def save_pictures(folder: Path, key: str, image: Image, reference: Image) -> None:
    """Save an image and its difference from the reference as they are displayed, for the page."""
    shown, wanted = (display_encode(np.asarray(each)[..., :3]) for each in (image, reference))
    difference = np.clip(0.5 + DIFFERENCE_GAIN * (shown - wanted), 0.0, 1.0)
    frame = key.split("/", 1)[0]
    for path, values in (
        (picture_path(folder, key, "image"), shown),
        (picture_path(folder, key, "difference"), difference),
        (picture_path(folder, f"{frame}/{REFERENCE}", "image"), wanted),
    ):
        _save_jpeg(path, values)


def _save_jpeg(path: Path, values: npt.NDArray[np.floating]) -> None:
    from PIL import Image as Pillow

    Pillow.fromarray(np.rint(255 * values).astype(np.uint8)).save(path, quality=JPEG_QUALITY)


def save_page(folder: Path, rows: Sequence[Row], lines: Sequence[str], plots: Sequence[Path]) -> Path:
    """Write ``bench.html``, which needs no other file.

    Parameters
    ----------
    folder : path
        With the pictures of `save_pictures` in ``pictures``.
    rows : sequence of Row
    lines : sequence of str
        The summary.
    plots : sequence of path
    """
    parts = [f"<h2>Summary</h2><pre>{html.escape(chr(10).join(lines))}</pre>"]
    for path in plots:
        data = base64.b64encode(path.read_bytes()).decode()
        parts.append(f'<h2>{path.stem.replace("_", ", ")}</h2><img class="plot" src="data:image/png;base64,{data}">')
    for (frame, task, source), group in panels(rows).items():
        parts.append(f"<h2>{html.escape(f'{frame}, {task} from {source}')}</h2>")
        parts += [_table(group), _viewer(folder / "pictures", frame, group)]
    page = folder / "bench.html"
    text = TEMPLATE.read_text().replace("@GAIN@", f"{DIFFERENCE_GAIN:g}")
    page.write_text(text.replace("@BODY@", "\n".join(parts)))
    return page


def _table(group: Sequence[Row]) -> str:
    """Return the rows as a table, those on a front marked with its metrics."""
    on = {metric: {row.key for row in front(group, metric)} for metric in METRICS}
    head = "".join(f"<th>{name}</th>" for name in ("method", "knob", *METRICS, "seconds", "fastest to slowest", "note"))
    body = []
    for row in group:
        cells = [f"<td>{html.escape(row.method)}</td><td>{html.escape(row.knob)}</td>"]
        for metric in METRICS:
            mark = ' class="front"' if row.key in on[metric] else ""
            cells.append(f"<td{mark}>{getattr(row, metric):.4g}</td>")
        low, high = row.spread
        cells.append(f"<td>{row.seconds:.3f}</td><td>{low:.3f} to {high:.3f}</td><td>{html.escape(row.note)}</td>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    return f"<table><tr>{head}</tr>{''.join(body)}</table>"


def _viewer(folder: Path, frame: str, group: Sequence[Row]) -> str:
    """Return a viewer of pictures: result, difference and reference under one zoom and exposure."""
    first = {row.method: row for row in reversed(group) if row.measured}
    chosen = {row.key: row for row in [*front(group, "ssim"), *first.values()]}
    shown = [row for row in chosen.values() if picture_path(folder, row.key, "image").exists()][:MOST_PICTURES]
    if not shown:
        return ""
    pictures = [
        [f"{row.name} (SSIM {row.ssim:.4f}, {row.seconds:.2f} s)"]
        + [_data_url(picture_path(folder, row.key, kind)) for kind in ("image", "difference")]
        for row in shown
    ]
    data = {
        "reference": _data_url(picture_path(folder, f"{frame}/{REFERENCE}", "image")),
        "pictures": pictures,
    }
    return f"<div class='viewer'></div><script>viewer({json.dumps(data)})</script>"


def _data_url(path: Path) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
