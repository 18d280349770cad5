"""Methods made of functions: they keep name, docstring and signature, so that ``help`` and editors show them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any


def as_method(build: Callable[..., Any], method: Callable[..., Any]) -> None:
    """Give ``method`` the name, the docstring and the signature (behind ``self``) of ``build``."""
    functools.update_wrapper(method, build)
    self = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    parameters = [p for p in inspect.signature(build).parameters.values() if p.name != "self"]
    # update_wrapper makes inspect look at `build`, which has no self to drop for a bound method.
    method.__signature__ = inspect.Signature([self, *parameters])  # type: ignore[attr-defined]
