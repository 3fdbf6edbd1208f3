"""Onsets of hunting by simulation against the critical speeds computed otherwise."""

import numpy as np

import railjax
from railjax.tuning.onset import QuietSpeeds, first_onset

KMH = 3.6


def test_a_passive_vehicle_is_quiet_up_to_its_critical_speeds(coach):
    """245.6 and 234.2 km/h, on a grid of 1 to 2 km/h between 200 and 260; at the linear one it takes longer than a minute to grow."""
    quiet = QuietSpeeds(coach, railjax.PassiveDamper(), 200.0 / KMH, 1e-3)
    assert -1.5 < quiet.small * KMH - 245.6 < 3.0
    assert -2.0 < quiet.large * KMH - 234.2 < 1.0
    assert quiet.kept(railjax.PassiveDamper())
    assert not quiet.kept(railjax.PassiveDamper(0.0))
    # where it hunts at once nothing is asked for
    above = QuietSpeeds(coach, railjax.PassiveDamper(), 250.0 / KMH, 1e-3)
    assert np.isnan(above.speeds).all()
    assert above.kept(railjax.PassiveDamper(0.0))


def test_the_lowest_speed_from_which_on_up_it_hunts():
    for quiet, first in (((1, 1, 0, 0), 2), ((0, 1, 0, 0), 2), ((0, 0), 0), ((1, 1), 2)):
        assert first_onset(np.array(quiet, bool)) == first
