"""Memory that is used again: what one layer was drawn in, the next is drawn in, too.

Fresh memory costs more than what is then done with it: the system clears each page when it is first touched.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np
import numpy.typing as npt

_kept: ContextVar[dict[Hashable, npt.NDArray[Any]] | None] = ContextVar("buffers", default=None)


@contextmanager
def kept_buffers() -> Iterator[None]:
    """Let `buffer` use memory again within the enclosed block."""
    token = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(token)


def buffer(name: Hashable, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Return an array whose values mean nothing.

    Within `kept_buffers`, it lies where the last one of its name did: that must not be needed any more.

    Parameters
    ----------
    name : hashable
        Of one use; its arrays share their type.
    shape : tuple of int
    dtype : data type

    Returns
    -------
    ndarray
        C-contiguous.

    Examples
    --------
    >>> import numpy as np
    >>> from spreadlets.runtime.buffers import buffer, kept_buffers
    >>> with kept_buffers():
    ...     first, second = buffer("canvas", (4, 6)), buffer("canvas", (2, 3))
    >>> np.shares_memory(first, second)
    True
    """
    kept, size = _kept.get(), math.prod(shape)
    if kept is None:
        return np.empty(shape, dtype)
    if name not in kept or kept[name].size < size:
        # A smaller one goes before a larger one comes.
        kept.pop(name, None)
        kept[name] = np.empty(size, dtype)
    return kept[name][:size].reshape(shape)
