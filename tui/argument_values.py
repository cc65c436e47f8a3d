"""Values of the command line: what is not of its kind is refused with what was expected."""

import argparse

PLOT_FORMATS = (".pdf", ".png", ".svg")


def whole(text: str) -> int:
    """A whole number."""
    try:
        return int(text)
    except ValueError:
        raise _refused("a whole number", text) from None


def count(text: str) -> int:
    """A whole number from 1."""
    value = whole(text)
    if value < 1:
        raise _refused("a whole number from 1", text)
    return value


def number(text: str) -> float:
    """A number."""
    try:
        return float(text)
    except ValueError:
        raise _refused("a number", text) from None


def not_negative(text: str) -> float:
    """A finite number from 0."""
    value = number(text)
    if not 0 <= value < float("inf"):
        raise _refused("a number >= 0", text)
    return value


def depth(text: str) -> float | str:
    """A depth in m, or one of the words for none and for one that is not known."""
    if text in ("unknown", "none"):
        return text
    try:
        value = float(text)
    except ValueError:
        raise _refused("a depth in m, unknown or none", text) from None
    return "none" if value == float("inf") else value


def layers(text: str) -> int | str:
    """A number of layers, or the word for as many as the record can tell."""
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise _refused("a whole number from 1 to 4, or auto", text) from None


def thickness(text: str) -> tuple[float, ...] | str:
    """Thicknesses in m from the top, with commas between, or the word for not known."""
    if text == "unknown":
        return text
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise _refused("numbers in m with commas between, or unknown", text) from None


def report_file(text: str) -> str:
    """The name of a report."""
    if not text.lower().endswith((".html", ".pdf", ".xlsx")):
        raise _refused("a name ending in .html or .pdf, or in .xlsx with --template", text)
    return text


def plot_file(text: str) -> str:
    """The name of a picture."""
    if not text.lower().endswith(PLOT_FORMATS):
        raise _refused(f"a name ending in {', '.join(PLOT_FORMATS)}", text)
    return text


def _refused(expected: str, came: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"expected {expected}, got {came}")
