"""The command that sets up: kernels compiled ahead of their first use."""

from __future__ import annotations

import cloup

from spreadlets.cli.options import json_option
from spreadlets.cli.show import print_figures, progress_bar


@cloup.command()
@cloup.option("--all", "every_method", is_flag=True, help="Also for the methods that ours are compared with.")
@json_option
def warmup(every_method: bool, as_json: bool) -> None:
    """Compile the kernels that synth and reconstruct call, so that no later run has to; say where they are kept.

    Run it once where the package is installed, or in the image of a container; the folder may be copied.

    Example: spreadlets warmup
    """
    from spreadlets.warmup import warm_up

    with progress_bar("compiling", quiet=as_json) as report:
        done = warm_up(every_method=every_method, progress=report)
    print_figures(done._asdict(), as_json)
