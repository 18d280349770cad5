"""The evidence a map rests on: placed samples of the field, and who brought them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.engine.errors import InputError
from app.engine.types.arrays import BoolArray, Float32Array, Float64Array, Int32Array, IntArray
from app.engine.types.features import FeatureSet


class SourceKind(StrEnum):
    """How positions came about: labelled by a surveyor, or found by a session that was located on a map."""

    SURVEY = "survey"
    SESSION = "session"


@dataclass(frozen=True, slots=True)
class EvidenceSource:
    """Who brought a part of the evidence.

    Attributes
    ----------
    id : str
        Of the survey walk or the contribution.
    kind : SourceKind
    contributor : str
        Who answers for it (an API key); sources of one contributor are no independent witnesses. Empty: nobody known.
    device : str
        Empty: not known; then the source counts as a device of its own.
    t : float, s
        UTC seconds of its first sample.
    """

    id: str
    kind: SourceKind
    contributor: str = ""
    device: str = ""
    t: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Placed samples of the field in the level frame, corrected for their devices, row by row.

    Attributes
    ----------
    features : FeatureSet
    sources : tuple of EvidenceSource
    source : array, shape (n,), int32
        Index into ``sources``.
    xy : array, shape (n, 2), float32, m, level frame
    values : array, shape (n, channels), float32, uT
    spread : array, shape (n,), float32, m
        Standard deviation of the position, per axis, beyond what labels of a survey are worth; 0 for surveys.
    weight : array, shape (n,), float32
        0 (kept, but not used: not yet vouched for, or overtaken by a change) to 1.
    """

    features: FeatureSet
    sources: tuple[EvidenceSource, ...]
    source: Int32Array
    xy: Float32Array
    values: Float32Array
    spread: Float32Array
    weight: Float32Array

    def __post_init__(self) -> None:
        n = len(self.xy)
        wanted = {
            "source": (n,), "xy": (n, 2), "values": (n, len(self.features.channels)), "spread": (n,), "weight": (n,),
        }  # fmt: skip
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise InputError(name, f"needs shape {shape}, got {getattr(self, name).shape}")
        if n and not (self.source.min() >= 0 and self.source.max() < len(self.sources)):
            raise InputError("source", f"must name one of {len(self.sources)} sources")

    def __len__(self) -> int:
        return len(self.xy)

    @classmethod
    def empty(cls, features: FeatureSet) -> Evidence:
        """No evidence."""
        none, channels = np.empty(0, np.float32), len(features.channels)
        return cls(
            features, (), np.empty(0, np.int32), np.empty((0, 2), np.float32), np.empty((0, channels), np.float32),
            none, none,
        )  # fmt: skip

    @classmethod
    def of(
        cls, features: FeatureSet, source: EvidenceSource, xy: Float64Array, values: Float64Array, spread: float = 0.0
    ) -> Evidence:
        """Evidence of one source, all of it in full use."""
        n = len(xy)
        return cls(
            features=features,
            sources=(source,),
            source=np.zeros(n, np.int32),
            xy=np.asarray(xy, np.float32),
            values=np.asarray(values, np.float32),
            spread=np.full(n, spread, np.float32),
            weight=np.ones(n, np.float32),
        )

    def subset(self, keep: BoolArray | IntArray) -> Evidence:
        """Rows of a mask or index array; sources without rows are dropped."""
        used, source = np.unique(self.source[keep], return_inverse=True)
        return Evidence(
            features=self.features,
            sources=tuple(self.sources[int(i)] for i in used),
            source=source.astype(np.int32),
            xy=self.xy[keep],
            values=self.values[keep],
            spread=self.spread[keep],
            weight=self.weight[keep],
        )

    def without(self, ids: Sequence[str]) -> Evidence:
        """What is left when the sources of these ids are taken out."""
        gone = set(ids)
        kept = np.array([source.id not in gone for source in self.sources], dtype=bool)
        return self.subset(kept[self.source]) if len(self) else self

    @classmethod
    def joined(cls, parts: Sequence[Evidence]) -> Evidence:
        """Evidence of several parts, rows in their order; a source that several parts name is one source.

        Raises
        ------
        InputError
            No part, or parts of different feature sets.
        """
        features = {part.features for part in parts}
        if len(features) != 1:
            raise InputError("features", f"of the parts must be one and the same, got {sorted(features)}")
        sources: dict[str, EvidenceSource] = {}
        for part in parts:
            for source in part.sources:
                sources.setdefault(source.id, source)
        place = {name: i for i, name in enumerate(sources)}
        return cls(
            features=parts[0].features,
            sources=tuple(sources.values()),
            source=np.concatenate(
                [np.array([place[s.id] for s in part.sources], np.int32)[part.source] for part in parts if len(part)]
                or [np.empty(0, np.int32)]
            ),
            xy=np.concatenate([part.xy for part in parts]),
            values=np.concatenate([part.values for part in parts]),
            spread=np.concatenate([part.spread for part in parts]),
            weight=np.concatenate([part.weight for part in parts]),
        )
