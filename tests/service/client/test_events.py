from __future__ import annotations

import itertools
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.client.errors import UnexpectedAnswer
from service.client.events import Event, EventParser

STREAM = (
    b"\xef\xbb\xbf: hello\n\n"
    b'retry: 1500\nid: 1\nevent: progress\ndata: {"stage": "fit",\ndata: "progress": 0.5}\n\n'
    b'id: 2\r\nevent: state\r\ndata:{"state":"succeeded"}\r\n\r\n'
    b"event: state\rdata: [1]\r\r"
    b"data\ndata: \n\n"
    b'event: state\ndata: {"cut": 1}\n'
)
EVENTS = [
    Event("progress", {"stage": "fit", "progress": 0.5}, "1"),
    Event("state", {"state": "succeeded"}, "2"),
    Event("state", {}, "2"),
    Event("message", {}, "2"),
]


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_events_do_not_depend_on_where_the_network_cuts(size: int) -> None:
    chunks = [STREAM[start : start + size] for start in range(0, len(STREAM), size)]
    parser = EventParser()
    assert list(parser.feed(chunks)) == EVENTS
    assert parser.reconnect_s == 1.5
    assert parser.last_id == "2"


@given(
    st.lists(st.tuples(st.dictionaries(st.text(), st.text(), max_size=3), st.integers(0, 99)), max_size=5),
    st.sampled_from(["\n", "\r", "\r\n"]),
    st.lists(st.integers(0, 400), max_size=6),
)
def test_every_json_object_comes_through(events: list[tuple[dict[str, str], int]], end: str, cuts: list[int]) -> None:
    """Line separators of Unicode inside JSON are text here; httpx and str.splitlines would cut the event there."""
    lines = [
        f"id: {number}{end}data: {json.dumps(data, ensure_ascii=False)}{end}{end}".encode("utf-8", "replace")
        for data, number in events
        if all(ord(letter) not in range(0xD800, 0xE000) for letter in "".join(itertools.chain(*data.items())))
    ]
    stream = b"".join(lines)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    parsed = list(EventParser().feed(stream[start:stop] for start, stop in itertools.pairwise(edges)))
    assert [event.id for event in parsed] == [line.split(b"data")[0].decode().strip()[4:] for line in lines]
    assert all(f"{end}data: {json.dumps(event.data, ensure_ascii=False)}".encode() in stream for event in parsed)


def test_an_id_with_a_nul_is_ignored_and_an_empty_one_resets() -> None:
    parser = EventParser("7")
    list(parser.feed([b"id: 1\0\ndata: {}\n\n"]))
    assert parser.last_id == "7"
    list(parser.feed([b"id\ndata: {}\n\n"]))
    assert parser.last_id == ""


@pytest.mark.parametrize("data", [b"not json", b"[" * 5000, b'"text"', b"NaN"])
def test_data_that_is_no_object_does_no_harm(data: bytes) -> None:
    assert [event.data for event in EventParser().feed([b"data: " + data + b"\n\n"])] == [{}]


@pytest.mark.parametrize("chunk", [b"x" * (1 << 16), b"data: " + b"x" * (1 << 15) + b"\n"])
def test_a_stream_without_end_does_not_fill_the_memory(chunk: bytes) -> None:
    with pytest.raises(UnexpectedAnswer, match="event"):
        list(EventParser().feed(itertools.repeat(chunk, 100)))
