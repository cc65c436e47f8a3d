"""What the files of a command line stand for."""

import os
from collections.abc import Sequence


def any_folder(files: Sequence[str]) -> bool:
    """Whether one stands for what is below it: a folder that is no survey."""
    if not any(map(os.path.isdir, files)):
        return False
    from pfwd.files.folders import is_survey

    return any(os.path.isdir(file) and not is_survey(file) for file in files)
