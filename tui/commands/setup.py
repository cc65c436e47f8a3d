"""``pfwd setup``: write the setup file of a logger or microcontroller, from a builder's answers."""

import argparse
import os

from pfwd.errors import OptionError, refusal
from tui.output import quoted, say
from tui.questions import ask_choice, ask_number, ask_text

LOGGERS = {"dataq": "DATAQ DI series", "labjack": "LabJack T7", "ascii": "lines of numbers"}
"""Dialects whose setup files the command writes, and their instruments."""

SENSORS = ("load", "geophone", "accelerometer", "displacement", "unused")
MILLIVOLT = 1e-3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd setup`` and its description to the parser."""
    parser.description = (
        "Asks for the logger, the plate and each channel as their data sheets state them, and "
        "writes a setup file for pfwd log --setup and pfwd live --setup."
    )
    parser.add_argument("output", metavar="SETUP.toml", help="file to write")
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")


def run(args: argparse.Namespace) -> int:
    """Ask, check the file as a measurement would, and write it."""
    from pfwd.files.output_path import require_writable
    from pfwd.session.setup_file import parse_setup

    require_writable(args.output, "SETUP.toml")
    if os.path.exists(args.output) and not args.force:
        hint = "--force overwrites it"
        raise OptionError(refusal(args.output, "a new file", "an existing one", hint))
    text = setup_text()
    parse_setup(text, args.output)
    with open(args.output, "w", encoding="utf-8", newline="\n") as stream:
        stream.write(text)
    say(f"setup: {args.output} written; next: pfwd log PORT --setup {quoted(args.output)}")
    return 0


def setup_text() -> str:
    """Return the text of a setup file with the user's answers."""
    from pfwd.files.toml import toml_line

    say("setup: Enter accepts the value in brackets")
    listed = ", ".join(f"{name} ({title})" for name, title in LOGGERS.items())
    dialect = ask_choice(f"logger: {listed}", tuple(LOGGERS), "dataq")
    lines = [toml_line("plate_radius_m", ask_number("plate radius in m", 0.15))]
    lines.append(toml_line("plate_mass_kg", ask_number("mass of plate and parts below in kg", 15)))
    lines.append(toml_line("poisson_ratio", ask_number("Poisson's ratio of the ground", 0.35)))
    rate = ask_number("samples of each channel per second", 10_000)
    lines += ["", "[link]", toml_line("dialect", dialect), toml_line("sampling_rate_hz", rate)]
    if dialect == "ascii":
        bits = int(ask_number("bits of the converter", 24))
        volts = ask_number("full scale of the converter in V", 2.5)
        lines += ["", "[instrument]", toml_line("adc_bits", bits), toml_line("adc_range_v", volts)]
    count = int(ask_number("number of channels", 2))
    for number in range(1, count + 1):
        lines += ["", *_channel(number, dialect)]
    return "\n".join(lines) + "\n"


def _channel(number: int, dialect: str) -> list[str]:
    """Return the lines of one channel."""
    from pfwd.files.toml import toml_line

    default = "load" if number == 1 else "geophone"
    role = ask_choice(f"channel {number}: {', '.join(SENSORS)}", SENSORS, default)
    name = ask_text("  its name", role if number <= 2 else f"{role} {number - 1}")
    first = 0 if dialect == "labjack" else 1
    key, what = ("column", "column") if dialect == "ascii" else ("input", "input on the logger")
    place = int(ask_number(f"  its {what}", number - 1 + first))
    lines = ["[[channels]]", toml_line("name", name), toml_line("role", role)]
    lines.append(toml_line(key, place))
    if dialect != "ascii":
        lines.append(toml_line("range_v", ask_number("  range of the input in V", 10)))
    if role == "load":
        way = ask_choice("  sensitivity in mV/V (bridge) or V/N", ("mV/V", "V/N"), "mV/V")
        if way == "mV/V":
            ratio = ask_number("  mV/V at the rated load", 2)
            rated = ask_number("  rated load in N", 20_000)
            excitation = ask_number("  excitation in V", 5)
            gain = ask_number("  gain of the amplifier", 1)
            sensitivity = MILLIVOLT * ratio * excitation * gain / rated
        else:
            sensitivity = ask_number("  V per N", 1e-4)
        lines.append(toml_line("sensitivity", sensitivity))
        shunt = ask_number("  load in N that the shunt simulates; 0: no shunt", 0)
        lines += [toml_line("shunt_n", shunt)] if shunt else []
        return lines
    if role == "geophone":
        lines.append(toml_line("sensitivity", ask_number("  V per m/s", 28.8)))
        frequency = ask_number("  natural frequency in Hz", 4.5)
        damping = ask_number("  damping with its resistor, such as 0.6", 0.6)
        lines += [toml_line("natural_frequency_hz", frequency), toml_line("damping", damping)]
    elif role == "accelerometer":
        millivolts = ask_number("  mV per g", 10)
        lines.append(toml_line("sensitivity", MILLIVOLT * millivolts / 9.80665))
    else:
        lines.append(toml_line("sensitivity", ask_number("  V per unit", 1)))
    offset = ask_number("  distance from the centre of the plate in m", 0)
    lines.append(toml_line("offset_m", offset))
    return lines
