"""Sphinx: the site of opnav_workbench, built offline by `opnav docs`."""

import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from generate import write_generated  # noqa: E402
from opnav_workbench.version import __version__  # noqa: E402

write_generated(HERE)

project = "opnav_workbench"
author = "The opnav_workbench developers"
copyright = "The opnav_workbench developers, Apache-2.0"  # noqa: A001
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "CHANGELOG.md", "generated/notebooks.md"]
html_theme = "furo"
html_title = "opnav_workbench"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
default_role = "py:obj"
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
# Docstrings are read in the source and by help(); what reStructuredText would like of their lists is not asked of them.
suppress_warnings = ["docutils", "ref.python", "autodoc", "misc.highlighting_failure"]

LITERAL = re.compile(r"(``.*?``|`[^`]*`)")


def plain_signs(_app, _what, _name, _obj, _options, lines):
    """Let bars, single stars and trailing underscores in docstrings stand for themselves, but for code and doctests."""
    in_doctest = False
    for number, line in enumerate(lines):
        in_doctest = line.lstrip().startswith(">>>") or (in_doctest and bool(line.strip()))
        if not in_doctest:
            parts = LITERAL.split(line)
            parts[::2] = [_escaped(part) for part in parts[::2]]
            lines[number] = "".join(parts)


def _escaped(text):
    text = text.replace("|", r"\|")
    text = re.sub(r"(\w)_(?=\W|$)", r"\1\\_", text)
    return text.replace("*", r"\*") if text.count("*") % 2 else text


def setup(app):
    """Before napoleon reads the docstrings."""
    app.connect("autodoc-process-docstring", plain_signs, priority=400)
