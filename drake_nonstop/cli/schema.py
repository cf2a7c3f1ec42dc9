"""`drake-nonstop schema`: a JSON Schema of scenario files, for editors."""

import argparse
import json
import sys
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust
from drake_nonstop.scenario.json_schema import custom_tags, scenario_schema
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies.files import replacing_file, require_writable_file


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
    parser.add_argument(
        "scenarios",
        nargs="*",
        metavar="NAME|FILE.yaml",
        help="with the blocks of your own that these scenarios have, see --trust",
    )
    add_trust(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="(the terminal)")
    parser.add_argument(
        "--tags", action="store_true", help="the value of yaml.customTags in place of the schema"
    )


def _schema(options: argparse.Namespace) -> int:
    scenarios = [load_scenario(name, trust=options.trust) for name in options.scenarios]
    found = custom_tags(scenarios) if options.tags else scenario_schema(scenarios)
    text = json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if options.out is None:
        sys.stdout.write(text)
        return 0
    require_writable_file(options.out)
    with replacing_file(options.out) as file:
        file.write(text.encode())
    print(f"written: {options.out}")
    return 0
