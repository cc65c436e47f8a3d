"""``pfwd schema``: print the JSON Schema of a file that users write."""

import argparse
import json

from simulators.instrument.scenario import scenario_schema


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd schema`` and its description to the parser."""
    from pfwd.schemas import schema_names

    parser.description = (
        "Prints the JSON Schema of a file. An editor for TOML completes and checks the file by it: "
        "write the schema beside the file and begin the file with #:schema ./setup.schema.json."
    )
    parser.add_argument("name", choices=[*schema_names(), "scenario"], help="kind of file")


def run(args: argparse.Namespace) -> int:
    """Print the JSON Schema of one kind of file."""
    from pfwd.schemas import json_schema

    schema = scenario_schema() if args.name == "scenario" else json_schema(args.name)
    print(json.dumps(schema, indent=2, ensure_ascii=False))
    return 0
