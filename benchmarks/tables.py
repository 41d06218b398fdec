"""The tables and figures of the papers on one page, `docs/tables.md`, from the results of the studies.

    python benchmarks/tables.py

Reads benchmarks/results; what a study has not made yet is named as missing. It measures nothing itself.
"""

import argparse
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from scenes import RESULTS, SCENES

PAGE = RESULTS.parent.parent / "docs" / "tables.md"
PLACE = "../benchmarks/results/"
"""Of the results, seen from the page."""
FIRST, CELL = 30, 12
"""Widths of the columns that `scenes.Report` writes."""
PSF_ZOO = {
    "simplelens": (1, 100, "1.1", "31.3"),
    "combined": (2, 400, "4.2", "9.3"),
    "physicallens": (2, 4000, "30.8", "2.2"),
    "volume": (1, 200, "5.3", "18.4"),
    "stylized": (1, 200, "9.0", "24.9"),
}
"""LKS table 1: dimensions, cells, MB, sparsity in per cent."""
SLR_SECONDS = (("DRAGON", 73.9, 7.5, 3.5), ("CITADEL", 75.0, 9.1, 4.8), ("SAN MIGUEL", 113.9, 14.1, 9.5))
"""SLR table III: TLFR on twelve threads, SLR on one, s; layers in a tile."""
SHOWN_OF_RECONSTRUCTION = "1 sample: spreadlets, denoisers, the mean, reference, difference x 4"
SHOWN_OF_ANIMATION = (
    "mean, spreadlets, lrdm, lrdm-sheared, lrdm-ewa, tlfr, truth: the last frame; below, a row of pixels over time"
)
METHODS_OF_LRDM = "lrdm", "lrdm-sheared", "lrdm-ewa"
SHOWN_OF_LRDM = "4 samples: lrdm, lrdm-sheared, lrdm-ewa, mean, reference, difference of lrdm x 4"
LRDM_TIMES = "2 to 4 times as fast as LRDM with sheared filters, 3 to 5 times with hardware lookups"


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Return a table."""
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return [*lines, *("| " + " | ".join(map(str, row)) + " |" for row in rows)]


def read(name: str, first: int = FIRST) -> list[list[str]]:
    """Return the rows of a result that `scenes.Report` wrote; none if there is no such file."""
    path = RESULTS / name
    lines = path.read_text().splitlines() if path.exists() else []
    return [
        [line[:first].strip(), *(line[k : k + CELL].strip() for k in range(first, len(line), CELL))]
        for line in lines
        if line.strip()
    ]


def table_of(name: str, first: int = FIRST) -> list[str]:
    """Return a result as a table: its first row is the head."""
    rows = read(name, first)
    if not rows:
        return [f"*Missing: no `{name}` in benchmarks/results.*"]
    width = len(rows[0])
    return markdown(rows[0], ((row + [""] * width)[:width] for row in rows[1:]))


def tables_of(name: str) -> list[str]:
    """Return each table of a result that has several, which empty lines part, below one another."""
    path = RESULTS / name
    if not path.exists():
        return [f"*Missing: no `{name}` in benchmarks/results.*", ""]
    begins = [block.lstrip("\n").split("\n")[0] for block in path.read_text().split("\n\n")]
    tables = (part(name, begin) for begin in begins)
    return [line for rows in tables for line in [*markdown(rows[0], rows[1:]), ""]]


def picture(name: str, what: str) -> list[str]:
    """Return a picture of the results, or that it is missing."""
    return [f"![{what}]({PLACE}{name})" if (RESULTS / name).exists() else f"*Missing: {name} ({what}).*", ""]


def pictures(prefix: str, what: str, scenes: Sequence[str] = SCENES) -> list[str]:
    """Return the pictures of some scenes; of `gear` and `rain`, which not every folder has, only if they are there."""
    lines = []
    for scene in scenes:
        name = f"{prefix}_{scene}.png"
        if scene not in ("gear", "rain") or (RESULTS / name).exists():
            lines += picture(name, f"{scene}: {what}")
    return lines


def part(name: str, begin: str) -> list[list[str]]:
    """Return the rows of one table of a result that has several, which empty lines part: that which begins so."""
    text = (RESULTS / name).read_text()
    found = next((block for block in text.split("\n\n") if block.lstrip("\n").startswith(begin)), "")
    return [
        [line[:FIRST].strip(), *(line[k : k + CELL].strip() for k in range(FIRST, len(line), CELL))]
        for line in found.splitlines()
        if line.strip()
    ]


def psf_zoo() -> list[str]:
    """LKS table 1."""
    rows = []
    for line in (RESULTS / "models.txt").read_text().splitlines():
        words = line.split()
        if len(words) == 14 and words[0] in PSF_ZOO:
            axes, cells, size, sparsity = PSF_ZOO[words[0]]
            rows.append((words[0], axes, cells, f"{sparsity} %, {size} MB", f"{words[4]} %, {words[10]} MB", words[7]))
    head = "model", "coordinates", "cells", "LKS: sparsity, size", "here: sparsity, size", "similarity"
    return markdown(head, rows)


def from_lks(begin: str, end: str) -> list[str]:
    """Return a part of lks.md, from a heading to another, with its pictures and links seen from the page."""
    text = (RESULTS / "lks.md").read_text()
    found = text[text.index(begin) :]
    found = found[: found.index(end)] if end and end in found else found
    return re.sub(r"\]\((?=\w+\.(?:png|txt))", f"]({PLACE}", found).replace("\n## ", "\n### ").splitlines()[1:]


def slr_times() -> list[str]:
    """SLR table III, with our processor times at four samples in a pixel."""
    rows = [
        (scene, f"{tlfr:.1f} (12 threads)", f"{slr:.1f}", f"{tlfr / slr:.1f}", layers)
        for scene, tlfr, slr, layers in SLR_SECONDS
    ]
    layers = {row[0].split(",")[0]: row[-1] for row in read("sheared_settings.txt") if row[0].endswith(", default")}
    found = {row[0]: row for row in read("tlfr_quality.txt", 40)}
    for name, row in found.items():
        scene, count, method = name.split(", ", 2)
        if (count, method) == ("4", "tlfr"):
            sheared = found[f"{scene}, 4, sheared"][3]
            ratio = float(row[3]) / float(sheared)
            rows.append((f"{scene}, 512 x 512 px", row[3], sheared, f"{ratio:.0f}", layers.get(scene, "-")))
    return markdown(("scene", "TLFR, s of a processor", "SLR, s", "ratio", "layers in a tile"), rows)


def lks() -> list[str]:
    """Return the part on LKS."""
    return [
        "## LKS",
        "",
        "### Table 1, the PSF models",
        "",
        *psf_zoo(),
        "",
        "Densities, sparsities at a similarity of .97 and the databases that ship: [models](models.md), "
        f"[models_sparsity.txt]({PLACE}models_sparsity.txt).",
        "",
        "### Table 2, synthesis, and figure 8",
        "",
        *from_lks("## Table 2", "## Table 3"),
        *pictures("frames", "pinhole, spreadlets, gathered, drawn in full, reference"),
        *picture("real_glass.png", "rain, two corners: traced through the glass, spreadlets, a thin lens"),
        "### Table 3, reconstruction, and figure 9",
        "",
        *from_lks("## Table 3", "## Fig. 10"),
        *pictures("reconstruction", SHOWN_OF_RECONSTRUCTION, (*SCENES, "rain")),
        "### Figure 10",
        "",
        *from_lks("## Fig. 10", "## Fig. 11"),
        *picture("spreadlet_quality_corpus.png", "a to d"),
        *picture("spreadlet_quality_coordinates.png", "e"),
        *picture("spreadlet_quality_shapes.png", "f"),
        "Figure 10 e for each model: similarity between the cells, by the number of cells.",
        "",
        *table_of("between_models.txt"),
        "",
        "### Figure 11",
        "",
        *from_lks("## Fig. 11", ""),
        "",
        "### Figure 12, stylized and volume",
        "",
        "![A frame with stylized](models/stylized_frame.png)",
        "![A frame with volume](models/volume_frame.png)",
        "",
        "Both against a Monte Carlo that shares nothing with them (`benchmarks/monte_carlo.py`):",
        "",
        *tables_of("monte_carlo.txt"),
        *picture("monte_carlo.png", "frame, truth, all layers, one layer, difference x 4; heart and fog"),
    ]


def slr() -> list[str]:
    """Return the part on SLR."""
    rounded = [row for row in read("sheared_settings.txt") if "fixed point" in row[0]]
    return [
        "## SLR",
        "",
        "### Table I and figure 12, fixed point",
        "",
        "Sums in the bits of table I against sums in floats, on 8-bit colours, in steps of 8 bits:",
        "",
        *markdown(("", "mean", "99.9 %", "largest"), ([row[0], *row[1:3], row[3][:5].rstrip("8")] for row in rounded)),
        "",
        "### Table III, time (table II is hardware: here two cores of a Xeon)",
        "",
        *slr_times(),
        "",
        "### Table IV, steps",
        "",
        "The paper (graphics card, ms): partitions .6 to .8, integration over the lens 20 to 49, filter and composite",
        "11 to 26. Here both are one step, done tile by tile:",
        "",
        *table_of("layered_steps.txt"),
        "",
        "### Figures 6 to 8, visibility",
        "",
        *picture("sheared_visibility.png", "exact, reconstructed, and along a line"),
        "### Figure 13, filters",
        "",
        *table_of("layered_filters.txt"),
        "",
        *picture("layered_filters.png", "axis-aligned without and with layers, sheared, reference"),
        "### Figure 14, methods",
        "",
        *pictures("tlfr", "4 samples: tlfr, as published, sheared, lrdm, reference, difference of tlfr x 4"),
        "### Figure 15, layers",
        "",
        *table_of("layered_layers.txt"),
        "",
        *picture("layered_layers.png", "layers in colours, image, difference x 8; motion is beyond this method"),
        "### Figure 16, fewer layers",
        "",
        *table_of("layered_fewer.txt"),
        "",
        *picture("layered_fewer.png", "60, 30, 8 and 4 layers"),
        "### A Gaussian lens",
        "",
        "SLR's own lens weighs its samples by a Gaussian. Frames at rest, 4 samples, filters set to this lens and to a",
        "disc:",
        "",
        *table_of("layered_gaussian.txt"),
        "",
        *picture("layered_gaussian.png", "sheared, axis-aligned, weighted mean, reference"),
    ]


def lrdm() -> list[str]:
    """Return the part on LRDM."""
    quality, speed = part("lrdm.txt", "samples per pixel"), part("lrdm.txt", "CPU seconds, 4 samples")
    return [
        "## LRDM",
        "",
        "### Table 1, time",
        "",
        f"The paper: {LRDM_TIMES}. Here, with lookups in software:",
        "",
        *markdown(("", *METHODS_OF_LRDM, "sheared", "ewa"), (row[:6] for row in speed[1:])),
        "",
        "### Table 2, steps",
        "",
        "The paper (ms): LRDM 7.1 statistics, 12 reprojection and filter; lookups 2.0, 2.2, .9; sheared 2.0, 2.3, 2.5.",
        "Here, ms of a processor, in the [table of SLR's steps](#table-iv-steps).",
        "",
        "### Table 3, PSNR, and figure 3",
        "",
        "The paper: lookups lose .7 to 1.9 dB on LRDM (2.6 in its text), sheared filters -.4 to 1.6 dB.",
        "",
        *markdown(("", *quality[0][1:7], "loss at 4"), (row[:8] for row in quality[1:])),
        "",
        *pictures("lrdm", SHOWN_OF_LRDM, ("coins", "whirl", "gear")),
        "### Figure 7, an animation",
        "",
        "The paper has the time of each frame of a flight through a scene: 25 to 33 ms for 1920 x 1080 px, renderer",
        "and reconstruction together. There is no such renderer here. Instead a camera flies past cards, samples are",
        "drawn of them, and flicker is measured: what the image changes from frame to frame beside what the truth",
        "does, as a share of the displayed range (`benchmarks/animation.py`).",
        "",
        *table_of("animation.txt"),
        "",
        *picture("animation.png", SHOWN_OF_ANIMATION),
        "### Figure 8, the fence",
        "",
        *pictures("lrdm", SHOWN_OF_LRDM, ("fence",)),
        "### Figure 9, the pixel's filter",
        "",
        "The moving board of `fence`; the paper has .33 everywhere else, here it is .5 by default.",
        "",
        *table_of("layered_sigma.txt"),
        "",
        *picture("layered_sigma.png", "sigma of .33, .5, .7 and 1 px, reference"),
    ]


def tlfr() -> list[str]:
    """Return the part on TLFR."""
    return [
        "## TLFR",
        "",
        "Quality and time are on [its page](tlfr.md). Views of a pixel, with and without the filter on the screen:",
        "",
        *table_of("tlfr_views.txt", 40),
        "",
        "Other settings:",
        "",
        *table_of("tlfr_settings.txt", 40),
        "",
    ]


def references() -> list[str]:
    """Return the part on the times of the renderer."""
    return [
        "## References",
        "",
        "What Cycles takes for our scenes on two cores, direct light alone. Halves of a reference agree by this SSIM:",
        "",
        *table_of("render_times.txt", 22),
        "",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=PAGE, help="default: docs/tables.md")
    page = parser.parse_args().out
    lines = [
        "# The papers' tables and figures",
        "",
        "Each table and figure of the papers beside ours, made by `benchmarks/tables.py` of the studies' results. What",
        "follows from them, and where we deviate, is in [what the papers claim](papers.md).",
        "",
    ]
    lines += [*lks(), *slr(), *lrdm(), *tlfr(), *references()]
    page.write_text("\n".join(lines).rstrip("\n") + "\n")
    missing = [line for line in lines if line.startswith("*Missing")]
    print(f"{page}: {len(lines)} lines", *missing, sep="\n")


if __name__ == "__main__":
    main()
