"""The data files that an avatar was computed with, for the manifest."""

from __future__ import annotations

from pathlib import Path

from service.anatomy.hair.wearables import FILE as HAIR_FILE
from service.archive.avatar import ModelCard
from service.head.files import DEFAULT_HEAD
from service.head.model import HeadModel
from service.reflectance.albedo.albedo_prior import FILE as PRIOR_FILE
from service.runtime.sessions import model_table

ROLES = {
    "face_detector": "finds faces",
    "face_mesh": "468 landmarks",
    "reader": "place of the head, normal and part of every pixel",
    "lids": "edges of the lids",
    "lips": "edges of the lips",
    "face_landmarker": "478 points for the expression",
    "face_blendshapes": "expression scores",
    "person": "tells the person from the background",
    "face_identity": "compares the result with the photo",
}
"""Networks that run for every photo."""

REFLECTANCE_ROLES = {
    "zeta_body": "enlarges the texture",
    "zeta_tail": "enlarges the texture",
    "delta_context": "sees the light of the whole texture",
    "delta": "texture to diffuse albedo",
    "psi": "diffuse to specular albedo",
    "rho": "diffuse albedo to specular normals",
    "sigma": "diffuse albedo to diffuse normals",
}
"""Networks that run where their maps are requested."""


def model_cards(
    head: HeadModel, head_file: Path | None = None, networks: tuple[str, ...] = (), *, photo: bool = True
) -> tuple[ModelCard, ...]:
    """Cards of the head model and of the networks that ran.

    Args:
        head: the head model.
        head_file: where it was read from; None for the shipped one.
        networks: names of the reflectance networks that ran.
        photo: whether the networks of ``ROLES`` ran.

    Raises:
        ModelFault: the table of networks is broken.
    """
    from hashlib import sha256

    table = model_table()
    digest = sha256((head_file or DEFAULT_HEAD).read_bytes()).hexdigest()
    cards = [ModelCard(head.name, digest, head.licence, "head model")]
    if photo:
        digest = sha256(HAIR_FILE.read_bytes()).hexdigest()
        cards.append(ModelCard("makehuman-hair", digest, "CC0-1.0", "hair, lashes, brows and bust"))
    for name, role in ((ROLES if photo else {}) | {name: REFLECTANCE_ROLES[name] for name in networks}).items():
        if name in table:
            cards.append(ModelCard(name, table[name]["sha256"], table[name]["licence"], role))
    if "delta_context" in networks:
        digest = sha256(PRIOR_FILE.read_bytes()).hexdigest()
        cards.append(ModelCard("albedo-prior", digest, "Apache-2.0", "AvatarMe's texture prior: unseen albedo"))
    return tuple(cards)
