"""The columns of a table of results: names with their units, kinds and meanings."""

from typing import Literal, NamedTuple

Kind = Literal["text", "whole", "number", "flag", "texts"]


class Column(NamedTuple):
    """One column."""

    name: str
    """With the SI unit at its end."""
    kind: Kind
    """texts: several, joined by ``"; "`` where a cell holds one text."""
    meaning: str


COLUMNS = (
    Column("survey_id", "text", "identity of the survey"),
    Column("point", "text", "test point, as it was named last"),
    Column("drop", "whole", "number of the drop within the point"),
    Column("record", "whole", "number of the drop within the survey"),
    Column("discarded", "flag", "whether the drop or its point was discarded"),
    Column("time_utc", "text", "when, ISO 8601"),
    Column("latitude", "number", "degrees, north positive"),
    Column("longitude", "number", "degrees, east positive"),
    Column("altitude_m", "number", "m"),
    Column("site", "text", ""),
    Column("operator", "text", ""),
    Column("device", "text", ""),
    Column("peak_load_n", "number", "measured, N"),
    Column("peak_displacement_m", "number", "measured in the centre, m"),
    Column("target_pa", "number", "target modulus, Pa"),
    Column("status", "text", "measured, seating, rejected, or no result"),
    Column("reason", "text", "why it was rejected, or why there is no result"),
    Column("method", "text", "how the parameters were searched"),
    Column("model", "text", "layer or half-space"),
    Column("modulus_pa", "number", "Young's modulus, Pa"),
    Column("modulus_sd_pa", "number", "its standard deviation, random part, Pa"),
    Column("modulus_interval_low_pa", "number", "its 95 % interval, model error included, Pa"),
    Column("modulus_interval_high_pa", "number", "its 95 % interval, model error included, Pa"),
    Column("viscosity_pa_s", "number", "Pa s"),
    Column("viscosity_sd_pa_s", "number", "Pa s"),
    Column("density_kg_m3", "number", "kg/m3"),
    Column("density_sd_kg_m3", "number", "kg/m3; empty: given, not fitted"),
    Column("bedrock_depth_m", "number", "m; empty: not in the model"),
    Column("bedrock_depth_sd_m", "number", "m; empty: given, not fitted"),
    Column("bedrock_depth_interval_low_m", "number", "95 %, m"),
    Column("bedrock_depth_interval_high_m", "number", "95 %, m"),
    Column("modulus_depth_correlation", "number", ""),
    Column("poisson_ratio", "number", "of the ground"),
    Column("plate_radius_m", "number", "m"),
    Column("plate", "text", "contact of plate and ground"),
    Column("load", "text", "measured or half-sine"),
    Column("half_sine_peak_pressure_pa", "number", "Pa"),
    Column("half_sine_duration_s", "number", "s"),
    Column("half_sine_rms_over_peak", "number", ""),
    Column("peak_modulus_pa", "number", "of the peak method, for comparison, Pa"),
    Column("peak_factor", "number", "shape factor of the peak method"),
    Column("r_squared", "number", ""),
    Column("noise_rms_m", "number", "m"),
    Column("residual_rms_over_peak", "number", "trigger to end of record"),
    Column("contact_residual_rms_over_peak", "number", "contact phase"),
    Column("explained", "flag", "whether the residual is within noise and model error"),
    Column("converged", "flag", ""),
    Column("at_bound", "texts", "parameters on a bound"),
    Column("seed", "whole", ""),
    Column("warnings", "texts", ""),
    Column("notes", "texts", "of the drop and of its point"),
)
