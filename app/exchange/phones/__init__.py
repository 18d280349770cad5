"""What applications of phones send and write: read into :class:`Readings`, assembled to samples on one time base."""

from app.exchange.phones.assembly import Assembled, GnssColumns, PhoneFrame, assemble, missing
from app.exchange.phones.errors import FormatError
from app.exchange.phones.readings import Annotation, Readings, Sensor, Series

__all__ = [
    "Annotation",
    "Assembled",
    "FormatError",
    "GnssColumns",
    "PhoneFrame",
    "Readings",
    "Sensor",
    "Series",
    "assemble",
    "missing",
]
