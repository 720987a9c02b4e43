"""Pages that are made of the package: its public names, its files' fields, its glossary, its figures of accuracy.

Written below ``generated`` beside the sources, whenever the site is built.
"""

import inspect
import json
import re
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import opnav_workbench
from opnav_workbench.contracts import KINDS, schema_of
from opnav_workbench.format_versions import PRESENT_VERSION, PROMISE
from opnav_workbench.observables.columns import COLUMNS
from opnav_workbench.observables.explanation import CONVENTIONS
from opnav_workbench.parts import PARTS, install_command
from opnav_workbench.processing.model import Processing

PACKAGE = Path(opnav_workbench.__file__).parent


def write_generated(here: Path) -> None:
    """Write every generated page."""
    folder = here / "generated"
    folder.mkdir(exist_ok=True)
    pages = {
        "glossary.md": glossary(),
        "files.md": files_index(),
        "accuracy.md": accuracy(),
        "changelog.md": changelog(here),
        "options.md": options(),
        "exports.md": exports(),
        "api.rst": api_index(),
        "map.rst": package_map(),
    }
    pages |= {f"file_{kind.name}.md": file_page(kind) for kind in KINDS.values()}
    pages |= {f"api_{name}.rst": api_page(name) for name in modules_with_names()}
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# ---- Public names


