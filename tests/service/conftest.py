from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.service.client.fake import Fake, serving
from tests.support.archives import archive


@pytest.fixture
def fake() -> Iterator[Fake]:
    """A small server of the HTTP contract that can be told to misbehave."""
    with serving(Fake(archive=archive())) as running:
        yield running
