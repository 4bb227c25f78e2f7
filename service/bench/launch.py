"""A fresh process for each measurement, so that caches are cold and its peak memory is measured alone."""

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
"""Environment variables that numeric libraries read when they load."""


def isolated(work: Callable[..., T], *arguments: Any, blas_threads: int = 1) -> T:
    """``work(*arguments)`` in a separate process.

    Args:
        work: a function at the top level of a module.
        arguments: of ``work``, picklable.
        blas_threads: threads of numpy's matrix products; the program itself runs with one.

    Raises:
        Crashed: the process ended without a result, for example for want of memory.
        Exception: as ``work`` raises it.
    """
    with _environment(blas_threads), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(work, *arguments).result()
        except BrokenProcessPool as error:
            raise Crashed(
                f"the process of {work.__name__} ended without a result; there may be too little memory"
            ) from error


def here(work: Callable[..., T], *arguments: Any, blas_threads: int = 1) -> T:
    """``work(*arguments)`` in this process; the measured peak memory is then meaningless."""
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
