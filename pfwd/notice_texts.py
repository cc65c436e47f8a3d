"""English sentences of warnings about setups, drops and files, and of reasons of verdicts.

`inversion.notices` inserts the values.
"""

from inversion.notice_texts import Template

TEMPLATES: dict[str, str] = {
    # of a setup
    "stiffness-test": (
        "stiffness test: the weight fell on a rig of springs, so there is no modulus"
    ),
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
    "sensor-dead": (
        "dead extra channel: {quantity:words} at {offset_m:g} m, {fault:message}; left out"
    ),
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
    "drop-rejected": "drop {drop:d}: {reason:message}",
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
        "{effect:names}: expected {parameter:words} {shared:.3g}{unit} as by all points of the "
        "device, got {own:.3g}{unit} by this point alone: it contradicts them"
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

REASONS: dict[str, str] = {
    # why a drop is rejected
    "peaks-only": "peaks only: the file had no time history, which the dynamic inversion needs",
    "record-damaged": (
        "damaged record: {missing:d} of {samples:d} samples are missing, the first at "
        "{first_missing_s:.1f*1000} ms; repeat the drop"
    ),
    "record-unreadable": "damaged record: {fault}",
    "screening-failed": "could not be screened: {fault}",
    "rebound": (
        "false trigger: peak load {peak_load_n:.3g/1000} kN is {share:.0f*100}% of the largest of "
        "this point ({largest_load_n:.3g/1000} kN): a rebound or a knock"
    ),
    "no-pulse": "no pulse: the load changes by {change_n:.3g} N at most",
    "no-pulse-in-newton": (
        "no pulse: the load changes by {change_n:.3g} N at most (is the load in kN?)"
    ),
    "load-too-small": (
        "false trigger: peak load {peak_load_n:.3g/1000} kN, less than {least_n:.3g/1000} kN"
    ),
    "load-upward": (
        "load of the wrong polarity: {upward_n:.3g/1000} kN upward, downward is positive"
    ),
    "several-pulses": (
        "false trigger: {pulses:d} pulses above half of the peak load in one record; did the "
        "weight hit twice? catch it after the first blow"
    ),
    "pulse-end-missing": (
        "pulse cut off by the window: the load ends at {share:.0f*100}% of its peak"
    ),
    "pulse-start-missing": (
        "pulse cut off by the window: the load starts at {share:.0f*100}% of its peak"
    ),
    "pulse-too-short": (
        "false trigger: the load is above half its peak for {duration_s:.2g*1000} ms only"
    ),
    "no-centre-channel": "no centre channel: none of the sensors stands at offset 0",
    "no-centre-trace-of-drop": "no trace of a sensor in the centre",
    "centre-dead": "dead centre channel: {fault:message}",
    "centre-not-credible": "centre sensor cannot be believed: {fault:message}",
    "samples-copied": "its samples are those of drop {drop:d}, number for number",
    "moved": "moved to point {point}, drop {drop}",
    "no-drop": "no drop",
    # faults of a sensor
    "constant": "constant at {value:.6g}",
    "only-noise": "nothing above its own noise",
    "motion-too-small": "it moves by {deflection_m:.2g*1e6} um only",
    "moves-upward": "wrong polarity: it moves upward under the load, downward is positive",
    "stops-under-load": (
        "it stops at {deflection_m:.4g*1e6} um under the load: end of its stroke or of the range"
    ),
    "neighbours-deflect-more": (
        "both sensors next to it go down farther under the load, {share:.0f*100}% of it"
    ),
    "returns-too-early": ("it is back at {share:.0f*100}% of its peak while half of the load acts"),
    "negative-work": (
        "the load does negative work on it, {share:.0f*100}% of peak load times displacement"
    ),
    # marks of a record
    "cut-off": "cut off: {reason}",
    "samples-missing": (
        "{missing:d} of {samples:d} samples missing, the first at {first_missing_s:.1f*1000} ms"
    ),
    "saturated": "saturated: {samples:d} samples of {channel} at the end of the converter's range",
    "triggered-by-operator": "triggered by the operator",
    "shunt-was-on": "the calibration shunt was on",
    "buffered-before-restart": (
        "buffered before the instrument restarted: its time is that of the transfer"
    ),
    "not-buffered": "recorded from the stream, because the instrument did not store the drop",
    # of a check of the sensors
    "zero-too-large": (
        "zero of the load cell: expected at most {limit_n:.0f} N at rest, got {zero_n:.0f} N; take "
        "everything off the plate, then check the load cell and its cable"
    ),
    "span-not-checked": (
        "span of the load cell: not checked, because the instrument did not switch its calibration "
        "shunt on"
    ),
    "span-off": (
        "span of the load cell: expected {shunt_n:.0f} N from the shunt, got {reading_n:.0f} N; "
        "calibrate the load cell again"
    ),
    "shunt-stays-on": (
        "the calibration shunt is still on {limit_s:.0f} s after it was switched off: drops cannot "
        "be recorded. Switch the instrument off and on again"
    ),
    "channel-constant": (
        "channel {channel}: expected at least the noise of the converter, got the constant value "
        "{value:d}; check its cable"
    ),
    # why a drop is not averaged
    "rejected": "rejected: {reason:message}",
    "discarded": "discarded",
    "discarded-because": "discarded: {reason:message}",
    "seating-drop": "seating drop",
    "seating-drop-of": "seating drop {number:d} of {required:d}",
    "beyond-measured": "beyond the {required:d} measured drops",
    "value-too-small": "{quantity:words} {value:.3g} {unit}, less than {limit:.3g} {unit}",
    "value-too-large": "{quantity:words} {value:.3g} {unit}, more than {limit:.3g} {unit}",
    "values-too-small": (
        "{quantity:words} less than {limit:.3g} {unit} (not verified, not enforced)"
    ),
    "values-too-large": (
        "{quantity:words} more than {limit:.3g} {unit} (not verified, not enforced)"
    ),
    # preconditions of a procedure
    "tolerance": "within {tolerance:.3g*100} %",
    "our-tolerance": "within {tolerance:.3g*100} %, our tolerance",
    "plate-wrong": (
        "wrong plate: radius {radius_m:g} m, this procedure needs {needed_m:g} m "
        "({tolerance:message})"
    ),
    "plates-differ": (
        "its drops were measured with plates of {smallest_m:g} m and {largest_m:g} m radius"
    ),
    "sensor-on-ground": (
        "the centre sensor is on the ground, this procedure needs it on the plate"
    ),
    "sensor-on-plate": (
        "the centre sensor is on the plate, this procedure needs it on the ground; if it is there, "
        "declare centre_sensor"
    ),
    "drop-height-wrong": (
        "wrong drop height: {load_n:.3g/1000} kN, this procedure needs {needed_n:.3g/1000} kN "
        "({tolerance:message})"
    ),
    "to-repeat": "{fault:message}; discard and repeat it",
    # why the data do not support a value
    "record-copied": "its record is a copy of that of drop {drop:d}",
    "record-copied-from-point": ("its record is a copy of that of drop {drop} of point {point}"),
    "record-contradicts-file": "the record contradicts the peak that its file stores",
    "sampling-rate-wrong": "the sampling rate was {deviation:.1f*100} % off the declared one",
    "residual-too-large": (
        "the model leaves {residual:.2g*100} % of the peak, at most {limit:.3g*100} % is allowed"
    ),
    # use of a diagnosed modulus
    "modulus-open": "the diagnosis leaves the modulus open",
    "record-is-clean": "the record is clean and the interval is narrow",
    "record-is-explained": "the record is explained and the interval is narrow",
    "interval-too-wide": (
        "the interval of the modulus reaches {reach:.2p*100} % from it, at most {limit:.2p*100} % "
        "is allowed"
    ),
    "interval-spans": "the interval of the modulus spans more than a factor of {factor:g}",
    "unexplained-too-much": (
        "{share:.2p*100} % of the peak is unexplained (allowance included), at most "
        "{limit:.2p*100} % is permitted"
    ),
    "unexplained-covered": (
        "{share:.2p*100} % of the peak is unexplained (allowance included), the interval covers it"
    ),
    # notes on a judgement
    "unverified-in-formula": "used in the formula without being verified: {numbers:terms}",
    "unverified": "not verified, hence not enforced: {numbers:terms}",
    "one-measured-drop": "one drop: the scatter between drops is not in the interval",
    "diagnosed-not-used": "the diagnosed modulus is not used: {reason:message}",
    "modulus-diagnosed": "{quantity:terms} is the diagnosed one, {modulus_mpa:digits} MPa",
    "modulus-diagnosed-and-fitted": (
        "{quantity:terms} is the diagnosed one, {modulus_mpa:digits} MPa; that of the fits is "
        "{fitted_mpa:digits} MPa"
    ),
    "spread-too-large": ("{spread:terms} is {value:.1f*100}%, at most {limit:.1f*100}% is allowed"),
    "not-enforced": "{fault:message} (not verified, not enforced)",
    "below-range": "{quantity:terms} is below the range of the method ({limit_pa:g/1e6} MPa)",
    "above-range": "{quantity:terms} is above the range of the method ({limit_pa:g/1e6} MPa)",
    "target-is-deflection": (
        "the target is a deflection, the procedure judges a modulus: not compared"
    ),
    "target-is-modulus": (
        "the target is a modulus, the procedure judges a deflection: not compared"
    ),
    "s-over-v-too-large": (
        "s/v is {s_over_v_s:.2f*1000} ms, above {limit_s:.2f*1000} ms: more compaction is possible"
    ),
    "poisson-ratio-assumed": "Poisson's ratio {poisson_ratio:g} is assumed",
    # source of a target
    "target-of-point": "of the point",
    "target-of-station": "of the station",
    "target-of-survey": "of the survey",
    "target-of-report": "given with the report",
    # why a verdict is as it is
    "no-target": "there is no target",
    "drops-missing": "measured drops are missing",
    "not-supported": "{quantity:terms} is not supported by the data: {reason:message}",
    "no-equivalent-modulus": (
        "no equivalent modulus: no sensor is on the plate, or the data leave it open"
    ),
    "value-missing": "a measured drop lacks what is judged: discard and repeat it",
    "modulus-without-interval": "the modulus has no interval",
    "interval-needs-drops": (
        "an interval needs {needed:d} measured drops, the point has {drops:d}"
    ),
    "target-reached": "the whole 95 % interval reaches the target",
    "target-missed": "the whole 95 % interval misses the target",
    "target-within-interval": "the target lies within the 95 % interval",
    "point-discarded": "the point is discarded",
    "verdict-pending": "its verdict is pending: the diagnosis of the point is under way",
}
"""Reasons why a drop is rejected or not averaged, a value is not supported, and a verdict is as it
is; with the notes on a judgement, and the parts of these sentences."""

TERMS: dict[str, str] = {
    "drift": "it ends far from rest, unlike the others",
    "against the others": "it moves more than the sensors nearer to the plate",
    "no contact": "it stands still between two that move: no contact with the ground?",
    # quantities that a procedure judges
    "E_vd": "E_vd",
    "E_LWD": "E_LWD",
    "modulus": "the modulus",
    "equivalent-modulus": "the equivalent modulus",
    "deflection": "the deflection",
    "poisson_ratio": "Poisson's ratio",
}
"""Phrases for faults of a sensor, by their name in `inversion.measured.bad_sensors`, and others."""
