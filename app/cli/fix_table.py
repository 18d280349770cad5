"""Positions for people (a table) and for programs (columns)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from app.cli.common import print_table

if TYPE_CHECKING:
    import isodyn_client as isodyn


def print_fixes(fixes: isodyn.Fixes, start_ms: float) -> None:
    """One line a fix, with its time since the first sample."""
    ellipses = [fixes.ellipse95(i) for i in range(len(fixes))]
    print_table(
        ("t (s)", "level", "x (m)", "y (m)", "95 % ellipse (m)", "status", "sure"),
        [
            (
                f"{(fixes.t_ms[i] - start_ms) / 1000:.2f}",
                fixes.level_id[i],
                f"{fixes.x[i]:.2f}",
                f"{fixes.y[i]:.2f}",
                f"{ellipses[i].semi_major_m:.1f} x {ellipses[i].semi_minor_m:.1f}",
                fixes.status[i].value,
                "yes" if fixes.sure[i] else "no",
            )
            for i in range(len(fixes))
        ],
        empty="no fixes: the samples are too short for a single step",
    )


def columns_of(fixes: isodyn.Fixes) -> dict[str, list[Any]]:
    """Columns as the API names them."""
    names = ("t_ms", "x", "y", "cov_xx", "cov_xy", "cov_yy", "heading_deg", "quality", "sure")
    columns = {name: getattr(fixes, name).tolist() for name in names}
    walk_on = [None if value != value else value for value in fixes.walk_on_m.tolist()]  # noqa: PLR0124  # NaN
    return {
        **columns,
        "kind": [k.value for k in fixes.kind],
        "status": [s.value for s in fixes.status],
        "walk_on_m": walk_on,
        "level_id": list(fixes.level_id),
    }
