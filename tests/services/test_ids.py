"""Ids sort by age, whatever the clock does."""

from __future__ import annotations

import re
import threading
from datetime import timedelta

from hypothesis import given
from hypothesis import strategies as st

from app.services.ids import IdFactory, seed_of
from tests.support.builders import START


def test_an_id_names_its_kind_and_millisecond() -> None:
    id_ = IdFactory()("ven", START)
    assert re.fullmatch(r"ven_[0-9a-f]{26}", id_)
    assert int(id_[4:16], 16) == int(START.timestamp() * 1000)


@given(st.lists(st.integers(-5, 5), min_size=2, max_size=50))
def test_ids_never_go_backwards(steps_ms: list[int]) -> None:
    make, now, made = IdFactory(), START, []
    for step in steps_ms:
        now += timedelta(milliseconds=step)
        made.append(make("x", now))
    assert made == sorted(set(made))


def test_two_processes_do_not_make_the_same_id() -> None:
    assert IdFactory()("x", START) != IdFactory()("x", START)


def test_threads_get_different_ids() -> None:
    make = IdFactory()
    made: list[str] = []

    def work() -> None:
        made.extend([make("x", START) for _ in range(200)])

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert len(set(made)) == 800


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_seeds_depend_on_the_name_only(name: str) -> None:
    assert seed_of(name) == seed_of(name)
    assert 0 <= seed_of(name) < 2**63
    assert seed_of(name) != seed_of(name + "x")
