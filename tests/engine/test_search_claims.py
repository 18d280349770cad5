"""What a search claims of its places: status, weights and covariance from its shares of belief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.filtering import Cloud, Estimate, Mode, whole
from app.engine.localization.integrity import IntegrityPolicy, confirmed, credible, search_fix
from app.engine.localization.search import Belief, Place
from app.engine.types import Fix, Status

POLICY = IntegrityPolicy()
HALL = Mode(50.0, 30.0, 800.0, 0.0, 300.0, 1.0)
"""About 100 m by 60 m."""


def belief(weight: float, *, start: Mode | None = HALL, sd: float = 1.0) -> Belief:
    """One place at (10, 10) with this share, the rest 60 m east of it; particles are where the shares say."""
    first = Mode(10.0, 10.0, sd**2, 0.0, sd**2, weight)
    other = Mode(70.0, 10.0, 1.0, 0.0, 1.0, 1.0 - weight)
    places = (Place("sim", first), Place("sim", other))
    x = weight * 10.0 + (1.0 - weight) * 70.0
    spread = weight * (1.0 - weight) * 60.0**2
    return Belief(places, Estimate(x, 10.0, spread + 1.0, 0.0, 1.0, 0.0, 1.0), 12.0, start)


def told(weight: float, walked_m: float = 30.0, **more: object) -> Fix:
    return search_fix(0.0, [belief(weight, **more)] * POLICY.found_steps, walked_m, POLICY, hypotheses=True)  # type: ignore[arg-type]


def test_a_share_earns_less_than_it_is() -> None:
    shares = np.array([0.05, 0.2, 0.5, 0.8, 0.95, 0.99])
    earned = np.array([credible(share, POLICY) for share in shares])
    assert (np.diff(earned) > 0).all()
    assert (earned <= shares).all()
    assert credible(1.0, POLICY) < 1.0
    assert credible(0.0, POLICY) == 0.0


def test_weights_leave_room_for_places_not_listed() -> None:
    fix = told(0.8)
    assert fix.status is Status.AMBIGUOUS
    assert [round(h.weight / fix.hypotheses[0].weight, 2) for h in fix.hypotheses] == [1.0, 0.25]
    assert fix.hypotheses[0].weight == pytest.approx(credible(0.8, POLICY))
    assert sum(h.weight for h in fix.hypotheses) < 0.7


def test_the_covariance_holds_the_rest_of_the_level() -> None:
    """A share of 95 % is right two times in three: the ellipse reaches to where the walk may have begun."""
    alone, heard = told(0.95), told(0.95, start=None)
    share = credible(0.95, POLICY)
    about_hall = HALL.cov_yy + (HALL.y - 10.0) ** 2
    assert alone.cov_yy == pytest.approx(POLICY.covariance_scale * (share + (1.0 - share) * about_hall) + 0.3, rel=1e-6)
    assert alone.cov_yy > 10.0 * heard.cov_yy


def test_with_other_evidence_shares_are_told_as_they_are() -> None:
    fix = told(0.95, start=None)
    assert fix.hypotheses[0].weight == pytest.approx(0.95)


def test_a_place_is_found_once_and_for_seven_steps() -> None:
    found = [belief(0.9999)] * POLICY.found_steps
    assert confirmed(found, 30.0, POLICY)
    assert not confirmed(found[1:], 30.0, POLICY)
    assert not confirmed([belief(0.99), *found[1:]], 30.0, POLICY)
    assert not confirmed(found, POLICY.found_m - 1.0, POLICY)
    fix = told(0.9999)
    assert fix.status is Status.OK
    assert not fix.sure  # that is for the steps that follow


@pytest.mark.parametrize(("walked_m", "enough"), [(26.0, 0.9992), (40.0, 0.9999), (60.0, 0.999995)])
def test_the_longer_the_search_the_more_it_takes(walked_m: float, enough: float) -> None:
    assert confirmed([belief(enough)] * 7, walked_m, POLICY)
    assert not confirmed([belief(1.0 - 3.0 * (1.0 - enough))] * 7, walked_m, POLICY)


def test_with_the_level_open_it_takes_more_and_nothing_is_sure_yet() -> None:
    open_level = [replace(belief(0.99999), level_open=True)] * POLICY.found_steps
    assert confirmed([belief(0.99999)] * POLICY.found_steps, 40.0, POLICY)
    assert not confirmed(open_level, 40.0, POLICY)
    assert confirmed(open_level, 26.0, POLICY)
    fix = search_fix(0.0, open_level, 26.0, POLICY)
    assert fix.status is Status.OK
    assert not fix.sure


def test_a_place_too_wide_is_none() -> None:
    assert not confirmed([belief(0.9999, sd=6.0)] * 7, 30.0, POLICY)


def test_all_particles_are_one_gathering() -> None:
    rng = np.random.default_rng(0)
    cloud = Cloud.empty(4000)
    cloud.p[0], cloud.p[1] = rng.normal(105.0, 2.0, 4000), rng.normal(-3.0, 1.0, 4000)
    m = whole(cloud)
    assert (m.x, m.y, m.weight) == pytest.approx((105.0, -3.0, 1.0), abs=0.1)
    assert (m.cov_xx, m.cov_xy, m.cov_yy) == pytest.approx((4.0, 0.0, 1.0), abs=0.2)
