"""Columns of the exported tables of drops and points: name with unit, type, and meaning."""

from pfwd.analysis.result_columns import ResultColumn, result_columns

DROP_COLUMNS = (
    ResultColumn("survey_id", "text", "identity of the survey"),
    ResultColumn("point", "text", "test point, as it was named last"),
    ResultColumn("drop", "whole", "number of the drop within the point"),
    ResultColumn("record", "whole", "number of the drop within the survey"),
    ResultColumn("discarded", "flag", "whether the drop or its point was discarded"),
    ResultColumn("time_utc", "time", "UTC, ISO 8601"),
    ResultColumn("latitude", "number", "degrees, north positive"),
    ResultColumn("longitude", "number", "degrees, east positive"),
    ResultColumn("altitude_m", "number", "m"),
    ResultColumn("site", "text", ""),
    ResultColumn("operator", "text", ""),
    ResultColumn("device", "text", ""),
    ResultColumn("peak_load_n", "number", "measured, N"),
    ResultColumn("deflection_recorded_m", "number", "peak of the centre as recorded, m"),
    ResultColumn("target_pa", "number", "target modulus, Pa"),
    ResultColumn("status", "text", "measured, seating, rejected, or no result"),
    ResultColumn("reason", "text", "reason of the rejection, or of the missing result"),
    *result_columns("established"),
    ResultColumn("notes", "texts", "of the drop and of its point"),
    # New columns are added at the end, for programs that read columns by position.
    *result_columns("layers"),
    ResultColumn("kind", "text", "traces, peaks (no history) or stiffness (a rig)"),
    ResultColumn("sci_m", "number", "surface curvature index of peaks, d0 - d300, m"),
    ResultColumn("bdi_m", "number", "base damage index of peaks, d300 - d600, m"),
    ResultColumn("bci_m", "number", "base curvature index of peaks, d600 - d900, m"),
    ResultColumn("area_m", "number", "area of the basin of peaks to 0.9 m over d0, m"),
    ResultColumn("surface_moduli_pa", "texts", "of peaks: distance (m) and modulus (Pa)"),
    ResultColumn("secant_stiffness_n_per_m", "number", "of a rig, at the peaks, N/m"),
    ResultColumn("dynamic_stiffness_n_per_m", "number", "of a rig, 15 to 30 Hz, N/m"),
    ResultColumn(
        "deflection_corrected_m",
        "number",
        "peak of the centre without the declared response of the geophone, m; procedures judge it",
    ),
    ResultColumn("procedure", "text", "procedure of the point; none: no procedure was chosen"),
    ResultColumn("quantity", "text", "judged quantity: E_vd, E_LWD, modulus or deflection"),
    ResultColumn("value", "number", "judged value of the point, in the unit"),
    ResultColumn("interval_low", "number", "lower end of its 95 % interval, in the unit"),
    ResultColumn("interval_high", "number", "upper end of its 95 % interval, in the unit"),
    ResultColumn("unit", "text", "unit of value, interval and target: Pa or m"),
    ResultColumn("target", "number", "target of the point, in the unit"),
    ResultColumn("verdict", "text", "verdict of the point: pass, fail, undecided or none"),
    ResultColumn(
        "value_not_supported", "text", "reason why the value of the point decides nothing"
    ),
    ResultColumn(
        "modulus_source",
        "text",
        "source of the point's modulus in force, which may not be that of this drop's fit: "
        "diagnosed or fitted; empty: none",
    ),
    ResultColumn(
        "modulus_not_supported",
        "text",
        "reason why the data do not support modulus_pa; it is empty if the diagnosis of the point "
        "permits no modulus either",
    ),
    *result_columns("last"),
)
"""Columns of the table of drops, in their order."""

POINT_COLUMNS = (
    ResultColumn("point", "text", "test point, as it was named last"),
    ResultColumn("chainage_m", "number", "distance along the line, m"),
    ResultColumn("latitude", "number", "degrees, north positive"),
    ResultColumn("longitude", "number", "degrees, east positive"),
    ResultColumn("altitude_m", "number", "m"),
    ResultColumn("time_utc", "time", "UTC of the first averaged drop, ISO 8601"),
    ResultColumn("time_local", "time", "local time of the first averaged drop, ISO 8601"),
    ResultColumn("procedure", "text", "procedure of the point"),
    ResultColumn("quantity", "text", "judged quantity: E_vd, E_LWD, modulus or deflection"),
    ResultColumn("value", "number", "judged value, in the unit"),
    ResultColumn("interval_low", "number", "lower end of its 95 % interval, in the unit"),
    ResultColumn("interval_high", "number", "upper end of its 95 % interval, in the unit"),
    ResultColumn("unit", "text", "unit of value, interval and target: Pa, or m for a deflection"),
    ResultColumn("target", "number", "target, in the unit"),
    ResultColumn("verdict", "text", "pass, fail, undecided, or none"),
    ResultColumn("drops_measured", "whole", "number of averaged drops"),
    ResultColumn("modulus_pa", "number", "modulus from the fits of the averaged drops, Pa"),
    ResultColumn("modulus_interval_low_pa", "number", "lower end of its 95 % interval, Pa"),
    ResultColumn("modulus_interval_high_pa", "number", "upper end of its 95 % interval, Pa"),
    ResultColumn("diagnosis", "text", "clean, explained or unexplained; empty: not diagnosed"),
    ResultColumn("discarded", "flag", "whether the point was discarded"),
    ResultColumn("note", "text", "notes on the point"),
    ResultColumn("verdict_reason", "text", "reason of the verdict, one sentence"),
    ResultColumn("verdict_reason_code", "text", "kind of the reason; empty: no target"),
    ResultColumn("value_not_supported", "text", "reason why the value decides nothing"),
    ResultColumn("modulus_in_force_pa", "number", "modulus that may be used, Pa; empty: none"),
    ResultColumn("modulus_in_force_interval_low_pa", "number", "lower end of its interval, Pa"),
    ResultColumn("modulus_in_force_interval_high_pa", "number", "upper end of its interval, Pa"),
    ResultColumn("modulus_source", "text", "source of the modulus in force: diagnosed or fitted"),
    ResultColumn("modulus_not_supported", "text", "reason why the data do not support modulus_pa"),
    ResultColumn("photos", "text", "paths of photos within the survey; empty: none"),
    ResultColumn("use", "text", "use of the diagnosed modulus: design, with-care or do-not-use"),
    ResultColumn("use_reason", "text", "reason for that use, one sentence; empty: not diagnosed"),
)
"""Columns of the table of points, in their order, and properties of a point in every other format.
"""
