"""Write docs/rooms.md: every file of the package by room, with its own first line.

python tools/list_rooms.py            # write it
python tools/list_rooms.py --check    # exit with 1 if it is not what the code says (part of make lint)
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from pathlib import Path

from check_imports import FLOORS, ROOT

PAGE = ROOT.parent / "docs" / "rooms.md"

HEAD = """\
# Rooms

Every file of the package with its first line, by room, the highest floor first. Written by `tools/list_rooms.py`;
[architecture.md](architecture.md) walks through them.
"""


def main() -> int:
    """Write the page, or check it; return the exit code."""
    text = page()
    if "--check" in sys.argv:
        if PAGE.read_text(encoding="utf-8") == text:
            return 0
        print("docs/rooms.md is not what the code says; run python tools/list_rooms.py")
        return 1
    PAGE.write_text(text, encoding="utf-8")
    return 0


def page() -> str:
    """Return the whole page."""
    sections = [HEAD]
    for height in range(len(FLOORS), 0, -1):
        rooms = sorted(FLOORS[height - 1])
        folders = [room for room in rooms if (ROOT / room).is_dir()]
        files = [ROOT / f"{room}.py" for room in rooms if room not in folders]
        if files:
            sections.append(f"## Floor {height}\n\n" + table(files))
        sections += [section(room) for room in folders]
    return "\n".join(sections)


def section(room: str) -> str:
    """Return the part of the page on a folder, and on the folders in it."""
    by_folder = defaultdict(list)
    for path in sorted((ROOT / room).rglob("*.py")):
        by_folder[path.parent].append(path)
    parts = []
    for folder, paths in sorted(by_folder.items()):
        name = folder.relative_to(ROOT).as_posix()
        heading = "##" if folder == ROOT / room else "###"
        files = [path for path in paths if path.name != "__init__.py" or len(paths) == 1 or is_code(path)]
        parts.append(f"{heading} {name}/\n\n{first_line(folder / '__init__.py')}\n\n{table(files)}")
    return "\n".join(parts)


def is_code(path: Path) -> bool:
    """Whether a file has more than its docstring."""
    return len(ast.parse(path.read_text(encoding="utf-8")).body) > 1


def table(paths: list[Path]) -> str:
    """Return a table of files and what each says that it is."""
    lines = ["| file | |", "|---|---|"]
    lines += [f"| `{path.name}` | {first_line(path)} |" for path in paths]
    return "\n".join(lines) + "\n"


def first_line(path: Path) -> str:
    """Return the first line of a file's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0]


if __name__ == "__main__":
    sys.exit(main())
