# SPDX-License-Identifier: GPL-3.0-or-later
"""Wheels and source distributions whose bytes follow from their contents alone."""

import base64
import csv
import gzip
import hashlib
import io
import tarfile
import zipfile
from pathlib import Path

#: Time of every file in an archive: the earliest that a zip can state.
EPOCH = (1980, 1, 1, 0, 0, 0)


def write_zip(path: Path, files: dict[str, bytes]) -> Path:
    """Write a zip of files by name, in this order; returns its path. What is compressed already is stored."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            item = zipfile.ZipInfo(name, EPOCH)
            item.create_system, item.external_attr = 3, 0o100644 << 16
            stored = name.endswith((".whl", ".png", ".jpg"))
            item.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
            archive.writestr(item, content, compresslevel=9)
    return path


def write_wheel(folder: Path, metadata: str, tag: str, files: dict[str, bytes]) -> Path:
    """Write a wheel, named by `Name` and `Version` of its metadata, into a folder; returns its path.

    metadata: text of METADATA. tag: such as py3-none-win_amd64. files: by their names in site-packages; those of
    "licenses" go beside the metadata.
    """
    stem = _stem(metadata)
    notes = f"{stem}.dist-info"
    pure = str(tag.endswith("-any")).lower()
    wheel = f"Wheel-Version: 1.0\nGenerator: mrpnn\nRoot-Is-Purelib: {pure}\nTag: {tag}\n"
    files = {f"{notes}/{name}" if name.startswith("licenses/") else name: data for name, data in sorted(files.items())}
    files |= {f"{notes}/METADATA": metadata.encode(), f"{notes}/WHEEL": wheel.encode()}
    record = io.StringIO()
    rows = csv.writer(record, lineterminator="\n")
    for name, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        rows.writerow([name, f"sha256={digest}", len(content)])
    rows.writerow([f"{notes}/RECORD", "", ""])
    files[f"{notes}/RECORD"] = record.getvalue().encode()
    return write_zip(folder / f"{stem}-{tag}.whl", files)


def write_sdist(folder: Path, metadata: str, files: dict[str, bytes]) -> Path:
    """Write a source distribution, named by its metadata, into a folder; returns its path.

    files: by their names below the distribution's folder.
    """
    stem = _stem(metadata)
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name, content in sorted({**files, "PKG-INFO": metadata.encode()}.items()):
            item = tarfile.TarInfo(f"{stem}/{name}")
            item.size, item.mode = len(content), 0o644
            archive.addfile(item, io.BytesIO(content))
    path = folder / f"{stem}.tar.gz"
    path.write_bytes(gzip.compress(packed.getvalue(), mtime=0))
    return path


def _stem(metadata: str) -> str:
    fields = dict(line.split(": ", 1) for line in metadata.partition("\n\n")[0].splitlines())
    return f"{fields['Name'].replace('-', '_')}-{fields['Version']}"
