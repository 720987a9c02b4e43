"""The JSON Schemas that the package carries are those of its models."""

import json

import pytest

from opnav_workbench.contracts import KINDS, SCHEMAS_DIR, schema_of
from opnav_workbench.contracts.schemas import schema_file

ANEW = "opnav check --schemas opnav_workbench/contracts/schemas"


@pytest.mark.parametrize("name", KINDS)
def test_schema_in_the_package_is_the_models(name):
    path = SCHEMAS_DIR / schema_file(KINDS[name])
    assert json.loads(path.read_text(encoding="utf-8")) == json.loads(json.dumps(schema_of(KINDS[name]))), (
        f"the model of {name} files has changed; write its schema anew: {ANEW}"
    )


def test_no_other_schema_is_there():
    assert {path.name for path in SCHEMAS_DIR.iterdir()} == {schema_file(kind) for kind in KINDS.values()}
