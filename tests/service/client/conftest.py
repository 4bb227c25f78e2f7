from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from service.client.client import Client
from tests.service.client.fake import Fake


@pytest.fixture
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Pauses that the client made; they take no time."""
    pauses: list[float] = []
    clock = SimpleNamespace(sleep=pauses.append, monotonic=time.monotonic)
    monkeypatch.setattr("tenacity.nap.time", clock)
    monkeypatch.setattr("service.client.client.time", clock)
    return pauses


@pytest.fixture
def client(fake: Fake, slept: list[float]) -> Iterator[Client]:
    with Client(fake.url, api_key="secret", timeout_s=5) as made:
        yield made
