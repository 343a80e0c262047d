"""OpenEXR files, complete or not at all."""

import os
from typing import Dict, Union

import numpy as np


def write_exr(path: str, channels: Dict[str, np.ndarray], attributes: Dict[str, Union[str, int, float]]) -> None:
    """Write `channels`, float32 (H, W) each with rows from the top, under their names.

    attributes: go into the header as string, int and float attributes.

    The file appears under `path` only once it is complete. Raises OSError where it cannot be
    written, or where the OpenEXR package that the extension ships is missing.
    """
    # Imported when needed: most renders write no file.
    try:
        import OpenEXR
    except ImportError as error:
        raise OSError(f"the package OpenEXR cannot be imported ({error}); reinstall the extension") from error
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    pixels = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
    # Beside the file, so that it can be renamed, under a name that no other process picks.
    unfinished = f"{path}.{os.getpid()}.part"
    try:
        # OpenEXR reports a missing folder and a full disk alike as RuntimeError.
        OpenEXR.File(header, pixels).write(unfinished)
        os.replace(unfinished, path)
    except RuntimeError as error:
        raise OSError(f"cannot write {path}: {error}") from error
    finally:
        if os.path.exists(unfinished):
            os.unlink(unfinished)
