# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages and CSV files that benchmarks write."""

import csv
import io
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from .data import ROOT

DOCS = ROOT / "docs"
TABLES, IMAGES = DOCS / "tables", DOCS / "images"


def replace(path: Path, text: str) -> None:
    """Write a file through a temporary name, so that it is never half there."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    partial.write_text(text)
    os.replace(partial, path)


def between_marks(page: str, name: str, text: str) -> str:
    """The page with a text between its marks <!-- name --> and <!-- end -->; unchanged where it has none."""
    marked = rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)"
    return re.sub(marked, lambda mark: f"{mark.group(1)}{text}\n{mark.group(2)}", page, flags=re.S)


def with_table(page: str, name: str, table: str, made_by: str) -> str:
    """The page with a table, and the sentence on what made it, between its marks."""
    return between_marks(page, name, f"{table}\n\n{made_by}")


def markdown_tables(text: str) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, header and rows of each Markdown table in a text; the title is the line of prose before it, or ""."""
    found, title, lines = [], "", []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            lines.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif lines:
            found.append((title, lines[0], lines[2:]))
            title, lines = "", []
        elif line.strip():
            title = line.strip()
    return found


def write_tables(name: str, text: str, made_by: Sequence[str], folder: Path = TABLES) -> list[Path]:
    """Write the Markdown tables of a text as CSV: NAME.csv, or NAME-1.csv and so on where there are several.

    made_by: sentences on what made them, which stand above each, after its title.
    """
    found, written = markdown_tables(text), []
    for number, (title, header, rows) in enumerate(found, 1):
        written.append(folder / (f"{name}.csv" if len(found) == 1 else f"{name}-{number}.csv"))
        said = [*([title] if title else []), *made_by]
        replace(written[-1], csv_text(said, header if all(header[1:]) else ["quantity", "value"], rows))
    return written


def csv_text(made_by: Sequence[str], header: Sequence, rows: Iterable[Sequence]) -> str:
    """CSV below lines "# ...": sentences on what made it."""
    text = io.StringIO()
    text.writelines(f"# {line}\n" for line in made_by)
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue()


def read_csv(path: Path) -> list[dict]:
    """Rows of a file that `csv_text` made, by column."""
    return list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#")))


def csv_made_by(path: Path) -> list[str]:
    """The sentences of such a file on what made it."""
    return [line[2:] for line in path.read_text().splitlines() if line.startswith("# ")]


def record(path: Path, made_by: str, figures: dict[str, float]) -> None:
    """Enter a program's figures into a CSV of columns made_by, figure and value, in place of what it had there."""
    command = made_by[made_by.index("`python") :]
    known = read_csv(path) if path.exists() else []
    rows = [list(row.values()) for row in known if not row["made_by"].endswith(command)]
    rows += [[made_by, name, f"{value:.4g}"] for name, value in figures.items()]
    replace(path, csv_text([], ("made_by", "figure", "value"), rows))
