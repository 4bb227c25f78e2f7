"""The OpenAPI document has what programs need that write clients."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import pytest

from service.api.server import create_app
from service.jobs.settings import Settings
from service.map_registry import MAP_NAMES
from service.options import Options

Json = dict[str, Any]


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> Json:
    """Made without a database or a server."""
    found: Json = create_app(Settings(data=tmp_path_factory.mktemp("none"))).openapi()
    return found


def operations(document: Json) -> Iterator[tuple[str, str, Json]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if isinstance(value.get("$ref"), str):
            yield value["$ref"]
        value = list(value.values())
    for item in value if isinstance(value, list) else ():
        yield from references(item)


def test_every_reference_leads_somewhere_and_every_schema_is_used(document: Json) -> None:
    prefix, schemas = "#/components/schemas/", document["components"]["schemas"]
    found = set(references(document))
    assert found == {prefix + name for name in schemas}, "a client would lack a type, or have one for nothing"


def test_every_answer_with_a_body_has_a_type(document: Json) -> None:
    for path, method, operation in operations(document):
        for status, answer in operation["responses"].items():
            content = answer.get("content", {})
            assert bool(content) == (status not in ("204", "304", "307")), (path, method, status)
            for kind, media in content.items():
                anything = kind == "application/json" and path.endswith("{path}")  # each file has a schema of its own
                assert media["schema"] or anything, f"{method} {path}: {kind} of {status} may be anything"
        assert {"4XX", "5XX"} <= set(operation["responses"])


@pytest.mark.parametrize(
    ("path", "method", "kind"),
    [
        ("/v1/avatars/{job}/archive.zip", "get", "application/zip"),
        ("/v1/avatars/{job}/files/{path}", "get", "model/gltf-binary"),
        ("/v1/avatars/{job}/files/{path}", "get", "application/octet-stream"),
        ("/v1/renders", "post", "image/png"),
    ],
)
def test_files_are_bytes(document: Json, path: str, method: str, kind: str) -> None:
    """Without the format a client reads them as text and breaks them."""
    answers = document["paths"][path][method]["responses"]
    for status in {"200", "206"} & set(answers):
        assert answers[status]["content"][kind]["schema"] == {"type": "string", "format": "binary"}


def test_every_option_says_what_it_means(document: Json) -> None:
    options = document["components"]["schemas"]["Options"]
    assert options["additionalProperties"] is False
    for field in fields(Options):
        words = options["properties"][field.name]["description"]
        assert len(words) > 10, field.name
        assert "``" not in words
        assert "service." not in words
    assert set(options["properties"]) == {field.name for field in fields(Options)}
    assert options["properties"]["maps"]["items"]["enum"] == list(MAP_NAMES)
