"""Captures of others: found, paired, decoded, and refused with a reason."""

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.lightstage.captures import CaptureFolder  # noqa: E402
from service.errors import ModelFault  # noqa: E402

pytestmark = pytest.mark.train


def _write(folder: Path, name: str, image: np.ndarray) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(folder / name), image)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    flat = np.zeros((512, 512, 3), np.uint8)
    flat[:] = (255, 128, 128)  # BGR: z, y, x
    for i in (1, 2):
        _write(tmp_path / "DiffAlbedo", f"s_{i}_diffalbedo.png", np.full((512, 512, 3), (0, 0, 188), np.uint8))
        _write(tmp_path / "Spec_Albedo", f"s_{i}_specalbedo.png", np.full((512, 512), 51, np.uint8))
        _write(tmp_path / "SpecNormals", f"s_{i}_specnormals.png", flat)
        _write(tmp_path / "diff-normals", f"s_{i}_diffnormals.png", flat)
        _write(tmp_path / "Normals", f"s_{i}_normals.png", flat.astype(np.uint16) * 257)
    _write(tmp_path / "DiffAlbedo", "s_3_diffalbedo.png", flat)  # has no partners
    return tmp_path


def test_patches_are_paired_and_decoded(folder: Path) -> None:
    captures = CaptureFolder.open(folder)
    assert captures.names == ("s_1", "s_2")
    patch = captures[0]
    assert set(patch) == {"diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "shape_normal"}
    assert patch["diffuse_albedo"].shape == (3, 512, 512)
    assert patch["diffuse_albedo"][0].mean() == pytest.approx(0.5029, abs=1e-3)  # red, made linear
    assert patch["diffuse_albedo"][2].max() == 0
    assert patch["specular_albedo"].shape == (1, 512, 512)
    assert patch["specular_albedo"].mean() == pytest.approx(0.2)
    for kind in ("specular_normal", "shape_normal"):
        assert torch.allclose(patch[kind].square().sum(0), torch.ones(512, 512), atol=1e-5)
        assert patch[kind][2].min() > 0.99
    assert len(list(captures)) == 2


def test_wrong_size_names_the_file(folder: Path) -> None:
    _write(folder / "DiffAlbedo", "s_1_diffalbedo.png", np.zeros((256, 512, 3), np.uint8))
    with pytest.raises(ModelFault, match=r"s_1_diffalbedo\.png is 512x256"):
        CaptureFolder.open(folder)[0]
