"""MkDocs hooks: executed notebooks as pages, equations as MathML."""

import base64
import json
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert as to_mathml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
ORDER = (
    "quickstart",
    "grounding",
    "belief",
    "planner",
    "sweep",
    "gradients",
    "your_own_world",
    "husky",
)
"""Order in the menu."""
_MAGICS = re.compile(r"(?m)^%.*\n")
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
_DISPLAYED = re.compile(r"(?ms)^```math\n(.*?)^```$")
_INLINE = re.compile(r"\$(?=\S)([^$\n`]+)(?<=\S)\$")
_TAG = re.compile(r"\\tag\{([^}]*)\}")
_PLACEHOLDER = re.compile(r"equation(\d+)set aside")
_equations: list[str] = []
_FRAMES = re.compile("[\u2500-\u257f]")
"""Box-drawing characters: output with them scrolls and is not wrapped."""


def notebooks() -> list[Path]:
    """List the executed notebooks, those of ``ORDER`` first."""
    known = {name: rank for rank, name in enumerate(ORDER)}
    paths = sorted(FOLDER.glob("*.ipynb"))
    return sorted(paths, key=lambda path: known.get(path.stem, len(ORDER)))


def title(path: Path) -> str:
    """Name a notebook for the menu."""
    return path.stem.replace("_", " ").capitalize()


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the notebooks into the menu, after the first page (called by MkDocs)."""
    pages = [{title(path): f"notebooks/{path.stem}.md"} for path in notebooks()]
    menu = list(config.nav or [])
    position = 1 + next(index for index, entry in enumerate(menu) if "Start" in entry)
    config.nav = [*menu[:position], {"Notebooks": pages}, *menu[position:]]
    return config


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Redirect notebook links to their pages, and extract equations (called by MkDocs)."""
    del page, config, files
    if _DISPLAYED.search(markdown):
        markdown = _INLINE.sub(_store_equation, _DISPLAYED.sub(_store_equation, markdown))
    return re.sub(r"\]\(\.\./notebooks/(\w+)\.ipynb\)", r"](notebooks/\1.md)", markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Insert the stored equations into the HTML (called by MkDocs)."""
    del page, config, files
    return _PLACEHOLDER.sub(lambda match: _equations[int(match[1])], html)


def _store_equation(match: re.Match[str]) -> str:
    """Convert an equation and its number to MathML, store it, and return a placeholder."""
    numbered = _TAG.sub(r"\\qquad (\1)", match[1].strip())
    _equations.append(to_mathml(numbered, display="block" if match.re is _DISPLAYED else "inline"))
    return f"equation{len(_equations) - 1}set aside"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each notebook, and its pictures beside it (called by MkDocs)."""
    for path in notebooks():
        page, pictures = convert(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=page))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def convert(path: Path) -> tuple[str, dict[str, bytes]]:
    """Convert an executed notebook (``.ipynb``) to Markdown and pictures by name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        text = _text(cell["source"])
        if cell["cell_type"] == "markdown":
            # A link from notebooks/ into docs/ leads one folder up on the site.
            parts.append(text.replace("](../docs/", "](../"))
            continue
        parts.append(_fence(_MAGICS.sub("", text), "python"))
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{path.stem}-{len(pictures) + 1}.png"
                pictures[name] = base64.b64decode(_text(data["image/png"]))
                parts.append(f"![What this cell draws]({name})")
            else:
                text_output = _text(output.get("text", data.get("text/plain", "")))
                text_output = _ESCAPES.sub("", text_output).rstrip()
                language = "{ .text .aligned }" if _FRAMES.search(text_output) else "text"
                parts.append(_fence(text_output, language))
    footer = f"Made by `notebooks/{path.stem}.py`; run `make notebooks` to make it again."
    return "\n\n".join([*parts, f"---\n\n*{footer}*"]) + "\n", pictures


def _text(value: Any) -> str:
    return value if isinstance(value, str) else "".join(value)


def _fence(text: str, language: str) -> str:
    """Format text as a fenced code block; "" for blank text."""
    return f"````{language}\n{text}\n````" if text.strip() else ""
