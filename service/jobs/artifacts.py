"""Photos, stages and archives of jobs as files named by their hash, on a local disk or in a store.

Names are ``<job>/<kind>-<sha256><suffix>``; they are made here and never come from a request. Erasing a job is erasing
its folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import shutil
from pathlib import Path

from service.places import Place, translated

_NAME = re.compile(r"[0-9a-f]{32}/[a-z][a-z0-9_]{0,40}-[0-9a-f]{64}\.[a-z]{1,5}\Z")
_JOB = re.compile(r"[0-9a-f]{32}\Z")


class Artifacts(Place):
    """Files of all jobs. Several machines need a place that they share."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)

    def free_mb(self, beside: Path) -> float:
        """Free space in MiB where the files are, as far as that is a disk, and in a folder beside them."""
        return min(shutil.disk_usage(path).free for path in (self.folder or beside, beside)) / 2**20

    def signed(self, name: str, seconds: int, disposition: str, head: bool = False) -> str | None:
        """An address at the store that gives out a file for so long; None where the store cannot sign.

        ``disposition`` is the header ``Content-Disposition`` of the answer. An address for HEAD (``head``) does not
        hold for GET, nor one for GET for HEAD.
        """
        if self.folder is not None or not self.is_kept_by("s3"):
            return None
        with translated():
            # A parameter of GetObject; whoever changes it breaks the signature.
            more = {"client_method": "head_object"} if head else {"ResponseContentDisposition": disposition}
            return str(self._fs.sign(self._path(name), expiration=seconds, **more))

    def sweep(self, job: str, keep: set[str]) -> None:
        """Remove all files of a job but those of ``keep``, unfinished ones too."""
        if not _JOB.match(job):
            raise ValueError(f"not a job: {job!r}")
        for name in self.names(job):
            if name not in keep:
                self._remove(super()._path(name))
        if not keep and self.folder is not None:
            with contextlib.suppress(OSError):
                (self.folder / job).rmdir()

    def jobs(self) -> list[str]:
        """Jobs that have files."""
        return [name for name in self.names("") if _JOB.match(name)]

    def _path(self, name: str) -> str:
        if not _NAME.match(name):
            raise ValueError(f"not a name of an artifact: {name!r}")
        return super()._path(name)


def kept_folder(tenant: str, photo_sha256: str) -> str:
    """Where the stages of a photo lie that its owner wants to be kept, for heads that are made again with corrections.

    No job has this id, so the files go as those of no job do: after an hour (``Janitor.sweep_strays``), or when
    a head of the photo is erased.
    """
    return hashlib.sha256(f"stages\n{tenant}\n{photo_sha256}".encode()).hexdigest()[:32]


def artifact_name(job: str, kind: str, digest: str, suffix: str) -> str:
    """``<job>/<kind>-<digest>.<suffix>``."""
    return f"{job}/{kind}-{digest}.{suffix}"
