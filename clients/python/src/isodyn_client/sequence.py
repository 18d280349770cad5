"""Numbering of a session's segments."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from isodyn_client import endpoints
from isodyn_client.encoding import Encoding
from isodyn_client.flows import Flow, Flows
from isodyn_client.models import SessionInfo
from isodyn_client.results import SegmentResult
from isodyn_client.samples import Samples, WifiScans


@dataclass(slots=True)
class Sequencer:
    """Gives each segment its number, and takes it back if the segment was not accepted."""

    flows: Flows
    info: SessionInfo
    next_seq: int = field(init=False)

    def __post_init__(self) -> None:
        self.next_seq = self.info.next_seq

    def send(
        self, samples: Samples, *, wifi: WifiScans | None, wait: float | None, encoding: Encoding | str, gzip: bool
    ) -> Flow[SegmentResult]:
        """Send under the next number; only an accepted segment uses it up."""
        call = endpoints.send_segment(
            self.info.id, self.next_seq, samples, wifi=wifi, wait=wait, encoding=encoding, gzip=gzip
        )
        result = yield from self.flows.exchange(call)
        self.next_seq = result.seq + 1
        return result

    @staticmethod
    def pieces(
        samples: Samples, wifi: WifiScans | None, segment_s: float
    ) -> Iterator[tuple[Samples, WifiScans | None]]:
        """Segments of ``segment_s`` seconds, each with the Wi-Fi readings heard up to its end."""
        after = -float("inf")
        for piece in samples.split(segment_s):
            until = float(piece.t_ms[-1]) + 1.0
            yield piece, wifi.between(after, until) if wifi is not None else None
            after = until
