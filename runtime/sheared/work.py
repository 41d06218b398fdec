"""Sizes of the parts that LRDM's steps are divided into: found for a machine by a set-up command (LRDM section 3)."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path

import platformdirs

from spreadlets.errors import InvalidParameterError

FILE_VARIABLE = "SPREADLETS_WORK_SIZES"
"""Environment variable that names another file."""
MOST = 1 << 12


@dataclass(frozen=True)
class WorkSizes:
    """How many tiles or layers a thread takes at a time; results do not depend on it.

    Attributes
    ----------
    set_up : int
        Tiles, for statistics and set-up.
    reproject : int
        Layers.
    blur : int
        Layers, for the first pass of the screen filter.
    composite : int
        Tiles, for the second pass and for compositing.
    """

    set_up: int = 16
    reproject: int = 8
    blur: int = 8
    composite: int = 4

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if type(value) is not int or not 1 <= value <= MOST:
                raise InvalidParameterError(f"work size {name} is {value!r}: allowed are whole numbers, 1 to {MOST}")

    @staticmethod
    def current() -> WorkSizes:
        """Return those of this machine: from its file if there is one."""
        return _read(work_size_file())

    def save(self) -> Path:
        """Write the file of this machine and return its path."""
        path = work_size_file()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=2) + "\n")
        _read.cache_clear()
        return path


def work_size_file() -> Path:
    """Return the path of this machine's work sizes; it need not exist."""
    given = os.environ.get(FILE_VARIABLE)
    return Path(given) if given else platformdirs.user_config_path("spreadlets", appauthor=False) / "work_sizes.json"


@cache
def _read(path: Path) -> WorkSizes:
    if not path.exists():
        return WorkSizes()
    names = [field.name for field in fields(WorkSizes)]
    try:
        return WorkSizes(**json.loads(path.read_text()))
    except (ValueError, TypeError, OSError, InvalidParameterError) as error:
        raise InvalidParameterError(
            f"the work sizes in {path} cannot be used ({error}): it must be a JSON object with {', '.join(names)}; "
            "remove it, or run spreadlets tune"
        ) from None
