"""What a run begins while the program itself is still being imported: threads load the networks of faces and the head.

What they need is imported by them: this module imports next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, cast

from service.levels import Size
from service.options import Options, installed
from service.runtime.network_registry import networks_of
from service.runtime.sessions import few_heaps
from service.stage_cache import Loaded

if TYPE_CHECKING:
    from service.face.finder import FaceFinder
    from service.face.identity import Recogniser
    from service.face.reading.reader import Readers
    from service.geometry.chart import Chart
    from service.hair.reading import HairNetwork
    from service.head.model import HeadModel
    from service.runtime.networks import Ahead

FINDER, RECOGNISER = "face.finder.FaceFinder", "face.identity.Recogniser"
READER, HAIR = "face.reading.reader.Readers", "hair.reading.HairNetwork"
"""What is loaded, by module and name."""

READERS = networks_of("read")
"""Networks that read a face; without them the fit follows landmarks and outline."""


class FaceNetworks(Loaded):
    """What finds, reads and compares faces: loaded by threads, dropped before the maps take memory.

    Attributes:
        reads: whether faces are read: it was asked for, and the networks are there.
    """

    def __init__(self, options: Options, head: Path | None = None, maps: Callable[[], Ahead] | None = None) -> None:
        """Begin to load what a run with these options needs; ``maps`` begins to load the networks of maps, too."""
        few_heaps()
        self.reads = options.fit != "landmarks" and installed(READERS)
        kinds = [FINDER, RECOGNISER, *([READER, HAIR] if self.reads else [])]
        pool = ThreadPoolExecutor(2)
        if head is None:  # another file's faults are told where it is used
            pool.submit(head_and_chart, options.base_size, None, modes_of(options))
        self._loads: dict[str, Future[Any]] = {kind: pool.submit(_load, kind) for kind in kinds}
        pool.submit(import_module, "scipy.sparse.linalg")
        self._maps = pool.submit(maps) if maps else None
        pool.shutdown(wait=False)

    def finder(self) -> FaceFinder:
        """Finds faces."""
        return cast("FaceFinder", self._loads[FINDER].result())

    def recogniser(self) -> Recogniser:
        """Compares faces."""
        return cast("Recogniser", self._loads[RECOGNISER].result())

    def readers(self) -> Readers:
        """Read a face, where that was asked for."""
        return cast("Readers", self._loads[READER].result())

    def hair(self) -> HairNetwork | None:
        """Reads hair, where faces are read; None where they are not."""
        return cast("HairNetwork", self._loads[HAIR].result()) if self.reads else None

    def maps(self) -> Ahead | None:
        """Has begun to load the networks of a draft's maps; None where nothing was loaded ahead."""
        return None if self._maps is None else self._maps.result()

    def drop(self, *, recogniser: bool = True) -> None:
        """Let go of those of faces; without ``recogniser`` of all but that, as faces are compared last."""
        for kind in {*self._loads} - (set() if recogniser else {RECOGNISER}):
            del self._loads[kind]


def _load(kind: str) -> Any:
    """A class of the program, by its module and name, made."""
    module, _, name = kind.rpartition(".")
    return getattr(import_module(f"service.{module}"), name)()


_ONE_AT_A_TIME = Lock()


def head_and_chart(size: Size, head_file: Path | None = None, beyond: int = 0) -> tuple[HeadModel, Chart]:
    """The head to fit, its chart, and so many modes of it, which are kept where they are made."""
    from service.face.fit.landmark_fit import modes
    from service.geometry.chart import Chart
    from service.head.files import load_head

    with _ONE_AT_A_TIME:  # who asks while another makes them waits for those
        if head_file is None:
            head, chart = _usual_head_and_chart(size)
        else:
            head = load_head(head_file)
            chart = Chart.build(head, *size)
        if beyond:
            modes(head, beyond)
    return head, chart


def modes_of(options: Options, photos: int = 1) -> int:
    """How many modes of free form a fit to so many photos begins with."""
    return options.fit_settings().beyond if photos == 1 and options.fit == "full" else 0


@lru_cache(maxsize=1)
def _usual_head_and_chart(size: Size) -> tuple[HeadModel, Chart]:
    from service.geometry.chart import Chart
    from service.head.files import load_head

    head = load_head()
    return head, Chart.build(head, *size)
