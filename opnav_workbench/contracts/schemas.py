"""JSON Schemas (draft 2020-12) of the kinds of files, made of their models, and written for editors and other programs.

A schema says less than ``opnav check``: what fields must be to each other is not in it.
"""

import re
from functools import cache
from pathlib import Path
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from opnav_workbench.contracts.kinds import KINDS, Kind
from opnav_workbench.files import make_folder, write_json
from opnav_workbench.format_versions import FORMAT_KEY, PRESENT_VERSION, PROMISE

__all__ = ["SCHEMAS_DIR", "schema_file", "schema_of", "write_schemas"]

SCHEMAS_DIR = Path(__file__).with_name("schemas")
DIALECT = "https://json-schema.org/draft/2020-12/schema"
SECTION = re.compile(
    r"\n\s*(?:Attributes|Parameters|Raises|Examples|References|Notes)\n\s*-{3,}.*", re.DOTALL
)


def schema_file(kind: Kind) -> str:
    """Return the name of a kind's schema file.

    Examples
    --------
    >>> schema_file(KINDS["night"])
    'night.schema.json'
    """
    return f"{kind.name}.schema.json"


@cache
def schema_of(kind: Kind) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file.

    Examples
    --------
    >>> schema_of(KINDS["night"])["required"]
    ['mission', 'images']
    """
    made = kind.model.model_json_schema(schema_generator=_Schema)
    newest = PRESENT_VERSION[kind.version]
    if kind.is_yaml:
        version = {"type": "integer", "minimum": 0, "maximum": newest, "default": newest}
        made["properties"] = {FORMAT_KEY: version, **made["properties"]}
    head = {
        "$schema": DIALECT,
        "$id": f"urn:opnav_workbench:{kind.name}:{newest}",
        "title": f"opnav_workbench {kind.what}",
        "$comment": PROMISE[kind.is_yaml],
    }
    return head | {key: value for key, value in made.items() if key != "title"}


def write_schemas(folder: Path) -> list[Path]:
    """Write the schema of every kind into a folder; return their paths.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    paths = [make_folder(folder) / schema_file(kind) for kind in KINDS.values()]
    for path, kind in zip(paths, KINDS.values(), strict=True):
        write_json(path, schema_of(kind))
    return paths


class _Schema(GenerateJsonSchema):
    """Schemas whose models tell the names and meanings of their fields from their docstrings."""

    def model_schema(self, schema: Any) -> dict[str, Any]:
        return _described(super().model_schema(schema), schema["cls"])

    def dataclass_schema(self, schema: Any) -> dict[str, Any]:
        return _described(super().dataclass_schema(schema), schema["cls"])


def _described(made: dict[str, Any], model: type[Any]) -> dict[str, Any]:
    """Take what a docstring says of fields to the fields, and leave its first paragraphs as the whole's description."""
    text = model.__doc__ or ""
    for name, words in field_words(text).items():
        field = made.get("properties", {}).get(name)
        if field is not None:
            field.setdefault("description", words)
    if text and "description" in made:
        made["description"] = " ".join(SECTION.sub("", text).split())
    return made


def field_words(docstring: str) -> dict[str, str]:
    r"""Return what the section Attributes of a numpydoc docstring says of each name.

    Examples
    --------
    >>> field_words("A size.\n\n    Attributes\n    ----------\n    width, height : float\n        In pixels.\n")
    {'width': 'In pixels.', 'height': 'In pixels.'}
    """
    found = re.search(r"^(\s*)Attributes\n\s*-{3,}\n(.*)", docstring, re.DOTALL | re.MULTILINE)
    if not found:
        return {}
    indent, names = len(found[1].lstrip("\n")), list[str]()
    words: dict[str, str] = {}
    for line in found[2].splitlines():
        depth = len(line) - len(line.lstrip())
        if line.strip() and set(line.strip()) == {"-"}:
            break
        if line.strip() and depth <= indent:
            names = [name.strip() for name in line.split(" : ")[0].split(",")]
            words |= dict.fromkeys(names, "")
        elif line.strip():
            words |= {name: f"{words[name]} {line.strip()}".strip() for name in names}
    return {name: text for name, text in words.items() if text and name.isidentifier()}
