"""`drake-nonstop schema`: a JSON Schema of scenario files, for editors."""

import argparse
import json
import sys
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.scenario.json_schema import custom_tags, scenario_schema
from drake_nonstop.studies.files import replacing_file, require_writable


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "schema",
        help="write a JSON Schema of scenario files, by which editors complete and check them",
        description="Writes a JSON Schema. An editor with YAML's language server uses it for files "
        "that begin with `# yaml-language-server: $schema=FILE`; its setting `yaml.customTags` has "
        "to know the blocks, see --tags.",
    )
    parser.set_defaults(action=_schema)
    parser.add_argument("--out", type=Path, metavar="FILE", help="(the terminal)")
    parser.add_argument(
        "--tags", action="store_true", help="the value of yaml.customTags in place of the schema"
    )


def _schema(options: argparse.Namespace) -> int:
    found = custom_tags() if options.tags else scenario_schema()
    text = json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if options.out is None:
        sys.stdout.write(text)
        return 0
    require_writable(options.out.parent, [options.out.name])
    with replacing_file(options.out) as file:
        file.write(text.encode())
    print(f"written: {options.out}")
    return 0
