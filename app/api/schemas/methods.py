"""Methods: the engine's registry as answers, and as an enum for requests."""

from __future__ import annotations

import dataclasses
import re
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import Field, WithJsonSchema

from app.api.schemas.base import Out, PageOut, example
from app.engine.localization.registry import DEFAULT_METHOD, METHODS, Method
from app.engine.matching import Bound
from app.engine.types import FeatureSet
from app.services.methods import AUTO

MethodName = Annotated[
    str,
    Field(max_length=64),
    WithJsonSchema(
        {
            "type": "string",
            "enum": [*METHODS, AUTO],
            "default": DEFAULT_METHOD,
            "description": "See `GET /v1/methods`; `auto` chooses by venue, map and prior, and the answer says why.",
        }
    ),
]
"""A plain string to pydantic: the services know the registry and name the choices in their error."""
MethodReason = Annotated[str | None, Field(description="Why this method, where the request left it to `auto`.")]

_PARAMETER = {
    "name": "particles",
    "type": "integer",
    "default": 2000,
    "minimum": 100.0,
    "maximum": 20000.0,
    "choices": None,
    "description": "Number of particles once the start is known.",
}
_METHOD = {
    "name": "particle",
    "summary": "Particle filter over steps.",
    "reference": "doi:10.1145/2632048.2632057",
    "kind": "tracker",
    "default": True,
    "features": ["vector", "hv", "total"],
    "needs_heading": False,
    "needs_odometry": False,
    "dimensions": 2,
    "needs_prior": False,
    "needs_routes": False,
    "scales": ["indoor"],
    "parameters": [_PARAMETER],
}


class ParameterOut(Out):
    """One parameter of a method."""

    name: str
    type: Literal["integer", "number", "boolean", "string"]
    default: Any
    minimum: float | None
    maximum: float | None
    choices: list[str] | None
    description: str

    @classmethod
    def of(cls, item: dataclasses.Field[Any], bound: Bound | None, description: str) -> Self:
        """Show a field of a parameter class."""
        default = item.default
        return cls(
            name=item.name,
            type=_type_name(default),
            default=str(default) if isinstance(default, StrEnum) else default,
            minimum=bound.low if bound else None,
            maximum=bound.high if bound else None,
            choices=[str(member) for member in type(default)] if isinstance(default, StrEnum) else None,
            description=description,
        )


class MethodOut(Out):
    """A positioning method."""

    model_config = example(_METHOD)

    name: str
    summary: str
    reference: str
    kind: Literal["tracker", "matcher"]
    default: Annotated[bool, Field(description="Whether it is used when a request names none.")]
    features: list[FeatureSet]
    needs_heading: bool
    needs_odometry: bool
    dimensions: Annotated[int, Field(description="2 over an area, 1 along lines.")]
    needs_prior: Annotated[bool, Field(description="Whether it only searches about a known start.")]
    needs_routes: Annotated[bool, Field(description="Whether it compares with the lines a map was surveyed along.")]
    scales: Annotated[list[str], Field(description="Kinds of venue that it suits.")]
    parameters: list[ParameterOut]

    @classmethod
    def of(cls, method: Method) -> Self:
        """Show a method of the registry."""
        descriptions = _descriptions(method.parameters)
        return cls(
            name=method.name,
            summary=method.summary,
            reference=method.reference,
            kind=method.kind,
            default=method.name == DEFAULT_METHOD,
            features=list(method.features),
            needs_heading=method.needs_heading,
            needs_odometry=method.needs_odometry,
            dimensions=method.dimensions,
            needs_prior=method.needs_prior,
            needs_routes=method.needs_routes,
            scales=list(method.scales),
            parameters=[
                ParameterOut.of(item, method.bounds.get(item.name), descriptions.get(item.name, ""))
                for item in dataclasses.fields(method.parameters)
            ],
        )


class MethodPage(PageOut):
    """All methods."""

    model_config = example({"items": [_METHOD], "next_cursor": None})

    items: list[MethodOut]


def _type_name(default: object) -> Literal["integer", "number", "boolean", "string"]:
    if isinstance(default, bool):
        return "boolean"
    if isinstance(default, int):
        return "integer"
    return "number" if isinstance(default, float) else "string"


def _descriptions(parameters: type) -> dict[str, str]:
    """Read the numpydoc attributes of a parameter class: ``name : type``, then indented lines."""
    doc = parameters.__doc__ or ""
    found = re.findall(r"^ {4}(\w+) : [^\n]*\n((?: {8}[^\n]*\n)+)", doc, flags=re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in found}
