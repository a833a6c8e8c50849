"""The documentation's pages, taken apart: headings, links, code blocks, tables."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]


def text(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def words(page: str) -> str:
    """The text with its lines joined."""
    return " ".join(text(page).split())


def pages() -> list[str]:
    """README, changelog and everything in docs."""
    return ["README.md", "CHANGELOG.md", *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md")))]


def blocks(page: str, language: str) -> list[str]:
    """The code blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text(page), re.MULTILINE | re.DOTALL)


def commands(page: str) -> list[str]:
    """The shell commands, without comments."""
    lines = "".join(blocks(page, "sh")).splitlines()
    return [command for line in lines if (command := line.split("  #")[0].strip())]


def prose(page: str) -> str:
    """What is left without code blocks."""
    return re.sub(r"^```.*?^```", "", text(page), flags=re.MULTILINE | re.DOTALL)


def links(page: str) -> list[str]:
    return re.findall(r"\]\(([^)\s]+)\)", prose(page))


def anchors(page: str) -> set[str]:
    """What links can point at, spelled as GitHub does."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def rows(page: str) -> Iterator[tuple[str, list[str]]]:
    """The rows of all tables, each with the heading above it; the first row of a table heads it."""
    heading = ""
    for line in prose(page).splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("|") and not line.startswith("|-"):
            yield heading, [cell.strip() for cell in line.strip("|").split("|")]


def column(page: str, heading: str, number: int = 0) -> list[str]:
    """What stands between backticks in a column of the table below a heading, in order."""
    cells = [row[number] for above, row in rows(page) if above == heading]
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]
