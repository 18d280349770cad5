"""Imported by the fork server, and only there: everything workers are to find ready when they are forked."""

from __future__ import annotations

from app.workers.bootstrap import warm_up

warm_up()
