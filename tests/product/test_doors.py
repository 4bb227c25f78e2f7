"""Photos through every door of the product, with the shipped networks: the same bytes come out of each."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from PIL import Image

from service.diagnosis import SAMPLE
from tests.end_to_end.command import avatarme
from tests.product.conftest import FLAGS, Archives, Service, archives_in, manifest_of
from tests.product.page import Parts
from tests.support.browser import Pixels, opening, settle

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NAMES = ("closed", "full_beard", "mouth_open", "sample", "wide_smile")


def test_a_folder_on_this_machine_gives_what_one_photo_gives(local: Archives, tmp_path: Path) -> None:
    assert set(local) == set(NAMES)
    run = avatarme("make", SAMPLE, "-o", tmp_path / "sample.zip", *FLAGS)
    assert run.status == 0, run.stderr
    assert (tmp_path / "sample.zip").read_bytes() == local["sample"]


@pytest.mark.parametrize("name", NAMES)
def test_the_service_gives_the_bytes_of_the_command(name: str, served: Archives, local: Archives) -> None:
    """All five are handed in at once, and two are computed at a time."""
    assert served[name] == local[name]


def test_what_is_worn_was_noticed(local: Archives) -> None:
    """Else these photos would try nothing."""
    warnings = {name: set(manifest_of(archive)["warnings"]) for name, archive in local.items()}
    assert warnings["sample"] == set()
    assert "gaze-not-seen" in warnings["closed"]
    assert "glasses-removed" in warnings["full_beard"]
    folds = {name: manifest_of(archive)["maps"] for name, archive in local.items()}
    assert all(any(entry["role"].startswith("wrinkle") for entry in maps) for maps in folds.values())


def test_a_folder_at_the_server(
    service: Service, jobs: dict[str, str], served: Archives, photos: Path, tmp_path: Path
) -> None:
    """The jobs of before are found again and not computed a second time; those that were fetched are erased."""
    (tmp_path / "in").mkdir()
    for name in ("mouth_open.jpg", "wide_smile.heic"):
        (tmp_path / "in" / name).write_bytes((photos / name).read_bytes())
    run = avatarme("batch", tmp_path / "in", tmp_path / "out", "--server", service.server.url, *FLAGS)
    assert run.status == 0, run.stderr
    assert archives_in(tmp_path / "out") == {name: served[name] for name in ("mouth_open", "wide_smile")}
    left = {name: service.client.get(f"/v1/avatars/{job}").status_code for name, job in jobs.items()}
    assert left == {name: 410 if name in ("mouth_open", "wide_smile") else 200 for name in NAMES}


def test_48_megapixels_of_a_jpeg(service: Service, local: Archives) -> None:
    """A phone's best: nearly all that the gate takes. It is the same head."""
    sample = cv2.imread(str(SAMPLE))
    assert sample is not None
    large = cv2.resize(sample, (6928, 6928), interpolation=cv2.INTER_LINEAR)
    photo = bytes(cv2.imencode(".jpg", large, [cv2.IMWRITE_JPEG_QUALITY, 80])[1])
    manifest = manifest_of(service.archive(service.post(photo)))
    assert (manifest["input"]["width"], manifest["input"]["height"]) == (6928, 6928)
    alike, plain = (found["fit"]["identity_similarity"] for found in (manifest, manifest_of(local["sample"])))
    assert alike["centred_cosine"] > plain["centred_cosine"] - 0.1


def test_pictures_of_an_avatar(service: Service, jobs: dict[str, str], served: Archives, tmp_path: Path) -> None:
    """Drawn by the command and by the service, to the same bytes; a face is in the middle."""
    (tmp_path / "sample.zip").write_bytes(served["sample"])
    asked = ("--size", "192x256", "--view", "three-quarter")
    run = avatarme("render", tmp_path / "sample.zip", "-o", tmp_path / "head.png", *asked)
    assert run.status == 0, run.stderr
    drawn = (tmp_path / "head.png").read_bytes()
    content = {"avatar": jobs["sample"], "size": [192, 256], "view": "three-quarter"}
    answer = service.client.post("/v1/renders", json=content)
    assert answer.status_code == 200, answer.text
    assert answer.content == drawn
    pixels = np.asarray(Image.open(io.BytesIO(drawn)).convert("RGB"), float)
    middle = pixels[100:156, 70:122]
    assert middle.mean() > 40 and middle.std() > 8
    assert pixels[:20, :20].max() == 0


def test_kits_of_an_avatar(service: Service, jobs: dict[str, str], served: Archives, tmp_path: Path) -> None:
    (tmp_path / "sample.zip").write_bytes(served["sample"])
    run = avatarme("export", tmp_path / "sample.zip", "--for", "unity", "-o", tmp_path / "kit")
    assert run.status == 0, run.stderr
    files = {path.relative_to(tmp_path / "kit").as_posix() for path in (tmp_path / "kit").rglob("*") if path.is_file()}
    assert any(name.endswith((".glb", ".fbx", ".gltf")) for name in files), files


def grey(colours: Pixels) -> Pixels:
    """Blue over red: 1 without colour, less the redder."""
    return np.asarray(colours[..., 2] / colours[..., 0])


def test_the_page_dresses_each_part_in_its_own(
    service: Service, jobs: dict[str, str], served: Archives, browser: Browser
) -> None:
    """Through the photo's camera, where the archive tells what each pixel shows."""
    with opening(browser) as opened:
        page = opened(f"{service.server.url}/#avatar={jobs['sample']}", bypass_csp=True, device_scale_factor=1)
        page.wait_for_selector("#inset:not([hidden])")
        page.click("#inset")
        page.evaluate("document.getElementById('view').style.setProperty('--at', '0%')")
        page.add_style_tag(content="#view > :not(canvas) { visibility: hidden !important }")
        settle(page)
        picture = Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB")
    seen = Parts.of(served["sample"]).seen(picture.size)
    pixels = np.asarray(picture, float)
    skin, hair, teeth = (pixels[seen[name]] for name in ("skin", "hair", "teeth_upper_gums"))
    eyes = pixels[seen["eye_left_ball"] | seen["eye_right_ball"]]
    assert min(map(len, (skin, hair, teeth, eyes))) > 50
    flesh = np.median(skin, 0)
    assert np.abs(np.median(hair, 0) - flesh).max() > 30, "a wig of skin"
    assert np.median(grey(teeth)) > grey(flesh) + 0.12, "teeth are whiter than skin"
    assert np.percentile(grey(eyes), 80) > grey(flesh) + 0.12, "and so are the whites of the eyes"
    assert np.percentile(eyes.mean(1), 20) < 0.92 * flesh.mean(), "irises are darker"
    assert np.percentile(eyes.mean(1), 90) > 1.1 * flesh.mean(), "and the whites lighter"
