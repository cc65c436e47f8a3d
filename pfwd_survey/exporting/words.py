"""A result in words, with everything that a modulus must not be shown without."""

from pfwd_survey.exporting.rows import Row


def result_words(row: Row) -> str:
    """The result of a drop on one line, units shown."""
    values = row.values
    if values["modulus_pa"] is None:
        reason = values["reason"] or "; ".join(values["warnings"]) or "no modulus"
        return f"{values['status']} ({reason})"
    parts = [f"{values['status']}, E = {values['modulus_pa'] / 1e6:.4g} MPa"]
    if values["modulus_sd_pa"] is not None:
        parts.append(f"sd {values['modulus_sd_pa'] / 1e6:.2g} MPa")
    low, high = values["modulus_interval_low_pa"], values["modulus_interval_high_pa"]
    if low is not None and high is not None:
        parts.append(f"95 % {low / 1e6:.4g} to {high / 1e6:.4g} MPa")
    parts.append(f"model {values['model']}")
    parts.append(f"plate radius {values['plate_radius_m']:g} m")
    parts.append(f"Poisson's ratio {values['poisson_ratio']:g}")
    parts.append("warnings: " + ("; ".join(values["warnings"]) or "none"))
    return ", ".join(parts)
