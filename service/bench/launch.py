"""A fresh process for each measurement: nothing is warm, and its peak memory is its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, TypeVar

from service.errors import Crashed

T = TypeVar("T")

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
"""Read by numeric libraries when they load."""


def isolated(work: Callable[..., T], *arguments: Any, blas_threads: int = 1) -> T:
    """``work(*arguments)`` in a process of its own.

    Args:
        work: a function at the top level of a module.
        arguments: that can be sent to another process.
        blas_threads: threads that numpy multiplies matrices with; the program itself runs with one.

    Raises:
        Crashed: the process ended without an answer, for example for want of memory.
        Exception: whatever ``work`` raises.
    """
    with _environment(blas_threads), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(work, *arguments).result()
        except BrokenProcessPool as error:
            raise Crashed(f"the process of {work.__name__} ended without an answer; is there enough memory?") from error


def here(work: Callable[..., T], *arguments: Any, blas_threads: int = 1) -> T:
    """The same without a process of its own; peak memory then means nothing."""
    return work(*arguments)


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
