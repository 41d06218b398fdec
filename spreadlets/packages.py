"""Packages that only some uses need: imported where they are used, with one clear line if they are missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from spreadlets.errors import MissingPackageError


def optional_package(name: str, extra: str, user: str) -> Any:
    """Import a package that a plain installation does not bring.

    Parameters
    ----------
    name : str
        The module to import.
    extra : str
        The extra of ``spreadlets`` that brings it.
    user : str
        What needs it, as the message says it.

    Raises
    ------
    MissingPackageError
        If it is not installed; the message says how to install it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise MissingPackageError(
            f"{user} needs the package {name.split('.')[0]}, which is not installed: pip install 'spreadlets[{extra}]'"
        ) from error
