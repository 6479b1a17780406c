"""A case as the commented YAML file that a user would have written."""

from typing import Any

import yaml

from palpate.workers.organs.breast.case.spec import AXES, CaseFile, CaseLoad

HEADER = """\
# A diagnosis: why a simulated breast differs from its scans.
#
#   palpate diagnose THIS_FILE
#
# Every key carries its unit, and a key that is not known is refused. `palpate new diagnosis NAME`
# writes a file that explains all of them. Paths are relative to this file.

"""


def case_yaml(file: CaseFile) -> str:
    """Return a text from which the same case is read again."""
    record = file.model_dump(mode="json", exclude_none=True)
    record["scans"]["loads"] = [_load(load) for load in file.scans.loads]
    if file.model.law == "neo-hookean":
        record["model"] = {"law": file.model.law, "nu": file.model.nu}
    return HEADER + "\n".join(
        yaml.safe_dump({key: value}, sort_keys=False, default_flow_style=_flow(value), width=100)
        for key, value in record.items()
    )


def _flow(value: Any) -> bool | None:
    """Return the style of a key: innermost lists and mappings on one line."""
    return None if isinstance(value, dict) else False


def _load(load: CaseLoad) -> dict[str, Any]:
    record = load.model_dump(mode="json", exclude_none=True)
    names = {axis: name for name, axis in AXES.items()}
    return record | {"axis": names.get(load.axis, list(load.axis))}
