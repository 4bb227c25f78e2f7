"""The manifest holds what is promised, its schema is published, and it never holds NaN."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from service import manifest as schema
from service.archive.maps import MapFiles
from service.archive.pack import archive_members, describe
from service.errors import NumericFault
from service.manifest import json_schema, to_json
from tests.service.archive.toys import toy_avatar

SCHEMA = json_schema()
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def written() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(archive_members(toy_avatar())["manifest.json"])
    return content


def test_the_published_schema_is_current() -> None:
    assert schema.PUBLISHED.read_text("utf-8") == schema.schema_text(), "run python -m service.manifest"
    assert (ROOT / "docs" / "manifest.schema.json").samefile(schema.PUBLISHED), "one file, and a link to it"


def test_manifests_validate_against_the_published_schema(written: dict[str, Any]) -> None:
    published = json.loads((ROOT / "docs" / "manifest.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(published)
    jsonschema.validate(written, published)
    bare = toy_avatar(similarity=None)
    bare = replace(bare, fit=replace(bare.fit, light=None, inter_ocular_px=0.0))
    content = json.loads(archive_members(bare)["manifest.json"])
    jsonschema.validate(content, published)
    assert content["fit"]["landmark_rms_iod"] is None, "no division by an unknown distance"
    assert content["timings_s"] is content["peak_rss_mb"] is None, "they differ from run to run"


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("units",), "cm"), (("camera", "focal_px"), 0), (("camera", "rotation"), [[1, 0, 0]]), (("surprise",), 1),
        (("maps", 0, "sha256"), "short"), (("maps", 0, "bits"), 12), (("fit", "visible_fraction"), 1.5),
        (("schema_version",), "2.0"),
    ],
)  # fmt: skip
def test_the_schema_refuses_what_is_wrong(written: dict[str, Any], path: tuple[Any, ...], value: object) -> None:
    content = json.loads(json.dumps(written))
    at = content
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content, SCHEMA)


def test_a_number_that_is_not_finite_is_named() -> None:
    avatar = toy_avatar()
    broken = replace(avatar, fit=replace(avatar.fit, landmark_rms_px=float("nan")))
    manifest = describe(broken, {}, (), MapFiles(()))
    with pytest.raises(NumericFault, match=r"\$\.fit\.landmark_rms_px"):
        to_json(manifest)
