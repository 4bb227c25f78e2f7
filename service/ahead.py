"""What a run begins while the program itself is still being imported: networks of faces are loaded by threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from service.options import installed
from service.runtime.network_registry import networks_of
from service.runtime.sessions import few_heaps
from service.stage_cache import Loaded

if TYPE_CHECKING:
    from service.face.finder import FaceFinder
    from service.face.identity import Recogniser
    from service.face.reading.reader import Readers
    from service.hair.reading import HairNetwork
    from service.runtime.networks import Ahead

READERS = networks_of("read")
"""Networks that read a face; without them the fit follows landmarks and outline."""


class FaceNetworks(Loaded):
    """What finds, reads and compares faces: loaded by threads, dropped before the maps take memory.

    Attributes:
        reads: whether faces are read: it was asked for, and the networks are there.
    """

    def __init__(self, fit: str = "full", maps: Callable[[], Ahead] | None = None) -> None:
        """Begin to load.

        Args:
            fit: as of the options.
            maps: begins to load the networks of maps, too.
        """
        few_heaps()
        self.reads = fit != "landmarks" and installed(READERS)
        kinds = ["face.finder.FaceFinder", "face.identity.Recogniser"]
        kinds += ["face.reading.reader.Readers", "hair.reading.HairNetwork"] if self.reads else []
        pool = ThreadPoolExecutor(2)
        self._loads: list[Future[Any]] = [pool.submit(_load, kind) for kind in kinds]
        pool.submit(import_module, "scipy.optimize")
        self._maps = pool.submit(maps) if maps else None
        pool.shutdown(wait=False)

    def finder(self) -> FaceFinder:
        """Finds faces."""
        return cast("FaceFinder", self._loads[0].result())

    def recogniser(self) -> Recogniser:
        """Compares faces."""
        return cast("Recogniser", self._loads[1].result())

    def readers(self) -> Readers:
        """Read a face, where that was asked for."""
        return cast("Readers", self._loads[2].result())

    def hair(self) -> HairNetwork | None:
        """Reads hair, where faces are read; None where they are not."""
        return cast("HairNetwork", self._loads[3].result()) if self.reads else None

    def maps(self) -> Ahead | None:
        """Has begun to load the networks of a draft's maps; None where nothing was loaded ahead."""
        return None if self._maps is None else self._maps.result()

    def drop(self) -> None:
        """Let go of those of faces."""
        self._loads.clear()


def _load(kind: str) -> Any:
    """A class of the program, by its module and name, made."""
    module, _, name = kind.rpartition(".")
    return getattr(import_module(f"service.{module}"), name)()
