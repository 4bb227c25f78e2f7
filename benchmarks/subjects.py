"""Heads whose albedo is known, of three kinds: whom ``benchmarks.light_spread`` photographs in several lights.

- ``carried``: shapes that the head model has not seen, with the skin of FFHQ-UV in several tones.
- ``scan``: the head scan of Lee Perry-Smith with its own colours. These were photographed: some light is baked in, and
  his eyes are closed, so their whites of the eyes tell nothing.
- ``stage``: subjects of our own light stage that training never sees, in the program's own shape and chart.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.heads import IctHeads, Skin, TexturedHead
from benchmarks.shoot import FFHQ_EYES_M, ffhq_head, ict_colours, landmarks_on
from models.lightstage.references import linear, read
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

ICT_SEEDS = (100, 103)

SCAN_LIDS = np.array([[0.68, 1.74, 1.75], [-0.83, 1.74, 1.75]])
"""Middles of the scan's closed lids in its own unit, left first."""
PUPILS_M = 0.063
"""Distance that is taken for that of the scan's pupils, which do not show."""
BEHIND_LIDS_M = 0.014
"""Depth of the scan's eyeballs: well behind the lids, as no part of them may show."""

STAGE_SEEDS = (1071, 1027)
"""Of ``models.lightstage.split``'s held-out subjects: one of light skin, one of dark, neither in a corner."""
STAGE_CHART = (768, 512)
"""A texel of it is smaller on the face than a triangle of a :class:`TexturedHead`."""


def carried(data: Path, out: Path) -> list[TexturedHead]:
    """The head of FFHQ-UV, and heads of ICT-FaceKit with skins of other tones."""
    skin = Skin.load(data / "ffhq_uv_head")
    reference = ffhq_head(skin)
    ict = IctHeads(data / "ict_facekit_head.npz")
    cached = (out / "skin.npy").is_file()
    landmarks = np.zeros((0, 3)) if cached else landmarks_on(reference, out, "reference_skin")
    colours = ict_colours(ict, skin, landmarks, FFHQ_EYES_M.mean(0), out)
    return [reference, *(ict.textured(f"ict{seed}", seed, colours) for seed in ICT_SEEDS)]


def scan(data: Path, out: Path) -> list[TexturedHead]:
    """The head scan, brought to metres, centred between its eyes.

    Raises:
        UsageError: ``data`` has no ``lee_perry_smith/``.
    """
    import trimesh

    folder = data / "lee_perry_smith"
    image = read(folder / "color.jpg")
    mesh: Any = trimesh.load(folder / "head.glb", force="mesh", process=False)
    # The file counts v from the bottom, where glTF counts it from the top.
    uv = np.asarray(mesh.visual.uv, np.float64) * [1, -1] + [0, 1]
    skin = Skin(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64), uv, linear(image))
    metres = PUPILS_M / float(np.linalg.norm(SCAN_LIDS[0] - SCAN_LIDS[1]))
    eyes = metres * SCAN_LIDS - [0, 0, BEHIND_LIDS_M]
    vertices, triangles, colours = skin.dense(2)
    return [TexturedHead("scan", metres * vertices - eyes.mean(0), triangles, colours, eyes - eyes.mean(0), 0.0115)]


def stage(data: Path, out: Path) -> list[TexturedHead]:
    """Held-out subjects of the light stage at rest, without relief; kept beside their photos, as truth of these."""
    found = []
    for seed in STAGE_SEEDS:
        file = out / f"stage{seed}.npz"
        if not file.is_file():
            np.savez(file, **vars(stage_head(seed)))
        with np.load(file) as kept:
            fields = {name: kept[name] for name in kept.files}
        found.append(TexturedHead(**fields | {"name": str(fields["name"]), "eye_radius": float(fields["eye_radius"])}))
    return found


def stage_head(seed: int) -> TexturedHead:
    """A subject of the light stage; some ten seconds of a core."""
    from models.lightstage.skin.window import ChartWindow
    from models.lightstage.stage import Stage

    studio = Stage.open()
    person = studio.skin(seed)
    albedo = person.maps(ChartWindow.whole(*STAGE_CHART)).diffuse_albedo.permute(1, 2, 0).double().cpu().numpy()
    return staged(f"stage{seed}", studio.head, studio.vertices(person).astype(np.float64), albedo)


def staged(name: str, head: HeadModel, vertices: Float, albedo: Float) -> TexturedHead:
    """The skin of a head of ours (V, 3) in linear colours (h, w, 3) of its chart, and its eyes."""
    balls = []
    for part in ("eye_left", "eye_right"):
        own = vertices[np.unique(head.triangles[head.triangle_part == head.part_names.index(part)])]
        balls.append((own.min(0), own.max(0)))
    (low, high), chosen = np.swapaxes(balls, 0, 1), head.triangle_part == head.part_names.index("skin")
    eyes, radius = (low + high) / 2, float((high - low).max()) / 2
    # A vertex at which the chart is cut has a place on either side.
    corners = np.stack([head.triangles[chosen], head.triangle_uv[chosen]], -1).reshape(-1, 2)
    pairs, index = np.unique(corners, axis=0, return_inverse=True)
    skin = Skin(vertices[pairs[:, 0]], index.reshape(-1, 3), head.uv[pairs[:, 1]].astype(np.float64), albedo)
    fine, triangles, colours = skin.dense(2)
    return TexturedHead(name, fine - eyes.mean(0), triangles, colours, eyes - eyes.mean(0), radius)


KINDS: dict[str, Callable[[Path, Path], list[TexturedHead]]] = {"carried": carried, "scan": scan, "stage": stage}
"""Kinds of heads: (folder of reference heads, folder that keeps what was made) -> heads."""
