"""Numbering of a session's segments."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from isodyn_client import endpoints
from isodyn_client.aids import Aids
from isodyn_client.encoding import Encoding
from isodyn_client.flows import Flow, Flows
from isodyn_client.models import SessionInfo
from isodyn_client.results import SegmentResult
from isodyn_client.samples import Samples


@dataclass(slots=True)
class Sequencer:
    """Gives each segment its number, and takes it back if the segment was not accepted."""

    flows: Flows
    info: SessionInfo
    next_seq: int = field(init=False)

    def __post_init__(self) -> None:
        self.next_seq = self.info.next_seq

    def send(
        self, samples: Samples, *, aids: Aids | None, wait: float | None, encoding: Encoding | str, gzip: bool
    ) -> Flow[SegmentResult]:
        """Send under the next number; only an accepted segment uses it up."""
        call = endpoints.send_segment(
            self.info.id, self.next_seq, samples, aids=aids, wait=wait, encoding=encoding, gzip=gzip
        )
        result = yield from self.flows.exchange(call)
        self.next_seq = result.seq + 1
        return result

    @staticmethod
    def pieces(samples: Samples, aids: Aids | None, segment_s: float) -> Iterator[tuple[Samples, Aids | None]]:
        """Segments of ``segment_s`` seconds, each with the readings taken up to its end."""
        after = -float("inf")
        for piece in samples.split(segment_s):
            until = float(piece.t_ms[-1]) + 1.0
            yield piece, aids.heard(after, float(piece.t_ms[0]), until) if aids is not None else None
            after = until
