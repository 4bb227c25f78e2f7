"""Small archives in the form of real ones: files, and a manifest that lists them."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile


def archive(files: dict[str, bytes] | None = None, listed: dict[str, bytes] | None = None) -> bytes:
    """A stored zip.

    Args:
        files: what the zip holds; two small files unless told.
        listed: what its manifest says that it holds; the same unless told.
    """
    files = {"maps/texture.png": bytes(range(256)) * 40, "mesh/head.obj": b"v 0 0 0\n" * 50} if files is None else files
    entries = [
        {"path": name, "size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        for name, data in (files if listed is None else listed).items()
    ]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as target:
        for name, content in {"manifest.json": json.dumps({"files": entries}).encode(), **files}.items():
            target.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content)
    return stream.getvalue()
