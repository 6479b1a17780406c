"""The validation page, from the records in validation.yaml."""

from pathlib import Path

import yaml

HEAD = """# Why to trust it: validation

What was tested, against which independent truth, with which result, and the command that repeats
it. Data on which a method was tuned are marked.
"""


def validation_page() -> str:
    """Return all records as tables."""
    groups = yaml.safe_load(Path(__file__).with_name("validation.yaml").read_text())
    lines = [HEAD]
    for group in groups:
        lines += [f"## {group['group']}", "", group["intro"], ""]
        if "picture" in group:
            lines += [group["picture"], ""]
        lines += ["| tested | truth | cases | result | repeat with |", "|---|---|---|---|---|"]
        for one in group["records"]:
            note = f" ({one['known']})" if "known" in one else ""
            lines.append(
                f"| {one['tested']} | {one['truth']} | {one['cases']} | {one['result']}{note} "
                f"| `{one['command']}` |"
            )
        lines.append("")
    return "\n".join(lines)
