"""A queue of pictures that are made from those before them."""

from __future__ import annotations

from tunenet_logs.recorders.session import TopicQueue


def filled(queue: TopicQueue[int]) -> list[bool]:
    """Ten of 30 bytes; every fourth stands alone."""
    return [
        queue.put("/a", number, number, 30, stands_alone=number % 4 == 0) for number in range(10)
    ]


def test_after_a_drop_what_is_made_from_it_is_dropped_too():
    queue: TopicQueue[int] = TopicQueue(60, drops=True)
    assert all(filled(queue))
    assert (queue.captured, queue.dropped) == (10, 8)
    kept = [item.payload for item in iter(queue.take, None)]
    assert kept == [0, 1]
    queue.put("/a", 11, 11, 30, stands_alone=False)
    queue.put("/a", 12, 12, 30)
    queue.put("/a", 13, 13, 30, stands_alone=False)
    items = list(iter(queue.take, None))
    assert [(item.payload, item.follows_drop) for item in items] == [(12, True), (13, False)]


def test_a_cut_forgets_what_waits_and_what_was_taken_beyond_the_end():
    queue: TopicQueue[int] = TopicQueue(1000, drops=True)
    filled(queue)
    for _ in range(3):
        queue.take()
    queue.cut("/a", 1)
    assert (queue.captured, queue.dropped) == (2, 0)
    assert queue.is_done
    assert not queue.put("/a", 10, 10, 1)


def test_receipts_never_run_backwards():
    queue: TopicQueue[int] = TopicQueue(1000, drops=True)
    for number, received_ns in enumerate((5, 3, 9)):
        queue.put("/a", number, number, 1, received_ns)
    assert [item.received_ns for item in iter(queue.take, None)] == [5, 5, 9]
