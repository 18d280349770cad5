"""What the papers print, as they print it."""

from __future__ import annotations

from typing import Any

S4: dict[str, dict[str, dict[str, float]]] = {
    "marine": {
        "magcom": {"north": 373.8, "east": 328.3, "ms": 30_900.0},
        "icm": {"north": 120.3, "east": 69.2, "ms": 7_900.0},
    },
    "land": {
        "magcom": {"north": 517.8, "east": 339.5, "ms": 28_400.0},
        "icm": {"north": 95.7, "east": 69.6, "ms": 7_910.0},
    },
}
"""Cheng and Zhou 2026, doi:10.7690/bgzdh.2026.05.004: mean errors (m) and time of a match."""

S1_MEAN: dict[int, dict[str, float]] = {
    20: {"dtw": 2.61, "ddtw": 2.28, "ddtw_itakura": 2.26},
    40: {"dtw": 2.27, "ddtw": 2.01, "ddtw_itakura": 1.79},
    60: {"dtw": 1.96, "ddtw": 1.72, "ddtw_itakura": 1.37},
}
"""Zhang 2021, chapter 4: mean error (m) by window. Chapter 3 has 1.85 and 1.63 m for DTW and improved DTW at 60."""
S1_IMPROVED_60 = {"dtw": 1.85, "improved_dtw": 1.63}
S1_WITHIN_4_M = {"dtw": 0.857, "improved_dtw": 0.964}
S1_SECONDS: dict[int, dict[str, float]] = {
    20: {"dtw": 2.05, "improved_dtw": 1.45, "ddtw": 2.07, "ddtw_itakura": 1.89},
    40: {"dtw": 3.14, "improved_dtw": 1.85, "ddtw": 3.12, "ddtw_itakura": 2.06},
    60: {"dtw": 3.89, "improved_dtw": 1.56, "ddtw": 4.01, "ddtw_itakura": 2.12},
}
"""Time of a fix (s)."""

S3_VOTING = {"accepted": 0.9103, "bound_m": 4.65, "max_m": 4.9}
"""Bao, Shang and Shi 2019, part 1; the bound holds 97.7 % of the accepted errors."""
S3_DECLINATION = {
    "heading_before_deg": 63.7, "heading_after_deg": 5.2, "heading_max_before_deg": 101.3,
    "heading_max_after_deg": 23.5, "within_1m": 0.9375, "max_m": 1.687, "max_without_m": 3.225,
    "within_2m_without": 0.8472,
}  # fmt: skip
"""The same, part 2."""

ALL: dict[str, Any] = {
    "s4": S4,
    "s1": {"mean": S1_MEAN, "seconds": S1_SECONDS, "mean_60_chapter_3": S1_IMPROVED_60, "within_4m_60": S1_WITHIN_4_M},
    "s3": {"voting": S3_VOTING, "declination_aided": S3_DECLINATION},
}
