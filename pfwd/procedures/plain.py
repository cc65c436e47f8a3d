"""What counts where nobody chose a document: so many drops, or whatever was measured."""

from pfwd.procedures.profile import Procedure, Quantity
from pfwd.procedures.reading import parse_procedure

NO_PROCEDURE = Procedure(
    name="none",
    title="",
    source="",
    about="",
    quantity=Quantity.MODULUS,
    average="modulus",
)
"""Every measured drop is averaged, and the modulus of the inversion is judged."""

PLAIN = "plain"
"""Name of the procedure that nobody chose."""

SEATING, MEASURED = 3, 3
"""The usual procedure of portable deflectometers: three drops seat the plate, three count."""

_CHOSEN = "chosen for this survey, after no document"


def plain_procedure(seating: int = SEATING, measured: int = MEASURED) -> Procedure:
    """So many seating drops, so many measured ones, their mean modulus against a target."""
    source = f'source = "{_CHOSEN}"'
    text = (
        "pfwd-procedure = 1\n"
        f'name = "{PLAIN}"\n'
        'title = "seating drops, then measured drops"\n'
        f"{source}\n"
        'quantity = "modulus"\n'
        'average = "modulus"\n'
        "[drops]\n"
        f"seating = {{ value = {seating}, {source}, verified = true }}\n"
        f"measured = {{ value = {measured}, {source}, verified = true }}\n"
    )
    return parse_procedure(text, f"procedure {PLAIN}", shipped=True)
