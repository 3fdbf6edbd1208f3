"""Files that are there whole or not at all, whenever the process that writes them is stopped."""

import os
from pathlib import Path


def write_whole(path: Path, content: bytes | str) -> None:
    """Write under another name first, so that a stop leaves no half file; text as UTF-8."""
    beside = path.with_name(f"{path.name}.{os.getpid()}.part")
    beside.write_bytes(content.encode() if isinstance(content, str) else content)
    beside.replace(path)
