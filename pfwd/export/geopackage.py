"""Format ``gpkg``: OGC GeoPackage 1.3 (OGC 12-128r17) with a feature for each point, in SQLite.

The standard requires the tables ``gpkg_spatial_ref_sys``, ``gpkg_contents`` and
``gpkg_geometry_columns``. An index of the places, its extension F.3, is left to the program that
edits the file: a survey has too few points to need one.
"""

import contextlib
import datetime
import os
import sqlite3
import struct
from collections.abc import Iterator, Sequence

from pfwd.export.columns import POINT_COLUMNS
from pfwd.export.maps import without_position
from pfwd.export.output import new_file
from pfwd.export.rows import Order, PointValues, place_of_row, point_rows
from pfwd.judging.places import Place

LAYER_NAME = "points"
"""Name of the layer and of its table."""

APPLICATION_ID = 0x47504B47
"""Application number of a GeoPackage in SQLite: the letters GPKG."""
USER_VERSION = 10300
"""Version 1.3.0 of the standard, as SQLite stores it."""

_WGS_84 = 4326
"""EPSG number of the reference system in which satellite receivers report positions."""

_POINT, _POINT_Z = 1, 1001
"""Kinds of geometry in well-known binary (ISO 13249-3)."""

_COLUMN_TYPES = {"number": "REAL", "whole": "INTEGER", "flag": "BOOLEAN"}
"""SQL type of each type of column; TEXT for the others."""

_TABLES_SQL = """
CREATE TABLE gpkg_spatial_ref_sys (
    srs_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL PRIMARY KEY,
    organization TEXT NOT NULL,
    organization_coordsys_id INTEGER NOT NULL,
    definition TEXT NOT NULL,
    description TEXT
);
CREATE TABLE gpkg_contents (
    table_name TEXT NOT NULL PRIMARY KEY,
    data_type TEXT NOT NULL,
    identifier TEXT UNIQUE,
    description TEXT DEFAULT '',
    last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
    min_x DOUBLE,
    min_y DOUBLE,
    max_x DOUBLE,
    max_y DOUBLE,
    srs_id INTEGER,
    CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id)
);
CREATE TABLE gpkg_geometry_columns (
    table_name TEXT NOT NULL,
    column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL,
    z TINYINT NOT NULL,
    m TINYINT NOT NULL,
    CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
    CONSTRAINT uk_gc_table_name UNIQUE (table_name),
    CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
    CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id)
);
"""

_WGS_84_DEFINITION = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
    'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,'
    'AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],'
    'AXIS["Latitude",NORTH],AXIS["Longitude",EAST],AUTHORITY["EPSG","4326"]]'
)

_REFERENCE_SYSTEMS = (
    ("Undefined Cartesian SRS", -1, "NONE", -1, "undefined", "undefined Cartesian coordinates"),
    ("Undefined geographic SRS", 0, "NONE", 0, "undefined", "undefined geographic coordinates"),
    ("WGS 84 geodetic", _WGS_84, "EPSG", _WGS_84, _WGS_84_DEFINITION, "longitude and latitude"),
)
"""The three reference systems that every GeoPackage has to define."""


def write_gpkg(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write a feature for each point; discarded points are marked.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        A sentence with the number of points without a position, whose geometry is null.
    """
    rows = point_rows(order)
    with new_file(path, force=order.force) as draft, _new_database(draft) as database:
        _add_points(database, rows)
    return without_position(rows)


@contextlib.contextmanager
def _new_database(path: os.PathLike[str]) -> Iterator[sqlite3.Connection]:
    """Open a new SQLite file for a block, then commit and close it.

    Raises
    ------
    OSError
        If the file cannot be written; SQLite raises OperationalError instead.
    """
    try:
        with contextlib.closing(sqlite3.connect(path)) as database:
            # `new_file` waits for the disk; a journal on the disk would only be a second file.
            database.execute("PRAGMA journal_mode = MEMORY")
            database.execute("PRAGMA synchronous = OFF")
            yield database
            database.commit()
    except sqlite3.OperationalError as err:
        raise OSError(str(err)) from err


def _add_points(database: sqlite3.Connection, rows: Sequence[PointValues]) -> None:
    """Create the tables of the standard, and the layer with its features."""
    places = [place_of_row(row) for row in rows]
    located = [place for place in places if place is not None]
    has_heights = all(place.altitude is not None for place in located)
    database.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    database.execute(f"PRAGMA user_version = {USER_VERSION}")
    database.executescript(_TABLES_SQL)
    database.executemany(
        "INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", _REFERENCE_SYSTEMS
    )
    columns = [
        f'"{column.name}" {_COLUMN_TYPES.get(column.kind, "TEXT")}' for column in POINT_COLUMNS
    ]
    database.execute(
        f"CREATE TABLE {LAYER_NAME} (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POINT, "
        f"{', '.join(columns)})"
    )
    extent = (
        (
            min(place.longitude for place in located),
            min(place.latitude for place in located),
            max(place.longitude for place in located),
            max(place.latitude for place in located),
        )
        if located
        else (None,) * 4
    )
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, ?, ?, ?, ?, ?)",
        (LAYER_NAME, LAYER_NAME, now.replace("+00:00", "Z"), *extent, _WGS_84),
    )
    database.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', 'POINT', ?, ?, 0)",
        (LAYER_NAME, _WGS_84, int(has_heights)),
    )
    marks = ", ".join("?" * (2 + len(POINT_COLUMNS)))
    database.executemany(
        f"INSERT INTO {LAYER_NAME} VALUES ({marks})",
        (
            (fid, place and _geometry(place, has_heights), *row.values())
            for fid, (row, place) in enumerate(zip(rows, places, strict=True), 1)
        ),
    )


def _geometry(place: Place, has_heights: bool) -> bytes:
    """Return a position in the GeoPackage form: a header without an envelope, then well-known
    binary.

    All numbers are little-endian; the longitude comes first.
    """
    header = struct.pack("<2sBBi", b"GP", 0, 0b1, _WGS_84)
    if has_heights and place.altitude is not None:
        coordinates = (place.longitude, place.latitude, place.altitude)
        return header + struct.pack("<BIddd", 1, _POINT_Z, *coordinates)
    return header + struct.pack("<BIdd", 1, _POINT, place.longitude, place.latitude)
