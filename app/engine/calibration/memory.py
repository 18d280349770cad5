"""What sessions teach about a device, fused into one memory: a Kalman filter whose steps are sessions.

Between two sessions the truth drifts (the platform recalibrates, a case or another pocket comes); a session then
measures it. Two traps are minded:

* A session starts from the memory, so what it learned contains the memory already. Its own evidence is what is left
  when the information it started with is taken out again, in information form, as nodes of a decentralized filter do
  with what they have in common (Grime and Durrant-Whyte 1994, doi:10.1016/0967-0661(94)90349-2): nothing is counted
  twice, sessions may overlap, and a memory that was deleted does not come back through a session that began with it.
* Filters are too sure of what they learned: sessions of the *same* phone differ by more than either claims. So no
  session counts as better than the floors, nor does the memory.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace

from app.engine.types import SOFT_IRON_UNKNOWN, DeviceCalibration, SixFloats

_TINY = 1e-6


@dataclass(frozen=True, slots=True)
class MemoryLaw:
    """How devices differ, and how one device differs from session to session.

    Attributes
    ----------
    offset_wide, stride_wide, soft_iron_wide : float
        Standard deviations over devices and carriers: what is known of a new one. The tracker's own start.
    offset_drift, stride_drift, soft_iron_drift : float
        Change from one session to the next, one standard deviation.
    offset_floor, stride_floor, soft_iron_floor : float
        Neither a session nor the memory knows better than this: by so much sessions of one phone differ on recorded
        walks (of soft iron: by so much a phone is held otherwise).
    stride_walk : float
        By so much single survey walks of one carrier differ: pace, and labels that are off.
    offset_walk, offset_survey_floor : float, three floats
        The same of offsets that map building tells of survey walks, and how well many walks tell it. Building does not
        say how well, and a walk that hardly crosses others gets no offset, so the first is what building believes of
        any walk before it looks. The second is about what left-out survey walks of four floors differ by from the other
        walks of their phone's calibration: 2 to 4 uT horizontally, 3.5 to 5.7 vertically, since the mean vertical
        offset of a survey's walks and the field of its level cannot be told apart.
    """

    offset_wide: float = 5.5
    stride_wide: float = 0.13
    offset_drift: float = 2.0
    stride_drift: float = 0.02
    offset_floor: float = 2.0
    stride_floor: float = 0.04
    stride_walk: float = 0.1
    offset_walk: float = 4.0
    offset_survey_floor: tuple[float, float, float] = (2.0, 2.0, 4.0)
    soft_iron_wide: float = SOFT_IRON_UNKNOWN
    soft_iron_drift: float = 0.005
    soft_iron_floor: float = 0.01


_LAW = MemoryLaw()


def unknown_device(law: MemoryLaw = _LAW) -> DeviceCalibration:
    """What is known about a device never seen: no iron and the stride of the model, give or take."""
    wide = law.offset_wide
    return DeviceCalibration(
        (0.0, 0.0, 0.0), (wide, wide, wide), 1.0, law.stride_wide, soft_iron_sd=_six([law.soft_iron_wide] * 6)
    )


def next_session(memory: DeviceCalibration, law: MemoryLaw = _LAW) -> DeviceCalibration:
    """What the memory is worth in the next session: the same values, less certain by the drift."""
    x, y, z = (min(math.hypot(sd, law.offset_drift), law.offset_wide) for sd in memory.offset_sd)
    stride_sd = min(math.hypot(memory.stride_scale_sd, law.stride_drift), law.stride_wide)
    iron_sd = _six([min(math.hypot(sd, law.soft_iron_drift), law.soft_iron_wide) for sd in memory.soft_iron_sd])
    return replace(memory, offset_sd=(x, y, z), stride_scale_sd=stride_sd, soft_iron_sd=iron_sd)


def next_epoch(memory: DeviceCalibration, law: MemoryLaw = _LAW) -> DeviceCalibration:
    """What the memory is worth once the magnetometer was recalibrated: the carrier's stride only."""
    known, unknown = next_session(memory, law), unknown_device(law)
    return replace(unknown, stride_scale=known.stride_scale, stride_scale_sd=known.stride_scale_sd)


