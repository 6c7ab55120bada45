"""Runs the Python lines of a README: `python readme.py README.md`."""

import sys
from pathlib import Path

text = Path(sys.argv[1]).read_text(encoding="utf-8")
for block in text.split("```python\n")[1:]:
    lines = block.split("```")[0]
    print(lines)
    exec(compile(lines, sys.argv[1], "exec"), {})
