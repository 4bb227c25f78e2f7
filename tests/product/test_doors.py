"""Photos through every door of the product, with the shipped networks: the same bytes come out of each."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from service.diagnosis import SAMPLE
from tests.end_to_end.command import avatarme
from tests.product.conftest import FLAGS, SMALL, Archives, Service, archives_in, manifest_of

NAMES = ("closed", "full_beard", "mouth_open", "sample", "wide_smile")
STAGES = (
    "decode", "detect", "read", "fit", "hair", "texture", "compare",
    "diffuse_albedo", "specular_albedo", "specular_normal", "diffuse_normal", "displacement",
)  # fmt: skip
"""What a job keeps on the disk, in this order; after the last the archive is packed."""


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


def test_a_folder_at_the_server(service: Service, photos: Path, local: Archives, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("mouth_open.jpg", "wide_smile.heic"):
        (tmp_path / "in" / name).write_bytes((photos / name).read_bytes())
    run = avatarme("batch", tmp_path / "in", tmp_path / "out", "--server", service.server.url, *FLAGS)
    assert run.status == 0, run.stderr
    assert archives_in(tmp_path / "out") == {name: local[name] for name in ("mouth_open", "wide_smile")}


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


def kept(service: Service, job: str) -> set[str]:
    """Stages of a job whose results are on the disk."""
    found = (service.server.data / "artifacts" / job).glob("stage_*")
    return {path.name.removeprefix("stage_").rpartition("-")[0] for path in found}


def moments(service: Service, job: str) -> Iterator[str]:
    """Waits for each stage of a job in turn, and says which it is in."""
    for done, stage in zip(("", *STAGES), (*STAGES, "pack"), strict=True):
        deadline = time.monotonic() + 120
        folder = service.server.data / "artifacts" / job
        while done and not any(name.startswith(f"stage_{done}-") for name in os.listdir(folder)):
            assert time.monotonic() < deadline, f"{job} does not come to {stage}"
            time.sleep(0.002)
        yield stage


def test_killed_in_every_stage_a_job_ends_with_the_same_bytes(
    service: Service, photos: Path, local: Archives
) -> None:
    """SIGKILL to server, worker and the job's process at once; no stage that was kept is computed again."""
    job = service.post((photos / "closed.jpg").read_bytes())
    killed = []
    for stage in moments(service, job):
        before = kept(service, job)
        service.server.kill()
        assert before <= kept(service, job)
        killed.append(stage)
        service.server.start()
    assert killed == [*STAGES, "pack"]
    assert service.archive(job) == local["closed"]
    assert kept(service, job) == set(), "what was kept for a restart is erased at the end"
