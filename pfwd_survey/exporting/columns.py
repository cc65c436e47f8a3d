"""The columns of a table of results: names with their units, kinds and meanings."""

from typing import Literal, NamedTuple

from pfwd_survey.inverting.layer_columns import LAYER_COLUMNS, NUMBER

Kind = Literal["text", "whole", "number", "flag", "texts", "time"]


class ResultColumn(NamedTuple):
    """One column."""

    name: str
    """With the SI unit at its end."""
    kind: Kind
    """texts: several, joined by ``"; "`` where a cell holds one text; time: ISO 8601."""
    meaning: str


COLUMNS = (
    ResultColumn("survey_id", "text", "identity of the survey"),
    ResultColumn("point", "text", "test point, as it was named last"),
    ResultColumn("drop", "whole", "number of the drop within the point"),
    ResultColumn("record", "whole", "number of the drop within the survey"),
    ResultColumn("discarded", "flag", "whether the drop or its point was discarded"),
    ResultColumn("time_utc", "time", "when, ISO 8601"),
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
    ResultColumn("reason", "text", "why it was rejected, or why there is no result"),
    ResultColumn("method", "text", "how the parameters were searched"),
    ResultColumn("model", "text", "layer or half-space"),
    ResultColumn("modulus_pa", "number", "Young's modulus, Pa; of layers the lowest one's"),
    ResultColumn("modulus_sd_pa", "number", "its standard deviation, random part, Pa"),
    ResultColumn(
        "modulus_interval_low_pa", "number", "its 95 % interval, model error included, Pa"
    ),
    ResultColumn(
        "modulus_interval_high_pa", "number", "its 95 % interval, model error included, Pa"
    ),
    ResultColumn("viscosity_pa_s", "number", "Pa s"),
    ResultColumn("viscosity_sd_pa_s", "number", "Pa s"),
    ResultColumn("density_kg_m3", "number", "kg/m3"),
    ResultColumn("density_sd_kg_m3", "number", "kg/m3; empty: given, not fitted"),
    ResultColumn("bedrock_depth_m", "number", "m; empty: not in the model"),
    ResultColumn("bedrock_depth_sd_m", "number", "m; empty: given, not fitted"),
    ResultColumn("bedrock_depth_interval_low_m", "number", "95 %, m"),
    ResultColumn("bedrock_depth_interval_high_m", "number", "95 %, m"),
    ResultColumn("modulus_depth_correlation", "number", ""),
    ResultColumn("poisson_ratio", "number", "of the ground"),
    ResultColumn("plate_radius_m", "number", "m"),
    ResultColumn("plate", "text", "contact of plate and ground"),
    ResultColumn("load", "text", "measured or half-sine"),
    ResultColumn("half_sine_peak_pressure_pa", "number", "Pa"),
    ResultColumn("half_sine_duration_s", "number", "s"),
    ResultColumn("half_sine_rms_over_peak", "number", ""),
    ResultColumn("peak_modulus_pa", "number", "of the peak method, for comparison, Pa"),
    ResultColumn("peak_factor", "number", "shape factor of the peak method"),
    ResultColumn("r_squared", "number", ""),
    ResultColumn("noise_rms_m", "number", "m"),
    ResultColumn("residual_rms_over_peak", "number", "trigger to end of record"),
    ResultColumn("contact_residual_rms_over_peak", "number", "contact phase"),
    ResultColumn(
        "explained", "flag", "whether the residual is within noise and model error; not if clipped"
    ),
    ResultColumn("converged", "flag", ""),
    ResultColumn("at_bound", "texts", "parameters on a bound"),
    ResultColumn("seed", "whole", ""),
    ResultColumn("warnings", "texts", ""),
    ResultColumn("notes", "texts", "of the drop and of its point"),
    # Behind all others, so that whoever reads columns by their place is not disturbed.
    ResultColumn(NUMBER.name, "whole", NUMBER.meaning),
    *(ResultColumn(column.name, "number", column.meaning) for column in LAYER_COLUMNS),
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
        "the same with the declared response of the geophone taken out, m; procedures judge it",
    ),
    ResultColumn("procedure", "text", "by which the point is judged; none: no one was chosen"),
    ResultColumn("quantity", "text", "what it judges: E_vd, E_LWD, modulus or deflection"),
    ResultColumn("value", "number", "of the point, in the unit"),
    ResultColumn("interval_low", "number", "its 95 % interval"),
    ResultColumn("interval_high", "number", "its 95 % interval"),
    ResultColumn("unit", "text", "of value, interval and target: Pa or m"),
    ResultColumn("target", "number", "that counts for the point"),
    ResultColumn("verdict", "text", "of the point: pass, fail, undecided or none"),
)
