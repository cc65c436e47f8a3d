"""English sentences of the inversion's warnings, by the code of the warning.

`inversion.notices` inserts the values. The sentences are in a module of their own, so that a stored
result can be read without importing the inversion. When a sentence is changed, its earlier form is
added to `EARLIER`, because stored results contain it.
"""

from typing import Literal

Invalidates = Literal["nothing", "fit", "record"]
"""What a warning forbids as the basis of a verdict: "fit" is a fitted modulus, which may look right
although a declaration or the model is wrong; "record" is every value of the drop, a diagnosed
modulus and the peaks included."""


class Template(str):
    """Sentence of a warning that invalidates the fitted modulus or the whole record of a drop.

    A plain `str` as a template invalidates nothing.

    Parameters
    ----------
    text : str
    invalidates : "fit" or "record"
    """

    invalidates: Invalidates

    def __new__(cls, text: str, invalidates: Invalidates = "fit") -> "Template":
        """Return the sentence with its meaning for a verdict."""
        template = super().__new__(cls, text)
        template.invalidates = invalidates
        return template


TEMPLATES: dict[str, str] = {
    # of a result
    "parameter-on-bound": Template("{parameter:words} sits on a bound of the search"),
    "residual-not-explained": Template(
        "residual not explained: over the fit it is {residual_over_noise:.1f} times the noise and "
        "the model's error together ({residual_over_peak:.1f*100} % of the peak); the model lacks "
        "an effect that may change the modulus: diagnose the point"
    ),
    "tail-not-explained": Template(
        "record after the contact not explained: {tail_over_peak:.1f*100} % of the peak is left "
        "where the load has gone, while the contact fits. The plate left the ground, the ground "
        "is layered, or geophone, plate mass, plate radius, load gain or time axis is not as "
        "declared; the interval of the modulus does not cover this"
    ),
    "not-converged": Template("the fit did not converge"),
    "density-suspect": Template(
        "density suspect: expected {usual_kg_m3:.0f} kg/m3 as soils have, got "
        "{density_kg_m3:.0f} kg/m3; check what is declared of load gain, plate radius, plate "
        "mass, time axis and geophone"
    ),
    "depth-not-unique": (
        "depth not unique: the data allow bedrock from {depth_low_m:.2g} m to {depth_high_m:.2g} "
        "m; the interval of the modulus covers them"
    ),
    "subgrade-modulus-unknown": (
        "modulus of the subgrade not known: {modulus_interval_pa:.2p/1e6} MPa fit as well; the "
        "effective modulus, {effective_modulus_pa:.3g/1e6} MPa, stands for the upper "
        "{effective_depth_m:.2g} m; sensors further out can resolve the layers"
    ),
    "layer-modulus-unknown": (
        "modulus of layer {layer:d} not known: {modulus_interval_pa:.2p/1e6} MPa fit as well"
    ),
    "layers-from-one-sensor": (
        "layers from the centre sensor alone: many other layers deflect the plate alike; the "
        "intervals hold them, the values are one choice"
    ),
    "layers-chosen": "layers chosen: {media:d} of 1 to {most_media:d} tried",
    "layers-chosen-by-sensors": (
        "layers chosen: {media:d} of 1 to {most_media:d} tried; a sensor that was left out is "
        "missed by, of its peak, {errors:list}"
    ),
    "layers-need-sensors": (
        "one sensor cannot resolve layers: the modulus is that of homogeneous ground, and its "
        "interval includes ground below a layer that fits as well; add sensors further out"
    ),
    # of a diagnosis
    "effect-on-bound": "{effect}: {parameter} sits on a bound",
    "effect-ambiguous": "{effect} cannot be distinguished from {others:list}",
    "modulus-uncertain": (
        "the modulus is only known to be {modulus_interval_pa:.3g/1e6} MPa: several sets of "
        "effects fit nearly as well"
    ),
    "discrepancy-remains": (
        "residual not explained: {discrepancy_over_peak:.2g*100} % of the peak is left that no "
        "effect explains, at most {limit:.2g*100} % is allowed"
    ),
    "noise-exceeded": (
        "residual not explained: expected noise alone, got {residual_over_noise:.1f} times the "
        "noise"
    ),
    "load-steps": (
        "drop {drop:d}, load: the record steps {after_s:.1f*1000} ms into the pulse, where no "
        "weight could: samples are missing, or its range was switched; measure again"
    ),
    "sensor-steps": (
        "drop {drop:d}, sensor at {offset_m:g} m: the record steps {after_s:.1f*1000} ms into the "
        "pulse, where no motion could: samples are missing, or its range was switched; measure "
        "again"
    ),
    "sensor-upside-down": (
        "sensor at {offset_m:g} m: upside down, {residual_over_peak:.2g*100} % of the peak is left "
        "in place of {residual_declared_over_peak:.2g*100} %, with E {modulus_pa:.2p/1e6} MPa; "
        "check its polarity"
    ),
    "sensors-exchanged": (
        "sensors at {near_m:g} and {far_m:g} m: exchanged, {residual_over_peak:.2g*100} % of the "
        "peak is left in place of {residual_declared_over_peak:.2g*100} %, with E "
        "{modulus_pa:.2p/1e6} MPa; check their order and their cables"
    ),
    "bedrock-contradicted": (
        "bedrock at {declared_m:g} m: with the depth left open, {residual_over_peak:.2g*100} % of "
        "the peak is left in place of {residual_declared_over_peak:.2g*100} %, with E "
        "{modulus_pa:.2p/1e6} MPa; check the declared depth"
    ),
    "bedrock-elsewhere": (
        "bedrock at {declared_m:g} m: with the depth left open, {residual_over_peak:.2g*100} % of "
        "the peak is left in place of {residual_declared_over_peak:.2g*100} %, with E "
        "{modulus_pa:.2p/1e6} MPa and bedrock at {depth_m:.2g} m; check the declared depth"
    ),
    "too-many-effects": (
        "{effects:d} effects at once fit this residual, but would fit almost any: measure again, "
        "with more drops or sensors"
    ),
    # of a diagnosis by earlier versions: stored results have them
    "ground-on-bound": "{parameter:words} of the ground sits on a bound",
    "noise-exceeded-by-several": (
        "residual not explained: expected at most {limit:g} times the noise of several effects, "
        "got {residual_over_noise:.2f} times with {effects:d} effects at once"
    ),
    "residual-unlike-noise": (
        "residual not explained: what is left is small, but not like the noise"
    ),
    "effect-past-bounds": "an effect that would go on past its bounds is no explanation",
    "parameter-unusual": (
        "{effect}: expected a {parameter:words} of {usual:g}{unit} as instruments in use have, got "
        "{value:.3g}{unit}: it stands in for another cause"
    ),
    "layer-fills-ground": (
        "layer: {thickness_m:.2g} m of it leave {left_m:.2g} m of ground above the rock: something "
        "else is behind it, as another depth of the rock"
    ),
    "layer-not-felt": (
        "layer: what lies under {thickness_m:.2g} m of {modulus_ratio:.2g} times its modulus "
        "changes the plate's deflection by less than {least:g*100} %: something else is behind it"
    ),
    "rig-not-ringing": (
        "spring_rig: {damping_ratio:.2g} of the critical damping is that of ground, springs ring "
        "with less than {limit:g}: it stands in for another cause"
    ),
    "effects-leave-modulus-open": (
        "not taken over, as it leaves the modulus open by more than a factor of {factor:g}: "
        "{effects} came nearest"
    ),
    "effects-leave-residual": (
        "not taken over, as it leaves more than half of the residual or runs into a bound: "
        "{effects} came nearest"
    ),
}

