"""Runs targets under atheris: python tests/fuzz/fuzz.py GROUP [NAME ...] -max_total_time=600

GROUP is wire, recording, text or foreign. Without names every target of the group runs, chosen by
the first byte of the input. What begins with "-" is libFuzzer's, and so is a folder for the corpus.
"""

import sys
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

with atheris.instrument_imports(include=["pfwd_device", "pfwd"]):
    import tests.fuzz.foreign_targets
    import tests.fuzz.outside_targets  # noqa: F401  (these enter their targets)
    from tests.fuzz.targets import TARGETS


def main(arguments: list[str]) -> None:
    if not arguments or arguments[0] not in TARGETS:
        sys.exit(f"fuzz.py: expected one of {', '.join(TARGETS)} first; {__doc__}")
    group, *arguments = arguments
    targets = TARGETS[group]
    names = [name for name in arguments if name in targets] or list(targets)
    chosen = [targets[name] for name in names]

    def run(data: bytes) -> None:
        if len(chosen) == 1:
            chosen[0](data)
        elif data:
            chosen[data[0] % len(chosen)](data[1:])

    rest = [word for word in arguments if word not in targets]
    atheris.Setup([sys.argv[0], *rest], run)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
