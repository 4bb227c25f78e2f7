"""Accessors, buffer views and the GLB container (glTF 2.0, sections 3.6 and 4).

Covers what a head with morph targets needs. Arrays of a kind share one buffer view, which keeps the JSON small.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32

Object = dict[str, Any]

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_BUFFER = 34962, 34963


@dataclass
class GltfWriter:
    """Collects the binary part of a glTF file and the accessors into it."""

    accessors: list[Object] = field(default_factory=list)
    chunks: dict[str, list[bytes]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    views: list[str] = field(default_factory=list)
    zeros: dict[tuple[int, bool], int] = field(default_factory=dict)

    def add_raw(self, data: bytes) -> int:
        """A separate buffer view for bytes without an accessor."""
        view, _ = self._append(f"raw{len(self.views)}", data)
        return view

    def add_vertices(self, rows: AnyFloat, *, bounds: bool = False) -> int:
        """Accessor of (N, 2), (N, 3) or (N, 4) float32 vertex data."""
        data = np.ascontiguousarray(rows, "<f4")
        view, offset = self._append(f"vec{data.shape[1]}", data.tobytes())
        return self._accessor(data, bounds, {"bufferView": view, "byteOffset": offset})

    def add_indices(self, triangles: AnyInt, vertex_count: int) -> int:
        """Accessor of triangle corners, 16-bit where possible (index 65535 would restart the primitive)."""
        wide = vertex_count > 0xFFFF
        data = np.ascontiguousarray(triangles.ravel(), "<u4" if wide else "<u2")
        view, offset = self._append("indices32" if wide else "indices16", data.tobytes())
        kind = _UINT32 if wide else _UINT16
        accessor = {"bufferView": view, "byteOffset": offset, "componentType": kind, "count": len(data)}
        self.accessors.append({**accessor, "type": "SCALAR"})
        return len(self.accessors) - 1

    def add_offsets(self, rows: Float32, *, bounds: bool = False) -> int:
        """Accessor of (N, 3) morph offsets: without data if all are zero, sparse where that is smaller."""
        moved = np.flatnonzero(rows.any(1))
        if not len(moved):
            return self._zeros(len(rows), bounds)
        wide = len(rows) > 0xFFFF
        if len(moved) * (12 + (4 if wide else 2)) >= len(rows) * 12:
            return self.add_vertices(rows, bounds=bounds)
        values = np.ascontiguousarray(rows[moved], "<f4")
        value_view, value_offset = self._append("sparse_values", values.tobytes())
        kind, code = (_UINT32, "<u4") if wide else (_UINT16, "<u2")
        index_view, index_offset = self._append(f"sparse_indices{code}", moved.astype(code).tobytes())
        sparse = {
            "count": len(moved),
            "indices": {"bufferView": index_view, "byteOffset": index_offset, "componentType": kind},
            "values": {"bufferView": value_view, "byteOffset": value_offset},
        }
        return self._accessor(rows, bounds, {"sparse": sparse})

    def finish(self, document: Object) -> bytes:
        """The GLB: header, JSON chunk padded with spaces, binary chunk padded with zeros."""
        offset, views = 0, []
        for name in self.views:
            view: Object = {"buffer": 0, "byteOffset": offset, "byteLength": self.sizes[name]}
            views.append(view | _view_facts(name))
            offset += self.sizes[name] + -self.sizes[name] % 4
        content = document | {
            "accessors": self.accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": offset}],
        }
        text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        padded = ((*self.chunks[name], b"\0" * (-self.sizes[name] % 4)) for name in self.views)
        binary = b"".join(chunk for chunks in padded for chunk in chunks)
        total = 12 + 8 + len(text) + 8 + len(binary)
        head = struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON")
        return b"".join((head, text, struct.pack("<I4s", len(binary), b"BIN\0"), binary))

    def _zeros(self, count: int, bounds: bool) -> int:
        key = (count, bounds)
        if key not in self.zeros:
            self.zeros[key] = self._accessor(np.zeros((count, 3), np.float32), bounds, {})
        return self.zeros[key]

    def _accessor(self, rows: AnyFloat, bounds: bool, source: Object) -> int:
        facts: Object = {"componentType": _FLOAT, "count": len(rows), "type": f"VEC{rows.shape[1]}"}
        if bounds:
            facts |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(source | facts)
        return len(self.accessors) - 1

    def _append(self, view: str, data: bytes) -> tuple[int, int]:
        """Index of the view and the offset of ``data`` in it, both multiples of four bytes."""
        if view not in self.chunks:
            self.views.append(view)
            self.chunks[view], self.sizes[view] = [], 0
        padding = b"\0" * (-self.sizes[view] % 4)
        offset = self.sizes[view] + len(padding)
        self.chunks[view] += [padding, data]
        self.sizes[view] = offset + len(data)
        return self.views.index(view), offset


def _view_facts(name: str) -> Object:
    """Shared vertex data needs target and stride, indices a target; sparse data and images must have neither."""
    if name.startswith("vec"):
        return {"target": _ARRAY_BUFFER, "byteStride": 4 * int(name[3:])}
    return {"target": _ELEMENT_BUFFER} if name.startswith("indices") else {}
