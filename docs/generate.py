"""Pages that are generated from the code and from records, and a search that needs no server.

MkDocs calls `on_page_markdown` and `on_post_build` (mkdocs.yml, `hooks`). The generated pages are
part of the repository, so that its links work; after a change of commands, keys or records::

    python docs/generate.py
"""

import json
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from generate_commands import commands_page  # noqa: E402
from generate_keys import keys_page  # noqa: E402
from generate_names import public_names  # noqa: E402
from generate_validation import validation_page  # noqa: E402

GENERATED = {
    "reference/commands.md": commands_page,
    "reference/keys.md": keys_page,
    "explanation/validation.md": validation_page,
}


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Append the public names and their docstrings to reference/python.md."""
    if page.file.src_uri == "reference/python.md":
        return markdown + "\n" + "\n".join(public_names())
    return markdown


def on_post_build(config: Any) -> None:
    """Put the search index into a script.

    MkDocs fetches its index, which browsers refuse for pages opened from disk.
    """
    search = Path(config.site_dir, "search")
    index = json.loads((search / "search_index.json").read_text())
    pages = [{key: doc[key] for key in ("location", "title", "text")} for doc in index["docs"]]
    scripts = (
        (search / "lunr.js").read_text(),
        f"var searchPages = {json.dumps(pages)};",
        (HERE / ".theme" / "search.js").read_text(),
    )
    (search / "main.js").write_text("\n".join(scripts))
    for unused in ("worker.js", "lunr.js", "search_index.json"):
        (search / unused).unlink()


if __name__ == "__main__":
    for name, page in GENERATED.items():
        (HERE / name).write_text(page())
