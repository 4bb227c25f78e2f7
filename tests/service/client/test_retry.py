from __future__ import annotations

from datetime import UTC, datetime

import pytest

from service.client.retry import Retry, retry_after_s
from service.errors import UsageError

NOON = datetime(2026, 1, 2, 12, tzinfo=UTC)


def pauses(retry: Retry, slept: list[float], asked: float | None = None) -> list[float]:
    running = retry.start()
    while running.pause(asked):
        pass
    return slept


def test_the_bound_doubles_up_to_the_longest() -> None:
    slept: list[float] = []
    retry = Retry(attempts=8, first_s=1, longest_s=5, sleep=slept.append, draw=lambda: 1.0)
    assert pauses(retry, slept) == [1, 2, 4, 5, 5, 5, 5]


def test_the_jitter_is_full() -> None:
    """Clients that failed together must not come back together."""
    slept: list[float] = []
    draws = iter([0.0, 0.25, 1.0])
    retry = Retry(attempts=4, first_s=1, longest_s=5, sleep=slept.append, draw=lambda: next(draws))
    assert pauses(retry, slept) == [0, 0.5, 4]


def test_the_server_is_never_asked_sooner_than_it_wants() -> None:
    slept: list[float] = []
    draws = iter([0.0, 0.5, 1.0])
    retry = Retry(attempts=4, first_s=0.5, sleep=slept.append, draw=lambda: next(draws))
    assert all(10 <= seconds <= 11.5 for seconds in pauses(retry, slept, asked=10))
    assert len(set(slept)) == 3, "without jitter on top all clients that were told 10 come back at 10"


def test_who_asks_for_more_than_our_patience_is_given_up_at_once() -> None:
    slept: list[float] = []
    assert pauses(Retry(patience_s=60, sleep=slept.append), slept, asked=61) == []


def test_pauses_add_up_to_no_more_than_the_patience() -> None:
    slept: list[float] = []
    retry = Retry(attempts=1000, first_s=1, longest_s=10, patience_s=60, sleep=slept.append, draw=lambda: 1.0)
    assert 50 < sum(pauses(retry, slept)) <= 60


def test_one_attempt_means_no_pause() -> None:
    slept: list[float] = []
    assert pauses(Retry(attempts=1, sleep=slept.append), slept) == []


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        (None, None),
        ("0", 0.0),
        (" 7 ", 7.0),
        ("Fri, 02 Jan 2026 12:00:30 GMT", 30.0),
        ("Fri, 02 Jan 2026 12:00:30 -0000", 30.0),
        ("Fri, 02 Jan 2026 11:00:00 GMT", 0.0),  # past: now, not minus an hour
        ("-5", None),
        ("soon", None),
        ("", None),
        ("1.5", None),
        ("9" * 400, None),  # would overflow a float, and sleep for ever
        ("٣", None),  # a digit to str.isdigit, not to HTTP
    ],
)
def test_retry_after(value: str | None, seconds: float | None) -> None:
    assert retry_after_s(value, NOON) == seconds


@pytest.mark.parametrize(
    "values", [{"attempts": 0}, {"first_s": -1}, {"longest_s": float("nan")}, {"patience_s": float("inf")}]
)
def test_impossible_policies_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(values))):
        Retry(**values)  # type: ignore[arg-type]
