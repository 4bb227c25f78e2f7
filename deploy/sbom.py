"""Print what is installed here, packages and data files, as a bill of materials (CycloneDX 1.6, JSON).

Run by the Python that the service runs with: python sbom.py > sbom.json
"""

from __future__ import annotations

import json
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

Json = dict[str, Any]


def package(found: metadata.Distribution) -> Json:
    """The component of an installed package."""
    name, version = found.metadata["Name"], found.version
    purl = f"pkg:pypi/{name.lower().replace('_', '-')}@{version}"
    entry: Json = {"type": "library", "bom-ref": purl, "name": name, "version": version, "purl": purl}
    licence = found.metadata.get("License-Expression")
    if licence:
        entry["licenses"] = [{"expression": licence}]
    elif found.metadata.get("License"):
        entry["licenses"] = [{"license": {"name": found.metadata["License"].splitlines()[0][:120]}}]
    return entry


def data_files(folder: Path) -> list[Json]:
    """Components of the files that SHA256SUMS of a folder lists: networks, head model, tables."""
    components = []
    for line in (folder / "SHA256SUMS").read_text("utf-8").splitlines():
        digest, path = line.split(maxsplit=1)
        kind = "machine-learning-model" if path.endswith(".onnx") else "data"
        hashes = [{"alg": "SHA-256", "content": digest}]
        components.append({"type": kind, "bom-ref": f"file:{path}", "name": path, "hashes": hashes})
    return components


def bill() -> Json:
    """The whole document."""
    import service

    distributions = sorted(metadata.distributions(), key=lambda found: found.metadata["Name"].lower())
    components = {entry["bom-ref"]: entry for entry in map(package, distributions)}
    folder = Path(service.__file__).parent / "data"
    own = {"type": "application", "name": "avatarme", "version": service.__version__, "bom-ref": "avatarme"}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": own},
        "components": [*components.values(), *data_files(folder)],
    }


if __name__ == "__main__":
    json.dump(bill(), sys.stdout, indent=1)
