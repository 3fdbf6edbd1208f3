"""The two pictures that open the README, a bifurcation diagram and the vehicle hunting:

    python notebooks/pictures.py            # the coach's, into notebooks/pages/

They are committed; draw them anew when the coach or the style of figures changes.
"""

import argparse
import tempfile
from pathlib import Path

import matplotlib as mpl
from PIL import Image

import railjax
from railjax.base.style import figure
from railjax.base.units import KMH
from railjax.stability.hunting.limit_cycles import Branch

#: the names under which README.md shows them
DIAGRAM, FILM = "bifurcation.svg", "hunting.gif"
#: share of the way from the nonlinear to the linear critical speed at which it is seen hunting: straight running is stable there, too
BETWEEN = 0.6
#: of the film as shown, pixels
WIDTH = 520


def bifurcation(branch: Branch, out: Path) -> None:
    """The branch's own figure, its two critical speeds named."""
    with figure(height=3.3) as (page, axes):
        ax, hopf = axes[0, 0], float(branch.hopf.speed)
        branch.plot(ax)
        marks = [(hopf, 0.0, "linear critical speed")]
        if branch.fold is not None:
            marks.append((branch.fold.speed, 1e3 * branch.fold.amplitude, "nonlinear critical speed"))
        for speed, amplitude, text in marks:
            ax.annotate(f"{text}\n{speed * KMH:.1f} km/h", (speed * KMH, amplitude), (8, 14), textcoords="offset points")
        ax.set(ylim=(0.0, 1.2e3 * branch.amplitude.max()))
        with mpl.rc_context({"svg.hashsalt": "railjax"}):
            page.savefig(out, metadata={"Date": None})


def hunting(vehicle: railjax.Vehicle, branch: Branch, out: Path, frames: int) -> None:
    """One period of the stable limit cycle, as `railjax.animate` draws it, made small."""
    fold = branch.fold.speed if branch.fold is not None else branch.hopf.speed
    speed = fold + BETWEEN * (float(branch.hopf.speed) - fold)
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "film.gif"
        title = f"{vehicle.name} on its limit cycle at {speed * KMH:.0f} km/h"
        railjax.animate(vehicle, branch.at(speed, stable=True), large, title=title)
        with Image.open(large) as film:
            every = max(1, film.n_frames // frames)
            kept, shown = range(0, film.n_frames, every), []
            for index in kept:
                film.seek(index)
                whole = film.convert("RGB")
                shown.append(whole.resize((WIDTH, round(WIDTH * whole.height / whole.width)), Image.Resampling.LANCZOS))
            last = film.info["duration"]
    palette = shown[0].quantize(24, method=Image.Quantize.MAXCOVERAGE)
    small = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in shown]
    small[0].save(out, save_all=True, append_images=small[1:], duration=every * last, loop=0, optimize=True)


def main() -> None:
    """Draw both."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, default=Path(__file__).resolve().parent / "pages", help="folder")
    options.add_argument("--vehicle", default="coach", help="a packaged vehicle or a file")
    options.add_argument("--frames", type=int, default=16, help="pictures of the film")
    given = options.parse_args()
    railjax.use_double_precision()
    vehicle = railjax.load_vehicle(given.vehicle)
    branch = railjax.hunting_branch(vehicle)
    bifurcation(branch, given.out / DIAGRAM)
    hunting(vehicle, branch, given.out / FILM, given.frames)
    for name in (DIAGRAM, FILM):
        print(f"{given.out / name}: {(given.out / name).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
