"""Localization of one session: prior, tracking, integrity."""

from app.engine.localization.registry import DEFAULT_METHOD, METHODS, Method, create_tracker
from app.engine.localization.warm import warm_up

__all__ = ["DEFAULT_METHOD", "METHODS", "Method", "create_tracker", "warm_up"]
