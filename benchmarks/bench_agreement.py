"""Whether two runs of `spreadlets bench` agree: equal errors, and times whose ranges overlap.

    spreadlets bench --quick --fresh --out a && spreadlets bench --quick --fresh --out b
    python benchmarks/bench_agreement.py a/bench.csv b/bench.csv

Prints each row's medians and ranges, and exits with 1 if errors differ by more than rounding, or if the ranges of
more than a tenth of the rows do not overlap.
"""

import argparse
import csv
import math
import sys
from pathlib import Path

NAMES = ("frame", "task", "input", "method", "knob")
ERRORS = ("ssim", "flip", "psnr", "relmse")
ERROR_TOLERANCE = 1e-5
MOST_APART = 0.1


def rows_of(path: Path) -> dict[tuple[str, ...], dict[str, str]]:
    """Return the measured rows by their names."""
    with path.open() as file:
        rows = {tuple(row[name] for name in NAMES): row for row in csv.DictReader(file)}
    return {key: row for key, row in rows.items() if int(row["runs"]) > 1}


def same_errors(first: dict[str, str], second: dict[str, str]) -> bool:
    """Whether all errors are equal but for rounding."""
    pairs = [(float(first[name]), float(second[name])) for name in ERRORS]
    return all(math.isclose(a, b, rel_tol=ERROR_TOLERANCE, abs_tol=ERROR_TOLERANCE) for a, b in pairs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs=2, type=Path)
    first, second = (rows_of(path) for path in parser.parse_args().runs)
    common = sorted(first.keys() & second.keys())
    apart = different = 0
    for key in common:
        a, b = first[key], second[key]
        overlap = max(float(a["seconds_low"]), float(b["seconds_low"])) <= min(
            float(a["seconds_high"]), float(b["seconds_high"])
        )
        apart += not overlap
        different += not same_errors(a, b)
        ranges = "   ".join(f"{r['seconds']} s ({r['seconds_low']} to {r['seconds_high']})" for r in (a, b))
        print(f"{' / '.join(key):<60} {ranges}{'' if overlap else '   apart'}")
    print(f"{len(common)} rows, {apart} with times apart, {different} with other errors")
    if not common or different or apart > MOST_APART * len(common):
        sys.exit(1)


if __name__ == "__main__":
    main()
