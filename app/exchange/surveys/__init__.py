"""Surveys as files: the project's own archives, and recordings of others."""

from app.exchange.surveys.archive import read_archive, read_survey, read_walk, survey_archive, walk_body
from app.exchange.surveys.csv_file import CsvChoices, read_csv
from app.exchange.surveys.getsensordata import LogChoices, SensorLog, read_getsensordata, read_sensor_log
from app.exchange.surveys.recording import Findings

__all__ = [
    "CsvChoices",
    "Findings",
    "LogChoices",
    "SensorLog",
    "read_archive",
    "read_csv",
    "read_getsensordata",
    "read_sensor_log",
    "read_survey",
    "read_walk",
    "survey_archive",
    "walk_body",
]
