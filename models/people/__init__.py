"""Synthetic people: portraits of our head by seed, each with its truth per pixel (``docs/synthetic-people.md``)."""

from __future__ import annotations

from models.people.make import Portrait, portrait

__all__ = ["Portrait", "portrait"]
