"""Lines of vehicles' loggers as they come, made into segments: magnetometer, accelerometer, gyroscope, wheel speed."""

from app.exchange.vehicles.cutter import Cutter, Piece
from app.exchange.vehicles.lines import LineChoices, LineReader, Row

__all__ = ["Cutter", "LineChoices", "LineReader", "Piece", "Row"]
