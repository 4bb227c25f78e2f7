from __future__ import annotations

from pathlib import Path

import pytest

from service.jobs.artifacts import Artifacts

JOB = "a" * 32
DIGEST = "0" * 64


@pytest.fixture(params=["file", "memory"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> Artifacts:
    """On a disk, and in a store that is none."""
    root = f"file://{tmp_path}/store" if request.param == "file" else f"memory://store-{tmp_path.name}"
    made = Artifacts(root)
    made._fs.makedirs(made._root, exist_ok=True)
    return made


@pytest.mark.parametrize(
    "name", ["../x", f"{JOB}/../../etc/passwd", f"{JOB}/photo-{DIGEST}.zip/x", f"{JOB}/PHOTO-{DIGEST}.zip", "", "x\0y"]
)
def test_only_names_of_ours_are_names(artifacts: Artifacts, name: str) -> None:
    """No input reaches names today; if some change let it, this still keeps it inside the folder."""
    for use in (artifacts.read, artifacts.exists, artifacts.delete):
        with pytest.raises(ValueError, match="not a name"):
            use(name)
