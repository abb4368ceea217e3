"""MkDocs hook: adds paper/notes to the site, and ranks pages in its search."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

NOTES = Path(__file__).parent / "notes"


def on_files(files: Files, config: Any) -> Files:
    """Adds each note and its pictures as `notes/NAME`."""
    for path in sorted(NOTES.iterdir()):
        files.append(File.generated(config, f"notes/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turns the links between docs/ and paper/notes/ of the repository into those of the site."""
    folder = "../" * page.file.src_uri.count("/")
    if page.file.src_uri.startswith("api/") and page.file.name != "index":
        page.meta["search"] = {"boost": 0.5}
    if page.file.src_uri.startswith("notes/"):
        page.meta["search"] = {"exclude": True}
        return markdown.replace("](../../docs/", "](../")
    return markdown.replace(f"]({folder}../paper/notes/", f"]({folder}notes/")
