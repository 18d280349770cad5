"""Answers that are remembered."""

from __future__ import annotations

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor

from app.engine.localization.memo import Memo


class Thing:
    """Something that answers are about."""


def test_an_answer_is_worked_out_once() -> None:
    memo, thing, asked = Memo[Thing, int, int](4), Thing(), []
    for _ in range(3):
        assert memo.get(thing, 7, lambda: asked.append(1) or 49) == 49
    assert len(asked) == 1


def test_things_do_not_share_answers() -> None:
    memo, one, other = Memo[Thing, int, str](4), Thing(), Thing()
    assert memo.get(one, 7, lambda: "one") == "one"
    assert memo.get(other, 7, lambda: "other") == "other"


def test_what_was_not_asked_for_the_longest_is_forgotten() -> None:
    memo, thing = Memo[Thing, int, int](2), Thing()
    for key in (1, 2, 1, 3):
        memo.get(thing, key, lambda key=key: key)
    assert memo.get(thing, 1, lambda: -1) == 1
    assert memo.get(thing, 2, lambda: -2) == -2


def test_a_thing_that_goes_takes_its_answers_along() -> None:
    memo, thing = Memo[Thing, int, Thing](2), Thing()
    gone = weakref.ref(memo.get(thing, 1, Thing))
    assert gone() is not None
    del thing
    gc.collect()
    assert gone() is None


def test_threads_may_share_it() -> None:
    memo, thing = Memo[Thing, int, int](8), Thing()
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda k: memo.get(thing, k % 20, lambda: k % 20), range(5000)))
    assert answers == [k % 20 for k in range(5000)]
