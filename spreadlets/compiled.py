"""How kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, overload

import numba

Kernel = Callable[..., Any]


@overload
def kernel(function: Kernel) -> Kernel: ...
@overload
def kernel(*, fastmath: bool | set[str] = ..., error_model: str = ...) -> Callable[[Kernel], Kernel]: ...
def kernel(function: Kernel | None = None, **options: Any) -> Kernel | Callable[[Kernel], Kernel]:
    """Compile a function when it is first called, keep it for later processes, and run it without the global lock.

    Parameters
    ----------
    function : callable
        Written in what Numba compiles.
    **options
        Numba's: ``fastmath``, liberties with floating-point numbers, by default none, so that results are exact;
        ``error_model``, whether dividing by zero is an error ("python") or gives infinity ("numpy").
    """
    compile_it: Callable[[Kernel], Kernel] = numba.njit(cache=True, nogil=True, **options)
    return compile_it if function is None else compile_it(function)


@overload
def helper(function: Kernel) -> Kernel: ...
@overload
def helper(
    *, fastmath: bool | set[str] = ..., error_model: str = ..., inline: Literal["never", "always"] = ...
) -> Callable[[Kernel], Kernel]: ...
def helper(function: Kernel | None = None, **options: Any) -> Kernel | Callable[[Kernel], Kernel]:
    """Compile a function that only kernels call: it is kept within them, and has no entrance from Python.

    Parameters
    ----------
    function : callable
    **options
        As for `kernel`; and ``inline``: "always" for what is called in one place, which is then compiled once.
    """
    compile_it: Callable[[Kernel], Kernel] = numba.njit(  # type: ignore[call-overload]
        no_cpython_wrapper=True, no_cfunc_wrapper=True, **options
    )
    return compile_it if function is None else compile_it(function)
