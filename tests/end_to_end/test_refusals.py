"""What the command says, and how it ends, when a photo cannot become a head. No archive may be left behind."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.end_to_end.command import avatarme
from tests.end_to_end.conftest import TEXTURE_ONLY, Pixels, png, unpacked


def jpeg(pixels: Pixels) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def refused(data: bytes, folder: Path, status: int) -> dict[str, object]:
    (folder / "photo.jpg").write_bytes(data)
    run = avatarme("make", folder / "photo.jpg", "--json")
    assert run.status == status, run.stderr
    assert not (folder / "photo.zip").exists()
    error: dict[str, object] = run.json["error"]
    assert run.stderr == f"avatarme: {error['message']}\n"
    return error


def test_two_faces_are_refused_with_their_boxes_until_one_is_chosen(portrait: Pixels, tmp_path: Path) -> None:
    error = refused(png(np.concatenate([portrait, portrait], 1)), tmp_path, 3)
    assert error["code"] == "multiple-faces"
    boxes = np.array(error["boxes"])
    assert boxes.shape == (2, 4)
    np.testing.assert_allclose(boxes[1] - boxes[0], [512, 0, 512, 0], atol=6)
    chosen = avatarme("make", tmp_path / "photo.jpg", "-o", "-", "--face", "1", "--size", "192x128", *TEXTURE_ONLY)
    assert chosen.status == 0, chosen.stderr
    manifest = json.loads(unpacked(chosen.stdout)["manifest.json"])
    np.testing.assert_allclose(manifest["input"]["face_box"], boxes[1], atol=0.1)


@pytest.mark.parametrize("share", [0.3, 0.98])
def test_a_jpeg_that_was_cut_off(portrait: Pixels, tmp_path: Path, share: float) -> None:
    """Decoders fill the missing rows with grey; a head from half a face and half a grey block must not be made."""
    whole = jpeg(portrait)
    error = refused(whole[: int(share * len(whole))], tmp_path, 4)
    assert error["code"] == "corrupt-image"
