"""What files hold, for those who read or write them without this package: JSON Schemas, and a check of any file.

Enter by `check_file`, which ``opnav check`` calls; by `schema_of` for the JSON Schema of a kind of file. The schemas
stand in ``schemas`` beside these modules; ``opnav check --schemas opnav_workbench/contracts/schemas`` writes them anew.

``kinds``
    The kinds of files: how each is called, recognized, described and loaded.
``layouts``
    The layouts of the JSON files that the program writes: result, session, a night's status, observables.
``schemas``
    JSON Schemas made of the models, and written.
``checking``
    One line for every fault of a file.
"""

from opnav_workbench.contracts.checking import Checked, check_file
from opnav_workbench.contracts.kinds import KINDS, Kind
from opnav_workbench.contracts.schemas import SCHEMAS_DIR, schema_of, write_schemas

__all__ = ["KINDS", "SCHEMAS_DIR", "Checked", "Kind", "check_file", "schema_of", "write_schemas"]
