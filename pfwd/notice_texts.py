"""English sentences of the warnings about setups, drops and files; `inversion.notices` fills them.

A stored result is used again only if its warnings about setup and drop are equal. A reworded
sentence therefore makes stored results with this warning stale: they are computed again.
"""

from inversion.notice_texts import Template

STIFFNESS_TEST = "stiffness test: the weight fell on a rig of springs, so there is no modulus"
"""Warning, and reason why a drop is not inverted."""

TEMPLATES: dict[str, str] = {
    # of a setup
    "stiffness-test": STIFFNESS_TEST,
    "plate-mass-not-declared": Template("plate_mass_kg is not declared: taken as 0"),
    "plate-mass-too-small": Template(
        "plate_mass_kg = {plate_mass_kg:g} is less than a plate of radius {plate_radius_m:g} m "
        "weighs: the modulus may be read a third too low. Declare what moves between load cell "
        "and ground, usually 5 to 25 kg for a radius of 0.15 m"
    ),
    "geophone-not-declared": Template(
        "response of the geophone is not declared: taken as none; a geophone of 4.5 Hz reads the "
        "peak of a 17 ms pulse up to 18 % too low and the modulus 10 to 30 % too high. Declare "
        "geophone_natural_frequency_hz and geophone_damping, or 0 Hz where the record is corrected"
    ),
    "plate-radius-suspect": Template(
        "units suspect: plate_radius_m = {plate_radius_m:g} (in metres?)", "record"
    ),
    "header-key-unknown": "header key {key} is not known to the format: kept, not used",
    "poisson-ratio-not-declared": "Poisson's ratio is not declared: taken as {poisson_ratio:g}",
    # of a drop
    "drop-incomplete": (
        "incomplete record: {missing:d} of {samples:d} samples are missing, the first at "
        "{first_missing_s:.1f*1000} ms; the unbroken part was used"
    ),
    "load-clipped": "clipped samples: load, {samples:d} in a flat top",
    "sensor-clipped": (
        "clipped samples: {quantity:words} at {offset_m:g} m, {samples:d} in flat tops"
    ),
    "time-axis-suspect": Template(
        "time axis suspect: the pulse lasts {pulse_duration_s:.2g*1000} ms, on a plate of radius "
        "{plate_radius_m:g} m usually 11 to 30 ms; check the sampling rate",
        "record",
    ),
    "load-suspect": Template(
        "units suspect: peak load {peak_load_n:.3g/1000} kN (in N?)", "record"
    ),
    "deflection-suspect": Template(
        "units suspect: {quantity:words} at {offset_m:g} m deflects by "
        "{deflection_m:.3g*1000} mm (in {unit}?)",
        "record",
    ),
    "polarity-suspect": Template(
        "polarity suspect: {quantity:words} at {offset_m:g} m moves upward under the load"
    ),
    "sensor-dead": "dead extra channel: {quantity:words} at {offset_m:g} m, {fault}; left out",
    "sensor-bad": (
        "bad sensor: {quantity:words} at {offset_m:g} m: {faults:terms}; left out of the inversion"
    ),
    "partial-drop": (
        "partial drop: peak load {peak_load_n:.3g/1000} kN is {share:.0f*100}% of the largest of "
        "this point ({largest_load_n:.3g/1000} kN)"
    ),
    # of a stored result
    "declaration-changed": (
        "the result was computed with {key} = {then:g}, but {now:g} is declared now: invert again"
    ),
    "modulus-withheld": "modulus withheld: the result lacks {missing:list}; invert again",
    "sensors-without-index": "bad sensors, left out of the indices: {places:list}",
    "declarations-changed": (
        "declared values have changed since the stored result: inverted again"
    ),
    "modulus-of-lowest-medium": "modulus E is that of the lowest medium, below the layers",
    "modulus-of-lowest-medium-judged": (
        "modulus E is that of the lowest medium, below the layers; the average and a target refer "
        "to it, and drops that leave it open take no part"
    ),
    "media-differ": (
        "the drops of the point have {media} media, and their moduli differ in meaning"
    ),
    # of a diagnosis
    "drop-rejected": "drop {drop:d}: {reason}",
    "no-measured-drop": "no measured drop to diagnose",
    "modulus-left-open": (
        "the records do not determine the modulus: every value from {low_pa:.2p/1e6} to "
        "{high_pa:.2p/1e6} MPa fits; declare the depth of rock if it is known, add sensors or "
        "record longer"
    ),
    "rig-not-explained": (
        "a mass on a spring leaves {residual_over_peak:.1f*100} % of the peak displacement: "
        "friction, a second contact, a spring that is no straight line"
    ),
    "held-out-failed": ("nothing is predicted without part {part:d} ({mode}): {reason}"),
    "device-contradicted": (
        "{effect}: expected {parameter:words} {shared:.3g}{unit} as by all points of the device, "
        "got {own:.3g}{unit} by this point alone: it contradicts them"
    ),
    # of a calibration
    "no-centre-trace": "{drop}: no trace of a sensor in the centre, left out",
    "survey-damaged": "damaged survey: {damage}",
    # of an import: what a reader of another program's file did
    "stored-traces": (
        "load and displacement are those that the maker's software processed and stored"
    ),
    "peaks-imported": "peaks as another program recorded them; the file has no time history",
    "sensor-at-same-place": (
        "a second sensor at {offset_m:g} m is left out: on the other side of the plate it would be "
        "negative"
    ),
    "load-from-pressure": (
        "{file}: load from the pressure and a plate of radius {plate_radius_m:g} m"
    ),
    "load-from-pressure-on-plates": (
        "{file}: load from the pressure and a plate of radius {radii} m"
    ),
    "plate-radius-assumed": (
        "{file}, line {line:d}: the plate radius is 0, {plate_radius_m:g} m was assumed; declare "
        "another one as plate_radius_m with --header"
    ),
    "plate-diameter-taken": (
        "{file}, line {line:d}: LoadPlateRadius {diameter_m:.3g} is the diameter in m, not a "
        "radius in mm, and loads are pressures in kPa, not kN, as this viewer writes them"
    ),
    "sensors-without-position": (
        "{file}, line {line:d}: {positions:d} sensor positions, but {deflections:d} deflections: "
        "the largest deflection was taken for the centre, {left_out:d} without a position were "
        "left out; declare all positions as sensor_offsets_m with --header"
    ),
    "positions-not-declared": (
        "sensor positions are not declared: the first sensor was taken for the centre, the others "
        "were left out; declare sensor_offsets_m with --header (sensors in the file: {sensors})"
    ),
    "thousands-joined": (
        "{file}, line {line:d}: numbers with a comma between the thousands; they were read as one "
        "number each{more:more}"
    ),
    "drop-columns-suspect": (
        "{file}, line {line:d}: {deflections:d} deflections, {positions:d} positions in line 5020, "
        "and the largest deflection is not at the plate: it was left out{more:more}"
    ),
    "deflections-without-position": (
        "{file}, line {line:d}: {deflections:d} deflections, {positions:d} positions in line 5020: "
        "deflection {columns:list} was left out{more:more}"
    ),
    "deflections-missing": (
        "{file}, line {line:d}: {deflections:d} deflections, {positions:d} positions in line 5020: "
        "the last sensors are missing{more:more}"
    ),
    "drop-cut-off": (
        "{file}, line {line:d}: the file is cut off within this drop: it was left out{more:more}"
    ),
    "line-not-read": (
        "{file}, line {line:d}: not read, because it does not begin with a number{more:more}"
    ),
    "time-histories-not-read": "{file}: {lines:d} lines with time histories were not read",
    "text-not-utf-8": ("{file}, line {line:d}: not UTF-8, read as Windows-1252"),
    "json-not-utf-8": ("{file}: not UTF-8, which JSON requires, read as Windows-1252"),
    "sign-not-escaped": "{file}, line {line:d}: {sign} is not escaped, and was read as text",
    "signs-not-escaped": (
        "{file}, line {line:d}: {sign} is not escaped, as at {more_places:d} more places, and was "
        "read as text"
    ),
    "raw-accelerations": ("the raw channels are accelerations, so the stored traces were used"),
    "traces-without-point": (
        "{file}: no point of the database has these traces, so their point has no name"
    ),
    "drop-without-peaks": "{file}, drop {drop:d}: no peaks, left out",
    "rate-of-database": (
        "{file}: {samples:d} samples without a sampling rate; {rate_hz:g} Hz of the database was "
        "used, which states {database_samples:d} samples: declare another rate as sampling_rate_hz"
        " with --header"
    ),
    "rate-of-traces": (
        "{file}: the traces state {rate_hz:g} Hz and {samples:d} samples, {database} states "
        "{database_rate_hz:g} Hz; those of the traces were used"
    ),
    "rate-and-samples-of-traces": (
        "{file}: the traces state {rate_hz:g} Hz and {samples:d} samples, {database} states "
        "{database_rate_hz:g} Hz and {database_samples:d} samples; those of the traces were used"
    ),
    # of an import: peaks that another program stored, against those of the traces
    "stored-drops-differ": (
        "{file}: peaks of {stored_drops:d} drops, {drops:d} drops in the {traces:words}"
    ),
    "traces-identical": (
        "{file}: the {traces:words} of all {drops:d} drops are the same, number for number: one "
        "drop was stored in place of each"
    ),
    "stored-load-differs": (
        "{file}: peak load of the {traces:words} is {deviation:+.1f*100} % off what the maker's "
        "software stored"
    ),
    "stored-deflection-differs": (
        "{file}: peak deflection of the {traces:words} is {deviation:+.1f*100} % off what the "
        "maker's software stored"
    ),
    "stored-deflection-earlier": (
        "{file}: the peak deflection that the maker's software stored is a maximum of the "
        "{traces:words}, which are larger later: they drift"
    ),
    "stored-peaks-smoothed": (
        "{file}: peaks that the maker's software stored are those of smoothed channels (low-pass "
        "of {cutoff_hz:g} Hz, {poles:d} poles); smoothed alike these agree within "
        "{tolerance:g*100} %, as recorded they do not"
    ),
    "peaks-file-not-read": "{file}: not read: {reason}",
    "peaks-file-without-station": "{file}: no drops of this station",
    "peaks-file-drops-differ": (
        "{file}: {file_drops:d} drops of this station, {drops:d} in the .THY"
    ),
    "peaks-file-load-differs": (
        "{file}, line {line:d}: load {file_load_n:.2f/1000} kN, in the .THY {load_n:.2f/1000}"
    ),
    "peaks-file-deflection-differs": (
        "{file}, line {line:d}: peak of sensor {sensor:d} is up to {difference_m:.0f*1e6} um off "
        "that of the time history"
    ),
}

TERMS: dict[str, str] = {
    "drift": "it ends far from rest, unlike the others",
    "against the others": "it moves more than the sensors nearer to the plate",
    "no contact": "it stands still between two that move: no contact with the ground?",
}
"""Phrases for the faults of a sensor, by their name in `inversion.measured.bad_sensors`."""
