"""Captures that tests of training share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.runtime.network_registry import GEOMETRY


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made-up captures: noise in the form of ``models.training.capture``."""
    pytest.importorskip("torch")
    from models.lightstage.split import HELD_OUT, TRAIN
    from models.training.capture import WHOLE

    folder = tmp_path_factory.mktemp("captures")
    rng = np.random.default_rng(0)
    for part, seed in ((TRAIN, 1), (HELD_OUT, 2)):
        width, height = WHOLE
        arrays: dict[str, np.ndarray] = {
            "whole_albedo": rng.integers(60, 200, (3, height, width), dtype=np.uint8),
            "whole_texture": rng.integers(60, 200, (2, 3, height, width), dtype=np.uint8),
            "whole_geometry": np.ones((len(GEOMETRY), height, width), np.float16),
            "whole_whites": np.zeros((2, 2, 3), np.float32),
            "patches": np.array(2),
        }
        for i in range(2):
            arrays |= {
                f"patch{i}_albedo": rng.integers(60, 200, (3, 512, 512), dtype=np.uint8),
                f"patch{i}_texture": rng.integers(60, 200, (3, 512, 512), dtype=np.uint8),
                f"patch{i}_specular": rng.integers(60, 200, (1, 512, 512), dtype=np.uint8),
                f"patch{i}_specular_normal": rng.integers(-9000, 9000, (2, 512, 512), dtype=np.int16),
                f"patch{i}_diffuse_normal": rng.integers(-9000, 9000, (2, 512, 512), dtype=np.int16),
                f"patch{i}_mask": np.full((1, 512, 512), 255, np.uint8),
                f"patch{i}_hair": np.zeros((1, 512, 512), np.uint8),
                f"patch{i}_geometry": rng.normal(size=(len(GEOMETRY), 66, 66)).astype(np.float16),
                f"patch{i}_window": np.array([1024, 512, 512, 512, 6144]),
            }
        (folder / part).mkdir()
        np.savez(folder / part / f"{seed}_neutral.npz", allow_pickle=False, **arrays)
    return folder
