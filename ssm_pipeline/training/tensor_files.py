"""Files of tensors and plain values, for matchers and checkpoints."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from ssm_pipeline.records import DamagedFile
from ssm_pipeline.storage import write_bytes


def save_tensors(content: dict[str, Any], path: Path) -> None:
    """Whole or not at all; only tensors and plain values, so that it loads without pickle code."""
    buffer = io.BytesIO()  # torch's own writer hides why a disk refuses
    torch.save(content, buffer)
    write_bytes(path, buffer.getbuffer())


def load_tensors(path: Path, device: str = "cpu") -> dict[str, Any]:
    """What `save_tensors` wrote; no pickle code is run. Raises DamagedFile."""
    try:
        with zipfile.ZipFile(path) as file:  # torch itself does not look at the checksums
            if (name := file.testzip()) is not None:
                raise DamagedFile(path, f"is damaged ({name} is not what was written)")
        content = torch.load(path, map_location=device, weights_only=True)
    except FileNotFoundError as error:
        raise DamagedFile(path, "is missing") from error
    except (DamagedFile, PermissionError):
        raise
    except Exception as error:  # damaged bytes can break the decoders anywhere
        what = f"is damaged or no file of tensors ({type(error).__name__})"
        raise DamagedFile(path, what) from error
    if not isinstance(content, dict):
        raise DamagedFile(path, f"holds a {type(content).__name__}, no matcher or checkpoint")
    return content
