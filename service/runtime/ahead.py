"""Networks loaded while something else is computed.

OpenVINO compiles a network for a fifth of a second, on one core. Fit and texture use one core too; so the networks of
the later stages are made ready beside them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace

from service.runtime.networks import Engine, Loaded, load


class Ahead:
    """Loads networks one after the other in a thread of its own; each is given away once."""

    def __init__(self, names: Iterable[str], engine: Engine) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._loads: dict[str, Future[Loaded]] = {name: self._pool.submit(load, name, engine) for name in names}

    def take(self, name: str) -> Loaded | None:
        """A network, as soon as it is loaded; None where it was not asked for, or was taken before.

        Raises:
            AvatarError: as ``service.runtime.networks.load``.
        """
        found = self._loads.pop(name, None)
        return None if found is None or found.cancel() else found.result()

    def close(self) -> None:
        """Forget what nobody took, and do not begin with what is not begun."""
        self._loads.clear()
        self._pool.shutdown(cancel_futures=True)


@contextmanager
def loading_ahead(names: Iterable[str], engine: Engine) -> Iterator[Engine]:
    """The engine, with networks ``names`` being loaded in their order for the length of a ``with`` block."""
    ahead = Ahead(names, engine)
    try:
        yield replace(engine, ahead=ahead)
    finally:
        ahead.close()
