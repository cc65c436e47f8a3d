"""Pages of the site that are no pages in this folder: README and its neighbours, the notebooks.

A hook of MkDocs (mkdocs.yml). The notebooks are shown with the outputs that are stored in them; the
tests compare these with a run, nothing is executed here.
"""

import base64
import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

TOP = Path(__file__).resolve().parents[1]
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "CONTRIBUTING.md",
    "CHANGELOG.md": "CHANGELOG.md",
}
"""Files beside this folder, and what they are called in the site."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The files of this folder and the pages made from others."""
    for source, name in PAGES.items():
        text = (TOP / source).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=text.replace("](docs/", "](")))
    for path in sorted((TOP / "examples").iterdir()):
        files.append(File.generated(config, f"examples/{path.name}", content=path.read_bytes()))
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        for name, content in notebook_pages(file.src_uri, file.content_string).items():
            files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Links as the site has them; as they stand they are those of the checkout."""
    if page.file.src_uri == "tutorials/README.md":
        return markdown.replace(".ipynb)", ".md)")
    return re.sub(r"\]\(\.\./(examples/|CONTRIBUTING|CHANGELOG)", r"](\1", markdown)


def notebook_pages(name: str, text: str) -> dict[str, str | bytes]:
    """A notebook as a page of Markdown and its pictures, by their names."""
    stem = name.removesuffix(".ipynb")
    found: dict[str, str | bytes] = {}
    parts: list[str] = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{stem}-{len(found) + 1}.png"
                found[picture] = base64.b64decode("".join(data["image/png"]))
                parts.append(f"![picture]({picture.rpartition('/')[2]})")
            elif "text/html" in data:
                # On one line: an empty line would end the block of HTML.
                html = "".join(data["text/html"])
                html = re.sub(r"<style scoped>.*?</style>", "", html, flags=re.S)
                parts.append(" ".join(html.split()))
            else:
                plain = "".join(output.get("text") or data.get("text/plain", ""))
                parts.append(f"```text\n{plain.rstrip()}\n```")
    download = f"[This page as a notebook]({name.rpartition('/')[2]})"
    found[f"{stem}.md"] = "\n\n".join([*parts, download]) + "\n"
    return found
