"""Animations: what is drawn where, from runs, limit cycles and modes; the files; one line for whatever is wrong."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from chromium import looked_at, needs_chromium
from PIL import Image

import railjax
from railjax.base.style import figure
from railjax.cli.application import status
from railjax.plots.animation import Stage
from railjax.plots.frames import MODE_AMPLITUDE, PERIOD_FRAMES, largest_displacement, of_limit_cycle, of_mode, of_simulation
from railjax.plots.top_view import TopView, magnification

SPEED = 30.0


@pytest.fixture(scope="module")
def wheelset():
    return railjax.load_vehicle("single-wheelset")


@pytest.fixture(scope="module")
def bogie():
    return railjax.load_vehicle("cooperrider-bogie")


@pytest.fixture(scope="module")
def run(wheelset):
    track = railjax.SinusoidTrack(2e-3, 12.0)
    record = railjax.animation_channels(wheelset)
    return railjax.simulate(wheelset, SPEED, track=track, duration=2.0, sample=2e-3, record=record)


@pytest.fixture(scope="module")
def still(wheelset):
    """The modes of a wheelset, to be filmed quickly."""
    return railjax.modes(wheelset, SPEED)


def drawn(vehicle, coordinates, magnified, **more):
    with figure() as (_, axes):
        view = TopView(axes[0, 0], vehicle, magnified)
        view.show(coordinates, **more)
    return view


def test_bodies_are_drawn_where_they_are(coach):
    moved = {
        "carbody_y": np.array(2e-3),
        "carbody_psi": np.array(1e-4),
        "bogie_y": np.array([1e-3, -3e-3]),
        "wheelset_y": np.array([0.0, 4e-3, 0.0, 0.0]),
        "wheelset_psi": np.array([0.0, 5e-3, 0.0, 0.0]),
    }
    view, rest = drawn(coach, moved, 50.0), drawn(coach, {}, 50.0)
    geometry = coach.geometry
    assert [part for _, _, part, _, _ in view._bodies].count("wheelset") == 4 * 3
    for (artist, _, part, number, position), (before, *_) in zip(view._bodies, rest._bodies, strict=True):
        here, there = (polygon.get_xy()[:-1] for polygon in (artist, before))
        if part == "carbody":
            expected = np.column_stack([there[:, 0] - 5e-3 * there[:, 1], there[:, 1] + 0.1 + 5e-3 * there[:, 0]])
        elif part == "bogie":
            assert position == pytest.approx((1, -1)[number] * geometry.half_pivot_distance)
            expected = there + np.array([0.0, 50.0 * moved["bogie_y"][number]])
        elif number == 1:
            assert position == pytest.approx(geometry.half_pivot_distance - geometry.half_wheelbase)
            expected = np.column_stack([there[:, 0] - 0.25 * there[:, 1], there[:, 1] + 0.2 + 0.25 * (there[:, 0] - position)])
        else:
            expected = there
        np.testing.assert_allclose(here, expected, atol=1e-12)


def test_the_track_is_drawn_under_the_vehicle(wheelset):
    view = drawn(wheelset, {}, 20.0, distance=7.0, track=lambda along: 1e-3 * along)
    lines = {offset: line.get_ydata() for line, offset in view._rails}
    gauge, clearance = wheelset.geometry.half_gauge, 20.0 * wheelset.contact.flange_clearance
    assert {round(abs(offset), 6) for offset in lines} == {round(gauge + d, 6) for d in (-0.035, 0.035, clearance)}
    for offset, heights in lines.items():
        np.testing.assert_allclose(heights, offset + 0.02 * view.along, atol=1e-12)


@pytest.mark.parametrize(
    ("bogies", "axles"), [((1.0, -1.0), (1.0, 0.0, -1.0)), ((1.0, 0.0, -1.0), (1.0, -1.0)), ((1.0,), (0.0,))]
)
def test_any_number_of_bogies_and_axles(coach, bogies, axles):
    geometry = dataclasses.replace(coach.geometry, bogie_pattern=bogies, axle_pattern=axles)
    vehicle = dataclasses.replace(coach, geometry=geometry)
    course = of_mode(vehicle, railjax.modes(vehicle, 60.0))
    assert course.coordinates["wheelset_y"].shape == (PERIOD_FRAMES, len(bogies) * len(axles))
    stage = Stage(vehicle, course, 50.0, 1.0)
    stage.show(7)
    assert sum(part == "wheelset" for _, _, part, _, _ in stage.view._bodies) == 3 * len(bogies) * len(axles)


def test_magnification_is_a_round_number():
    assert [magnification(largest) for largest in (0.009, 0.008, 0.004, 1.0, 0.0)] == [50.0, 50.0, 100.0, 0.5, 1.0]


def test_a_mode_turns_once(bogie):
    found = railjax.modes(bogie, 60.0)
    course = of_mode(bogie, found, 1)
    assert largest_displacement(bogie, course) == pytest.approx(MODE_AMPLITUDE)
    assert course.period == pytest.approx(1.0 / found.frequency[1])
    scale = course.coordinates["bogie_y"][0, 0] / found.shapes[found.coordinates.index("bogie_y[0]"), 1].real
    turning = np.exp(2j * np.pi * np.arange(PERIOD_FRAMES) / PERIOD_FRAMES)
    for k in range(2):
        shape = found.shapes[found.coordinates.index(f"wheelset_psi[{k}]"), 1]
        np.testing.assert_allclose(course.coordinates["wheelset_psi"][:, k], scale * (shape * turning).real, atol=1e-12)
    assert not course.scaled
    assert found.names[1] in course.title


def test_a_period_is_cut_as_the_slow_motion_wants(bogie):
    found = railjax.modes(bogie, 60.0)
    period = 1.0 / found.frequency[0]
    assert len(of_mode(bogie, found, slow=40.0).time) == round(20.0 * 40.0 * period)
    assert len(of_mode(bogie, found, slow=0.35 / period).time) == 16
    with pytest.raises(railjax.InputError, match="slow must be at least"):
        of_mode(bogie, found, slow=0.3 / period)


def test_a_limit_cycle_is_its_own_mirror_image_half_a_period_later(wheelset):
    cycle = railjax.hunting_branch(wheelset, highest_speed=36.0).at(34.0)
    course = of_limit_cycle(wheelset, cycle)
    y = course.coordinates["wheelset_y"][:, 0]
    assert np.abs(y).max() == pytest.approx(cycle.amplitude, rel=2e-3)
    half = PERIOD_FRAMES // 2
    for values in course.coordinates.values():
        np.testing.assert_allclose(values[half:], -values[:half], atol=2e-6)
    assert "stable limit cycle at 122.4 km/h" in course.title
    # the trail behind the wheelset goes on without a jump where the period ends
    stage = Stage(wheelset, course, 20.0, 1.0)
    stage.show(3)
    along, lateral = stage.view.trail.get_data()
    assert along[-1] == 0.0
    assert lateral[-1] == pytest.approx(20.0 * y[3])
    assert np.max(np.abs(np.diff(lateral))) < 20.0 * np.max(np.abs(np.diff(y))) * 1.01


def test_a_run_is_shown_as_it_was_recorded(wheelset, run):
    course = of_simulation(wheelset, run, 0.5, 1.5, slow=5.0)
    assert len(course.time) == 101
    np.testing.assert_allclose(np.diff(course.time), 0.01)
    index = np.rint(course.time / 2e-3).astype(int)
    np.testing.assert_allclose(course.coordinates["wheelset_y"][:, 0], np.asarray(run["wheelset_y"])[index, 0], atol=1e-12)
    np.testing.assert_allclose(course.distance, SPEED * course.time)
    distance = np.linspace(5.0, 55.0, 101)
    expected = railjax.alignment(railjax.SinusoidTrack(2e-3, 12.0), distance)
    np.testing.assert_allclose(course.alignment(distance), expected, atol=2e-6)
    assert len(of_simulation(wheelset, run).time) == 151


def test_what_is_missing_is_named(wheelset, coach, run):
    bare = dataclasses.replace(run, channels={"alignment": run["alignment"]})
    with pytest.raises(
        railjax.InputError, match=r"not recorded wheelset_y, wheelset_psi: .*record=railjax\.animation_channels\(vehicle\)"
    ):
        of_simulation(wheelset, bare)
    with pytest.raises(railjax.InputError, match=r"start and stop must lie within the run, 0 to 1\.998 s"):
        of_simulation(wheelset, run, 0.5, 3.0)
    with pytest.raises(railjax.InputError, match="500001 pictures"):
        of_simulation(wheelset, run, 0.5, 1.5, slow=25e3)
    lanes = dataclasses.replace(run, code=jnp.zeros(2, int))
    with pytest.raises(railjax.InputError, match="2 lanes"):
        of_simulation(wheelset, lanes)
    gone = dataclasses.replace(run, code=jnp.asarray(1))
    with pytest.raises(railjax.NumericalError, match="diverged"):
        of_simulation(wheelset, gone)
    two = railjax.replace(wheelset)
    two = dataclasses.replace(two, geometry=dataclasses.replace(two.geometry, axle_pattern=(1.0, -1.0)))
    with pytest.raises(railjax.InputError, match="of another vehicle: its wheelset_y has 1 parts"):
        of_simulation(two, run)
    fast = railjax.modes(wheelset, SPEED)
    with pytest.raises(railjax.InputError, match="mode must lie between 0 and"):
        of_mode(wheelset, fast, 9)
    damped = railjax.modes(coach, 3.0)
    overdamped = int(np.flatnonzero(damped.frequency == 0.0)[0])
    with pytest.raises(railjax.InputError, match="does not oscillate"):
        of_mode(coach, damped, overdamped)


def test_writes_a_gif_that_goes_round(wheelset, run, tmp_path):
    seen = []
    film = railjax.animate(
        wheelset, run, tmp_path / "run.gif", start=1.0, stop=1.2, slow=2, progress=lambda *step: seen.append(step)
    )
    assert film.frames == 9
    assert seen == [(k + 1, 9) for k in range(9)]
    with Image.open(film.path) as image:
        assert image.n_frames == 9
        assert image.info["loop"] == 0
        assert image.info["duration"] == 50
        pictures = []
        for k in (0, 8):
            image.seek(k)
            pictures.append(np.asarray(image.convert("L"), float))
    assert (np.abs(pictures[0] - pictures[1]) > 100).sum() > 500
    assert f"{film.magnified:g} times, slow motion 1:2" in str(film)


@needs_chromium
def test_writes_a_page_that_needs_nothing_else(wheelset, run, tmp_path):
    film = railjax.animate(wheelset, run, tmp_path / "run.html", start=1.0, stop=1.2)
    assert film.frames == 21
    page = film.path.read_text(encoding="utf-8")
    assert "http" not in page
    assert 'class="fa' not in page
    found = looked_at(page, tmp_path, width=1000)
    assert found["console"] == []
    assert found["fetched"] == []
    ((alternative, width),) = found["images"]
    assert "single-wheelset at 108.0 km/h" in alternative
    assert width > 500


def test_files_that_cannot_be_written(wheelset, still, run, tmp_path, monkeypatch):
    with pytest.raises(railjax.InputError, match=r"must end in \.gif, \.mp4 or \.html"):
        railjax.animate(wheelset, still, tmp_path / "mode.avi")
    with pytest.raises(railjax.InputError, match="cannot be written"):
        railjax.animate(wheelset, still, tmp_path / "nowhere" / "mode.gif")
    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", lambda: False)
    with pytest.raises(railjax.InputError, match="no ffmpeg"):
        railjax.animate(wheelset, still, tmp_path / "mode.mp4")
    with pytest.raises(railjax.InputError, match="start and stop are for a Simulation"):
        railjax.animate(wheelset, still, tmp_path / "mode.gif", start=1.0)
    with pytest.raises(railjax.InputError, match="slow must be positive"):
        railjax.animate(wheelset, run, tmp_path / "run.gif", slow=0.0)
    assert not list(tmp_path.iterdir())


def test_command_line(tmp_path, capsys):
    out = tmp_path / "mode.gif"
    assert status(["animate", "single-wheelset", "--speed-kmh", "108", "--mode", "1", "--out", str(out), "--json"]) == 0
    text, error = capsys.readouterr()
    content = json.loads(text)
    assert error == ""
    assert content["shown"] == "mode"
    assert content["frames"] == PERIOD_FRAMES
    assert out.stat().st_size > 10_000
    out = tmp_path / "run.gif"
    arguments = ["--speed-kmh", "108", "--duration-s", "0.5", "--start-s", "0.45", "--out", str(out)]
    assert status(["animate", "single-wheelset", *arguments]) == 0
    assert "slow motion 1:5" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "x.gif", "--mode", "1", "--limit-cycle"], "exclude each other"),
        (["--out", "x.gif", "--mode", "1", "--track", "erri-low"], "--track is for a run, not for --mode"),
        (["--out", "x.gif", "--limit-cycle", "--stop-s", "1"], "--limit-cycle shows one period"),
        (["--out", "x.gif", "--mode", "7"], "--mode must lie between 1 and"),
        (["--out", "x.gif", "--damper", "skyhook"], "no secondary suspension"),
        (["--out", "x.gif", "--duration-s", "0.5", "--stop-s", "2"], "within the run"),
        (["--out", "x.webm"], "must end in .gif, .mp4 or .html"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert status(["animate", "single-wheelset", *arguments]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert len(error.splitlines()) == 1
    assert message in error
    assert not list(tmp_path.iterdir())
