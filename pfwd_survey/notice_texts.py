"""English sentences of warnings about setups, drops and files, see `inversion.notices`.

The sentences about setups and drops are part of what tells stored results apart: reworded, every
result that was stored with one is found again.
"""

STIFFNESS_TEST = "stiffness test: the weight fell on a rig of springs, so there is no modulus"
"""Also the reason why a drop is not inverted."""

TEMPLATES: dict[str, str] = {
    # of a setup
    "stiffness-test": STIFFNESS_TEST,
    "plate-mass-not-declared": "plate_mass_kg is not declared: taken as 0",
    "plate-mass-too-small": (
        "plate_mass_kg = {plate_mass_kg:g} is less than a plate of radius {plate_radius_m:g} m "
        "weighs: the modulus may be read a third too low. Declare what moves between load cell "
        "and ground, usually 5 to 25 kg for a radius of 0.15 m"
    ),
    "geophone-not-declared": (
        "response of the geophone is not declared: taken as none; a geophone of 4.5 Hz reads the "
        "peak of a 17 ms pulse up to 18 % too low and the modulus 10 to 30 % too high. Declare "
        "geophone_natural_frequency_hz and geophone_damping, or 0 Hz where the record is corrected"
    ),
    "plate-radius-suspect": "units suspect: plate_radius_m = {plate_radius_m:g} (in metres?)",
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
    "time-axis-suspect": (
        "time axis suspect: the pulse lasts {pulse_duration_s:.2g*1000} ms, on a plate of radius "
        "{plate_radius_m:g} m usually 11 to 30 ms; check the sampling rate"
    ),
    "load-suspect": "units suspect: peak load {peak_load_n:.3g/1000} kN (in N?)",
    "deflection-suspect": (
        "units suspect: {quantity:words} at {offset_m:g} m deflects by "
        "{deflection_m:.3g*1000} mm (in {unit}?)"
    ),
    "polarity-suspect": (
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
    "declaration-changed": "{key} was {then:g} for this result, {now:g} is declared by now",
    "modulus-withheld": "modulus withheld: the result lacks {missing:list}; invert again",
    "sensors-without-index": "bad sensors, left out of the indices: {places:list}",
    "declarations-changed": "declared values were changed since: inverted anew",
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
        "the records leave the modulus open, between {low_pa:.2p/1e6} and {high_pa:.2p/1e6} MPa: "
        "none is told; another declared depth, more sensors or a longer record may fix it"
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
    "device-left-out": (
        "the device of the other points leaves {with_device_over_peak:.2g*100} % of the peak here, "
        "the base model alone {without_device_over_peak:.2g*100} %: the record contradicts them, "
        "and is told by itself"
    ),
    # of a calibration
    "no-centre-trace": "{drop}: no trace of a sensor in the centre, left out",
    "survey-damaged": "damaged survey: {damage}",
}

TERMS: dict[str, str] = {
    "drift": "it ends far from rest, unlike the others",
    "against the others": "it moves more than the sensors nearer to the plate",
    "no contact": "it stands still between two that move: no contact with the ground?",
}
"""Phrases by the word of the fault, see `inversion.measured.bad_sensors`."""

EARLIER: tuple[tuple[str, str], ...] = (
    (
        "device-contradicted",
        "{effect}: {parameter:words} {own:.3g}{unit} by this point alone, {shared:.3g}{unit} by "
        "all points of the device: it contradicts them",
    ),
    ("modulus-left-open", TEMPLATES["modulus-left-open"]),  # numbers as 1.0
)
"""Sentences of earlier versions, which stored results have."""
