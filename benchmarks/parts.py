"""Counts the parts of the source, folders and modules beside them, and how they hang together.

python benchmarks/parts.py [FOLDER]  # src/maidenflight unless given
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parents[1] / "src" / "maidenflight"


def list_imports(file: Path, package: str) -> Iterator[str]:
    """The parts of a package that a file imports, at its top or inside a function."""
    for node in ast.walk(ast.parse(file.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [one.name for one in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{one.name}" for one in node.names]
        yield from (name.split(".")[1] for name in names if name.startswith(f"{package}."))


def pairs(root: Path) -> dict[str, set[str]]:
    """Each part with those that it imports."""
    imports: dict[str, set[str]] = {}
    for file in sorted(root.rglob("*.py")):
        part = file.relative_to(root).parts[0].removesuffix(".py")
        if not part.startswith("__"):
            imports.setdefault(part, set()).update(list_imports(file, root.name))
    return {part: (names & imports.keys()) - {part} for part, names in imports.items()}


def main() -> None:
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    imports = pairs(root)
    for part, names in sorted(imports.items(), key=lambda one: (-len(one[1]), one[0])):
        print(f"{part:16} {len(names):3}  {' '.join(sorted(names))}")
    ring = len(imports.get("integrations", ()))
    print(
        f"{len(imports)} parts, {sum(map(len, imports.values()))} pairs of which one imports the "
        f"other, {ring} of them of integrations, which no other imports"
    )


if __name__ == "__main__":
    main()
