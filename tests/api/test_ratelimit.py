from __future__ import annotations

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from app.api.ratelimit import RateLimiter
from tests.api.harness import Api


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def allowed(limiter: RateLimiter, name: str = "a") -> bool:
    quota = limiter.take(name)
    assert quota is not None
    return quota.allowed


@given(per_minute=st.integers(1, 10_000), burst=st.integers(1, 300))
def test_a_burst_and_no_more(per_minute: int, burst: int) -> None:
    limiter = RateLimiter(per_minute, burst, Clock())
    taken = [allowed(limiter) for _ in range(burst + 3)]
    assert taken == [True] * burst + [False] * 3
    assert allowed(limiter, "b")


@given(
    per_minute=st.integers(6, 600),
    burst=st.integers(1, 20),
    pauses=st.lists(st.floats(0.0, 5.0), min_size=1, max_size=60),
)
def test_never_more_than_burst_and_rate(per_minute: int, burst: int, pauses: list[float]) -> None:
    """In any window: at most the burst, and the rate times the window."""
    clock = Clock()
    limiter = RateLimiter(per_minute, burst, clock)
    times = []
    for pause in pauses:
        clock.now += pause
        if allowed(limiter):
            times.append(clock.now)
    for i, start in enumerate(times):
        for j in range(i, len(times)):
            assert j - i + 1 <= burst + (times[j] - start) * per_minute / 60 + 1e-6


@given(per_minute=st.integers(1, 600), burst=st.integers(1, 20))
def test_retry_after_is_long_enough_and_refusals_are_free(per_minute: int, burst: int) -> None:
    clock = Clock()
    limiter = RateLimiter(per_minute, burst, clock)
    for _ in range(burst):
        assert allowed(limiter)
    refused = limiter.take("a")
    for _ in range(50):
        assert not allowed(limiter)
    assert refused is not None
    assert refused.retry_after_s >= 1
    clock.now += refused.retry_after_s
    assert allowed(limiter)


def test_remaining_counts_down_and_recovers() -> None:
    clock = Clock()
    limiter = RateLimiter(60, 5, clock)
    assert [quota.remaining for _ in range(5) if (quota := limiter.take("a"))] == [4, 3, 2, 1, 0]
    clock.now += 5.0
    quota = limiter.take("a")
    assert quota is not None
    assert (quota.remaining, quota.reset_s) == (4, 1)


def test_no_limit() -> None:
    assert RateLimiter(0, 1).take("a") is None


def test_idle_names_are_forgotten() -> None:
    clock = Clock()
    limiter = RateLimiter(6000, 2, clock)
    for i in range(10_001):
        clock.now += 1.0
        limiter.take(str(i))
    assert len(limiter._arrival) < 100


def test_headers_and_refusal(make_api: Callable[..., Api]) -> None:
    api = make_api(rate_limit_per_minute=1, rate_limit_burst=2)
    first = api.get("/v1/venues")
    assert first.headers["RateLimit-Policy"] == '"key";q=1;w=60'
    assert first.headers["RateLimit"] == '"key";r=1;t=60'
    api.get("/v1/venues/ven_none")
    refused = api.get("/v1/venues")
    assert refused.status_code == 429
    assert refused.json()["type"].endswith("/rate-limited")
    assert 1 <= int(refused.headers["Retry-After"]) <= 60
    assert refused.headers["RateLimit"].startswith('"key";r=0;')
    assert api.get("/healthz", key=None).status_code == 200


def test_keys_have_limits_of_their_own(make_api: Callable[..., Api]) -> None:
    api = make_api(rate_limit_per_minute=1, rate_limit_burst=1)
    secrets = [api.services.accounts.create_key("k", {"locate"})[1] for _ in range(2)]  # type: ignore[arg-type]
    assert [api.get("/v1/venues", key=secret).status_code for secret in (*secrets, *secrets)] == [200, 200, 429, 429]
