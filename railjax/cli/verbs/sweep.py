"""`railjax sweep`: a study file on the command line."""

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...base.errors import InputError
from ..common import AsJson, calibrated, prepare, show

if TYPE_CHECKING:
    import xarray


def sweep(
    study: Annotated[Path | None, typer.Argument(metavar="STUDY", help="A study file (TOML); --example prints one.")] = None,
    out: Annotated[Path, typer.Option(help="Zarr store for the results; one that is unfinished is continued.")] = Path(
        "results.zarr"
    ),
    part: Annotated[
        str, typer.Option(help="The share of this process where several fill one store: 2/8 is the 2nd of 8.")
    ] = "1/1",
    example: Annotated[bool, typer.Option("--example", help="Print a commented study file and stop.")] = False,
    as_json: AsJson = False,
) -> None:
    """Compute a study over a grid or a sample of parameters, into a Zarr store that can be stopped and continued.

    Example: railjax sweep study.toml --out results.zarr
    """
    from ... import sweep as run
    from ...sweeps.files import EXAMPLE, read_study

    if example:
        print(EXAMPLE, end="")
        return
    if study is None:
        raise InputError("name a study file; railjax sweep --example prints one")
    prepare()
    arguments = read_study(study)
    share = _share(part)
    start = time.monotonic()
    data = run(**arguments, out=out, part=share, progress=True)
    codes, ends = summary(data)
    seconds = time.monotonic() - start
    varied = tuple(f"{name}:" for name in arguments["over"])
    vehicle = arguments.get("vehicle")  # a study of profiles has none
    fitted = [entry for entry in calibrated(vehicle) if not entry.startswith(varied)] if vehicle else []
    content = {
        "study": data.attrs["study"],
        "vehicle": vehicle.name if vehicle else "",
        "points": math.prod(data["code"].shape),
        "codes": codes,
        "results": {name: {"unit": data[name].attrs["units"], "min": low, "max": high} for name, (low, high) in ends.items()},
        "out": str(out),
        "seconds": seconds,
        "calibrated": fitted,
        "note": vehicle.note if vehicle else "",
    }
    counted = ", ".join(f"{count} {word.replace('_', ' ')}" for word, count in codes.items())
    lines = [f"{content['points']} points: {counted}"]
    lines += [f"  {name}: {low:.5g} to {high:.5g} {data[name].attrs['units']}" for name, (low, high) in ends.items()]
    lines += [f"results: {out} (xarray.open_zarr), {seconds:.1f} s"]
    show(content, [*lines, *[f"calibrated, not predicted: {entry}" for entry in fitted]], as_json)


def _share(part: str) -> tuple[int, int]:
    """ "2/8" as (1, 8)."""
    first, _, last = part.partition("/")
    if not (first.isdecimal() and last.isdecimal() and 1 <= int(first) <= int(last)):
        raise InputError(f"--part {part!r}: write it like 2/8, the 2nd of 8 shares")
    return int(first) - 1, int(last)


def summary(data: "xarray.Dataset") -> tuple[dict[str, int], dict[str, tuple[float, float]]]:
    """How many points have which code, and the ends of each result's finite values; read a slab at a time."""
    import numpy as np

    words = dict(entry.split(" ", 1) for entry in data["code"].attrs["meaning"].split(", "))
    codes: dict[str, int] = {}
    ends: dict[str, tuple[float, float]] = {}
    along = data["code"].dims[0]
    step = data["code"].encoding.get("chunks", data["code"].shape)[0]
    for start in range(0, data.sizes[along], step):
        slab: Any = data.isel({along: slice(start, start + step)})
        values, counts = np.unique(slab["code"].values, return_counts=True)
        for value, count in zip(values.tolist(), counts.tolist(), strict=True):
            word = words.get(str(value), str(value))
            codes[word] = codes.get(word, 0) + count
        for name in (name for name in slab.data_vars if name != "code"):
            found = slab[name].values
            found = found[np.isfinite(found)]
            low, high = ends.get(name, (math.inf, -math.inf))
            if found.size:
                ends[str(name)] = (min(low, float(found.min())), max(high, float(found.max())))
    return codes, ends
