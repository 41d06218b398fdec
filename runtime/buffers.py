"""Memory that is used again: what one layer was drawn in, the next is drawn in, too, and the next frame.

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

Buffers = dict[Hashable, npt.NDArray[Any]]

MOST_IDLE_BYTES = 192 << 20
"""Memory that waits for the next frame, at most: what a frame of some 1024 x 1024 pixels is drawn in."""

_kept: ContextVar[Buffers | None] = ContextVar("buffers", default=None)
_idle: list[Buffers] = []


@contextmanager
def kept_buffers() -> Iterator[None]:
    """Let `buffer` use memory again within the enclosed block, and in the next one: no other thread has it meanwhile."""
    try:
        kept = _idle.pop()
    except IndexError:
        kept = {}
    token = _kept.set(kept)
    try:
        yield
    finally:
        _kept.reset(token)
        if not _idle and sum(each.nbytes for each in kept.values()) <= MOST_IDLE_BYTES:
            _idle.append(kept)


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
