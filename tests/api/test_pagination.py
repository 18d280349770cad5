"""Pages put together are the list, for every list."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.api.harness import Api, plain, segment_body, walk_body


def venues(api: Api) -> str:
    for i in range(5):
        api.ok("POST", "/v1/venues", json={"name": f"v{i}"})
    return "/v1/venues"


def levels(api: Api) -> str:
    for _ in range(5):
        api.level()
    return "/v1/levels"


def devices(api: Api) -> str:
    for i in range(5):
        api.ok("POST", "/v1/devices", json={"name": f"d{i}"})
    return "/v1/devices"


def surveys(api: Api) -> str:
    for _ in range(5):
        api.surveyed_level()
    return "/v1/surveys"


def walks(api: Api) -> str:
    survey_id = api.ok("POST", "/v1/surveys", json={"level_id": api.level().id, "name": "s"})["id"]
    for i in range(5):
        api.ok("POST", f"/v1/surveys/{survey_id}/walks", json=plain(walk_body(n=20, seed=i)))
    return f"/v1/surveys/{survey_id}/walks"


def maps(api: Api) -> str:
    level = api.surveyed_level()
    for _ in range(3):
        api.ok("POST", "/v1/maps", json={"level_id": level.id})
    return f"/v1/maps?level_id={level.id}"


def sessions(api: Api) -> str:
    level = api.mapped_level()
    for _ in range(5):
        api.ok("POST", "/v1/sessions", json={"level_id": level.id})
    return f"/v1/sessions?level_id={level.id}&status=open"


def segments(api: Api) -> str:
    path = f"/v1/sessions/{api.session_id()}/segments"
    for seq in range(5):
        api.ok("POST", path, json=plain(segment_body(seq, n=20)))
    return path


def jobs(api: Api) -> str:
    segments(api)
    return "/v1/jobs?kind=locate_segment&state=done"


def keys(api: Api) -> str:
    return "/v1/keys"


LISTS = [venues, levels, devices, surveys, walks, maps, sessions, segments, jobs, keys]


@pytest.mark.parametrize("fill", LISTS)
def test_pages_make_the_list(api: Api, fill: Callable[[Api], str]) -> None:
    path = fill(api)
    joint = "&" if "?" in path else "?"
    whole = api.ok("GET", f"{path}{joint}limit=500")
    assert whole["next_cursor"] is None
    assert len(whole["items"]) >= 3
    following: str | None = f"{path}{joint}limit=2"
    pages: list[list[Any]] = []
    while following is not None:
        response = api.get(following)
        page = response.json()
        pages.append(page["items"])
        link = response.headers.get("Link")
        assert (link is None) == (page["next_cursor"] is None)
        following = link and link.removesuffix('; rel="next"').strip("<>")
        assert following is None or following.count("cursor=") == 1
    assert [item for page in pages for item in page] == whole["items"]
    assert all(len(page) == 2 for page in pages[:-1])


@pytest.mark.parametrize("query", ["limit=0", "limit=501", "limit=x", "cursor=", "cursor=%40", "cursor=" + "a" * 65])
def test_page_parameters_are_checked(api: Api, query: str) -> None:
    response = api.get(f"/v1/venues?{query}")
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert error["field"] == query.partition("=")[0]
    assert error["remedy"]


def test_a_cursor_of_another_list_gives_an_empty_or_refused_page(api: Api) -> None:
    path = segments(api)
    assert api.get(f"{path}?cursor=ven_0").status_code == 422
