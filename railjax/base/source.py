"""The package's own source as a digest: what is kept on disk is only ever continued by the code that began it."""

import functools
import hashlib
from pathlib import Path

#: top of the package, in whatever room this module stands
PACKAGE = Path(__file__).parents[1]


@functools.cache
def digest_of_source(*without: str, package: Path = PACKAGE) -> str:
    """Digest of every module and packaged vehicle, and of where it lies, but in the rooms (first folders) `without`: those that
    change no number of the result in question."""
    found = hashlib.sha256()
    for path in sorted(path for path in package.rglob("*") if path.suffix in (".py", ".toml")):
        inside = path.relative_to(package)
        if inside.parts[0] not in without:
            for piece in (inside.as_posix().encode(), path.read_bytes()):
                found.update(len(piece).to_bytes(8, "big") + piece)
    return found.hexdigest()[:16]
