"""Other people's captures: patches in the form of RealFaceDB, as a data set.

RealFaceDB (Lattas et al. 2020) is 7,500 patches of 512 x 512 pixels, cut from maps of 6144 x 4096, 1,500 of each of
five kinds, in a folder per kind. A folder counts as one of ours by its name, whatever its spelling; patches of
different kinds belong together by the name of their file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.errors import ModelFault

PATCH = 512
KINDS = {
    "diffuse_albedo": ("diffusealbedo", "diffalbedo", "albedodiffuse"),
    "specular_albedo": ("specularalbedo", "specalbedo", "albedospecular"),
    "diffuse_normal": ("diffusenormals", "diffusenormal", "diffnormals", "diffnormal", "normalsdiffuse"),
    "specular_normal": ("specularnormals", "specularnormal", "specnormals", "specnormal", "normalsspecular"),
    "shape_normal": ("shapenormals", "shapenormal", "normals", "normalsshape"),
    "texture": ("texture", "textures", "rendered", "baked"),
}
_COLOUR = ("diffuse_albedo", "texture")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")


@dataclass(frozen=True)
class CaptureFolder:
    """Patches on disk.

    Attributes:
        files: for each kind of map the path of each patch, by the patch's name.
        names: patches that every kind has, sorted.
    """

    files: dict[str, dict[str, Path]]
    names: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path) -> CaptureFolder:
        """Find the kinds of maps under ``folder``.

        Raises:
            ModelFault: there is no such folder, no kind of map in it, or no patch that all kinds have.
        """
        if not folder.is_dir():
            raise ModelFault(f"captures: {folder} is not a folder")
        files: dict[str, dict[str, Path]] = {}
        for child in sorted(p for p in folder.rglob("*") if p.is_dir()):
            kind = _kind(child.name)
            if kind is None:
                continue
            found = {_key(p, kind): p for p in sorted(child.iterdir()) if p.suffix.lower() in _SUFFIXES}
            files.setdefault(kind, {}).update(found)
        files = {kind: found for kind, found in files.items() if found}
        if not files:
            wanted = ", ".join(sorted(KINDS))
            raise ModelFault(f"captures: {folder} has no folder of patches named like one of: {wanted}")
        names = set.intersection(*(set(found) for found in files.values()))
        if not names:
            counts = ", ".join(f"{kind} {len(found)}" for kind, found in files.items())
            raise ModelFault(f"captures: no patch has the same name in all folders of {folder} ({counts})")
        return cls(files, tuple(sorted(names)))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """Maps of one patch, (C, 512, 512) float32 each, in the stage's own form.

        Albedo and texture become linear RGB in [0, 1], specular albedo one channel in [0, 1] (as stored), normals unit
        vectors.

        Raises:
            ModelFault: a file cannot be decoded or has another size than 512 x 512.
        """
        name = self.names[index]
        return {kind: _load(found[name], kind) for kind, found in self.files.items()}

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        return (self[i] for i in range(len(self)))


def _plain(name: str) -> str:
    return re.sub(r"[^a-z]", "", name.lower())


def _kind(folder: str) -> str | None:
    plain = _plain(folder)
    return next((kind for kind, spellings in KINDS.items() if plain in (*spellings, _plain(kind))), None)


def _key(path: Path, kind: str) -> str:
    """The file's name without the kind's own words: 'subj1_DiffAlbedo_07' meets 'subj1_SpecNormals_07'."""
    words = re.split(r"[^A-Za-z0-9]+", path.stem)
    spellings = (*KINDS[kind], _plain(kind), "map", "patch")
    kept = [w for w in words if w and _plain(w) not in spellings]
    pairs = [w for i, w in enumerate(kept) if _plain("".join(kept[i : i + 2])) not in spellings]
    return "_".join(pairs or kept or words)


def _load(path: Path, kind: str) -> Tensor:
    raw = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if raw is None:
        raise ModelFault(f"captures: {path} cannot be decoded")
    if raw.shape[:2] != (PATCH, PATCH):
        raise ModelFault(f"captures: {path} is {raw.shape[1]}x{raw.shape[0]}, patches are {PATCH}x{PATCH}")
    full = {"uint8": 255.0, "uint16": 65535.0}.get(raw.dtype.name, 1.0)
    image: npt.NDArray[np.float32] = np.asarray(raw, np.float32) / np.float32(full)
    image = image[..., None] if image.ndim == 2 else image[..., 2::-1]
    if kind == "specular_albedo":
        image = image.mean(-1, keepdims=True, dtype=np.float32)
    elif kind in _COLOUR:
        image = _linear(np.repeat(image, 3 // image.shape[-1], -1))
    else:
        image = _unit(image * np.float32(2.0) - np.float32(1.0), path)
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))


def _linear(coded: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    high = ((np.maximum(coded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.asarray(np.where(coded <= 0.04045, coded / 12.92, high), np.float32)


def _unit(vectors: npt.NDArray[np.float32], path: Path) -> npt.NDArray[np.float32]:
    if vectors.shape[-1] != 3:
        raise ModelFault(f"captures: {path} has {vectors.shape[-1]} channel, a normal map needs 3")
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0], np.float32)
    return np.asarray(np.where(length > 1e-3, vectors / np.maximum(length, 1e-3), up), np.float32)
