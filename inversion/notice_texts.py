"""English sentences of the inversion's warnings, by the code of the warning.

`inversion.notices` inserts the values. The sentences are in a module of their own, so that a stored
result can be read without importing the inversion.
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
    # parts of sentences
    "more-of-that-kind": "; {count:d} more of that kind",
    "one-drop": "drop {numbers}",
    "several-drops": "drops {numbers}",
    "of-drops": "{drops:drops}: {message:message}",
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
    "layers-need-sensors": (
        "one sensor cannot resolve layers: the modulus is that of homogeneous ground, and its "
        "interval includes ground below a layer that fits as well; add sensors further out"
    ),
    # of a diagnosis
    "effect-on-bound": "{effect:names}: {parameter:names} sits on a bound",
    "effect-ambiguous": "{effect:names} cannot be distinguished from {others:names}",
    "modulus-uncertain": (
        "the modulus is only known to be {modulus_interval_pa:.3g/1e6} MPa: several sets of "
        "effects fit nearly as well"
    ),
    "discrepancy-remains": (
        "records not explained: {discrepancy_over_peak:.2g*100} % of the peak is unexplained "
        "(allowance included), at most {limit:.2g*100} % is permitted"
    ),
    "noise-exceeded": (
        "records not explained: the residual is {residual_over_noise:.1f} times the noise and the "
        "model's error together"
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
}