def modules_with_names() -> list[str]:
    """The packages and single modules of the package whose public names are documented."""
    packages = [path.parent.name for path in PACKAGE.glob("*/__init__.py")]
    singles = [path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")]
    return sorted([*packages, *singles])


def public_modules(name: str) -> list[str]:
    """A package and all its modules, or a single module."""
    top = PACKAGE / name
    if not top.is_dir():
        return [f"opnav_workbench.{name}"]
    parts = (p.relative_to(PACKAGE.parent).with_suffix("").parts for p in sorted(top.rglob("*.py")))
    return [".".join(p[:-1] if p[-1] == "__init__" else p) for p in parts]


def api_index() -> str:
    """Return the page of all packages."""
    entries = "\n".join(f"   api_{name}" for name in modules_with_names())
    return f"""Public names
============

Every public name of every module, from its docstring. Enter by `opnav_workbench.ImageSession` for one picture step by step, by
`opnav_workbench.process` for many.

.. toctree::
   :maxdepth: 1

{entries}
"""


def api_page(name: str) -> str:
    """Return the page of a package: its map, and the names of each of its modules."""
    blocks = [heading(name, "=")]
    for module in public_modules(name):
        if module != f"opnav_workbench.{name}":
            blocks.append(heading(module.removeprefix(f"opnav_workbench.{name}."), "-"))
        blocks.append(module_block(module))
    return "\n".join(blocks)


def module_block(module: str) -> str:
    """Document a module and the names that are defined in it."""
    try:
        loaded = import_module(module)
    except ImportError as error:  # a part that is not installed
        return f"Not documented here: {error}.\n"
    names = [n for n in getattr(loaded, "__all__", ()) if defined_in(loaded, n)]
    return f".. automodule:: {module}\n   :no-members:\n\n" + "".join(block(module, loaded, n) for n in names)


def defined_in(module: Any, name: str) -> bool:
    """Whether a public name is a module's own: what a package lends from its modules is documented there."""
    value = getattr(module, name, None)
    return getattr(value, "__module__", module.__name__) == module.__name__


def block(module: str, loaded: Any, name: str) -> str:
    """Return the directive for one name."""
    value = getattr(loaded, name)
    if inspect.isclass(value):
        return f".. autoclass:: {module}.{name}\n   :members:\n\n"
    if callable(value):
        return f".. autofunction:: {module}.{name}\n\n"
    return f".. py:data:: {module}.{name}\n\n"


def package_map() -> str:
    """Return the package's own map: what each package is, and where to change what."""
    text = inspect.cleandoc(opnav_workbench.__doc__ or "")
    start, end = text.index("Enter by `ImageSession`"), text.index("Glossary\n---")
    return heading("Map of the package", "=") + "\n" + text[start:end]


def heading(text: str, line: str) -> str:
    """Return an underlined title."""
    return f"{text}\n{line * len(text)}\n"


def glossary() -> str:
    """Return the glossary of the package's docstring."""
    text = inspect.cleandoc(opnav_workbench.__doc__ or "")
    body = text[text.index("Glossary\n---") :].split("\n", 2)[2]
    entries = re.findall(r"^(\S.*)\n((?:    .*\n?)+)", body, re.MULTILINE)
    lines = [f"{term}\n: {' '.join(words.split())}\n" for term, words in entries]
    return "# Glossary\n\n" + "\n".join(lines)


# ---- Files


def files_index() -> str:
    """Return the page of all kinds of files."""
    written = "\n".join(f"file_{k.name}" for k in KINDS.values() if k.is_yaml)
    made = "\n".join(f"file_{k.name}" for k in KINDS.values() if not k.is_yaml)
    return f"""# Files

`opnav check FILE` holds a file against what it must be, `opnav check --schemas DIR` writes the JSON Schemas of all kinds.

## What people write

{PROMISE[True]}

```{{toctree}}
:maxdepth: 1

{written}
```

## What the program writes

{PROMISE[False]}

```{{toctree}}
:maxdepth: 1

{made}
exports
```
"""


def file_page(kind: Any) -> str:
    """Return the page of one kind of file: every field of its model."""
    schema = schema_of(kind)
    about = "written by people" if kind.is_yaml else "written by the program"
    lines = [
        f"# {kind.what[0].upper()}{kind.what[1:]}",
        "",
        f"{'YAML' if kind.is_yaml else 'JSON'}, {about}; `format_version` {PRESENT_VERSION[kind.version]}. "
        f"Checked with `opnav check --as {kind.name} FILE`.",
        "",
        plain(schema.get("description", "")),
        "",
        *fields_table(schema),
    ]
    for name, part in sorted(schema.get("$defs", {}).items()):
        if "properties" in part:
            lines += ["", f"## {name.strip('_')}", "", plain(part.get("description", "")), "", *fields_table(part)]
        elif "enum" in part:
            lines += ["", f"## {name.strip('_')}", "", ", ".join(f"`{v}`" for v in part["enum"])]
    return "\n".join(lines) + "\n"


def fields_table(part: dict[str, Any]) -> list[str]:
    """Return the table of a model's fields."""
    needed = set(part.get("required", ()))
    rows = ["| field | what it holds | default | what it is |", "|---|---|---|---|"]
    for name, field in part.get("properties", {}).items():
        default = "required" if name in needed else cell(json.dumps(field.get("default")))
        rows.append(f"| `{name}` | {cell(type_words(field))} | {default} | {cell(plain(field.get('description', '')))} |")
    return rows


def type_words(field: dict[str, Any]) -> str:
    """Return what may stand in a field, in words."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2].strip("_")
        return f"[{name}](#{name.lower()})"
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    for several in ("anyOf", "oneOf", "allOf"):
        if several in field:
            return " or ".join(dict.fromkeys(type_words(one) for one in field[several]))
    return plain_type(field)


def plain_type(field: dict[str, Any]) -> str:
    """Return a JSON type in words, with its limits."""
    kind = field.get("type", "anything")
    if kind == "array":
        return array_words(field)
    if kind == "object" and isinstance(field.get("additionalProperties"), dict):
        return f"names to {type_words(field['additionalProperties'])}"
    words = {"object": "fields", "string": "text", "boolean": "true or false", "integer": "whole number"}.get(kind, kind)
    signs = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    limits = [f"{sign} {field[key]}" for key, sign in signs.items() if key in field]
    format_ = {"date-time": "time, UTC", "path": "path"}.get(field.get("format", ""), words)
    return ", ".join([format_, *limits])


def array_words(field: dict[str, Any]) -> str:
    """Return a list in words."""
    if "prefixItems" in field:
        return "[" + ", ".join(type_words(one) for one in field["prefixItems"]) + "]"
    count = field.get("minItems") if field.get("minItems") == field.get("maxItems") else None
    return f"list of {count or ''} {type_words(field.get('items', {}))}".replace("  ", " ")


def exports() -> str:
    """Return the page of exports: conventions and columns."""
    rows = [f"| `{c.name}` | {cell(unit(c.unit))} | {cell(c.description)} |" for c in COLUMNS]
    said = [f"{name}\n: {words}\n" for name, words in CONVENTIONS.items()]
    return "\n".join(
        [
            "# Exports of observables",
            "",
            "`observables.ecsv` of every picture, and `opnav export` for many: ECSV, CSV, JSON, CCSDS TDM. Each says in itself:",
            "",
            *said,
            "and by which program, camera, catalog and kernels (with SHA-256) its observables came about.",
            "",
            "## Columns",
            "",
            "| column | unit | what it is |",
            "|---|---|---|",
            *rows,
            "",
        ]
    )


def unit(value: str | None) -> str:
    """Return a column's unit, as the page shows it."""
    return "text" if value is None else value or "1"


def options() -> str:
    """Return the page of the options of processing, and of the parts of the installation."""
    rows = [
        f"| `{name}` | {cell(plain(field.description or ''))} | {cell(repr(field.default) if not field.is_required() else 'required')} |"
        for name, field in Processing.model_fields.items()
    ]
    parts = [f"| `{extra}` | {what} | `{install_command(extra)}` |" for extra, (what, _) in PARTS.items()]
    return "\n".join(
        [
            "# Options of processing",
            "",
            "The same for `opnav process`, `nightly`, `lab` and `ort solve`, for night files, notebooks and "
            "`opnav_workbench.process`.",
            "",
            "| option | what it says | default |",
            "|---|---|---|",
            *rows,
            "",
            "## Parts of the installation",
            "",
            "| part | brings | command |",
            "|---|---|---|",
            *parts,
            "",
        ]
    )


# ---- What stands elsewhere


def readme() -> str:
    """Return the README: of the checkout, or as the installed package has it."""
    path = PACKAGE.parent / "README.md"
    if path.is_file():
        return path.read_text(encoding="utf-8")
    return str(metadata.metadata("opnav_workbench").get_payload())


def accuracy() -> str:
    """Return what is measured, as the README has it."""
    text = readme()
    start = text.index("## What is measured")
    return "# Accuracy\n\n" + text[start : text.index("\n## ", start + 5)].split("\n", 2)[2]


def changelog(here: Path) -> str:
    """Return the changelog."""
    for path in (here.parent / "CHANGELOG.md", here / "CHANGELOG.md", PACKAGE.parent / "CHANGELOG.md"):
        if path.is_file():
            return path.read_text(encoding="utf-8")
    return "# Changelog\n\nIt stands in the repository.\n"


def cell(text: str) -> str:
    """Return text for a cell of a table."""
    return " ".join(text.replace("|", "\\|").split())


def plain(text: str) -> str:
    """Return a docstring's words with code as Markdown has it."""
    return re.sub(r"``([^`]+)``", r"`\1`", text)
