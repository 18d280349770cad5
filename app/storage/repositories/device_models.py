"""Models that devices name."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Select, func, select

from app.engine.types import DeviceCalibration
from app.services.errors import NotFoundError
from app.services.records import DeviceModel, Page
from app.storage.models import device_calibrations, devices
from app.storage.repositories.base import Repository
from app.storage.repositories.devices import calibration_of

_EPOCHS = 4
"""Memories that are read for each device wanted: some devices have several epochs."""


class SqlDeviceModelRepository(Repository):
    """Port ``DeviceModelRepository``."""

    def list(self, *, cursor: str | None, limit: int) -> Page[DeviceModel]:
        """Models by name; the cursor is the first device of the last one seen."""
        after = ""
        if cursor is not None:
            after = self._read(select(devices.c.model).where(devices.c.id == cursor)).scalar() or ""
        names = [name for name in self._read(_names(after, limit + 1)).scalars() if name is not None]
        shown = names[:limit]
        numbers = (func.count().label("n"), func.min(devices.c.id).label("first"))
        counted = select(devices.c.model, *numbers).where(devices.c.model.in_(shown))
        rows = self._read(counted.group_by(devices.c.model)).all()
        found = {row.model: (int(row.n), str(row.first)) for row in rows}
        return Page(
            tuple(DeviceModel(name, found[name][0]) for name in shown),
            found[shown[-1]][1] if len(names) > limit else None,
        )

    def get(self, name: str) -> DeviceModel:
        """One model, without its estimate."""
        n = self._read(select(func.count()).where(devices.c.model == name)).scalar_one()
        if n == 0:
            raise NotFoundError("device model", name)
        return DeviceModel(name, int(n))

    def memories(self, name: str, *, limit: int, without: str | None = None) -> Sequence[DeviceCalibration]:
        """One memory a device of the model, but of one: those used last, at most ``limit``."""
        table = device_calibrations
        statement = select(table).where(table.c.model == name).order_by(table.c.updated_at.desc())
        found: dict[str, DeviceCalibration] = {}
        for row in self._read(statement.limit(_EPOCHS * limit)):
            if row.device_id != without and row.device_id not in found:
                found[row.device_id] = calibration_of(row)
                if len(found) == limit:
                    break
        return tuple(found.values())


def _names(after: str, limit: int) -> Select[tuple[str]]:
    """Names that follow one another: each is a step of the index, however many devices share it."""
    model = devices.c.model
    first = select(func.min(model).label("name")).where(model > after)
    walk = first.cte("model_names", recursive=True)
    following = select(func.min(model)).where(model > walk.c.name).scalar_subquery()
    walk = walk.union_all(select(following).where(walk.c.name.is_not(None)))
    return select(walk.c.name).limit(limit)
