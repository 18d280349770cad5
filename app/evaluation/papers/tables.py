"""Tables of the papers' protocols: our figures, the papers' own below them, and what may be compared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.evaluation.papers import published
from app.evaluation.papers.figures import Figures
from app.evaluation.papers.s1 import METHODS
from app.evaluation.papers.s4 import FAILED_M
from app.evaluation.tables import layout, length_cell, percent_cell

Row = tuple[str, ...]


def s4_table(regions: Mapping[str, Mapping[str, Figures]], about: Mapping[str, Figures]) -> list[str]:
    """Regions and methods."""
    rows: list[Row] = [_S4_HEADER]
    for name, methods in regions.items():
        indicated = about[name]["indicated"]
        rows.append((name, "no match", str(indicated["tracks"]), *_metres(indicated, "north", "east"), *[""] * 8))
        for method, f in methods.items():
            lengths = _metres(f, "north", "east", "p50", "north_held", "east_held")
            shares = _shares(f, "failure_rate", "not_ok_rate", "ok_failure_rate", "ellipse95")
            rows.append((name, method, str(f["tracks"]), *lengths, *shares, length_cell(f["ms"])))
        for method, p in published.S4.get(name, {}).items():
            rows.append((name, f"paper: {method}", "", *_metres(p, "north", "east"), *[""] * 7, f"{p['ms']:.0f}"))
    where = [_where(name, a) for name, a in about.items()]
    title = "s4: contour matching over an area (Cheng, Zhou 2026), errors of the track's end in metres"
    return [title, *layout(rows, left=2), *where, *_S4_LEGEND]


def _where(name: str, about: Figures) -> str:
    lines = about["left_out_lines"]
    kind = f"{lines} left-out lines" if lines else "the map is the field"
    field = f"gradient {about['gradient_nt_km']} nT/km, map sd {about['map_sd_nt']} nT"
    return f"{name}: {about['survey']}, {field}, {kind}"


_S4_HEADER = (
    "region", "method", "tracks", "north", "east", "p50", "north*", "east*", "failed", "not ok", "ok failed", "in 95 %",
    "ms",
)  # fmt: skip
_S4_LEGEND = (
    "north, east: mean absolute error over the tracks that got a place; *: over those that did not fail",
    f"failed: no place, or off by more than {FAILED_M:.0f} m; not ok: status other than ok; ok failed: of the ok ones",
    "in 95 %: ends inside the ellipse of the likeliest place, of the ok ones (ok says that there is one place, its",
    "ellipse how well it is known); ms: processor time of a match, median",
    "comparable with the paper, as orders of size: marine and land (same sensors, noise, cell and uncertainty; another",
    "field, and tracks of a length and speed that the paper does not give)",
    "not comparable: times (another machine and language); *_lines: there the map errs, in the paper it does not",
)


def s1_table(sets: Mapping[str, Mapping[str, Figures]]) -> list[str]:
    """Data sets, windows and methods."""
    rows: list[Row] = [_S1_HEADER]
    for name, windows in sets.items():
        for window, methods in windows.items():
            for method in (method for method in METHODS if method in methods):
                f = methods[method]
                shares = _shares(f, "within_1m", "within_2m", "within_3m", "within_4m", "ok_rate")
                ratio = _ratio(f["ms"], methods.get("dtw", {}).get("ms"))
                lengths = (length_cell(f["mean"]), length_cell(f["p50"]))
                way = f"{methods['window_m']:.1f} m"
                rows.append(
                    (name, method, window, way, str(f["fixes"]), *lengths, *shares, length_cell(f["ms"]), ratio)
                )
    for count in published.S1_MEAN:
        rows += [_paper_row(count, method) for method in METHODS]
    title = "s1: windows slid along a stored sequence (Zhang 2021), errors of the window's end in metres"
    return [title, *layout(rows, left=2), *_S1_LEGEND]


def _paper_row(count: int, method: str) -> Row:
    seconds = published.S1_SECONDS[count]
    mean = published.S1_MEAN[count].get(method) or (published.S1_IMPROVED_60.get(method) if count == 60 else None)
    within = percent_cell(published.S1_WITHIN_4_M.get(method)) if count == 60 else "-"
    times = (f"{1000 * seconds[method]:.0f}", _ratio(seconds[method], seconds["dtw"]))
    return ("paper", method, str(count), "", "", length_cell(mean), "", "", "", "", within, "", *times)


_S1_HEADER = (
    "set", "method", "readings", "way", "fixes", "mean", "p50", "<1 m", "<2 m", "<3 m", "<4 m", "ok", "ms", "to dtw"
)  # fmt: skip
_S1_LEGEND = (
    "shares are of all windows (no place counts as farther); ok: status ok; ms: processor time of a fix, median",
    "to dtw: that time over dtw's; paper: improved_dtw's mean and <4 m are of its chapter 3, where dtw has 1.85 m",
    "comparable with the paper: the order of methods and windows, best on the cart (its sensors, rate, noise and way;",
    "its field is ours, such that dtw errs about as there); not comparable: absolute times, and errors on walks, whose",
    "ways are longer and whose stored sequence is a map made of other walks",
)


def voting_table(places: Mapping[str, Figures]) -> list[str]:
    """Part 1 of S3."""
    rows: list[Row] = [_VOTING_HEADER]
    for name, f in places.items():
        accepted, ok = _shares(f, "accepted", "ok_rate")
        voted = (length_cell(f[key]) for key in ("mean_m", "bound_m", "max_m"))
        claimed = (length_cell(f[key]) for key in ("ok_bound_m", "ok_max_m", "ms"))
        rows.append((name, str(f["windows"]), f"{f['routes_m']:.0f} m", accepted, *voted, ok, *claimed))
    p = published.S3_VOTING
    accepted, bound, top = percent_cell(p["accepted"]), length_cell(p["bound_m"]), length_cell(p["max_m"])
    rows.append(("paper", "", "", accepted, "", bound, top, "", "", "", ""))
    title = "s3, part 1: three-axis voting without odometry (Bao, Shang, Shi 2019), metres"
    return [title, *layout(rows, left=1), *_VOTING_LEGEND]


_VOTING_HEADER = (
    "place", "windows", "routes", "accepted", "mean", "97.7 %", "max", "ok", "ok 97.7 %", "ok max", "ms"
)  # fmt: skip
_VOTING_LEGEND = (
    "accepted: two components at least agree on a place; 97.7 %, max: of the accepted errors; ok: status ok",
    "comparable with the paper: lane (its map, rate and acceptance; length and field are not given there)",
    "not comparable: uji, where all corridors are searched at once and the map is made of other walks",
)


def declination_table(places: Mapping[str, Figures]) -> list[str]:
    """Part 2 of S3."""
    rows: list[Row] = [_DECLINATION_HEADER]
    for name, f in places.items():
        lengths = (length_cell(f[key]) for key in (*_HEADINGS, "mean_without_m", "mean_m"))
        near = _shares(f, "within_2m_without", "within_1m_without", "within_1m")
        tops = (length_cell(f["max_without_m"]), length_cell(f["max_m"]))
        rows.append((name, str(f["walks"]), *lengths, *near, *tops, percent_cell(f["ok_rate"]), length_cell(f["ms"])))
    p = published.S3_DECLINATION
    headings, largest = (tuple(length_cell(p[key]) for key in keys) for keys in (_HEADINGS, ("max_without_m", "max_m")))
    near = (percent_cell(p["within_2m_without"]), "", percent_cell(p["within_1m"]))
    rows.append(("paper", "", *headings, "", "", *near, *largest, "", ""))
    title = "s3, part 2: headings corrected by the map (Bao, Shang, Shi 2019), degrees and metres"
    return [title, *layout(rows, left=1), *_DECLINATION_LEGEND]


_HEADINGS = ("heading_before_deg", "heading_after_deg", "heading_max_before_deg", "heading_max_after_deg")
_DECLINATION_HEADER = (
    "place", "walks", "heading", "after", "max", "after", "mean", "after", "<2 m", "<1 m", "after", "max",
    "after", "ok", "ms",
)  # fmt: skip
_DECLINATION_LEGEND = (
    "each pair: dead reckoning with the compass, then the method; heading: of the track over 1 m of straight way",
    "mean, <1 m, max: errors along whole tracks; <2 m: without the method",
    "comparable with the paper: office (its size, start known; its steel is ours: dead reckoning errs as there)",
    "not comparable: uji, a room six times as large whose map is made of other walks",
)


def _metres(figures: Mapping[str, Any], *keys: str) -> Row:
    return tuple("-" if figures.get(key) is None else f"{figures[key]:.0f}" for key in keys)


def _shares(figures: Mapping[str, Any], *keys: str) -> Row:
    return tuple(percent_cell(figures[key]) for key in keys)


def _ratio(value: float | None, base: float | None) -> str:
    return "-" if not value or not base else f"{value / base:.2f}"
