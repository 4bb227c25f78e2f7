"""Every warning has a code of one list and a sentence: on the page, at the command, over HTTP."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

import service.pipeline
from service.archive.avatar import Avatar
from service.jobs.stage_files import kept_types
from service.photo.container import Container
from service.words import WORDS, WarningCode

VIEWER = Path(service.pipeline.__file__).parent / "web" / "static" / "viewer.js"


def test_every_code_has_a_sentence_of_its_own() -> None:
    """The list is checked by types: a stage that issues another code does not pass mypy."""
    sentences = WORDS["warnings"]
    assert list(sentences) == list(get_args(WarningCode))
    assert len(set(sentences.values())) == len(sentences)
    assert all(words[0].isupper() and words.endswith(".") for words in sentences.values())


def test_nothing_that_carries_warnings_has_other_codes() -> None:
    carriers = {
        f"{kind.__name__}.{field.name}": get_type_hints(kind)[field.name]
        for kind in (*kept_types(service.pipeline).values(), Avatar)
        for field in fields(kind)
        if field.name in ("warnings", "doubts")
    }
    assert {"Photo.warnings", "Face.warnings", "Fit.warnings", "Texture.warnings", "WornHair.doubts"} <= set(carriers)
    carriers |= {"Container.warnings": get_type_hints(Container)["warnings"]}
    assert {name: kind for name, kind in carriers.items() if kind != tuple[WarningCode, ...]} == {}


def test_the_built_page_has_the_sentences() -> None:
    page = VIEWER.read_text("utf-8")
    assert [words for words in WORDS["warnings"].values() if words not in page.replace("\\'", "'")] == []
