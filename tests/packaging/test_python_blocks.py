"""The marked Python blocks of the docs run as printed, file by file, in order."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"<!-- runs -->\n```python\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE)
TEXTS = {
    str(file.relative_to(ROOT)): "\n".join(m["text"] for m in BLOCK.finditer(file.read_text()))
    for file in sorted((ROOT / "docs").rglob("*.md"))
}


@pytest.mark.parametrize("file", [name for name, text in TEXTS.items() if text])
def test_blocks_run_as_printed(file: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", TEXTS[file]],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "HOME": str(tmp_path), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )
    assert done.returncode == 0, done.stderr
