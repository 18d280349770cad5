"""Annotations as waypoints: coordinates as users write them, and markers."""

from __future__ import annotations

import pytest

from app.exchange.phones import Annotation, FormatError
from app.exchange.phones.places import marker_key, position_of, read_markers, waypoints_of

MARKERS = {marker_key("Door 3"): (1.0, 2.0), marker_key("12,5"): (7.0, 8.0)}


@pytest.mark.parametrize(
    "text",
    ["12.5,40", " 12.5, 40 ", "12.5 40", "12.5;40", "12.5/40.0", "12,5 40", "12,5; 40,0", "(12.5, 40)", "x=12.5 y=40",
     "X: 12.5, Y: 40", "12.5 m 40m", "+12.5,40."],
)  # fmt: skip
def test_coordinates_in_many_spellings(text: str) -> None:
    assert position_of(text, {}) == (12.5, 40.0)


@pytest.mark.parametrize(
    "text",
    [
        "12.540",
        "door 3",
        "1,2,3",
        "1 2 3",
        "nan,nan",
        "inf 3",
        "1e3,2",
        "99999999,1",
        "",
        ",",
        "x=1",
        "1_0,2",
        "\u0661,2",
    ],
)
def test_what_names_no_place(text: str) -> None:
    assert position_of(text, {}) is None


def test_markers_come_before_coordinates() -> None:
    assert position_of("  door   3 ", MARKERS) == (1.0, 2.0)
    assert position_of("12,5", MARKERS) == (7.0, 8.0)
    assert position_of("12,6", MARKERS) == (12.0, 6.0)


def test_waypoints_and_the_rest() -> None:
    notes = [Annotation(10**18 + k * 10**9, text) for k, text in enumerate(["door 3", "coffee", "3,4", "5,6"])]
    points, others = waypoints_of([*notes, Annotation(10**18 + 3 * 10**9, "9,9")], MARKERS)
    assert points.t.tolist() == [1e9, 1e9 + 2, 1e9 + 3]
    assert (points.x.tolist(), points.y.tolist()) == ([1.0, 3.0, 5.0], [2.0, 4.0, 6.0])
    assert others == ("coffee",)


def test_a_table_of_markers() -> None:
    found = read_markers("\ufeffNAME;X;Y;note\nDoor 3;1;2;ok\n\n Stairs ;-3.5;4\ndoor 3;1.0;2\n".encode())
    assert found == {"door 3": (1.0, 2.0), "stairs": (-3.5, 4.0)}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "lacks name, x, y"),
        (b"name,x\na,1\n", "lacks y"),
        (b"name,x,y\na,1,north\n", "line 2: y: is 'north'"),
        (b"name,x,y\na,,2\n", "line 2: x"),
        (b"name,x,y\na,1,2\n,3,4\n", "line 3: lacks name"),
        (b"name,x,y\na,1,2\nA,1,3\n", "line 3: names 'A' once more"),
    ],
)
def test_what_is_wrong_with_markers_is_said(content: bytes, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        read_markers(content)
