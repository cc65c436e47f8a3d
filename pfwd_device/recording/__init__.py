"""Recording of surveys in such a way that no saved drop is lost by a crash or a power cut.

Terms of this package:

Survey
    Folder with all drops of a job, which are made at test points.
Journal, record, segment
    The journal consists of files, the segments, to which all data are appended as records: points,
    drops, rebounds, edits, events. Each record has a sequence number and checksums.
Ledger
    Text file ``acknowledged.txt`` with a line for each record that reached the disk. If the journal
    is damaged later, the ledger shows which records are lost.
Acknowledged
    Recorded in journal and ledger, and confirmed by the disk.
Published
    Written as an HDF5 file, one for each drop, by a child process.
Survey-wide number
    Number of a drop within its survey, from 1. A drop also has a number within its point.
Key
    Text that identifies a drop on its instrument, so that a drop that is sent twice is stored once.
Home, spare folder
    Home is the folder of the survey. The spare folder receives all records after home could not be
    written or was changed by others; a recovery merges them into home.
"""

import logging

from pfwd_device.recording.capture import CapturedBytes, CaptureReader, CaptureWriter
from pfwd_device.recording.checking import CheckReport, check
from pfwd_device.recording.drop_file import read_drop_file
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.recording.recovery import RecoveryReport, recover
from pfwd_device.recording.spare import SpareFolder
from pfwd_device.recording.storage import Storage
from pfwd_device.recording.storage_reports import (
    PublishingFailed,
    StorageReport,
    SurveyNotSafe,
)
from pfwd_device.recording.survey_reader import Survey, SurveyDrop, SurveyPoint, read_survey
from pfwd_device.recording.survey_writer import SurveyWriter

__all__ = [
    "CaptureReader",
    "CaptureWriter",
    "CapturedBytes",
    "CheckReport",
    "DropRecord",
    "PublishingFailed",
    "ReboundRecord",
    "RecoveryReport",
    "SpareFolder",
    "Storage",
    "StorageReport",
    "Survey",
    "SurveyDrop",
    "SurveyNotSafe",
    "SurveyPoint",
    "SurveyWriter",
    "check",
    "read_drop_file",
    "read_survey",
    "recover",
]

# Without a handler Python would write warnings to the terminal, which belongs to the screens.
logging.getLogger(__name__).addHandler(logging.NullHandler())
