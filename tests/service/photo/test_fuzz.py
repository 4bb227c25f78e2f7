"""Damaged files end as a photo or as a refusal, never in another way (the command is benchmarks/gate_fuzz.py)."""

from __future__ import annotations

import pytest

from benchmarks.gate_fuzz import decode_here, decode_in_child, run, seeds


def faults(outcomes: dict[str, int]) -> list[str]:
    return [outcome for outcome in outcomes if outcome.startswith("FAULT")]


def test_seeds_are_sound() -> None:
    for data in seeds():
        assert decode_here(data) == "photo"


def test_damaged_files() -> None:
    outcomes = run(700, 1, decode_here)
    assert not faults(outcomes)
    assert outcomes["photo"] > 20, "damage that never leaves a photo would not reach the decoder's end"
    assert outcomes["refused: corrupt-image"] > 200


def test_damaged_files_through_the_whole_gate() -> None:
    assert not faults(run(26, 2, decode_in_child))


@pytest.mark.slow
def test_ten_thousand_damaged_files() -> None:
    assert not faults(run(10_000, 3, decode_here))


@pytest.mark.slow
def test_a_thousand_damaged_files_through_the_whole_gate() -> None:
    assert not faults(run(1000, 4, decode_in_child))
