"""Peaks in the layouts of other programs, from numbers of our own."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

from tests.pfwd.files.foreign.builders import sample

RADIUS = 0.15
OFFSETS = (-0.3, -0.2, 0.0, 0.2, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1)


@dataclass(frozen=True)
class Place:
    """A point: chainage (m), position, temperatures (C), loads (kPa) and deflections (um)."""

    chainage: float
    latitude: float
    longitude: float
    air: float
    surface: float
    drops: Sequence[tuple[float, Sequence[float]]]


def bowl(load: float, dead: float = 0.08) -> tuple[float, list[float]]:
    """A load in kPa and deflections in um; the second sensor hardly moves."""
    written = [round(load * 0.15 / (1 + 4 * abs(offset)), 2) for offset in OFFSETS]
    written[1] = dead
    return load, written


def places() -> list[Place]:
    """Two points of three drops; one deflection is not positive."""
    first = [bowl(992.67), bowl(821.7, 0.10), bowl(99.25, 0.0)]
    second = [bowl(984.51), bowl(814.17, -0.02), bowl(12.5)]
    return [
        Place(0.0, 48.5, 2.25, 8.6, 3.0, first),
        Place(20.0, 48.51, 2.26, 8.8, 2.0, second),
    ]


def newtons(pressure: float) -> float:
    """Load of a pressure in kPa under the plate."""
    return 1e3 * pressure * pi * RADIUS**2


def f25(written: Sequence[Place], units: str = "25SI", empty: Sequence[int] = ()) -> str:
    lines = sample("head.f25").format(units=units).splitlines()
    for place in written:
        lines += [
            f"5280,0,140418.0,{place.latitude:12.7f},{place.longitude:12.7f},  00.3, 2, 9,   0,  0",
            f"5301,0,1,3,3,{place.chainage:8.3f},1,1,NA      ,2024,05,06,07,30",
            '5302,0,1,8,0,0,0,1,0,"wet         "',
            f"5303,0, N0, {place.surface:4.1f}, {place.air:4.1f}",
        ]
        for number, (load, moved) in enumerate(place.drops, start=1):
            cells = ["N0" if n in empty else f"{v:6.1f}" for n, v in enumerate(moved)]
            lines.append(f"{number:4d},{load:6.0f},{','.join(cells)}")
    return "\r\n".join(lines) + "\r\n"


def sweco(written: Sequence[Place]) -> str:
    lines = sample("sweco.fwd").splitlines()
    names = [f"D({n + 1})" for n in range(len(OFFSETS))]
    for place in written:
        lines += [
            "_" * 40,
            "$2",
            f"Chainage [m]...........\t{place.chainage:g}",
            "Remarks................\twet",
            f"Position of Drop:\tLongitude: {sexagesimal(place.longitude)}E\t"
            f"Latitude: {sexagesimal(place.latitude)}N\tAltitude: 0.0 m",
            "_" * 40,
            "$3",
            f"Sequence: 1/1\tNo. of drops: {len(place.drops)}\tFallheight: 0\tTime: 07:30",
            "",
            "\t".join(["Drop", *names, "kPa", "kN", "Air", "Sur.", "Man.", "Pulse time"]),
        ]
        for number, (load, moved) in enumerate(place.drops, start=1):
            cells = [f"{number}", *(f"{value:.1f}" for value in moved), "0"]
            cells += [f"{newtons(load) / 1e3:.1f}", f"{place.air:.1f}", f"{place.surface:.1f}"]
            lines.append("\t".join([*cells, "0.0", f"{place.chainage:.1f}", "24.93"]))
    return "\r\n".join(lines) + "\r\n"


def sexagesimal(value: float) -> str:
    degrees, rest = divmod(value, 1)
    minutes, rest = divmod(60 * rest, 1)
    return f"{degrees:.0f}°{minutes:.0f}'{60 * rest:.4f}\""


def dynatest(written: Sequence[Place], radius: float = 0.0) -> str:
    """Return the layout of the viewer: no separators, 0.1 for values that are not positive."""

    def cell(value: float) -> str:
        text = f"{value:.2f}"
        return (text if float(text) > 0 else "0.1").rjust(4)

    positions = [radius, *OFFSETS[2:9]]
    head = "".join(f"{1e3 * value:4.0f}" for value in positions)
    head += "".join(f"{value * 0.0393701:6.2f}" for value in positions)
    lines = [
        "R80    102    yard",
        "70103300\0\0\0\0\0\0\0\00069994.3703111  1",
        head,
        "   R  D1  D2  D3  D4  D5  D6  D7     R    D1    D2    D3    D4    D5    D6    D7",
        "C:\\PV01",
        "S     0.00  8.600  3  0I20931   47   37   32",
        "Ld ELI 1.000 0.00",
        "D1 159 1.000 29.66",
        "*000+0.0 000+0.0 st",
    ]
    for place in written:
        lines += [
            f"G0000001+{place.latitude!r}+{place.longitude!r}999.9",
            f"S {place.chainage:8.2f} {place.air:4.1f}00 {place.surface:2.0f}  0I20730   47   37",
            *("".join(map(cell, [load, *moved])) for load, moved in place.drops),
        ]
    return "\r\n".join(line.ljust(80) for line in lines)


def pddx(written: Sequence[Place], *, viewer: bool = True) -> str:
    """Return the wrong layout of the viewer, a diameter as radius and pressures, or a sound one."""
    radius = "0.30000001192092896" if viewer else f"{1e3 * RADIUS:g}"
    axis = ([0.0] if viewer else []) + list(OFFSETS)
    head = sample("head.pdx").format(
        device="Rincent" if viewer else "Other",
        radius=radius,
        positions=", ".join(f"{1e3 * value:g}" for value in axis),
    )
    lines = head.splitlines()
    for number, place in enumerate(written):
        chainage = place.chainage if viewer else place.chainage / 1e3
        lines += [
            f"[Test Location {number}]",
            f"TestLocation = {chainage:g},0,0 ",
            f"GPSLocation = {place.latitude:.8f},{place.longitude:.8f},0",
            "TestLane = undefined  ",
            f"TestTemperatures = {place.air},{place.surface},0.0 ",
            "TestTime = 07:30:34 ",
            "TestComment = undefined " if viewer else "TestComment = km 1",
        ]
        for drop, (load, moved) in enumerate(place.drops):
            first = load if viewer else newtons(load) / 1e3
            cells = [f"{value:.2f}" for value in (first, *moved)]
            lines.append(f"DropData_{drop} = {','.join(cells)}")
    return "\r\n".join(lines) + "\r\n"
