"""Safe recording of a survey: an acknowledged journal, and one file for each drop."""

import logging

from pfwd_device.recording.capture import CapturedBytes, CaptureReader, CaptureWriter
from pfwd_device.recording.checking import CheckReport, check
from pfwd_device.recording.drop_file import read_drop_file
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.recording.recovery import RecoveryReport, recover
from pfwd_device.recording.spare import SpareFolder
from pfwd_device.recording.storage import Storage
from pfwd_device.recording.storage_reports import (
    FallbackMerged,
    FilesRewritten,
    PublishingFailed,
    SpareUsed,
    StorageReport,
    SurveyFilesRemoved,
    SurveyMovedAway,
)
from pfwd_device.recording.survey_content import SurveyDrop, SurveyPoint
from pfwd_device.recording.survey_reader import Survey, read_survey
from pfwd_device.recording.survey_writer import SurveyWriter

__all__ = [
    "CaptureReader",
    "CaptureWriter",
    "CapturedBytes",
    "CheckReport",
    "DropRecord",
    "FallbackMerged",
    "FilesRewritten",
    "PublishingFailed",
    "Rebound",
    "RecoveryReport",
    "SpareFolder",
    "SpareUsed",
    "Storage",
    "StorageReport",
    "Survey",
    "SurveyDrop",
    "SurveyFilesRemoved",
    "SurveyMovedAway",
    "SurveyPoint",
    "SurveyWriter",
    "check",
    "read_drop_file",
    "read_survey",
    "recover",
]

# Without a handler Python would write warnings to the terminal, which belongs to the screens.
logging.getLogger(__name__).addHandler(logging.NullHandler())
