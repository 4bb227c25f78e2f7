from __future__ import annotations

from collections.abc import Iterator

import pytest

from service.client.client import Client
from service.client.retry import Retry
from tests.service.client.archives import archive
from tests.service.client.fake import Fake, serving


@pytest.fixture
def fake() -> Iterator[Fake]:
    with serving(Fake(archive=archive())) as running:
        yield running


@pytest.fixture
def slept() -> list[float]:
    """Pauses that the client made; they take no time."""
    return []


@pytest.fixture
def client(fake: Fake, slept: list[float]) -> Iterator[Client]:
    with Client(fake.url, api_key="secret", retry=Retry(sleep=slept.append, draw=lambda: 0.5), timeout_s=5) as made:
        yield made
