"""Questions on a terminal: on the error stream, so that the output can be redirected."""

import sys
from collections.abc import Sequence

from tui.output import clean, say


def ask_text(question: str, default: str | None) -> str:
    """Return the user's answer; an empty one is the default, the end of the input an interrupt."""
    print(f"{question} [{default or ''}]: ", end="", file=sys.stderr, flush=True)
    try:
        answer = input().strip()
    except EOFError:
        raise KeyboardInterrupt from None
    return answer or default or ""


def ask_choice(question: str, choices: Sequence[str], default: str | None) -> str:
    """Return one of the choices; ask until the answer is one."""
    while True:
        answer = ask_text(question, default)
        if answer in choices:
            return answer
        say(f"expected one of {', '.join(choices)}, got {clean(answer) or 'nothing'}")


def ask_number(question: str, default: float) -> float:
    """Return a number; ask until the answer is one."""
    while True:
        number = ask_optional_number(question, default)
        if number is not None:
            return number


def ask_optional_number(question: str, default: float | None) -> float | None:
    """Return a number, or None for an empty answer without a default."""
    while True:
        answer = ask_text(question, None if default is None else f"{default:g}").replace(",", ".")
        if not answer:
            return None
        try:
            return float(answer)
        except ValueError:
            say(f"expected a number, got {clean(answer)}")
