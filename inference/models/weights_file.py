# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights files and their checksums."""

import hashlib
import pathlib

from ..scene.errors import SceneError

WEIGHTS = pathlib.Path(__file__).parent.parent / "weights"


def read_weights(name: str, folder: pathlib.Path | None = None) -> bytes:
    """Content of a weights file that matches the checksum in NAME.sha256 beside it. Raises SceneError otherwise.

    folder: WEIGHTS where it is None.
    """
    folder = folder or WEIGHTS
    try:
        content = (folder / f"{name}.onnx").read_bytes()
        promised = (folder / f"{name}.sha256").read_text().split()[0]
    except (OSError, IndexError, UnicodeDecodeError) as error:
        raise SceneError(
            f"the weights of {name!r} or their checksum cannot be read ({error}); reinstall the extension"
        ) from None
    if hashlib.sha256(content).hexdigest() != promised:
        raise SceneError(
            f"the weights of {name!r} cannot be read: they do not match their checksum; reinstall the extension"
        )
    # The key under which ONNX names a file with the values of a tensor.
    if b"location" in content:
        raise SceneError(f"the weights of {name!r} lie partly outside their file, which is refused")
    return content