def remember(
    expected: DeviceCalibration,
    started_with: DeviceCalibration | None,
    learned: DeviceCalibration,
    law: MemoryLaw = _LAW,
) -> DeviceCalibration:
    """The memory after a session.

    Parameters
    ----------
    expected : DeviceCalibration
        What was known before the session, drift included (:func:`next_session`, :func:`next_epoch`,
        :func:`unknown_device`).
    started_with : DeviceCalibration or None
        What the session itself began with; None: nothing known (:func:`unknown_device`). Usually ``expected``; another
        one when sessions overlapped.
    learned : DeviceCalibration
        What it ended with.
    """
    before = unknown_device(law) if started_with is None else started_with
    (x, sx), (y, sy), (z, sz) = (
        _fuse(
            (expected.offset[i], expected.offset_sd[i]),
            (before.offset[i], before.offset_sd[i]),
            (learned.offset[i], learned.offset_sd[i]),
            law.offset_floor,
        )
        for i in range(3)
    )
    stride, stride_sd = _fuse(
        (expected.stride_scale, expected.stride_scale_sd),
        (before.stride_scale, before.stride_scale_sd),
        (learned.stride_scale, learned.stride_scale_sd),
        law.stride_floor,
    )
    iron = [
        _fuse(*pairs, law.soft_iron_floor)
        for pairs in zip(_soft_iron(expected), _soft_iron(before), _soft_iron(learned), strict=True)
    ]
    values, sds = zip(*iron, strict=True)
    return DeviceCalibration((x, y, z), (sx, sy, sz), stride, stride_sd, _six(values), _six(sds))


def remember_strides(expected: DeviceCalibration, scales: Sequence[float], law: MemoryLaw = _LAW) -> DeviceCalibration:
    """The memory after survey walks of the device: strides between known positions are measured, not inferred.

    Hard and soft iron stay as they were.

    Parameters
    ----------
    expected : DeviceCalibration
        What was known before, drift included.
    scales : sequence of float
        Of each walk, stride over that of the stride model. Their median counts: a walk with a wrong label is no drama.
    """
    if not scales:
        return expected
    noise = max(law.stride_walk / math.sqrt(len(scales)), law.stride_floor)
    stride, stride_sd = _update(
        (expected.stride_scale, expected.stride_scale_sd), statistics.median(scales), noise, law.stride_floor
    )
    return replace(expected, stride_scale=stride, stride_scale_sd=stride_sd)


def remember_offsets(
    expected: DeviceCalibration, offsets: Sequence[Sequence[float]], law: MemoryLaw = _LAW
) -> DeviceCalibration:
    """The memory after survey walks of the device in one epoch of its magnetometer: hard iron measured against a map.

    Stride and soft iron stay as they were. Each walk's offset was found together with the map and with the others' of
    the survey; their common error is not told, so all walks count as one measurement, no better than a floor. Nor is it
    better than the walks agree: where they do not, the platform calibrated anew between them and nobody said so, and
    the next session may be of either kind.

    Parameters
    ----------
    expected : DeviceCalibration
        What was known before in this epoch, drift included.
    offsets : sequence of three floats each, uT
        Forward, left, up of the levelled device, of each walk. Their median counts.
    """
    if not offsets:
        return expected
    noise = law.offset_walk / math.sqrt(len(offsets))
    (x, sx), (y, sy), (z, sz) = (
        _update(
            (expected.offset[i], expected.offset_sd[i]),
            statistics.median(found),
            max(noise, _robust_sd(found), law.offset_survey_floor[i]),
            law.offset_floor,
        )
        for i, found in enumerate([[offset[i] for offset in offsets] for i in range(3)])
    )
    return replace(expected, offset=(x, y, z), offset_sd=(sx, sy, sz))


def _robust_sd(values: Sequence[float]) -> float:
    """Standard deviation from the median of absolute deviations; as if normal."""
    middle = statistics.median(values)
    return 1.4826 * statistics.median(abs(value - middle) for value in values)


def _soft_iron(known: DeviceCalibration) -> list[tuple[float, float]]:
    """Each element with its standard deviation."""
    return list(zip(known.soft_iron, known.soft_iron_sd, strict=True))


def _six(values: Sequence[float]) -> SixFloats:
    ff, ll, uu, fl, fu, lu = values
    return ff, ll, uu, fl, fu, lu


def _fuse(
    expected: tuple[float, float], before: tuple[float, float], after: tuple[float, float], floor: float
) -> tuple[float, float]:
    """One value and its standard deviation, updated by what a session found beyond what it began with."""
    value, sd = expected
    after_sd = max(after[1], _TINY)
    information = after_sd**-2 - before[1] ** -2
    if information <= 0.0:  # the session ended no wiser than it began
        return value, max(sd, floor)
    evidence = (after[0] * after_sd**-2 - before[0] * before[1] ** -2) / information
    return _update(expected, evidence, max(information**-0.5, floor), floor)


def _update(expected: tuple[float, float], evidence: float, noise: float, floor: float) -> tuple[float, float]:
    """One value and its standard deviation after evidence with this noise; never surer than the floor."""
    value, sd = expected
    gain = sd**2 / (sd**2 + noise**2)
    return value + gain * (evidence - value), max(sd * math.sqrt(1.0 - gain), floor)