EARLIER: tuple[tuple[str, str], ...] = (
    (
        "residual-not-explained",
        "residual not explained: over the fit it is {residual_over_noise:.1f} times the noise and "
        "the model's error together ({residual_over_peak:.1f*100} % of the peak); the model lacks "
        "an effect, so do not take the modulus for corrected",
    ),
    (
        "subgrade-modulus-unknown",
        "modulus of the subgrade not known: {modulus_interval_pa:.2p/1e6} MPa fit as well; the "
        "effective modulus, {effective_modulus_pa:.3g/1e6} MPa, stands for the upper "
        "{effective_depth_m:.2g} m; sensors further out tell the layers apart",
    ),
    (
        "layers-need-sensors",
        "one sensor does not tell layers: the modulus is that of one medium for all, and its "
        "interval holds the ground below a layer that fits as well; sensors further out tell",
    ),
    ("effect-ambiguous", "{effect} cannot be told from {others:list}"),
    (
        "modulus-uncertain",
        "the modulus is known no better than {modulus_interval_pa:.3g/1e6} MPa, with the effects "
        "that cannot be told apart",
    ),
    (
        "discrepancy-remains",
        "residual not explained: {discrepancy_over_peak:.2g*100} % of the peak is left that no "
        "effect tells, at most {limit:.2g*100} % is allowed",
    ),
    (
        "parameter-unusual",
        "{effect}: {value:.3g}{unit} is the {parameter:words} of no instrument in use ({usual:g}"
        "{unit}): it stands in for another cause",
    ),
    (
        "noise-exceeded",
        "residual not explained: {residual_over_noise:.1f} times the noise is left",
    ),
    (
        "noise-exceeded-by-several",
        "residual not explained: {residual_over_noise:.2f} times the noise is left by {effects:d} "
        "effects at once, where several may leave {limit:g}",
    ),
    (
        "density-suspect",
        "density suspect: {density_kg_m3:.0f} kg/m3 was fitted, soils have {usual_kg_m3:.0f} "
        "kg/m3; check what is declared of load gain, plate radius, plate mass, time axis and "
        "geophone",
    ),
)
