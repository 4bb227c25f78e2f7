"""What people wear and grow besides skin: meshes that follow the head, with their pictures.

``models/people/data/wardrobe.npz`` holds them; ``python -m models.people.tailor`` makes it from MakeHuman's assets
(CC0). Kinds: "hair", "brow", "lash", "teeth", "hat", "cloth", "torso", "hand", "iris".
"""

from __future__ import annotations

from pathlib import Path

from service.anatomy.items import Items, read_items

FILE = Path(__file__).resolve().parent / "data" / "wardrobe.npz"


def load_wardrobe(path: Path = FILE) -> Items:
    """Read the file.

    Raises:
        ModelFault: it is missing.
    """
    return read_items(path)
