"""Facts of the machine and the installation, and verification of the shipped data files."""

from __future__ import annotations

import platform
import resource
from importlib import metadata
from pathlib import Path

from service import machine
from service.errors import ModelFault
from service.places import file_sha256

DATA = Path(__file__).parent / "data"
SUMS = "SHA256SUMS"
SAMPLE = DATA / "sample" / "astronaut.png"

REQUIRED = ("numpy", "scipy", "opencv-contrib-python-headless", "onnxruntime", "pillow", "trimesh", "pydantic", "typer")
OPTIONAL = ("openvino", "pillow-heif")

_X86_FEATURES = ("avx", "avx2", "f16c", "fma", "avx512f", "avx512_vnni", "avx512_bf16", "amx_bf16", "amx_int8")
_ARM_FEATURES = ("asimd", "asimdhp", "asimddp", "bf16", "i8mm", "sve")


def library_versions() -> dict[str, str | None]:
    """Installed version of each library that serving uses, None where it is missing."""
    return {name: _version(name) for name in REQUIRED + OPTIONAL}


def cpu() -> dict[str, object]:
    """``model``, ``cores`` that this process may use, and the vector ``features`` that the runtimes use."""
    fields = machine.fields(Path("/proc/cpuinfo"))
    flags = set((fields.get("flags") or fields.get("Features") or "").split())
    return {
        "model": fields.get("model name") or platform.processor() or platform.machine(),
        "cores": machine.processors(),
        "features": [name for name in _X86_FEATURES + _ARM_FEATURES if name in flags],
    }


def memory_mb() -> dict[str, int | None]:
    """``total`` and ``available`` memory in MiB, None where the system does not say."""
    found = {key: machine.kib(Path("/proc/meminfo"), f"Mem{key.title()}") for key in ("total", "available")}
    return {key: None if kib is None else kib // 1024 for key, kib in found.items()}


def peak_rss_mb() -> float:
    """Largest resident memory of this process so far, MiB.

    /proc comes first, because ``ru_maxrss`` on Linux includes the memory of the parent at the time of the fork.
    """
    peak = machine.kib(Path("/proc/self/status"), "VmHWM")
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss if peak is None else peak) / 1024


def runtimes() -> list[str]:
    """Installed inference runtimes with their versions, for example ``onnxruntime 1.31.1``."""
    return [f"{name} {version}" for name in ("onnxruntime", "openvino") if (version := _version(name))]


def shipped_files(folder: Path = DATA) -> dict[str, str]:
    """The data files of this version: path relative to the data folder, and hex sha256.

    ModelFault: the list itself is missing or a line of it is not ``<sha256>  <path>``.
    """
    try:
        lines = (folder / SUMS).read_text("utf-8").splitlines()
    except OSError as error:
        raise ModelFault(f"{folder / SUMS} cannot be read ({error.strerror}); install the package again") from error
    files = {}
    for line in lines:
        digest, gap, path = line.partition("  ")
        if not gap or len(digest) != 64 or not path:
            raise ModelFault(f"{folder / SUMS} has the line {line!r}; it has to be a sha256, two spaces and a path")
        files[path] = digest
    return files


def data_faults(folder: Path = DATA) -> list[str]:
    """One sentence for each data file that is missing or not the shipped one; raises as :func:`shipped_files`."""
    faults = []
    for path, shipped in shipped_files(folder).items():
        try:
            digest = file_sha256(folder / path)
        except OSError as error:
            faults.append(f"{path} cannot be read: {error.strerror}")
            continue
        if digest != shipped:
            faults.append(f"{path} has sha256 {digest}; shipped was {shipped}")
    return faults


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
