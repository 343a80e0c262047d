# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages and CSV files that benchmarks write."""

import csv
import io
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path


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
